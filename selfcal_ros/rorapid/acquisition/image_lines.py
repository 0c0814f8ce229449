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
"""Straight edges of one image, to a fraction of a pixel, and the corners where they meet."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.rorapid.edges.edgels import find_edgels, sample_normals
from selfcal_ros.rorapid.edges.line_segments import line_segments

#: Edges found this far from a fitted line do not belong to it, pixels.
_NEAR_PX = 0.7
#: Ends of lines this far apart may meet in a corner, pixels.
_MEET_PX = 8.0
#: Lines that meet under a smaller angle have no good intersection.
_MIN_ANGLE_RAD = np.deg2rad(15)
#: Height of the arch of an edge that counts as straight, as a share of its length.
_MAX_ARCH = 0.015


@dataclass(frozen=True)
class Corner:
    """
    A place where lines end together.

    Parameters
    ----------
    xy : ndarray, shape (2,)
        Where they intersect, pixels.
    lines : frozenset of int
        Which lines end there.

    """

    xy: np.ndarray
    lines: frozenset[int]


def refine_lines(image: np.ndarray, segments: ArrayLike, reach_px: int = 5,
                 ) -> tuple[np.ndarray, np.ndarray]:
    """
    Move line segments onto the edges beside them.

    Parameters
    ----------
    image : ndarray, shape (H, W), uint8
    segments : array_like, shape (N, 2, 2)
        Ends in pixels, as clicked or detected.
    reach_px : int
        How far off they may be.

    Returns
    -------
    segments : ndarray, shape (N, 2, 2)
        Refined; their ends are the given ones brought onto the line.
    support : ndarray, shape (N,)
        Share of the places along each line where the edge was found; 0: the line is unchanged.

    """
    return _refined(image, segments, reach_px)[:2]


def _refined(image: np.ndarray, segments: ArrayLike, reach_px: int,
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Refine lines; returns their height of arch as a share of the length as well, (N,)."""
    segments = np.array(segments, float).reshape(-1, 2, 2)
    support, arch = np.zeros((2, len(segments)))
    for k, (start, end) in enumerate(segments):
        reach = reach_px
        for _ in range(3):
            length = np.hypot(*(end - start))
            if not length > 6:
                break
            along = (end - start) / length
            normal = np.array([-along[1], along[0]])
            # the ends, where other edges come in, are left out
            at = np.arange(min(4.0, 0.2 * length), length - min(3.9, 0.2 * length), 1.0)
            places = start + at[:, None] * along
            profiles = sample_normals(image, places, np.tile(normal, (len(at), 1)), reach, 1)
            offset = find_edgels(profiles).offset[:, 0]
            fit = _robust_line(at, offset)
            if fit is None:
                break
            height, slope, support[k], arch[k] = fit
            start, end = start + height * normal, end + (height + slope * length) * normal
            reach = 2
        segments[k] = start, end
    return segments, support, arch


def _robust_line(at: np.ndarray, offset: np.ndarray,
                 ) -> tuple[np.ndarray, float, float, float] | None:
    """Fit offset = height + slope at; returns the two, the share near it, and its arch."""
    good = np.isfinite(offset)
    if good.sum() < 5:
        return None
    # the line through two places that most others agree with
    i, j = np.triu_indices(len(at), 1)
    some = np.linspace(0, len(i) - 1, min(400, len(i))).astype(int)
    i, j = i[some], j[some]
    usable = good[i] & good[j] & (at[j] - at[i] > 0.3 * (at[-1] - at[0]))
    i, j = i[usable], j[usable]
    if not len(i):
        return None
    slope = (offset[j] - offset[i]) / (at[j] - at[i])
    height = offset[i] - slope * at[i]
    miss = np.abs(height[:, None] + slope[:, None] * at - offset)
    best = (miss < _NEAR_PX).sum(axis=1).argmax()
    near = miss[best] < _NEAR_PX
    if near.sum() < max(5, 0.4 * len(at)):
        return None
    slope, height = np.polyfit(at[near], offset[near], 1)
    span = at[-1] - at[0]
    bend = np.polyfit(at[near], offset[near], 2)[0]
    return height, slope, near.mean(), abs(bend) * span / 4


def detect_lines(image: np.ndarray, least_length_px: float = 20.0,
                 least_contrast: float = 12.0) -> np.ndarray:
    """
    Find straight edges.

    Parameters
    ----------
    image : ndarray, shape (H, W), uint8
    least_length_px : float
    least_contrast : float
        Grey levels between the two sides.

    Returns
    -------
    ndarray, shape (N, 2, 2)
        Ends in pixels, the longest first; the brighter side lies to the left of the way from
        the first end to the second (in the image as seen).

    """
    segments, support, arch = _refined(image, line_segments(image, 0.5 * least_length_px), 3)
    # chords of round edges are no lines; a lens bends lines much less
    segments = _joined(segments[(support > 0.5) & (arch < _MAX_ARCH)])
    lengths = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
    order = np.argsort(-lengths, kind='stable')
    segments = segments[order[lengths[order] >= least_length_px]]
    left, right = side_greys(image, segments)
    segments = np.where((left < right)[:, None, None], segments[:, ::-1], segments)
    contrasted: np.ndarray = segments[np.abs(left - right) >= least_contrast]
    return contrasted


