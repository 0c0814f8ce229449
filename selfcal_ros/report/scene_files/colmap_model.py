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
"""
The text model of COLMAP: cameras.txt, images.txt, points3D.txt.

COLMAP's poses lead from the world to the camera, quaternions have w first, and (0, 0) is the
corner of the top-left pixel: half a pixel is added to every position and principal point.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.report.camera_files.colmap_cameras import colmap_line, HALF_PIXEL, holds
from selfcal_ros.report.scene_files.exported_scene import ExportedScene
from selfcal_ros.values.output_files import atomic_write, check_writable

FILES = ('cameras.txt', 'points3D.txt', 'images.txt')
#: Files that COLMAP reads in place of ours, or that belong to another model.
RIVALS = ('cameras.bin', 'images.bin', 'points3D.bin', 'rigs.bin', 'frames.bin', 'rigs.txt',
          'frames.txt')


def check_colmap_folder(folder: Path) -> None:
    """
    Make sure beforehand that a model can be written.

    Raises
    ------
    InputError, ArgumentError
        If it cannot, or another one is there that would be read instead.

    """
    if not folder.exists():
        check_writable(folder)
        return
    if not folder.is_dir():
        raise ArgumentError(f'{folder} is a file; --colmap takes the name of a folder.')
    rivals = [name for name in RIVALS if (folder / name).exists()]
    if rivals:
        raise ArgumentError(f'{folder} holds another model of COLMAP ({", ".join(rivals)}), which '
                            'would be read with ours or in its place; choose another folder.')
    for name in FILES:
        check_writable(folder / name)


def write_colmap(folder: Path, scene: ExportedScene, names: Sequence[str],
                 colours: np.ndarray | None = None, comments: Sequence[str] = ()) -> list[Path]:
    """
    Write a model, each file whole or not at all.

    Parameters
    ----------
    folder : Path
        Made where it is missing.
    scene : ExportedScene
    names : sequence of str
        Of the image of every view.
    colours : ndarray of uint8, shape (P, 3), optional
        Red, green and blue of the points; mid grey by default.
    comments : sequence of str
        For the heads of the files.

    Returns
    -------
    list of Path

    Raises
    ------
    ArgumentError
        If COLMAP has no model for the camera, or cannot hold a name.
    InputError
        If a file cannot be written.

    """
    head = ''.join(f'# {" ".join(comment.split())}\n' for comment in comments)
    # all of it before the first file, so that a refusal leaves none
    texts = (head + _cameras(scene), head + _points(scene, colours), head + _images(scene, names))
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f'{folder} cannot be made: {error.strerror}.') from None
    return [atomic_write(folder / name, text) for name, text in zip(FILES, texts)]


def _cameras(scene: ExportedScene) -> str:
    """Return cameras.txt: one camera, or one for every view where it zooms."""
    if not holds(scene.camera):
        raise ArgumentError(f'COLMAP has no model for the lens {scene.camera.model}.')
    cameras = scene.cameras or (scene.camera,)
    return ('# Camera list with one line of data per camera:\n'
            '#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n'
            f'# Number of cameras: {len(cameras)}\n'
            + ''.join(f'{number} {colmap_line(camera)}\n'
                      for number, camera in enumerate(cameras, start=1)))


def _images(scene: ExportedScene, names: Sequence[str]) -> str:
    """Return images.txt: pose and name of every view, then what it saw."""
    odd = next((name for name in names if len(name.split()) != 1 or name != name.strip()), None)
    if odd is not None:
        raise ArgumentError(f"COLMAP's text model ends a name at a space, and the image "
                            f'{odd!r:.80} has one; rename it.')
    poses = scene.cam_from_world
    quaternions = Rotation.from_matrix(poses[:, :, :3]).as_quat(canonical=True)
    lines = ['# Image list with two lines of data per image:',
             '#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME',
             '#   POINTS2D[] as (X, Y, POINT3D_ID)', f'# Number of images: {len(poses)}']
    for view, name in enumerate(names):
        x, y, z, w = quaternions[view]
        numbers = ' '.join(repr(float(one)) for one in (w, x, y, z, *poses[view, :, 3]))
        lines.append(f'{view + 1} {numbers} {view + 1 if scene.cameras else 1} {name}')
        rows = scene.rows_of(view)
        # points are counted from 1, and -1 is none
        tied = scene.point[rows] + (scene.point[rows] >= 0)
        lines.append(' '.join(f'{u!r} {v!r} {point}' for (u, v), point in zip(
            (scene.xy[rows] + HALF_PIXEL).tolist(), tied.tolist())))
    return '\n'.join(lines) + '\n'


def _points(scene: ExportedScene, colours: np.ndarray | None) -> str:
    """Return points3D.txt: place, colour and track of every point."""
    # the place of each observation in its image
    first = np.searchsorted(scene.view, scene.view)
    place = np.arange(len(scene.view)) - first
    tied = np.flatnonzero(scene.point >= 0)
    order = tied[np.argsort(scene.point[tied], kind='stable')]
    starts = np.searchsorted(scene.point[order], np.arange(len(scene.points) + 1))
    lines = ['# 3D point list with one line of data per point:',
             '#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)',
             f'# Number of points: {len(scene.points)}']
    if colours is None:
        colours = np.full((len(scene.points), 3), 128, np.uint8)
    for number, (X, colour) in enumerate(zip(scene.points.tolist(), colours.tolist())):
        rows = order[starts[number]:starts[number + 1]]
        track = ' '.join(f'{view + 1} {at}' for view, at in zip(scene.view[rows].tolist(),
                                                                place[rows].tolist()))
        lines.append(f'{number + 1} {X[0]!r} {X[1]!r} {X[2]!r} {colour[0]} {colour[1]} '
                     f'{colour[2]} {float(scene.error[rows].mean())!r} {track}')
    return '\n'.join(lines) + '\n'
