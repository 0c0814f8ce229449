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
"""Where the launch, config and bag files of the package are, however it was installed."""

from __future__ import annotations

from pathlib import Path

from selfcal_ros.errors import InputError


def shared_file(relative: str) -> Path:
    """
    Find a file or folder that comes with the package.

    Parameters
    ----------
    relative : str
        'config/fastdds.xml', for example.

    Raises
    ------
    InputError
        If the installation does not have it.

    """
    # upwards from here lie the repository, or the prefix of pip and of colcon
    for folder in Path(__file__).resolve().parents:
        if (folder / 'package.xml').is_file() and (folder / relative).exists():
            return folder / relative
        if (folder / 'share' / 'selfcal_ros' / relative).exists():
            return folder / 'share' / 'selfcal_ros' / relative
    raise InputError(f'{relative} is not installed (pip install -e leaves such files out); '
                     'install with "pip install ." or run from the repository.')
