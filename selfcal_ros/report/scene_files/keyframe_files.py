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
"""The images of the views: read once more, for their names, the points' colours, and as files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import os
from pathlib import Path

import cv2
import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.frame_source import Frame, FrameSource
from selfcal_ros.report.ply import point_colours
from selfcal_ros.values.output_files import atomic_write
from selfcal_ros.values.tracks import Tracks

#: Beside a model, the images that come from a bag or a video.
FOLDER = 'images'
#: Names that `frame_name` gives.
PATTERN = 'frame_*.png'


@dataclass(frozen=True)
class KeyframeFiles:
    """
    Images of the views.

    Attributes
    ----------
    names : tuple of str
        Of the file of every view, without its folder.
    folder : Path or None
        Where these files have been from the start; None: they are written, or there are none.
    colours : ndarray of uint8, shape (P, 3), or None
        Red, green and blue of the points.
    written : bool
        Whether they have been written as files.

    """

    names: tuple[str, ...]
    folder: Path | None
    colours: np.ndarray | None
    written: bool = False

    def relative_to(self, place: Path) -> list[str]:
        """Return the files as seen from a folder, whose own images stand in `FOLDER`."""
        if self.folder is None:
            return [f'{FOLDER}/{name}' for name in self.names]
        start = Path(os.path.relpath(os.path.realpath(self.folder), os.path.realpath(place)))
        return [(start / name).as_posix() for name in self.names]


def frame_name(frame: int) -> str:
    """Name the file of an image that has none of its own."""
    return f'frame_{frame:06d}.png'


def read_keyframes(source: FrameSource, views: np.ndarray, tracks: Tracks, points: np.ndarray,
                   folders: Sequence[Path] = ()) -> KeyframeFiles:
    """
    Read the images of the views again.

    Parameters
    ----------
    source : FrameSource
        Opened in colour.
    views : ndarray of int, shape (V,)
        Frame of each.
    tracks : Tracks
    points : ndarray of int, shape (P,)
        Tracks whose colours are wanted.
    folders : sequence of Path
        Where images that are no files yet are written as PNG, each whole or not at all. Folders
        are made where they are missing.

    Returns
    -------
    KeyframeFiles

    Raises
    ------
    InputError
        If an image cannot be read any more, or a file not be written.

    """
    if source.kind == 'tracks':
        return KeyframeFiles(tuple(frame_name(int(one)) for one in views), None, None)
    names: dict[int, str] = {}
    # half an image is in no file yet
    are_files = source.kind == 'images' and source.excerpt.half is None
    if not are_files:
        for folder in folders:
            _make(folder)

    def each() -> Iterator[Frame]:
        for frame in source.only(views):
            names[frame.index] = frame.name if are_files else frame_name(frame.index)
            if not are_files and folders:
                picture = frame.image if frame.bgr is None else frame.bgr
                data = cv2.imencode('.png', picture)[1].tobytes()
                for folder in folders:
                    atomic_write(folder / names[frame.index], data)
            yield frame

    colours = point_colours(tracks, points, each())
    missing = [int(one) for one in views if int(one) not in names]
    if missing:
        raise InputError(f'{source.path} has changed: image {missing[0]} is not there any more.')
    return KeyframeFiles(tuple(names[int(one)] for one in views),
                         source.path if are_files else None, colours,
                         bool(folders) and not are_files)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f'{folder} cannot be made: {error.strerror}.') from None
