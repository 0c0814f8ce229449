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
A wireframe from the lines that are found in two translated images, without clicks (7.3.4).

Lines are found in both images and intersected to corners. Without a turn of the camera the
neighbourhood of a corner looks the same in both, so that correlation proposes the matches; the
one epipole on which most of them agree decides. An edge between two matched corners in both
images is a line of the model. `acquire_model` makes the model of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.rorapid.acquisition.image_lines import (Corner, detect_lines, find_corners,
                                                         refine_lines)

#: Half side of the square that is compared around corners, pixels.
_HALF = 9
#: Corners that correlate less are no match.
_MIN_CORRELATION = 0.6
#: With the translation known, lines that meet in the same directions need less.
_MIN_GUIDED, _SAME_DIRECTION_RAD = 0.2, np.deg2rad(8)
#: Corners further from their epipolar line are no match, pixels.
_BAND_PX = 1.5
#: Corners that moved less tell nothing about the translation, pixels.
_MIN_MOTION_PX = 2.0
#: Share of a line along which its edge must be found, in both images.
_MIN_SUPPORT = 0.6


@dataclass(frozen=True)
class MatchedVertices:
    """
    Attributes of corners found in both images, and the lines between them.

    Attributes
    ----------
    first_px, second_px : ndarray, shape (N, 2)
    lines : list of (int, int)

    """

    first_px: np.ndarray
    second_px: np.ndarray
    lines: list[tuple[int, int]]


def match_vertices(first: np.ndarray, second: np.ndarray, camera: Camera, rng: np.random.Generator,
                   region: tuple[float, float, float, float] | None = None,
                   largest_motion_px: float = 150.0) -> MatchedVertices | NoEstimate:
    """
    Find the corners of lines that two images related by a pure translation share.

    Parameters
    ----------
    first, second : ndarray, shape (H, W), uint8
        Grey images.
    camera : Camera
    rng : numpy.random.Generator
        Chooses the samples of RANSAC.
    region : (left, top, right, bottom), optional
        Where the object is in the first image, pixels; everything by default.
    largest_motion_px : float
        How far a corner may go between the images.

    Returns
    -------
    MatchedVertices or NoEstimate

    Raises
    ------
    ArgumentError
        If the images are not grey images of one size.

    """
    first, second = np.asarray(first), np.asarray(second)
    if not (first.shape == second.shape and first.ndim == 2 and first.dtype == np.uint8
            and second.dtype == np.uint8 and min(first.shape) > 4 * _HALF):
        raise ArgumentError('The two images must be grey, of 8 bits, and of one size.')
    lines = [detect_lines(image) for image in (first, second)]
    corners = [find_corners(found) for found in lines]
    places = [np.array([c.xy for c in found]).reshape(-1, 2) for found in corners]
    allowed = _within(places[0], region)
    a, b = _proposed(first, second, places[0], places[1], allowed, largest_motion_px)
    agreeing = _agreeing(camera, places[0][a], places[1][b], rng)
    if agreeing is None:
        return NoEstimate('corners_disagree', corners=len(a))
    chosen, epipole = agreeing
    a, b = _guided(first, second, camera, epipole, lines, corners, (a[chosen], b[chosen]), allowed)
    places = [places[0][a], places[1][b]]
    pairs = _connected((first, second), places,
                       ([corners[0][k] for k in a], [corners[1][k] for k in b]))
    used = sorted({k for pair in pairs for k in pair})
    if len(used) < 4:
        return NoEstimate('no_connected_lines')
    pairs = [(used.index(i), used.index(j)) for i, j in pairs]
    return MatchedVertices(places[0][used], places[1][used], pairs)


def _within(places: np.ndarray, region: tuple[float, float, float, float] | None) -> np.ndarray:
    if region is None:
        return np.ones(len(places), bool)
    left, top, right, bottom = region
    inside = (places >= [left, top]) & (places <= [right, bottom])
    return np.asarray(inside.all(axis=1))


def _proposed(first: np.ndarray, second: np.ndarray, places_a: np.ndarray, places_b: np.ndarray,
              allowed: np.ndarray, largest_motion_px: float,
              ) -> tuple[np.ndarray, np.ndarray]:
    """Rows of corners that correlate best with each other, both ways."""
    none = np.zeros(0, int)
    if not len(places_a) or not len(places_b):
        return none, none
    product = _patches(first, places_a) @ _patches(second, places_b).T
    motion = np.linalg.norm(places_a[:, None] - places_b, axis=2)
    product[(motion > largest_motion_px) | (motion < _MIN_MOTION_PX) | ~allowed[:, None]] = -1
    b = product.argmax(axis=1)
    a = np.arange(len(b))
    mutual = (product.argmax(axis=0)[b] == a) & (product[a, b] > _MIN_CORRELATION)
    return a[mutual], b[mutual]


