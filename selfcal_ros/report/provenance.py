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
"""How a report came about: when, by which command, from what, and with which versions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
import os
from pathlib import Path
import platform
import shlex
import sys

from selfcal_ros.values.tracks import Tracks
from selfcal_ros.version import __version__

#: Stamps before this are of a clock that nobody set: 2000-01-01, nanoseconds.
_FIRST_DATE_NS = 946_684_800 * 10**9
#: Packages that decide numbers, by the names of their modules.
_PACKAGES = {'numpy': 'NumPy', 'scipy': 'SciPy', 'cv2': 'OpenCV', 'rosbags': 'rosbags'}


@dataclass(frozen=True)
class Provenance:
    """
    What is needed to make a report again.

    Attributes
    ----------
    date : datetime
    command : tuple of str
        Words of the command line; empty where there was none.
    paths : tuple of str
        What was read, as it was named.
    versions : dict of str to str

    """

    date: datetime
    command: tuple[str, ...] = ()
    paths: tuple[str, ...] = ()
    versions: dict[str, str] = field(default_factory=dict)

    @staticmethod
    def of_this_run(command: Sequence[str] = (), paths: Sequence[str | Path] = ()) -> Provenance:
        """
        Take the time and the versions of this process.

        The variable SOURCE_DATE_EPOCH, where it is set, stands for the time (reproducible-builds
        specification).
        """
        epoch = os.environ.get('SOURCE_DATE_EPOCH', '')
        date = (datetime.fromtimestamp(int(epoch), timezone.utc) if epoch.isdecimal()
                else datetime.now(timezone.utc))
        return Provenance(date, tuple(command), tuple(map(str, paths)), _versions())

    def rows(self, tracks: Tracks | None = None) -> list[tuple[str, str]]:
        """Return names and values for a table; `tracks` tell when the images were taken."""
        rows = [('made', f'{self.date.astimezone(timezone.utc):%Y-%m-%d %H:%M:%S} UTC')]
        if self.command:
            rows.append(('command', shlex.join(self.command)))
        rows += [('input', f'{path}{_size_text(path)}') for path in self.paths]
        taken = _taken(tracks)
        if taken:
            rows.append(('images taken', taken))
        return rows + [('versions', ', '.join(f'{name} {version}'
                                              for name, version in self.versions.items()))]


def _versions() -> dict[str, str]:
    """Return the versions of what is loaded: what is not has decided nothing."""
    loaded = {title: getattr(sys.modules.get(name), '__version__', '')
              for name, title in _PACKAGES.items()}
    return {'selfcal_ros': __version__, 'Python': platform.python_version(),
            **{title: version for title, version in loaded.items() if version}}


def bytes_text(count: int) -> str:
    """Write a number of bytes with its unit."""
    return f'{count / 1e6:.1f} MB' if count > 95_000 else f'{count / 1e3:.1f} kB'


def _size_text(path: str) -> str:
    """Say how large a file, or all files of a folder, are; nothing where that is not known."""
    try:
        place = Path(path)
        files = [place] if place.is_file() else [one for one in place.iterdir() if one.is_file()]
        size = sum(one.stat().st_size for one in files)
    except OSError:
        return ''
    count = ('' if place.is_file() else
             f'{len(files)} file{"s" if len(files) != 1 else ""}, ')
    return f' ({count}{bytes_text(size)})'


def _taken(tracks: Tracks | None) -> str:
    """Say from when to when the images were taken, where their stamps are dates."""
    stamps = tuple((tracks.stamps_ns or {}).values()) if tracks is not None else ()
    if not stamps:
        return ''
    first, last = min(stamps), max(stamps)
    span = f'{(last - first) / 1e9:.1f} s'
    if first < _FIRST_DATE_NS:
        return f'over {span}'
    start = datetime.fromtimestamp(first // 10**9, timezone.utc)
    return f'{start:%Y-%m-%d %H:%M:%S} UTC, over {span}'
