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
Wide-baseline matching: distinctive matches first, then guided by F (Beardsley, 1996).

The largest blobs of two images tell F; only where they do not, all features are compared. With F
known, only features near each other's epipolar curve are, in blocks of neighbouring curves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
import os

import numpy as np
from scipy.spatial import cKDTree

from selfcal_ros.features.detection import Features
from selfcal_ros.features.epipolar import choose_division, EpipolarImages
from selfcal_ros.features.likeness import (alike_among, best_and_second, Described, GUIDED_RATIO,
                                           look_of, most_alike, mutual_nearest, perhaps_alike)
from selfcal_ros.features.neighbours import agrees_with_neighbours
from selfcal_ros.geometry.division import DivisionModel

#: Ratio of the distances to the best and the second best descriptor (Lowe, 2004, section 7.1).
RATIO = 0.8
#: Two places of one image more alike than this cannot be told apart, whatever the ratio says.
_SAME_SIMILARITY = 0.95
#: So many of the largest blobs are compared first, then so many, then all ...
_COARSEST = (600, 1200)
#: ... until so many distinctive matches are found; fewer than the second give no hope of more.
_ENOUGH, _HOPE = 80, 8
#: Places whose epipolar curves are searched together.
_BLOCK = 128
#: Images whose descriptors are held ready.
_READY = 24
_STATIC_PX, _MOVING_PX, _STILL_SIMILARITY = 0.7, 4.0, 0.9


@dataclass
class ImagePairMatches:
    """
    Matches of features a[i] with b[i] between images first and second.

    Parameters
    ----------
    first, second : int
        Positions of the images.
    a, b : ndarray of int, shape (M,)
        Rows of their features.
    F : ndarray, shape (3, 3)
        x_second' F x_first = 0, in the terms of `EpipolarImages`.
    lens : DivisionModel
        That of `EpipolarImages`.

    """

    first: int
    second: int
    a: np.ndarray
    b: np.ndarray
    F: np.ndarray
    lens: DivisionModel


