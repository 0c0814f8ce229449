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
Poses of a polyhedron from corners of one image: where it may be among other things.

Two edges of the model that meet in a vertex are laid on two lines of the image that meet in a
corner. Three points give the pose under scaled orthography, but for a reflection (Huttenlocher and
Ullman 1990). Each such pose is judged by how near the visible edges of the model lie to lines of
the image of the same direction. Nothing is asked of the background.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial import cKDTree

from selfcal_ros.rorapid.edges.line_segments import line_segments
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.projection.viewing_directions import (
    looking_along, seen_at, spread_directions)
from selfcal_ros.rorapid.visibility.visible_geometry import VisibleGeometry

#: Lines of the image, and what joins them: so many of the longest, and none shorter, pixels.
_MOST_LINES, _LEAST_PX = 1200, 12.0
#: Two lines are joined if one lies within this of the other, pixels, and no farther along than the
#: longer one is long.
_BESIDE_PX = 2.0
#: Ends of lines this far apart may meet in a corner, pixels; sine of the least angle there.
_MEET_PX, _LEAST_SINE = 6.0, 0.34
#: No more pairs of a corner in the image and one of the model are tried.
_MOST_PAIRS = 20_000
#: A model of more lines, or of more control points times triangles, would take seconds.
_MOST_MODEL_LINES, _MOST_TESTS = 200, 300_000
#: The object is so many pixels across at the least, and so many images at the most.
_LEAST_SIZE_PX, _MOST_SIZE = 50.0, 1.5
#: Directions that the model is drawn from, and diameters that the camera is away then.
_DIRECTIONS, _AWAY = 200, 6.0
#: Ranges of direction that lines are parted into; farther from a line than this counts nothing.
_SECTORS, _FAR_PX = 8, 6.0
#: About so many points on the edges are looked at, at first and then; so many poses are kept.
_ROUGHLY, _CLOSELY, _KEPT = 26, 100, 4000
#: Poses that are looked at, the best first, for some that differ: by so much of the object's size,
#: or so many radians.
_LOOKED_AT, _APART_SIZE, _APART_RAD = 400, 0.15, 0.3
#: Poses that are judged at a time.
_CHUNK = 10_000