def _patches(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Normalised neighbourhoods of places (N, 2), one a row."""
    at = np.arange(-_HALF, _HALF + 1, dtype=np.float32)
    x = places[:, 0, None, None].astype(np.float32) + at
    y = places[:, 1, None, None].astype(np.float32) + at[:, None]
    x, y = (np.ascontiguousarray(v.reshape(len(places), -1)) for v in np.broadcast_arrays(x, y))
    values = cv2.remap(cv2.GaussianBlur(image, (0, 0), 1.0), x, y, cv2.INTER_LINEAR,
                       borderMode=cv2.BORDER_REPLICATE).astype(float)
    values -= values.mean(axis=1, keepdims=True)
    unit: np.ndarray = values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-9)
    return unit


def _agreeing(camera: Camera, xy_a: np.ndarray, xy_b: np.ndarray, rng: np.random.Generator,
              trials: int = 500) -> tuple[np.ndarray, np.ndarray] | None:
    """Rows of the matches that agree on one translation ahead, and its epipole; None: no four."""
    if len(xy_a) < 4:
        return None
    focal = camera.K[0, 0]
    x, y = (np.column_stack([camera.normalised(p), np.ones(len(p))]) for p in (xy_a, xy_b))
    if not np.isfinite(x).all() or not np.isfinite(y).all():
        return None
    i = rng.integers(len(x), size=trials)
    j = (i + rng.integers(1, len(x), size=trials)) % len(x)
    moments = np.cross(x, y)
    epipoles = np.cross(moments[i], moments[j])
    size = np.linalg.norm(epipoles, axis=1)
    epipoles = epipoles[size > 0] / size[size > 0][:, None]
    best, chosen = 3, None
    for e in np.concatenate([epipoles, -epipoles]):
        miss, inverse_depth = _fit(e, x, y, focal)
        near = (miss < _BAND_PX) & (inverse_depth > 0)
        if near.sum() > best:
            best, chosen = near.sum(), (np.flatnonzero(near), e)
    return chosen


def _fit(e: np.ndarray, x: np.ndarray, y: np.ndarray, focal: float,
         ) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the epipolar line in pixels and inverse depth of pairs x, y (..., 3)."""
    line = np.cross(e, x)
    miss = focal * np.abs((line * y).sum(axis=-1)) / np.maximum(
        np.hypot(line[..., 0], line[..., 1]), 1e-12)
    # x' (1 + r e3) = x + r e with r the inverse depth
    slope = e[:2] - e[2] * y[..., :2]
    return miss, ((y - x)[..., :2] * slope).sum(axis=-1) / np.maximum(
        (slope**2).sum(axis=-1), 1e-12)


def _guided(first: np.ndarray, second: np.ndarray, camera: Camera, e: np.ndarray,
            lines: Sequence[np.ndarray], corners: Sequence[Sequence[Corner]],
            matches: tuple[np.ndarray, np.ndarray],
            allowed: np.ndarray,
            ) -> tuple[np.ndarray, np.ndarray]:
    """Add corners before a changing background: lines meet there in the same directions."""
    a, b = matches
    places = [np.array([c.xy for c in found]) for found in corners]
    x, y = (np.column_stack([camera.normalised(p), np.ones(len(p))]) for p in places)
    _, known = _fit(e, x[a], y[b], camera.K[0, 0])
    left = np.setdiff1d(np.flatnonzero(allowed), a)
    right = np.setdiff1d(np.arange(len(y)), b)
    if not len(left) or not len(right):
        return a, b
    miss, inverse_depth = _fit(e, x[left][:, None], y[right][None], camera.K[0, 0])
    score = _patches(first, places[0][left]) @ _patches(second, places[1][right]).T
    score[~((miss < _BAND_PX) & (inverse_depth > 0.7 * known.min())
            & (inverse_depth < 1.4 * known.max()))] = -1
    for i, j in zip(*np.nonzero(score > _MIN_GUIDED)):
        one, two = corners[0][left[i]], corners[1][right[j]]
        turn = (_directions(one, lines[0])[:, None] - _directions(two, lines[1])) % (2 * np.pi)
        same = np.minimum(turn, 2 * np.pi - turn) < _SAME_DIRECTION_RAD
        if same.any(axis=1).sum() < 2:
            score[i, j] = -1
    best = score.argmax(axis=1)
    rows = np.arange(len(best))
    mutual = (score.argmax(axis=0)[best] == rows) & (score[rows, best] > _MIN_GUIDED)
    return np.concatenate([a, left[mutual]]), np.concatenate([b, right[best[mutual]]])


def _directions(corner: Corner, lines: np.ndarray) -> np.ndarray:
    """Angles at which lines leave a corner, radians."""
    ends = lines[sorted(corner.lines)]
    nearer = np.linalg.norm(ends - corner.xy, axis=2).argmin(axis=1)
    rows = np.arange(len(ends))
    way = ends[rows, 1 - nearer] - ends[rows, nearer]
    angles: np.ndarray = np.arctan2(way[:, 1], way[:, 0])
    return angles


def _connected(images: Sequence[np.ndarray], places: Sequence[np.ndarray],
               corners: Sequence[Sequence[Corner]]) -> list[tuple[int, int]]:
    """Pairs of matched corners with a line between them in one image, and an edge in both."""
    pairs = [(i, j) for i in range(len(places[0])) for j in range(i + 1, len(places[0]))
             if any(own[i].lines & own[j].lines for own in corners)]
    if not pairs:
        return []
    support = [refine_lines(image, xy[np.array(pairs)], 2)[1]
               for image, xy in zip(images, places)]
    return [pair for pair, least in zip(pairs, np.min(support, axis=0)) if least > _MIN_SUPPORT]
