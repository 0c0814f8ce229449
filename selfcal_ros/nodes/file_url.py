# Copyright 2026 selfcal_ros contributors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Where a calibration file is: a path or a URL, in the words of camera_info_manager."""

from __future__ import annotations

import os
from pathlib import Path
import re

from selfcal_ros.errors import ArgumentError

#: What a URL begins with; camera_info_manager ignores the case, too.
_SCHEME = re.compile(r'([A-Za-z][A-Za-z0-9+.-]*):')
_VARIABLE = re.compile(r'\$\{([^}]*)\}')


def path_of(url: str, camera_name: str) -> Path:
    """
    Return the path of a calibration file.

    Parameters
    ----------
    url : str
        A path (~ is the home folder), file:///PATH, or package://PACKAGE/PATH, which lies in the
        share folder of a package of ROS. ${NAME} is the name of the camera, ${ROS_HOME} the
        folder of ROS (~/.ros unless the environment says otherwise).
    camera_name : str

    Raises
    ------
    ArgumentError
        If the URL is of another kind, or what it names is not there.

    """
    home = os.path.expanduser(os.environ.get('ROS_HOME') or '~/.ros')
    known = {'NAME': camera_name, 'ROS_HOME': home}

    def value(match: re.Match[str]) -> str:
        if match[1] not in known:
            raise ArgumentError(f'There is no {match[0]} in the URL of a calibration file, only '
                                f'${{NAME}} and ${{ROS_HOME}}: {url!r:.120}.')
        return known[match[1]]

    text = _VARIABLE.sub(value, url)
    scheme = _SCHEME.match(text)
    kind = scheme[1].lower() if scheme else ''
    if kind == 'package':
        return _in_package(text, url)
    if kind == 'file':
        text = text[len('file:'):]
        if not text.startswith('///'):
            raise ArgumentError(f'A file URL has three slashes, file:///PATH, not {url!r:.120}.')
        text = text[2:]
    elif kind:
        raise ArgumentError(f'A calibration file is a path, file:///PATH or package://PACKAGE/PATH'
                            f', not {url!r:.120}.')
    try:
        return Path(text).expanduser()
    except RuntimeError:
        raise ArgumentError(f'There is no such home folder as in {text!r}; give the full path '
                            'of the calibration file.') from None


def _in_package(text: str, url: str) -> Path:
    """Return the path in the share folder of a package."""
    package, _, inside = text[len('package:'):].removeprefix('//').partition('/')
    if not package or not inside or not text[len('package:'):].startswith('//'):
        raise ArgumentError('A package URL names a package and a file, package://PACKAGE/PATH, '
                            f'not {url!r:.120}.')
    from ament_index_python.packages import get_package_share_directory
    try:
        return Path(get_package_share_directory(package)) / inside
    except (LookupError, OSError, ValueError):
        raise ArgumentError(f'There is no package {package!r:.60} of ROS here, as in '
                            f'{url!r:.120}; build it and source its workspace.') from None
