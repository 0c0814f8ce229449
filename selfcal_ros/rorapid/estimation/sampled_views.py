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
Silhouettes of the object from all around: which pose has a silhouette like a given one?

A silhouette is shifted and scaled to one size, so that position and distance drop out. It is
turned in the image, and compared with views from all directions by the share of their areas that
overlaps.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.projection.viewing_directions import (
    looking_along, seen_at, spread_directions)
from selfcal_ros.rorapid.visibility.visible_geometry import VisibleGeometry
from selfcal_ros.values.wireframe import across_axes

#: Directions, turns in the image, and the side of the grid that silhouettes are compared on.
_DIRECTIONS, _TURNS, _GRID = 200, 36, 32
#: Area of every silhouette on that grid, cells.
_AREA = 280.0
#: Silhouettes are drawn from so many diameters, so many pixels across.
_AWAY, _ACROSS_PX = 5.0, 96.0
_FOCAL, _CANVAS = _AWAY * _ACROSS_PX, np.array([2 * _ACROSS_PX, 2 * _ACROSS_PX])
#: Points on the rim of a cylinder's end.
_RIM = 16


class SampledViews:
    """
    Silhouettes of one model.

    Parameters
    ----------
    visible : VisibleGeometry
    centre : ndarray, shape (3,)
        Origin of the tracker's object frame.

    """

    def __init__(self, visible: VisibleGeometry, centre: np.ndarray) -> None:
        """Draw all silhouettes."""
        self._rotations, self._areas, self._offsets, silhouettes = [], [], [], []
        self._diameter = visible.model.diameter_m
        draw = _drawing_of(visible, centre)
        away = _AWAY * self._diameter
        for direction in spread_directions(_DIRECTIONS):
            rotation = looking_along(-direction)
            mask = draw(rotation, np.array([0, 0, away]))
            if not mask.any():
                continue
            area, middle = _area_and_middle(mask)
            self._rotations.append(rotation)
            self._areas.append(area)
            self._offsets.append(middle - _CANVAS / 2)
            silhouettes.append(_normalised(mask, area, middle, 0.0))
        self._silhouettes = np.array(silhouettes, np.float32).reshape(-1, _GRID * _GRID)

    def poses(self, mask: np.ndarray, K: np.ndarray, most: int) -> list[ObjectPose]:
        """
        Poses whose silhouettes are most like a mask, one for each direction at the most.

        Parameters
        ----------
        mask : ndarray, shape (H, W), uint8
            Of an image without distortion.
        K : ndarray, shape (3, 3)
        most : int

        Returns
        -------
        list of ObjectPose
            The most alike first.

        """
        if not len(self._silhouettes):
            return []
        area, middle = _area_and_middle(mask)
        turns = np.arange(_TURNS) * 2 * np.pi / _TURNS
        turned = np.array([_normalised(mask, area, middle, turn) for turn in turns],
                          np.float32).reshape(_TURNS, -1)
        both = self._silhouettes @ turned.T
        either = self._silhouettes.sum(axis=1)[:, None] + turned.sum(axis=1) - both
        alike = both / np.maximum(either, 1.0)
        best = alike.argmax(axis=1)
        order = np.argsort(-alike.max(axis=1))[:most]
        found = []
        for k in order:
            turn = turns[best[k]]
            c, s = np.cos(turn), np.sin(turn)
            size = np.sqrt(area / self._areas[k])
            # the object's centre is not the middle of its silhouette
            pixel = middle - size * (np.array([[c, -s], [s, c]]) @ self._offsets[k])
            scale = _FOCAL * size / (_AWAY * self._diameter)
            about = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
            found.append(seen_at(pixel, scale, about @ self._rotations[k], K))
        return found


def _area_and_middle(mask: np.ndarray) -> tuple[float, np.ndarray]:
    """Area of a mask, and its centre of gravity, pixels."""
    moments = cv2.moments(mask, binaryImage=True)
    area = max(moments['m00'], 1.0)
    return area, np.array([moments['m10'], moments['m01']]) / area


def _normalised(mask: np.ndarray, area: float, middle: np.ndarray, turn: float) -> np.ndarray:
    """Draw a mask on the grid, turned back by an angle, and of the one size."""
    scale = np.sqrt(_AREA / area)
    c, s = scale * np.cos(turn), scale * np.sin(turn)
    carry = np.array([[c, s], [-s, c]])
    shift = (_GRID - 1) / 2 - carry @ middle
    return cv2.warpAffine(mask, np.column_stack([carry, shift]), (_GRID, _GRID),
                          flags=cv2.INTER_LINEAR) > 127


def _drawing_of(visible: VisibleGeometry, centre: np.ndarray,
                ) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return what draws the silhouette (canvas, uint8) of a pose (rotation, translation)."""
    shape = int(_CANVAS[1]), int(_CANVAS[0])

    def place(points: np.ndarray, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
        seen = points @ rotation.T + translation
        pixels: np.ndarray = _FOCAL * seen[..., :2] / seen[..., 2:] + _CANVAS / 2
        return pixels

    surface = visible.surface
    if surface is not None:
        return lambda rotation, translation: surface.mask(
            rotation, translation - rotation @ centre, shape,
            lambda points: place(points - centre, rotation, translation))
    model = visible.model
    triangles = model.vertices[model.triangles] - centre
    angle = np.arange(_RIM) * 2 * np.pi / _RIM
    solids = []
    for cylinder in model.cylinders:
        u, v = across_axes(cylinder)
        rim = cylinder.radius_m * (np.outer(np.cos(angle), u) + np.outer(np.sin(angle), v))
        solids.append(np.concatenate([cylinder.start + rim, cylinder.end + rim]) - centre)

    def draw(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
        mask = np.zeros(shape, np.uint8)
        for corners in place(triangles, rotation, translation):
            cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 255)
        for points in solids:
            hull = cv2.convexHull(np.rint(place(points, rotation, translation)).astype(np.int32))
            cv2.fillConvexPoly(mask, hull, 255)
        return mask

    return draw
