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
"""SIFT keypoints of one image, evenly spread, and which of its places look alike."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from selfcal_ros.features.likeness import (alike_within, Described, look_of, of_places,
                                           USUAL_SIMILARITY)
from selfcal_ros.features.mask import ImageMask

#: Images larger than this are searched at half size; registration restores the accuracy.
_FULL_SIZE_PIXELS = 1_200_000
#: And smaller still where this would be more: the pyramid of SIFT takes some 200 bytes a pixel.
_LARGEST_SEARCH_PIXELS = 2_500_000
#: Features of an image at most, and of all images; of more than 333 images each has fewer, for a
#: fifth of what is found is more than a camera needs (`surplus.ENOUGH_POSITIONS`).
MOST_FEATURES, MOST_OF_ALL, LEAST_FEATURES = 3000, 1_000_000, 600
#: Settings of SIFT: weak blobs, too, for most photographs have too few strong ones.
SIFT = {'contrastThreshold': 0.015, 'edgeThreshold': 12}
#: Not among the types that OpenCV states.
_sift = cv2.SIFT_create             # type: ignore[attr-defined]


@dataclass
class Features:
    """
    Keypoints of one image, one row a place (a place may carry several orientations).

    Parameters
    ----------
    xy : ndarray, shape (N, 2)
        Pixels; the largest blobs come first.
    size_px : ndarray, shape (N,)
        Standard deviation of the blob, full-resolution pixels.
    sift : ndarray of uint8, shape (N + E, 128)
        SIFT vectors: one for each place, then those of E places that have a second orientation.
    second : ndarray of int, shape (E,)
        The places that have a second one.
    twins : tuple of ndarray (a, b, similarity)
        Places of this image that look alike, by a: what tells one from the other is not in the
        patch.

    """

    xy: np.ndarray
    size_px: np.ndarray
    sift: np.ndarray
    second: np.ndarray
    twins: tuple[np.ndarray, ...] = ()

    def described(self) -> Described:
        """Return what the places look like, ready to be compared."""
        return Described(look_of(self.sift), self.second)

    def select(self, kept: np.ndarray) -> Features:
        """Return the features of the places where kept (N,) is true."""
        place = np.cumsum(kept) - 1
        rows = kept[self.second]
        a, b, alike = self.twins
        both = kept[a] & kept[b]
        main, further = np.split(self.sift, [len(self.xy)])
        return Features(self.xy[kept], self.size_px[kept],
                        np.concatenate([main[kept], further[rows]]), place[self.second[rows]],
                        (place[a[both]], place[b[both]], alike[both]))

    @classmethod
    def at_places(cls, xy: np.ndarray, size_px: np.ndarray) -> Features:
        """Return places alone, without what they look like, which takes most of the memory."""
        none = np.empty(0, int)
        return cls(xy, size_px, np.empty((0, 128), np.uint8), none,
                   (none, none, np.empty(0, np.float32)))

    def coarsest(self, most: int) -> Features:
        """Return the features of the largest blobs: a summary of the image."""
        return self.select(np.arange(len(self.xy)) < most)

    @property
    def twin_similarity(self) -> np.ndarray:
        """Similarity to the most alike other place of the same image, shape (N,)."""
        most = np.full(len(self.xy), USUAL_SIMILARITY, np.float32)
        a, _, alike = self.twins
        if len(a):
            # in order of a
            first = np.flatnonzero(np.r_[True, a[1:] != a[:-1]])
            most[a[first]] = np.maximum(np.maximum.reduceat(alike, first), USUAL_SIMILARITY)
        return most


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


def most_features(images: int) -> int:
    """Tell how many features each of so many images is searched for at most."""
    return max(LEAST_FEATURES, min(MOST_FEATURES, MOST_OF_ALL // images))


def detect(grey: np.ndarray, most: int = MOST_FEATURES, cells: int = 12,
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
    sift = _sift(nfeatures=0, **SIFT)
    points, descriptors = sift.detectAndCompute(image, None)
    at = np.array(cv2.KeyPoint.convert(points), dtype=float).reshape(-1, 2)
    size = np.array([point.size for point in points])
    keep = np.arange(len(points))
    if mask is not None and len(points):
        keep = np.flatnonzero(mask.allows_blobs(scale * at, scale / 2 * size))
    if len(keep) > most:
        strength = np.array([point.response for point in points])[keep]
        column, row = (at[keep] * cells / np.array(image.shape[::-1])).astype(int).T
        order = np.lexsort((-strength, row * cells + column))
        cell = (row * cells + column)[order]
        rank = np.arange(len(cell)) - np.searchsorted(cell, cell)
        keep = keep[order[np.argsort(rank, kind='stable')[:most]]]
    if not len(keep):
        return Features.at_places(np.empty((0, 2)), np.empty(0))
    # the largest first, and all orientations of a place together
    xy, size = at[keep] - _sift_offset_px(), size[keep] / 2
    tenths = np.round(10 * xy).astype(np.int64) @ [1 << 20, 1]
    _, start, place = np.unique(tenths, return_index=True, return_inverse=True)
    coarsest = np.argsort(-size[start], kind='stable')
    start = start[coarsest]
    place = np.argsort(coarsest)[place.ravel()]
    order = np.argsort(place, kind='stable')
    place = place[order]
    rank = np.arange(len(place)) - np.searchsorted(place, place)
    sift_vectors = descriptors[keep[np.concatenate([start, order[rank == 1]])]].astype(np.uint8)
    features = Features(scale * xy[start] + (scale - 1) / 2, scale * size[start], sift_vectors,
                        place[rank == 1])
    features.twins = _twins(features)
    return features


def _twins(features: Features) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places a, b of one image that look alike, and how much."""
    whole, parts = features.described(), []
    # the larger of two comes first
    (x, y), reach = features.xy.T.copy(), 1.5 * features.size_px
    for row, column, alike in alike_within(whole):
        a, b = whole.place[row], whole.place[column]
        # the same corner found at two scales is no twin
        apart = (np.abs(x[a] - x[b]) > reach[a]) | (np.abs(y[a] - y[b]) > reach[a])
        parts.append((row[apart], column[apart], alike[apart]))
    a, b, alike = of_places(whole, whole, *(np.concatenate(part) for part in zip(*parts)))
    a, b = a.astype(np.int32), b.astype(np.int32)
    a, b, alike = np.concatenate([a, b]), np.concatenate([b, a]), np.tile(alike, 2)
    order = np.argsort(a, kind='stable')
    return a[order], b[order], alike[order]