class CornerAlignment:
    """
    Proposes poses of one model.

    Parameters
    ----------
    visible : VisibleGeometry
        Of a model with plane faces.
    centre : ndarray, shape (3,)
        Origin of the tracker's object frame.

    """

    def __init__(self, visible: VisibleGeometry, centre: np.ndarray) -> None:
        """Draw the model from all around, and list its corners."""
        model = visible.model
        self._diameter = model.diameter_m
        self._directions = spread_directions(_DIRECTIONS)
        seen = []
        for direction in self._directions:
            rotation = looking_along(-direction)
            away = np.array([0, 0, _AWAY * self._diameter]) - rotation @ centre
            points = visible.control_points(rotation, away)
            seen.append((points.object_points[points.visible] - centre,
                         points.tangents[points.visible]))
        most = max(len(points) for points, _ in seen)
        #: Points and tangents of the visible edges, (directions, most, 3), and which are there.
        self._points, self._tangents = np.zeros((2, len(seen), most, 3), np.float32)
        self._weights = np.zeros((len(seen), most), np.float32)
        for k, (points, tangents) in enumerate(seen):
            self._points[k, :len(points)], self._tangents[k, :len(points)] = points, tangents
            self._weights[k, :len(points)] = 1
        self._vertex, self._arms = _corners_of_model(
            np.reshape(model.vertices, (-1, 3)) - centre, model.lines)

    def poses(self, image: np.ndarray, K: np.ndarray, most: int) -> list[ObjectPose]:
        """
        Propose poses whose edges lie near lines of an image.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
            Without distortion.
        K : ndarray, shape (3, 3)
        most : int

        Returns
        -------
        list of ObjectPose
            The likest first; no two of them are nearly equal.

        """
        lines = _lines_of(image)
        corners = _corners_of_image(lines)
        if not len(corners) or not len(self._arms):
            return []
        corners = corners[:max(1, _MOST_PAIRS // len(self._arms))]
        rotations, scales, places = self._aligned(corners)
        size = scales * self._diameter
        fits = (size > _LEAST_SIZE_PX) & (size < _MOST_SIZE * max(image.shape))
        rotations, scales, places = rotations[fits], scales[fits], places[fits]
        maps = _distance_maps(lines, image.shape)
        rough = self._likeness(rotations, scales, places, maps, _ROUGHLY)
        kept = np.argsort(-rough, kind='stable')[:_KEPT]
        rotations, scales, places = rotations[kept], scales[kept], places[kept]
        likeness = self._likeness(rotations, scales, places, maps, _CLOSELY)
        chosen: list[int] = []
        for k in np.argsort(-likeness, kind='stable')[:_LOOKED_AT]:
            apart = np.hypot(*(places[chosen] - places[k]).T) > (
                _APART_SIZE * scales[k] * self._diameter)
            cosine = (np.einsum('nij,ij->n', rotations[chosen], rotations[k]) - 1) / 2
            if np.all(apart | (cosine < np.cos(_APART_RAD))):
                chosen.append(k)
            if len(chosen) == most:
                break
        return [seen_at(places[k], scales[k], rotations[k], K) for k in chosen]

    def _aligned(self, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Lay each corner of the model on each of the image (N, 3, 2).

        With model arms u, v and image arms p, q the scale s and the depths h, g of the arms obey
        p.p + h^2 = s^2 u.u, q.q + g^2 = s^2 v.v and p.q + h g = s^2 u.v. Without h and g this is
        quadratic in s^2, and its larger root is the only one that leaves both squares positive.
        """
        which = np.tile(np.arange(len(self._arms)), len(corners))
        u, v = np.moveaxis(self._arms[which], 1, 0)
        arms = np.repeat(corners[:, 1:] - corners[:, :1], len(self._arms), axis=0)
        p, q = np.moveaxis(arms, 1, 0)
        uu, vv, uv = ((a * b).sum(axis=1) for a, b in ((u, u), (v, v), (u, v)))
        pp, qq, pq = ((a * b).sum(axis=1) for a, b in ((p, p), (q, q), (p, q)))
        a, b, c = uu * vv - uv * uv, uu * qq + vv * pp - 2 * uv * pq, pp * qq - pq * pq
        squared = (b + np.sqrt(np.maximum(b * b - 4 * a * c, 0))) / (2 * a)
        scale = np.sqrt(squared)
        depth = np.sqrt(np.maximum(squared[:, None] * np.column_stack([uu, vv])
                                   - np.column_stack([pp, qq]), 0))
        depth[:, 1] *= np.sign(squared * uv - pq)
        model = np.linalg.inv(np.stack([u, v, np.cross(u, v)], axis=2))
        rotations = []
        for sign in (1, -1):
            seen = np.concatenate([arms, sign * depth[..., None]], axis=2) / scale[:, None, None]
            rotations.append(np.stack([seen[:, 0], seen[:, 1], np.cross(seen[:, 0], seen[:, 1])],
                                      axis=2) @ model)
        rotation = np.concatenate(rotations)
        scale = np.tile(scale, 2)
        at = np.tile(np.repeat(corners[:, 0], len(self._arms), axis=0), (2, 1))
        vertex = np.tile(self._vertex[which], (2, 1))
        return rotation, scale, at - scale[:, None] * np.einsum(
            'nij,nj->ni', rotation[:, :2], vertex)

    def _likeness(self, rotations: np.ndarray, scales: np.ndarray, places: np.ndarray,
                  maps: np.ndarray, count: int) -> np.ndarray:
        """Say how near the visible edges lie to lines of their direction, 0 to 1, (N,)."""
        height, width = maps.shape[1:]
        every = max(1, round(self._points.shape[1] / count))
        points, tangents, weights = (part[:, ::every] for part in (
            self._points, self._tangents, self._weights))
        weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1)
        likeness = np.zeros(len(scales), np.float32)
        view = (-rotations[:, 2] @ self._directions.T).argmax(axis=1)
        for start in range(0, len(scales), _CHUNK):
            part = slice(start, start + _CHUNK)
            carry = (rotations[part, :2] * scales[part, None, None]).astype(
                np.float32).transpose(0, 2, 1)
            xy = np.rint(points[view[part]] @ carry + places[part, None]).astype(int)
            along = tangents[view[part]] @ carry
            sector = _sector_of(along)
            inside = ((xy >= 0) & (xy < [width, height])).all(axis=2)
            xy = np.where(inside[..., None], xy, 0)
            near = 1 - maps[sector, xy[..., 1], xy[..., 0]] / _FAR_PX
            likeness[part] = (near * inside * weights[view[part]]).sum(axis=1)
        return likeness


def has_corners(visible: VisibleGeometry) -> bool:
    """Whether a model is one of plane faces that may be sought by its corners."""
    model = visible.model
    return not model.is_outlined and 0 < len(model.lines) <= _MOST_MODEL_LINES and (
        visible.size * len(model.triangles) <= _MOST_TESTS)


def _corners_of_model(vertices: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (C, 3) where two lines meet, and the two arms from there (C, 2, 3)."""
    around: list[list[int]] = [[] for _ in vertices]
    for first, second in lines:
        around[first].append(second)
        around[second].append(first)
    trios = np.array([(middle, first, second) for middle, ends in enumerate(around)
                      for first in ends for second in ends if first != second],
                     int).reshape(-1, 3)
    vertex, arms = vertices[trios[:, 0]], vertices[trios[:, 1:]] - vertices[trios[:, :1]]
    lengths = np.linalg.norm(arms, axis=2)
    across = np.linalg.norm(np.cross(arms[:, 0], arms[:, 1]), axis=1)
    bent = across > _LEAST_SINE * lengths.prod(axis=1)
    order = np.argsort(-lengths[bent].min(axis=1), kind='stable')[:_MOST_PAIRS]
    return vertex[bent][order], arms[bent][order]


def _lines_of(image: np.ndarray) -> np.ndarray:
    """Find lines of an image, and what joins them: their ends (N, 2, 2), the longest first."""
    lines = line_segments(image, _LEAST_PX)
    lines = np.concatenate([lines, _joined(lines)])
    order = np.argsort(-np.hypot(*(lines[:, 1] - lines[:, 0]).T), kind='stable')
    return lines[order[:_MOST_LINES]]


def _joined(lines: np.ndarray) -> np.ndarray:
    """Join pairs of lines (N, 2, 2) that lie along each other: an edge may be seen in pieces."""
    span = lines[:, 1] - lines[:, 0]
    lengths = np.hypot(*span.T)
    span /= lengths[:, None]
    offset = lines[None] - lines[:, None, :1]
    beside = np.abs(offset @ np.stack([-span[:, 1], span[:, 0]], axis=1)[:, None, :, None])
    along = (offset @ span[:, None, :, None])[..., 0]
    low, high = along.min(axis=2), along.max(axis=2)
    gap = np.maximum(low - lengths[:, None], -high)
    i, j = np.nonzero(np.triu((beside[..., 0].max(axis=2) < _BESIDE_PX) & (gap < lengths[:, None])
                              & (gap > -_BESIDE_PX), 1))
    first, last = np.minimum(low[i, j], 0), np.maximum(high[i, j], lengths[i])
    ends: np.ndarray = lines[i, :1] + np.stack([first, last], axis=1)[..., None] * span[i, None]
    return ends


def _corners_of_image(lines: np.ndarray) -> np.ndarray:
    """Where lines meet, and their other ends (N, 3, 2); that with the longest arms first."""
    ends, others = lines.reshape(-1, 2), lines[:, ::-1].reshape(-1, 2)
    if not len(ends):
        return np.zeros((0, 3, 2))
    i, j = cKDTree(ends).query_pairs(_MEET_PX, output_type='ndarray').T
    u, v, gap = ends[i] - others[i], ends[j] - others[j], others[j] - others[i]
    cross = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    bent = np.abs(cross) > _LEAST_SINE * np.hypot(*u.T) * np.hypot(*v.T)
    i, j, u, v, gap, cross = (part[bent] for part in (i, j, u, v, gap, cross))
    meet = others[i] + ((gap[:, 0] * v[:, 1] - gap[:, 1] * v[:, 0]) / cross)[:, None] * u
    near = np.hypot(*(meet - ends[i]).T) < 2 * _MEET_PX
    corners = np.stack([meet, others[i], others[j]], axis=1)[near]
    arms = np.linalg.norm(corners[:, 1:] - corners[:, :1], axis=2).min(axis=1)
    kept: np.ndarray = corners[np.argsort(-arms, kind='stable')]
    return kept


def _sector_of(along: np.ndarray) -> np.ndarray:
    """Which range of direction a vector (..., 2) lies in; opposite ones in the same."""
    turn = np.arctan2(along[..., 1], along[..., 0]) % np.pi
    sector: np.ndarray = np.minimum((turn * (_SECTORS / np.pi)).astype(int), _SECTORS - 1)
    return sector


def _distance_maps(lines: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Distance of each pixel to the next line of a range of direction, (sectors, H, W)."""
    along = lines[:, 1] - lines[:, 0]
    turn = np.arctan2(along[:, 1], along[:, 0])
    maps = np.empty((_SECTORS, *shape), np.float32)
    for sector in range(_SECTORS):
        middle = (sector + 0.5) * np.pi / _SECTORS
        # twice as wide as a sector: a line at the border of one lies in both
        near = np.abs((turn - middle + np.pi / 2) % np.pi - np.pi / 2) < np.pi / _SECTORS
        free = np.full(shape, 255, np.uint8)
        cv2.polylines(free, list(np.rint(lines[near]).astype(np.int32)), False, 0)
        maps[sector] = np.minimum(cv2.distanceTransform(free, cv2.DIST_L2, 3), _FAR_PX)
    return maps