class _Gallery:
    """Descriptors of all images, as numbers to compare where they are needed."""

    def __init__(self, features: list[Features]):
        """Take the features of all images."""
        self.features = features
        # none of them holds the gallery, which is large and goes when it is left
        whole = self.whole = lru_cache(_READY)(lambda k: features[k].described())
        self.coarse = lru_cache(len(_COARSEST) * _READY)(
            lambda k, most: _Parted.of((part := features[k].coarsest(most)).described(),
                                       part.twin_similarity))
        self.parted = lru_cache(_READY)(
            lambda k: _Parted.of(whole(k), features[k].twin_similarity))

    def distinctive(self, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Matches a, b of two images that leave no doubt, of the largest blobs if they do."""
        sizes = len(self.features[i].xy), len(self.features[j].xy)
        for most in _COARSEST:
            if most >= max(sizes):
                break
            a, b = _distinctive(self.coarse(i, most), self.coarse(j, most))
            if len(a) >= _ENOUGH:
                return a, b
        else:
            if len(a) < _HOPE:
                return a, b
        return _distinctive(self.parted(i), self.parted(j))

    def along_curves(self, pair: tuple[int, int], epipolar: EpipolarImages, F: np.ndarray,
                     band_px: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places a, b that look alike and lie near each other's curve, and their similarity."""
        i, j = pair
        first, second = self.features[i], self.features[j]
        look, other = self.whole(i), self.whole(j)
        curves, order = _in_order(F, epipolar.curves(F, first.xy))
        rank = np.empty(len(order), int)
        rank[order] = np.arange(len(order))
        vectors = np.argsort(rank[look.place], kind='stable')
        sketch, parts, raised = look.sketch[vectors], [], epipolar.raised(second.xy)
        for begin in range(0, len(vectors), _BLOCK):
            rows = vectors[begin:begin + _BLOCK]
            ends = epipolar.off_curve(curves[look.place[rows[[0, -1]]], None], raised)
            # curves of a block turn about the epipole: what they sweep lies between the ends
            near = (ends[0] * ends[1] <= 0) | (np.abs(ends).min(axis=0) < 2 * band_px)
            columns = np.flatnonzero(near[other.place])
            a, b = perhaps_alike(sketch[begin:begin + _BLOCK], other.sketch[columns])
            parts.append((rows[a], columns[b]))
        rows, columns = (np.concatenate(part) for part in zip(*parts))
        a, b = look.place[rows], other.place[columns]
        near = np.abs(np.log2(first.size_px[a] / second.size_px[b])) < 1.0
        rows, columns, a, b = (part[near] for part in (rows, columns, a, b))
        near = np.abs(epipolar.distance(F, first.xy[a], second.xy[b])) < band_px
        return alike_among(look, other, rows[near], columns[near])


def _in_order(F: np.ndarray, curves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Epipolar curves (N, 3) turned alike, and their order about the epipole."""
    basis = np.linalg.svd(F)[0][:, :2]
    x, y = np.nan_to_num(curves @ basis).T
    angle = np.arctan2(y, x)
    turned = (angle < 0) | (angle >= np.pi)
    curves = np.where(turned[:, None], -curves, curves)
    return curves, np.argsort(np.where(turned, angle % np.pi, angle), kind='stable')


@dataclass(frozen=True)
class _Parted:
    """
    Places of one image, parted by whether the image can tell them apart.

    Attributes
    ----------
    single, confused : Described
        Those without a place so alike that no match is distinctive, and those with one.
    place : ndarray of int, shape (n,)
        Which places the single ones are.
    twin : ndarray of float32, shape (n,)
        Their similarity to the most alike other place.

    """

    single: Described
    confused: Described
    place: np.ndarray
    twin: np.ndarray

    @classmethod
    def of(cls, look: Described, twin: np.ndarray) -> _Parted:
        """Part places (N,) by their similarity to a twin (N,)."""
        tells = twin < _SAME_SIMILARITY
        place = np.flatnonzero(tells)
        return cls(look.select(tells), look.select(~tells), place, twin[place])


def _distinctive(first: _Parted, second: _Parted) -> tuple[np.ndarray, np.ndarray]:
    """
    Mutual nearest neighbours that pass the ratio test both ways, also against their twins.

    The squares of a chessboard pass the usual test where the right partner is out of view.
    """
    a, b, best, runner_up = mutual_nearest(first.single, second.single)
    twin = np.maximum(first.twin[a], second.twin[b])
    good = is_clear(best, np.maximum(runner_up, twin))
    a, b, best = a[good], b[good], best[good]
    # what has a twin is no partner, but it may be a rival
    good = is_clear(best, np.maximum(most_alike(first.single, a, second.confused),
                                     most_alike(second.single, b, first.confused)))
    return first.place[a[good]], second.place[b[good]]


def _guided(gallery: _Gallery, pair: tuple[int, int], epipolar: EpipolarImages, F: np.ndarray,
            band_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Best candidates along epipolar curves: mutual, clear of the runner-up and of twins."""
    first, second = (gallery.features[k] for k in pair)
    a, b, score = gallery.along_curves(pair, epipolar, F, band_px)
    top_a, second_a = best_and_second(a, score, len(first.xy))
    top_b, second_b = best_and_second(b, score, len(second.xy))
    chosen = top_a[top_a >= 0]
    chosen = chosen[top_b[b[chosen]] == chosen]
    runner_up = np.maximum(second_a[a[chosen]], second_b[b[chosen]])
    a, b, score = a[chosen], b[chosen], score[chosen]
    clear = is_clear(score, runner_up.astype(float), GUIDED_RATIO)
    a, b, score = a[clear], b[clear], score[clear]
    confused = _has_twin(first, epipolar, epipolar.curves(F.T, second.xy[b]), a, score, band_px)
    confused |= _has_twin(second, epipolar, epipolar.curves(F, first.xy[a]), b, score, band_px)
    return a[~confused], b[~confused]


def is_clear(score: np.ndarray, rival: np.ndarray, ratio: float = RATIO) -> np.ndarray:
    """Tell whether matches of a score (n,) stand out from rivals as alike as this, (n,)."""
    # |p - q|^2 = 2 - 2 cos
    clear: np.ndarray = (1 - score) < ratio ** 2 * (1 - rival)
    return clear


def _has_twin(features: Features, epipolar: EpipolarImages, curves: np.ndarray,
              chosen: np.ndarray, score: np.ndarray, band_px: float) -> np.ndarray:
    """Tell which chosen places (n,) have a rival twin on the curve of their partner, (n,)."""
    a, b, alike = features.twins
    # twins are in order of their first place
    begin, end = np.searchsorted(a, [chosen, chosen + 1])
    row = np.repeat(np.arange(len(chosen)), end - begin)
    pick = np.arange(len(row)) + np.repeat(begin - np.cumsum(end - begin) + end - begin,
                                           end - begin)
    alike = alike[pick]
    rival = (alike >= _SAME_SIMILARITY) | ~is_clear(score[row], alike.astype(float), GUIDED_RATIO)
    row, pick = row[rival], pick[rival]
    near = np.abs(epipolar.off_curve(curves[row], epipolar.raised(features.xy)[:, b[pick]]))
    found = np.zeros(len(chosen), bool)
    found[row[near < 2 * band_px]] = True
    return found


def moving_part(xy_a: np.ndarray, xy_b: np.ndarray) -> np.ndarray:
    """
    Tell which matches may take part in an estimate of F, shape (N,) of bool.

    Points that stay exactly where they are while others move (background of a turntable, dirt)
    would otherwise win the vote with zero motion.
    """
    distance = np.linalg.norm(xy_b - xy_a, axis=1)
    static, moving = distance < _STATIC_PX, distance > _MOVING_PX
    if static.sum() >= 5 and moving.sum() >= 20:
        moves: np.ndarray = ~static
        return moves
    return np.ones(len(distance), bool)


def _static(first: Features, second: Features, a: np.ndarray, b: np.ndarray) -> int:
    """Count the places that stay still between two images, where places a, b moved."""
    moved = np.linalg.norm(first.xy[a] - second.xy[b], axis=1) > _MOVING_PX
    if moved.sum() < 20 or not len(second.xy):
        return 0
    apart, at = cKDTree(second.xy).query(first.xy, distance_upper_bound=_STATIC_PX)
    near = np.flatnonzero(np.isfinite(apart))
    alike = np.einsum('ij,ij->i', look_of(first.sift[near]), look_of(second.sift[at[near]]))
    # the squares of a chessboard come to lie where others were
    clear = is_clear(alike, first.twin_similarity[near])
    still = int((clear & (alike > _STILL_SIMILARITY)).sum())
    return still if still >= 5 else 0


def match_pairs(features: list[Features], pairs: Sequence[tuple[int, int]],
                image_size: tuple[int, int], seed: int = 0,
                progress: Callable[[float], object] | None = None,
                ) -> tuple[list[ImagePairMatches], DivisionModel, int]:
    """
    Match image pairs, first the distinctive features, then all along epipolar curves.

    Parameters
    ----------
    features : list of Features
        One an image.
    pairs : list of (int, int)
        Positions in `features`.
    image_size : (int, int)
        Width and height in pixels.
    seed : int
        State of the sampler of F.
    progress : callable, optional
        Called with the share done, 0 to 1.

    Returns
    -------
    matches : list of ImagePairMatches
        Only pairs whose geometry was found.
    bend : DivisionModel
        Distortion used for the verification.
    static : int
        Largest number of matches of one pair that stayed still while others moved.

    """
    gallery, seeds, static = _Gallery(features), [], 0
    # matrix products and OpenCV release the interpreter lock
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        for found in pool.map(lambda pair: gallery.distinctive(*pair), pairs):
            seeds.append(found)
            if progress:
                progress(0.4 * len(seeds) / len(pairs))
        for k, (pair, (a, b)) in enumerate(zip(pairs, seeds)):
            use = moving_part(features[pair[0]].xy[a], features[pair[1]].xy[b])
            seeds[k] = a[use], b[use]
        richest = sorted(range(len(pairs)), key=lambda k: -len(seeds[k][0]))
        richest = richest[len(richest) // 5:][:6]
        for k in richest:
            static = max(static, _static(features[pairs[k][0]], features[pairs[k][1]], *seeds[k]))
        model = choose_division(
            [(features[pairs[k][0]].xy[seeds[k][0]], features[pairs[k][1]].xy[seeds[k][1]])
             for k in richest], image_size, seed=seed)
        epipolar = EpipolarImages(model)
        matches = _verified(gallery, pairs, seeds, epipolar, seed, pool,
                            lambda share: progress and progress(0.4 + 0.6 * share))
    return matches, model, static


def _verified(gallery: _Gallery, pairs: Sequence[tuple[int, int]],
              seeds: Sequence[tuple[np.ndarray, np.ndarray]], epipolar: EpipolarImages, seed: int,
              pool: Executor, progress: Callable[[float], object]) -> list[ImagePairMatches]:
    """Matches of the image pairs that agree with one F each, without those of no trustworthy F."""
    features = gallery.features

    def places(k: int, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return features[pairs[k][0]].xy[a], features[pairs[k][1]].xy[b]

    tried = [k for k, (a, _) in enumerate(seeds) if len(a) >= 16]
    found = {}
    for k, F in zip(tried, epipolar.fit_each([places(k, *seeds[k]) for k in tried], 1.5, seed,
                                             pool)):
        # chance puts a few matches on any F; a true one holds many more
        if F is not None and _near(epipolar, F, places(k, *seeds[k]), 2.0).sum() >= max(
                16, 0.25 * len(seeds[k][0])):
            found[k] = F

    def guide(k: int) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
        a, b = _guided(gallery, pairs[k], epipolar, found[k], 2.0)
        return (a, b), moving_part(*places(k, a, b))

    guided = {}
    for k, one in zip(found, pool.map(guide, found)):
        guided[k] = one
        progress(len(guided) / len(found))
    refined = epipolar.refit_each(list(found.values()),
                                  [places(k, a[use], b[use]) for k, ((a, b), use)
                                   in guided.items()], 1.0, pool)

    def agreeing(k: int, F: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        a, b = guided[k][0]
        if F is None:
            return a[:0], b[:0]
        good = _near(epipolar, F, places(k, a, b), 1.5)
        a, b = a[good], b[good]
        good = agrees_with_neighbours(*places(k, a, b))
        return a[good], b[good]

    return [ImagePairMatches(pairs[k][0], pairs[k][1], a, b, F, epipolar.model)
            for k, F, (a, b) in zip(found, refined, pool.map(agreeing, found, refined))
            if F is not None and len(a) >= 16]


def _near(epipolar: EpipolarImages, F: np.ndarray, places: tuple[np.ndarray, np.ndarray],
          most_px: float) -> np.ndarray:
    """Tell which matches lie near their epipolar curves, shape (N,) of bool."""
    near: np.ndarray = np.abs(epipolar.distance(F, *places)) < most_px
    return near
