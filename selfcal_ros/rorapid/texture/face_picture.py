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
"""One plane face of the model, its frame of texels, and what of it can be seen."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

#: Texels along the longer side of a face, and the share by which its picture is wider.
TEXELS, MARGIN = 96, 0.08


@dataclass
class Face:
    """One plane face: its frame, its picture and the corners in it."""

    origin: np.ndarray          # object frame, of texel (0, 0)
    axes: np.ndarray            # (3, 2): object vector of one texel step in x and y
    normal: np.ndarray
    corners: np.ndarray         # (n, 3) object frame
    mask: np.ndarray            # where the texture can be trusted to be the face's
    whole: bool                 # the polygon fills its rectangle
    picture: np.ndarray | None = None
    known: np.ndarray | None = None         # which texels were seen, 255 or 0
    all_known: bool = False
    points: np.ndarray | None = None        # (m, 3), object frame
    texels: np.ndarray | None = None        # (m, 2)
    score: np.ndarray | None = None         # (m,): how often each corner agreed, decaying
    doubt: np.ndarray | None = None         # how often each texel was something else
    other: np.ndarray | None = None         # the picture before, whatever it showed
    seen: int = 0
    quality: float = 0.0


def alike(face: Face, picture: np.ndarray) -> bool:
    """Whether a new picture shows the same as the old one."""
    old, new = face.picture.astype(np.float32), picture.astype(np.float32)
    old, new = old - old.mean(), new - new.mean()
    norm = np.sqrt((old**2).sum() * (new**2).sum())
    return norm > 0 and float((old * new).sum() / norm) > 0.8


def lay_frame(corners: np.ndarray) -> Face:
    """Lay a rectangle of texels around a plane face."""
    centre = corners.mean(axis=0)
    following = np.roll(corners, -1, axis=0)
    normal = np.cross(corners - centre, following - centre).sum(axis=0)
    normal /= np.linalg.norm(normal)
    # along the longest side
    side = following - corners
    u = side[np.argmax(np.linalg.norm(side, axis=1))]
    u = u / np.linalg.norm(u)
    v = np.cross(normal, u)
    flat = (corners - centre) @ np.column_stack([u, v])
    low, high = flat.min(axis=0), flat.max(axis=0)
    extent = high - low
    step = (1 + 2 * MARGIN) * extent.max() / TEXELS
    low, high = low - MARGIN * extent.max(), high + MARGIN * extent.max()
    width, height = np.maximum(np.ceil((high - low) / step).astype(int), 16)
    polygon = (flat - low) / step
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.round(polygon).astype(np.int32)], 255)
    whole = len(corners) == 4 and cv2.contourArea(polygon.astype(np.float32)) > (
        0.97 * np.prod(extent) / step**2)
    inner = cv2.erode(mask, np.ones((7, 7), np.uint8), borderValue=0)
    return Face(centre + u * low[0] + v * low[1], np.column_stack([u, v]) * step, normal,
                corners, inner, whole)


def sample_points(face: Face) -> np.ndarray:
    """Points spread over a face, (25, 3), object frame."""
    rows, columns = np.nonzero(face.mask)
    if not len(rows):
        return np.repeat(face.corners.mean(axis=0)[None], 25, axis=0)
    pick = np.linspace(0, len(rows) - 1, 25).astype(int)
    return face.origin + np.column_stack([columns[pick], rows[pick]]) @ face.axes.T


def hidden_points(points: np.ndarray, camera: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """
    Which points are behind a triangle, seen from the camera (Moeller and Trumbore's test).

    Parameters
    ----------
    points : ndarray, shape (N, 3)
    camera : ndarray, shape (3,)
    triangles : ndarray, shape (T, 3, 3)

    Returns
    -------
    ndarray of bool, shape (N,)

    """
    if not len(triangles):
        return np.zeros(len(points), bool)
    ray = points - camera
    one, two = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    across = np.cross(ray[:, None], two)
    scale = np.einsum('nti,ti->nt', across, one)
    scale = np.where(np.abs(scale) < 1e-18, np.nan, scale)
    start = camera - triangles[:, 0]
    a = np.einsum('nti,ti->nt', across, start) / scale
    side = np.cross(start, one)
    b = ray @ side.T / scale
    depth = np.einsum('ti,ti->t', two, side) / scale
    with np.errstate(invalid='ignore'):
        return ((a > -1e-9) & (b > -1e-9) & (a + b < 1 + 1e-9) & (depth > 1e-9)
                & (depth < 1 - 1e-4)).any(axis=1)
