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
"""Points as a coloured PLY, which every viewer of point clouds reads."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.report.files import atomic_write
from selfcal_ros.values.tracks import Tracks

_KINDS = {'f4': 'float', 'u1': 'uchar'}


def write_ply(path, points: np.ndarray, colours: np.ndarray | None = None,
              comments: Iterable[str] = ()) -> Path:
    """
    Write points as binary little-endian PLY, whole or not at all.

    Parameters
    ----------
    path : str or Path
    points : ndarray, shape (P, 3)
    colours : ndarray of uint8, shape (P, 3), optional
        Red, green, blue.
    comments : iterable of str
        For the header: the frame, the scale.

    Returns
    -------
    Path

    Raises
    ------
    ArgumentError
        If shapes differ.
    InputError
        If the file cannot be written.

    """
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ArgumentError(f'Points must be (P, 3), not {points.shape}.')
    columns = [(name, 'f4', points[:, axis]) for axis, name in enumerate('xyz')]
    if colours is not None:
        colours = np.asarray(colours)
        if colours.shape != points.shape or colours.dtype != np.uint8:
            raise ArgumentError(f'Colours must be uint8 of shape {points.shape}, not '
                                f'{colours.dtype} of {colours.shape}.')
        columns += [(name, 'u1', colours[:, k]) for k, name in enumerate(('red', 'green', 'blue'))]
    records = np.zeros(len(points), [(name, '<' + kind) for name, kind, _ in columns])
    for name, _, values in columns:
        records[name] = values
    header = ['ply', 'format binary_little_endian 1.0']
    # a line break in a comment would end it
    header += ['comment ' + ' '.join(comment.encode('ascii', 'replace').decode().split())
               for comment in comments]
    header += [f'element vertex {len(points)}',
               *(f'property {_KINDS[kind]} {name}' for name, kind, _ in columns), 'end_header\n']
    return atomic_write(path, '\n'.join(header).encode('ascii') + records.tobytes())


def point_colours(tracks: Tracks, wanted: np.ndarray, frames: Iterable) -> np.ndarray:
    """
    Find the colours of points: the mean over the images that saw them.

    Parameters
    ----------
    tracks : Tracks
    wanted : ndarray of int, shape (P,)
        Identities of the points.
    frames : iterable of Frame
        Images with `index`, `image` (grey) and `bgr` (colour, or None).

    Returns
    -------
    ndarray of uint8, shape (P, 3)
        Red, green, blue; mid grey for a point that no image shows.

    """
    wanted = np.asarray(wanted)
    total, count = np.zeros((len(wanted), 3)), np.zeros(len(wanted))
    order = np.argsort(wanted)
    for frame in frames:
        mask = np.flatnonzero(tracks.frame == frame.index)
        if not len(mask) or not len(wanted):
            continue
        place = order[np.minimum(np.searchsorted(wanted, tracks.track[mask], sorter=order),
                                 len(wanted) - 1)]
        known = wanted[place] == tracks.track[mask]
        mask, place = mask[known], place[known]
        image = frame.image[..., None] if frame.bgr is None else frame.bgr[..., ::-1]
        column, row = np.rint(tracks.xy[mask]).astype(int).T
        inside = (row >= 0) & (row < image.shape[0]) & (column >= 0) & (column < image.shape[1])
        # a track is seen once in an image, so no place occurs twice
        total[place[inside]] += image[row[inside], column[inside]]
        count[place[inside]] += 1
    colours = np.full((len(wanted), 3), 128, np.uint8)
    seen = count > 0
    colours[seen] = np.rint(total[seen] / count[seen, None])
    return colours
