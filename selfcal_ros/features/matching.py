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
"""Wide-baseline matching: SIFT, distinctive matches first, then guided by F (Beardsley, 1996)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
import os

import cv2
import numpy as np

from selfcal_ros.features.epipolar import choose_division, EpipolarImages
from selfcal_ros.features.neighbours import agrees_with_neighbours
from selfcal_ros.features.mask import ImageMask
from selfcal_ros.geometry.division import DivisionModel

#: Ratio of the distances to the best and the second best descriptor (Lowe, 2004, section 7.1).
RATIO = 0.8
#: Along an epipolar line fewer candidates compete, so that the ratio may be milder.
GUIDED_RATIO = 0.85
#: Similarity (cosine of Hellinger-normalised vectors) of a runner-up where none was found.
_USUAL_SIMILARITY = 0.8
#: Less alike than this cannot pass the guided ratio test against the usual runner-up.
_MIN_SIMILARITY = 1 - GUIDED_RATIO ** 2 * (1 - _USUAL_SIMILARITY)
#: Two places of one image more alike than this cannot be told apart, whatever the ratio says.
_SAME_SIMILARITY = 0.95
#: Images larger than this are searched at half size; registration restores the accuracy.
_FULL_SIZE_PIXELS = 1_200_000
#: And smaller still where this would be more: the pyramid of SIFT takes some 200 bytes a pixel.
_LARGEST_SEARCH_PIXELS = 2_500_000
_STATIC_PX, _MOVING_PX = 0.7, 4.0
#: Not among the types that OpenCV states.
_sift = cv2.SIFT_create             # type: ignore[attr-defined]


@dataclass
class Features:
    """
    Keypoints of one image, one row a place (a place may carry several orientations).

    Parameters
    ----------
    xy : ndarray, shape (N, 2)
        Pixels.
    size_px : ndarray, shape (N,)
        Standard deviation of the blob, full-resolution pixels.
    descriptors : ndarray of float32, shape (N + E, 128)
        Square roots of L1-normalised SIFT vectors: one for each place, then those of E places
        that have a second orientation.
    second : ndarray of int, shape (E,)
        The places that have a second one.
    twins : tuple of ndarray (a, b, similarity)
        Places of this image that look alike: what tells one from the other is not in the patch.

    """

    xy: np.ndarray
    size_px: np.ndarray
    descriptors: np.ndarray
    second: np.ndarray
    twins: tuple = ()

    def coarsest(self, most: int) -> np.ndarray:
        """Descriptors (at most, 128) of the largest blobs: a summary of the image."""
        return self.descriptors[np.argsort(-self.size_px, kind='stable')[:most]]

    def select(self, kept: np.ndarray) -> Features:
        """Return the features of the places where kept (N,) is true."""
        place = np.cumsum(kept) - 1
        rows = kept[self.second]
        a, b, alike = self.twins
        both = kept[a] & kept[b]
        main, further = np.split(self.descriptors, [len(self.xy)])
        return Features(self.xy[kept], self.size_px[kept],
                        np.concatenate([main[kept], further[rows]]), place[self.second[rows]],
                        (place[a[both]], place[b[both]], alike[both]))

    @property
    def twin_similarity(self) -> np.ndarray:
        """Similarity to the most alike other place of the same image, shape (N,)."""
        most = np.full(len(self.xy), _USUAL_SIMILARITY, np.float32)
        np.maximum.at(most, self.twins[0], self.twins[2])
        return most


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

    """

    first: int
    second: int
    a: np.ndarray
    b: np.ndarray
    F: np.ndarray


@lru_cache(maxsize=1)
def _sift_offset_px() -> float:
    """
    Offset of SIFT positions, measured on a blob at a known place.

    OpenCV doubles the image such that positions come out 0.25 px too large, or not, depending
    on version and settings.
    """
    at = 31.0
    x = np.arange(64) - at
    blob = 30 + 200 * np.exp(-(x[:, None] ** 2 + x[None] ** 2) / (2 * 3.0 ** 2))
    found = _sift().detect(np.round(blob).astype(np.uint8), None)
    near = [point.pt for point in found if np.hypot(point.pt[0] - at, point.pt[1] - at) < 2]
    if not near:
        return 0.0
    return float(np.round(4 * (np.median(near) - at)) / 4)


