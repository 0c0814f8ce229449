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
"""What is given in place of a camera file by mistake, and what to give instead."""

from __future__ import annotations

from contextlib import suppress
import os
from pathlib import Path

from selfcal_ros.errors import InputError
from selfcal_ros.values.foreign_files import BAG_BEGINNINGS
from selfcal_ros.values.output_files import RECORDED

#: How files begin that are no text: at which byte, with what, and what they are.
_BEGINNINGS = ((0, b'\x89PNG', 'an image'), (0, b'\xff\xd8\xff', 'an image'),
               (0, b'II*\0', 'an image'), (0, b'MM\0*', 'an image'),
               (4, b'ftyp', 'a video'), (0, b'RIFF', 'a video'), (0, b'\x1aE\xdf\xa3', 'a video'),
               *((0, beginning, 'a bag') for beginning in BAG_BEGINNINGS.values()))


def refuse_other_kinds(path: str | os.PathLike[str]) -> None:
    """
    Refuse what is given for a camera file, and is a report, an image, a video, a bag or a folder.

    Parameters
    ----------
    path : str or Path
        What is of no such kind passes, and so does what cannot be read.

    Raises
    ------
    InputError
        The sentence says what it is, and what to give.

    """
    path = Path(path)
    if path.is_dir():
        if (path / 'metadata.yaml').is_file():
            _refuse_recording(path, 'a bag')
        if not _files_in(path) and any(one.suffix.lower() in RECORDED for one in path.iterdir()):
            _refuse_recording(path, 'a folder of images')
        raise InputError(f'{path} is a folder, and no camera file; name '
                         f'{_files_in(path) or "a file in it"}.')
    kind = _kind_of(path)
    if kind == 'a report':
        raise InputError(f'{path} is a report, and no camera file; give '
                         f'{_files_in(path.parent) or "camera.yaml or result.json"} of the same '
                         'calibration.')
    if kind == 'an image':
        raise InputError(f'{path} is an image, and no camera file; give camera.yaml or '
                         'result.json of a calibration.')
    if kind:
        _refuse_recording(path, kind)


def _kind_of(path: Path) -> str:
    """Tell by its first bytes what a file is that holds no camera; '' for anything else."""
    # a pipe could not be read a second time
    if not path.is_file():
        return ''
    head = b''
    with suppress(OSError), path.open('rb') as stream:
        head = stream.read(1000)
    if head.lstrip().lower().startswith((b'<!doctype html', b'<html')):
        return 'a report'
    return next((kind for start, begins, kind in _BEGINNINGS if head[start:].startswith(begins)),
                '')


def _refuse_recording(path: Path, kind: str) -> None:
    raise InputError(f'{path} is {kind}, and no camera file; give the '
                     'camera.yaml that selfcal calibrate makes of it.')


def _files_in(folder: Path) -> str:
    """Name the files of a calibration in a folder, '' where there are none."""
    found = [folder / name for name in ('camera.yaml', 'result.json')]
    return ' or '.join(str(one) for one in found if one.is_file())
