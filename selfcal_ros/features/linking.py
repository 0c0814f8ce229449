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
"""Matches of pairs joined into tracks, and their positions registered to sub-pixel accuracy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
import os

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from selfcal_ros.features.curvature import along_tracks, EpipolarGeometry, feigned_shift
from selfcal_ros.features.detection import Features
from selfcal_ros.features.matching import ImagePairMatches
from selfcal_ros.features.neighbours import local_turns
from selfcal_ros.features.registration import DoubledImage, PatchRegistration, Templates

_REGISTRATION = PatchRegistration(half_px=7)
_MIN_CORRELATION = 0.75
#: Positions less certain than four times the median are dropped; bounds of that limit.
SIGMA_LIMIT_PX = (0.08, 0.5)
_LEVELS = 3
#: Templates taken at a time, of 7 kB each, and bytes of smoothed images held ready.
_TEMPLATES, _HELD_BYTES = 6000, 128_000_000


def link(features: list[Features], matches: list[ImagePairMatches],
         ) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """
    Join the matches of image pairs into tracks.

    A component with two places in one image is cut down to the edges that a third image
    confirms; where that does not settle it, it is dropped.

    Parameters
    ----------
    features : list of Features
    matches : list of ImagePairMatches

    Returns
    -------
    image, place, track : ndarray of int, shape (N,)
        Position of the image, row of its features, and track 0, 1, ...
    dropped : int
        Components that contradicted themselves.

    """
    offset = np.concatenate([[0], np.cumsum([len(feature.xy) for feature in features])])
    image = np.repeat(np.arange(len(features)), np.diff(offset))
    none = np.empty(0, int)
    if not matches:
        return none, none, none, 0
    a = np.concatenate([offset[match.first] + match.a for match in matches])
    b = np.concatenate([offset[match.second] + match.b for match in matches])
    component, bad = _components(a, b, image)
    dubious = bad[component[a]]
    graph = sparse.coo_matrix((np.ones(2 * dubious.sum()),
                               (np.concatenate([a[dubious], b[dubious]]),
                                np.concatenate([b[dubious], a[dubious]]))),
                              shape=(len(image), len(image))).tocsr()
    keep = ~dubious
    # SciPy answers a sparse matrix, which has no truth value, where nothing is asked for
    if dubious.any():
        keep[dubious] = np.asarray((graph @ graph)[a[dubious], b[dubious]]).ravel() > 0
    component, still_bad = _components(a[keep], b[keep], image)
    size = np.bincount(component)
    good = (size[component] >= 2) & ~still_bad[component]
    node = np.flatnonzero(good)
    _, track = np.unique(component[node], return_inverse=True)
    return image[node], node - offset[image[node]], track.ravel(), int(still_bad.sum())


def _components(a: np.ndarray, b: np.ndarray, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Component of every node, and which components hold two places of one image."""
    count = len(image)
    graph = sparse.coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    number, component = connected_components(graph, directed=False)
    order = np.lexsort((image, component))
    twice = ((np.diff(component[order]) == 0) & (np.diff(image[order]) == 0))
    bad = np.zeros(number, bool)
    bad[component[order][1:][twice]] = True
    return component, bad


def registered_positions(features: Sequence[Features], images: Sequence[np.ndarray],
                         image: np.ndarray, place: np.ndarray, track: np.ndarray,
                         matches: Sequence[ImagePairMatches]) -> tuple[np.ndarray, np.ndarray]:
    """
    Find the positions of linked features to sub-pixel accuracy; see `link` and `refine`.

    Returns
    -------
    xy : ndarray, shape (N, 2)
        Pixels.
    good : ndarray of bool, shape (N,)
        Which of them can be trusted.

    """
    offset = np.concatenate([[0], np.cumsum([len(one.xy) for one in features])])
    node = offset[image] + place
    xy = np.concatenate([one.xy for one in features])[node]
    size_px = np.concatenate([one.size_px for one in features])[node]
    xy, good, sigma_px = refine(images, image, track, xy, size_px, matches)
    if good.any():
        good &= sigma_px < np.clip(4 * np.median(sigma_px[good]), *SIGMA_LIMIT_PX)
    return xy, good