def detect(grey: np.ndarray, most: int = 3000, cells: int = 12,
           mask: ImageMask | None = None) -> Features:
    """
    Find SIFT keypoints, evenly spread.

    Parameters
    ----------
    grey : ndarray of uint8, shape (H, W)
    most : int
        Keypoints kept at most.
    cells : int
        The image is divided into cells x cells; the strongest of each cell go first.
    mask : ImageMask, optional
        Blobs keep what describes them within.

    Returns
    -------
    Features

    """
    scale = 2.0 if grey.size > _FULL_SIZE_PIXELS else 1.0
    while grey.size > _LARGEST_SEARCH_PIXELS * scale**2:
        scale *= 2
    image = grey if scale == 1 else cv2.resize(grey, None, fx=1 / scale, fy=1 / scale,
                                               interpolation=cv2.INTER_AREA)
    sift = _sift(nfeatures=0, contrastThreshold=0.015, edgeThreshold=12)
    points, descriptors = sift.detectAndCompute(image, None)
    if mask is not None and len(points):
        keep = np.flatnonzero(mask.allows_blobs(
            scale * np.array([point.pt for point in points]),
            scale / 2 * np.array([point.size for point in points])))
        points, descriptors = [points[k] for k in keep], descriptors[keep]
    if len(points) > most:
        at = np.array([point.pt for point in points])
        strength = np.array([point.response for point in points])
        column, row = (at * cells / np.array(image.shape[::-1])).astype(int).T
        order = np.lexsort((-strength, row * cells + column))
        cell = (row * cells + column)[order]
        rank = np.arange(len(cell)) - np.searchsorted(cell, cell)
        keep = order[np.argsort(rank, kind='stable')[:most]]
        points, descriptors = [points[k] for k in keep], descriptors[keep]
    if not len(points):
        none = np.empty(0, int)
        return Features(np.empty((0, 2)), np.empty(0), np.empty((0, 128), np.float32), none,
                        (none, none, np.empty(0, np.float32)))
    xy = np.array([point.pt for point in points], dtype=float) - _sift_offset_px()
    size = np.array([point.size for point in points]) / 2
    xy, size = scale * xy + (scale - 1) / 2, scale * size
    descriptors = descriptors.astype(np.float32)
    descriptors = np.sqrt(descriptors / (descriptors.sum(axis=1, keepdims=True) + 1e-9))
    _, start, place = np.unique(np.round(xy, 1), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(place.ravel(), kind='stable')
    place = place.ravel()[order]
    rank = np.arange(len(place)) - np.searchsorted(place, place)
    features = Features(xy[start], size[start],
                        np.concatenate([descriptors[start], descriptors[order[rank == 1]]]),
                        place[rank == 1])
    product = similarity(features, features)
    a, b = _alike(product)
    # the same corner found at two scales is no twin
    apart = (np.abs(features.xy[a] - features.xy[b]).max(axis=1)
             > 1.5 * np.maximum(features.size_px[a], features.size_px[b]))
    a, b = a[apart], b[apart]
    features.twins = (a, b, product[a, b])
    return features


def similarity(a: Features, b: Features) -> np.ndarray:
    """Cosine between the best fitting descriptors of every two places, shape (N_a, N_b)."""
    product = a.descriptors @ b.descriptors.T
    places = product[:, :len(b.xy)]
    places[:, b.second] = np.maximum(places[:, b.second], product[:, len(b.xy):])
    places[a.second] = np.maximum(places[a.second], places[len(a.xy):])
    return places[:len(a.xy)]


def _alike(product):
    """Rows and columns of what may match."""
    flat = np.flatnonzero(product > _MIN_SIMILARITY)
    return flat // product.shape[1], flat % product.shape[1]


def _distinctive(first: Features, second: Features, product: np.ndarray):
    """
    Mutual nearest neighbours that pass the ratio test both ways, also against their twins.

    The squares of a chessboard pass the usual test where the right partner is out of view.
    """
    if not product.size:
        return np.empty(0, int), np.empty(0, int)
    a = np.arange(len(product))
    b = product.argmax(axis=1)
    best = product[a, b]
    mutual = (product.argmax(axis=0)[b] == a) & (best > _MIN_SIMILARITY)
    a, b, best = a[mutual], b[mutual], best[mutual]
    product[a, b] = -1
    runner_up = np.maximum(product.max(axis=1, initial=-1)[a], product.max(axis=0, initial=-1)[b])
    product[a, b] = best
    twin = np.maximum(first.twin_similarity[a], second.twin_similarity[b])
    # |p - q|^2 = 2 - 2 cos
    good = (1 - best) < RATIO ** 2 * (1 - np.maximum(runner_up, twin))
    good &= twin < _SAME_SIMILARITY
    return a[good], b[good]


def _guided(first: Features, second: Features, candidates, epipolar: EpipolarImages, F,
            band_px: float):
    """Best candidates along epipolar curves: mutual, clear of the runner-up and of twins."""
    a, b, score = candidates
    near = np.abs(epipolar.distance(F, first.xy[a], second.xy[b])) < band_px
    scale = np.abs(np.log2(first.size_px[a] / second.size_px[b]))
    keep = near & (scale < 1.0)
    a, b, score = a[keep], b[keep], score[keep]
    if not len(a):
        return a, b

    def best_and_second(key, count):
        order = np.lexsort((-score, key))
        place = np.searchsorted(key[order], np.arange(count + 1))
        top = np.full(count, -1)
        second_score = np.full(count, _USUAL_SIMILARITY)
        some = place[1:] > place[:-1]
        two = place[1:] > place[:-1] + 1
        top[some] = order[place[:-1][some]]
        second_score[two] = score[order[place[:-1][two] + 1]]
        return top, second_score

    top_a, second_a = best_and_second(a, len(first.xy))
    top_b, second_b = best_and_second(b, len(second.xy))
    chosen = top_a[top_a >= 0]
    chosen = chosen[top_b[b[chosen]] == chosen]
    runner_up = np.maximum(second_a[a[chosen]], second_b[b[chosen]])
    a, b, score = a[chosen], b[chosen], score[chosen]
    twin = np.maximum(
        _twin_on_curve(first, epipolar, epipolar.curves(F.T, second.xy[b]), a, band_px),
        _twin_on_curve(second, epipolar, epipolar.curves(F, first.xy[a]), b, band_px))
    clear = (1 - score) < GUIDED_RATIO ** 2 * (1 - np.maximum(runner_up, twin))
    clear &= twin < _SAME_SIMILARITY
    return a[clear], b[clear]


def _twin_on_curve(features: Features, epipolar: EpipolarImages, curves, chosen,
                   band_px: float):
    """Similarity of the closest twin on the epipolar curve of each chosen place's partner."""
    row = np.full(len(features.xy), -1)
    row[chosen] = np.arange(len(chosen))
    a, b, alike = (part[row[features.twins[0]] >= 0] for part in features.twins)
    near = np.abs(epipolar.off_curve(curves[row[a]], features.xy[b])) < 2 * band_px
    most = np.full(len(features.xy), _USUAL_SIMILARITY, np.float32)
    np.maximum.at(most, a[near], alike[near])
    return most[chosen]


def moving_part(xy_a: np.ndarray, xy_b: np.ndarray) -> np.ndarray:
    """
    Tell which matches may take part in an estimate of F, shape (N,) of bool.

    Points that stay exactly where they are while others move (background of a turntable, dirt)
    would otherwise win the vote with zero motion.
    """
    distance = np.linalg.norm(xy_b - xy_a, axis=1)
    static, moving = distance < _STATIC_PX, distance > _MOVING_PX
    if static.sum() >= 5 and moving.sum() >= 20:
        return ~static
    return np.ones(len(distance), bool)


def match_pairs(features: list[Features], pairs, image_size: tuple[int, int],
                seed: int = 0, progress=None) -> tuple[list[ImagePairMatches], DivisionModel, int]:
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
    def compare(pair):
        first, second = features[pair[0]], features[pair[1]]
        product = similarity(first, second)
        candidates = _alike(product)
        return (*_distinctive(first, second, product), (*candidates, product[candidates]))

    seeds = []
    # matrix products and reductions release the interpreter lock
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        for seed_matches in pool.map(compare, pairs):
            seeds.append(seed_matches)
            if progress:
                progress(0.8 * len(seeds) / len(pairs))
    richest = sorted(range(len(pairs)), key=lambda k: -len(seeds[k][0]))
    richest = richest[len(richest) // 5:][:6]
    model = choose_division([_moving(features, pairs[k], seeds[k]) for k in richest],
                            image_size, seed=seed)
    epipolar = EpipolarImages(model)
    matches, static = [], 0
    for count, (pair, (a, b, candidates)) in enumerate(zip(pairs, seeds)):
        first, second = (features[k] for k in pair)
        use = moving_part(first.xy[a], second.xy[b])
        static = max(static, int((~use).sum()))
        found = _verified(first, second, a[use], b[use], candidates, epipolar, seed)
        if found is not None:
            matches.append(ImagePairMatches(*pair, *found))
        if progress:
            progress(0.8 + 0.2 * (count + 1) / len(pairs))
    return matches, model, static


def _verified(first: Features, second: Features, a, b, candidates, epipolar: EpipolarImages,
              seed: int):
    """Places a, b that agree with one F, and F; None where no F is trustworthy."""
    F = epipolar.fit(first.xy[a], second.xy[b], 1.5, seed)
    if F is None:
        return None
    fits = np.abs(epipolar.distance(F, first.xy[a], second.xy[b])) < 2.0
    # chance puts a few matches on any F; a true one holds many more
    if fits.sum() < max(16, 0.25 * len(fits)):
        return None
    a, b = _guided(first, second, candidates, epipolar, F, 2.0)
    use = moving_part(first.xy[a], second.xy[b])
    refined = epipolar.fit(first.xy[a[use]], second.xy[b[use]], 1.0, seed)
    if refined is None:
        return None
    good = np.abs(epipolar.distance(refined, first.xy[a], second.xy[b])) < 1.5
    a, b = a[good], b[good]
    good = agrees_with_neighbours(first.xy[a], second.xy[b])
    return (a[good], b[good], refined) if good.sum() >= 16 else None


def _moving(features, pair, seed):
    """Distinctive matches of a pair without the static ones."""
    xy_a, xy_b = features[pair[0]].xy[seed[0]], features[pair[1]].xy[seed[1]]
    use = moving_part(xy_a, xy_b)
    return xy_a[use], xy_b[use]