def side_greys(image: np.ndarray, segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median grey levels 2 to 4 px to the left and the right of segments (N, 2, 2), (N,) each."""
    if not len(segments):
        return np.zeros(0), np.zeros(0)
    along = segments[:, 1] - segments[:, 0]
    along = along / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    # y points down: to the left of (1, 0) is (0, -1)
    left = np.column_stack([along[:, 1], -along[:, 0]])
    share = np.linspace(0.15, 0.85, 15)[:, None, None]
    middle = segments[:, 0] + share * (segments[:, 1] - segments[:, 0])
    greys = []
    for side in (1, -1):
        places = np.stack([middle + side * d * left for d in (2, 3, 4)]).astype(np.float32)
        flat = places.reshape(-1, len(segments), 2)
        values = cv2.remap(image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR,
                           borderMode=cv2.BORDER_REPLICATE)
        greys.append(np.median(values.astype(float), axis=0))
    return greys[0], greys[1]


def _joined(segments: np.ndarray) -> np.ndarray:
    """Join pieces of one line that touch, the longest first."""
    lengths = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
    left, joined = segments[np.argsort(-lengths, kind='stable')], []
    while len(left):
        first, left = left[0], left[1:]
        while True:
            along = first[1] - first[0]
            length = np.hypot(*along)
            along = along / length
            offset = left - first[0]
            at = offset @ along
            same = (np.abs(offset @ [-along[1], along[0]]).max(axis=1, initial=0) < 1.0) \
                & (at.min(axis=1, initial=np.inf) < length + 5) \
                & (at.max(axis=1, initial=-np.inf) > -5)
            if not same.any():
                break
            ends = [min(0.0, at[same].min()), max(length, at[same].max())]
            first, left = first[0] + np.outer(ends, along), left[~same]
        joined.append(first)
    return np.array(joined).reshape(-1, 2, 2)


def find_corners(segments: np.ndarray, meet_px: float = _MEET_PX) -> list[Corner]:
    """
    Find where lines end together.

    Parameters
    ----------
    segments : ndarray, shape (N, 2, 2)
    meet_px : float
        How far from their intersection the ends may be.

    Returns
    -------
    list of Corner

    """
    groups: list[tuple[np.ndarray | None, set[int]]] = []
    ends = segments.reshape(-1, 2)
    gap = np.linalg.norm(ends[:, None] - ends, axis=2)
    gap = gap.reshape(len(segments), 2, len(segments), 2)
    # ends that are both near an intersection are near each other
    for i, j in zip(*np.nonzero(np.triu(gap.min(axis=(1, 3), initial=np.inf) < 2 * meet_px, 1))):
        xy = intersection(segments[[i, j]])
        if xy is not None and max(np.hypot(*(segments[k] - xy).T).min()
                                  for k in (i, j)) < meet_px:
            near = [g for g in groups if g[0] is not None
                    and np.hypot(*(g[0] - xy)) < 0.5 * meet_px and g[1] & {i, j}]
            merged = {int(i), int(j)}.union(*(g[1] for g in near))
            groups = [g for g in groups if not any(g is n for n in near)]
            groups.append((intersection(segments[sorted(merged)]), merged))
    return [Corner(xy, frozenset(lines)) for xy, lines in groups if xy is not None]


def intersection(segments: np.ndarray) -> np.ndarray | None:
    """Point (2,) nearest to all lines through segments (N, 2, 2); None where near parallel."""
    along = segments[:, 1] - segments[:, 0]
    along = along / np.hypot(*along.T)[:, None]
    normals = np.column_stack([-along[:, 1], along[:, 0]])
    smallest = np.linalg.svd(normals, compute_uv=False)[-1]
    if smallest**2 < 1 - np.cos(_MIN_ANGLE_RAD):
        return None
    offsets = (normals * segments[:, 0]).sum(axis=1)
    nearest: np.ndarray = np.linalg.lstsq(normals, offsets, rcond=None)[0]
    return nearest


def refine_vertices(image: np.ndarray, vertices_px: ArrayLike, lines: ArrayLike, reach_px: int = 5,
                    ) -> np.ndarray:
    """
    Move clicked vertices to where the edges between them intersect.

    Parameters
    ----------
    image : ndarray, shape (H, W), uint8
    vertices_px : array_like, shape (V, 2)
        As clicked.
    lines : sequence of (int, int)
        Which of them an edge connects.
    reach_px : int
        How far the clicks may be off.

    Returns
    -------
    ndarray, shape (V, 2)
        A vertex at which fewer than two edges were found stays as it is.

    """
    vertices = np.array(vertices_px, float).reshape(-1, 2)
    lines = np.array(lines, int).reshape(-1, 2)
    segments, support = refine_lines(image, vertices[lines], reach_px)
    refined = vertices.copy()
    for k in range(len(vertices)):
        own = np.flatnonzero((lines == k).any(axis=1) & (support > 0))
        if len(own) > 1:
            xy = intersection(segments[own])
            if xy is not None and np.hypot(*(xy - vertices[k])) < 3 * reach_px:
                refined[k] = xy
    return refined
