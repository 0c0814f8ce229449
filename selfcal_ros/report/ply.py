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
"""Points and cameras as a coloured PLY, which every viewer of point clouds reads."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.values.output_files import atomic_write
from selfcal_ros.values.tracks import Tracks

_KINDS = {'f4': 'float', 'u1': 'uchar', 'i4': 'int'}
#: Cameras are drawn so deep, in steps between views, and in this colour (red, green, blue).
FRUSTUM_DEPTH, FRUSTUM_COLOUR = 0.3, (230, 60, 30)
#: Corners of a frustum after its tip, and what its edges connect.
_CORNERS = 4
_EDGES = np.array([(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)])
#: Of a vertex that is a camera's.
NO_TRACK = -1


def camera_frusta(camera: Camera, rotation: np.ndarray, centre: np.ndarray,
                  step: float = 1.0) -> np.ndarray:
    """
    Draw cameras as pyramids: the centre, and the corners of the image in front of it.

    Parameters
    ----------
    camera : Camera
    rotation : ndarray, shape (V, 3, 3)
        World from camera.
    centre : ndarray, shape (V, 3)
    step : float
        Length of a usual step between views.

    Returns
    -------
    ndarray, shape (V, 5, 3)
        The tip; then top left, top right, bottom right and bottom left of the image, as a pinhole
        sees it.

    """
    K = camera.K
    right, low = camera.width - 0.5, camera.height - 0.5
    corners = np.array([(-0.5, -0.5), (right, -0.5), (right, low), (-0.5, low)])
    local = np.zeros((1 + _CORNERS, 3))
    local[1:, :2] = (corners - K[:2, 2]) / np.diag(K)[:2]
    local[1:, 2] = 1
    depth = FRUSTUM_DEPTH * step
    placed: np.ndarray = depth * local @ np.swapaxes(rotation, 1, 2) + centre[:, None]
    return placed


def write_ply(path: str | Path, points: np.ndarray, colours: np.ndarray | None = None,
              comments: Iterable[str] = (), *, tracks: np.ndarray | None = None,
              sigma: np.ndarray | None = None, frusta: np.ndarray | None = None) -> Path:
    """
    Write points, and cameras if there are any, as binary little-endian PLY, whole or not at all.

    Parameters
    ----------
    path : str or Path
    points : ndarray, shape (P, 3)
    colours : ndarray of uint8, shape (P, 3), optional
        Red, green, blue.
    comments : iterable of str
        For the header: the frame, the scale.
    tracks : ndarray of int, shape (P,), optional
        What each point is called; left out where one does not fit into 32 bits.
    sigma : ndarray, shape (P,), optional
        Largest standard deviation of each point.
    frusta : ndarray, shape (V, 5, 3), optional
        Of `camera_frusta`. Their corners follow the points as vertices, with `NO_TRACK` and no
        sigma, and edges connect them.

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
    count, views = len(points), 0 if frusta is None else len(frusta)
    drawn = np.zeros((0, 3)) if frusta is None else np.reshape(frusta, (-1, 3))
    columns: list[tuple[str, str, Any, Any]] = [
        (name, 'f4', points[:, axis], drawn[:, axis]) for axis, name in enumerate('xyz')]
    if colours is not None:
        colours = np.asarray(colours)
        if colours.shape != points.shape or colours.dtype != np.uint8:
            raise ArgumentError(f'Colours must be uint8 of shape {points.shape}, not '
                                f'{colours.dtype} of {colours.shape}.')
        columns += [(name, 'u1', colours[:, k], FRUSTUM_COLOUR[k])
                    for k, name in enumerate(('red', 'green', 'blue'))]
    if tracks is not None and np.abs(tracks).max(initial=0) < 2**31:
        columns.append(('track', 'i4', tracks, NO_TRACK))
    if sigma is not None:
        columns.append(('sigma', 'f4', sigma, 0.0))
    records = np.zeros(count + len(drawn), [(name, '<' + kind) for name, kind, *_ in columns])
    for name, _, values, of_cameras in columns:
        records[name][:count], records[name][count:] = values, of_cameras
    header = ['ply', 'format binary_little_endian 1.0']
    # a line break in a comment would end it
    header += ['comment ' + ' '.join(comment.encode('ascii', 'replace').decode().split())
               for comment in comments]
    header += [f'element vertex {len(records)}',
               *(f'property {_KINDS[kind]} {name}' for name, kind, *_ in columns)]
    body = records.tobytes()
    if views:
        first = count + (1 + _CORNERS) * np.arange(views)
        edges = first[:, None, None] + _EDGES
        header += [f'element edge {views * len(_EDGES)}', 'property int vertex1',
                   'property int vertex2']
        body += edges.astype('<i4').tobytes()
    return atomic_write(path, '\n'.join([*header, 'end_header\n']).encode('ascii') + body)


def point_colours(tracks: Tracks, wanted: np.ndarray, frames: Iterable[Frame]) -> np.ndarray:
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
