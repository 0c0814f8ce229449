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
"""One image as image_proc will show it: straight lines of the scene must be straight in it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.small_jpeg import reduced, small_jpeg

#: Longer side of the picture, and what it may weigh.
LONGER_SIDE_PX, MOST_BYTES = 720, 200_000
#: Lines along the longer side, and points of each.
_LINES, _POINTS = 9, 60
#: A lens is followed to this share of its widest angle.
_NEARLY = 0.999


@dataclass(frozen=True)
class Rectified:
    """
    An image before and after the distortion was undone, with one lattice over both.

    Attributes
    ----------
    before, after : bytes
        JPEG.
    bent, straight : str
        The lattice as paths of SVG, in the pixels of the full image.
    filled : float
        Share of the rectified image that shows something.

    """

    before: bytes
    after: bytes
    bent: str
    straight: str
    filled: float


def rectified_preview(camera: Camera, image: np.ndarray) -> Rectified | None:
    """
    Undo the distortion of an image, with the matrix K of the camera for the result.

    Parameters
    ----------
    camera : Camera
    image : ndarray of uint8, shape (H, W) or (H, W, 3)

    Returns
    -------
    Rectified or None
        None for a camera without distortion, or of another image size.

    """
    height, width = image.shape[:2]
    if camera.is_pinhole or (camera.width, camera.height) != (width, height):
        return None
    small = reduced(image, LONGER_SIDE_PX)
    rows, columns = small.shape[:2]
    scale = np.array([columns / width, rows / height])
    u, v = np.meshgrid(np.arange(columns), np.arange(rows))
    wanted = (np.stack([u, v], axis=-1) + 0.5) / scale - 0.5
    source = (_seen_at(camera, wanted) + 0.5) * scale - 0.5
    inside = ((source > -0.5) & (source < [columns - 0.5, rows - 0.5])).all(axis=-1)
    maps = np.where(inside[..., None], source, -10.0).astype(np.float32)
    after = cv2.remap(small, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR)
    straight = _lattice(width, height)
    bent = _seen_at(camera, straight)
    bent[~((bent > -0.5) & (bent < [width - 0.5, height - 0.5])).all(axis=-1)] = np.nan
    return Rectified(small_jpeg(small, LONGER_SIDE_PX, MOST_BYTES),
                     small_jpeg(after, LONGER_SIDE_PX, MOST_BYTES), _path(bent),
                     _path(straight[:, [0, -1]]), float(inside.mean()))


def _seen_at(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return where the image has what pixels (..., 2) of the rectified one show, or NaN."""
    flat = camera.pinhole.normalised(pixels)
    # beyond the fold of a polynomial the lens would show things twice
    angle = np.arctan(np.hypot(flat[..., 0], flat[..., 1]))
    with np.errstate(all='ignore'):
        seen: np.ndarray = camera.pixels(flat)
    return np.where((angle < _NEARLY * camera.lens.widest_angle(camera.distortion))[..., None],
                    seen, np.nan)


def _lattice(width: int, height: int) -> np.ndarray:
    """Return points of upright and level lines, shape (lines, points, 2)."""
    pitch = max(width, height) / _LINES
    along = np.linspace(0, 1, _POINTS)
    upright = [np.column_stack([np.full(_POINTS, x), along * (height - 1)])
               for x in np.arange(width / 2 % pitch, width - 1, pitch)]
    level = [np.column_stack([along * (width - 1), np.full(_POINTS, y)])
             for y in np.arange(height / 2 % pitch, height - 1, pitch)]
    return np.array(upright + level)


def _path(lines: np.ndarray) -> str:
    """Write lines (L, N, 2) as a path of SVG, broken where a point is not finite."""
    words = []
    for line in lines:
        pen = 'M'
        for x, y in line.tolist():
            if x == x and y == y:
                words.append(f'{pen}{x:.1f} {y:.1f}')
                pen = 'L'
            else:
                pen = 'M'
    return ''.join(words)