def refine(images: Sequence[np.ndarray], image: np.ndarray, track: np.ndarray, xy: np.ndarray,
           size_px: np.ndarray, matches: Sequence[ImagePairMatches] = (),
           ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Register every observation against one reference view of its track.

    The reference is the middle view, so that the deformation to the others stays small. A point
    that registration cannot follow (occlusion edge, strong deformation, poor texture) keeps its
    position. The reference itself counts as registered.

    Parameters
    ----------
    images : sequence of ndarray of uint8, shape (H, W)
    image, track : ndarray of int, shape (N,)
    xy : ndarray, shape (N, 2)
        Pixels.
    size_px : ndarray, shape (N,)
        Standard deviation of the blob: coarse ones are registered at a coarser scale.
    matches : sequence of ImagePairMatches
        With the geometry of these pairs, what curvature does to positions is taken off.

    Returns
    -------
    xy : ndarray, shape (N, 2)
    registered : ndarray of bool, shape (N,)
    sigma_px : ndarray, shape (N,)
        Standard deviation of each coordinate, predicted from texture and likeness; 0 for the
        references.

    """
    if not len(track):
        return xy.copy(), np.zeros(0, bool), np.zeros(0)
    order = np.lexsort((image, track))
    first = np.searchsorted(track[order], np.arange(track.max() + 1))
    length = np.bincount(track)
    reference = order[first + (length - 1) // 2]
    coarseness = np.clip(np.round(np.log2(size_px[reference] / 1.8)), 0, _LEVELS - 1).astype(int)
    refined, registered = xy.copy(), np.zeros(len(xy), bool)
    registered[reference] = True
    is_reference = registered.copy()
    sigma = np.zeros(len(xy))
    warps, scales = np.tile(np.eye(2), (len(xy), 1, 1)), np.ones(len(xy))
    responses = np.zeros((len(length), 2, 6))
    smoothed = _smoothed(images)
    level = coarseness[track]
    turns = local_turns(image, xy, reference[track])
    slot = np.full(len(length), -1)

    def register(k: int, rows: np.ndarray) -> None:
        """Register the observations of one image; rows of their own, in any order of images."""
        several = smoothed(k)
        for which in range(_LEVELS):
            register_at(several[which], rows[level[rows] == which], which)

    def register_at(doubled: DoubledImage, rows: np.ndarray, which: int) -> None:
        """Register those of one level."""
        scale = 2.0 ** which
        base = reference[track[rows]]
        residue = (xy[base] / scale - np.round(xy[base] / scale))[:, :, None]
        ratio = np.clip(size_px[rows] / size_px[base], 0.5, 2.0)
        start = turns[rows] * ratio[:, None, None]
        begin = xy[rows] / scale - (start @ residue)[:, :, 0]
        found, affine, correlation, step = _REGISTRATION.register(
            templates, doubled, begin, start, rows=slot[track[rows]])
        found = found + (affine @ residue)[:, :, 0]
        shift = np.linalg.norm(found - xy[rows] / scale, axis=1)
        good = (correlation > _MIN_CORRELATION) & (step < 0.05) & (shift < 2.5)
        refined[rows[good]] = scale * found[good]
        warps[rows[good]] = affine[good]
        registered[rows[good]], scales[rows] = True, scale
        sigma[rows] = scale * templates.position_sigma(correlation, slot[track[rows]])

    def templates_of(rows: np.ndarray) -> Templates:
        """Take the templates of references of one image, those of one level after the other."""
        several, at = smoothed(int(image[rows[0]])), np.unique(level[rows], return_index=True)
        # whole pixels: the template is taken without interpolation, its residue added back
        return Templates.joined([
            _REGISTRATION.templates(several[which], np.round(xy[some] / 2.0 ** which))
            for which, some in zip(at[0], np.split(rows, at[1][1:]))])

    # those first seen together are seen in the same other images
    tracks = np.lexsort((coarseness, image[reference]))
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        for first_track in range(0, len(tracks), _TEMPLATES):
            some = tracks[first_track:first_track + _TEMPLATES]
            slot[:] = -1
            slot[some] = np.arange(len(some))
            templates = Templates.joined(list(pool.map(templates_of, np.split(
                reference[some], np.flatnonzero(np.diff(image[reference[some]])) + 1))))
            responses[some] = templates.response
            rows = np.flatnonzero((slot[track] >= 0) & ~is_reference)
            rows = rows[np.argsort(image[rows], kind='stable')]
            here, at = np.unique(image[rows], return_index=True)
            # the other way round: the last images are held ready
            for _ in pool.map(register, here[::-1].tolist(), np.split(rows, at[1:])[::-1]):
                pass
    good = np.flatnonzero(registered)
    geometry = EpipolarGeometry.of_matches(matches, len(images))
    second = along_tracks(geometry, image[good], track[good], is_reference[good], refined[good],
                          warps[good])
    refined[good] -= feigned_shift(responses[track[good]], warps[good], second, scales[good])
    return refined, registered, sigma


def _smoothed(images: Sequence[np.ndarray]) -> Callable[[int], list[DoubledImage]]:
    """
    Slightly smoothed images, whole, halved and halved again; as many as there is room for.

    Each is asked for by its position.
    """
    # doubling takes four times, and the smaller ones a third of that
    each = 4 * 4 * images[0].size * 4 // 3
    held = max(2, _HELD_BYTES * 3 // 4 // each)
    return lru_cache(held)(lambda k: DoubledImage.smoothed(images[k], _LEVELS))
