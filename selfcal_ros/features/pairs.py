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
"""Which image pairs are worth matching."""

from __future__ import annotations

import numpy as np

from selfcal_ros.features.detection import Features
from selfcal_ros.features.likeness import look_of
from selfcal_ros.features.matching import is_clear

#: Features of an image that judge whether another shows the same.
_JUDGES = 300
#: Up to so many images all pairs of them are judged; of more, those whose words agree best.
_FEW, _CANDIDATES = 60, 16
#: Words of the vocabulary (Sivic and Zisserman, 2003), taken from the images themselves.
_WORDS = 2000


def propose_pairs(features: list[Features], neighbours: int = 3, relatives: int = 3,
                  ) -> list[tuple[int, int]]:
    """
    Choose the image pairs worth matching.

    Neighbours in time, and for every image the few others that share most distinctive features
    with it (loops, photographs in any order), judged by a few hundred coarse features.

    Parameters
    ----------
    features : list of Features
    neighbours : int
        Steps in time.
    relatives : int
        Further images for each.

    Returns
    -------
    list of (int, int)
        First before second.

    """
    count = len(features)
    pairs = {(i, i + gap) for gap in range(1, neighbours + 1) for i in range(count - gap)}
    if count <= 8:
        return [(i, j) for i in range(count) for j in range(i + 1, count)]
    coarse = [look_of(feature.sift[:min(_JUDGES, len(feature.xy))]) for feature in features]
    shared = np.zeros((count, count))
    for i, j in _candidates(coarse):
        if j - i <= neighbours or not len(coarse[i]) or not len(coarse[j]):
            continue
        product = coarse[i] @ coarse[j].T
        a, b = np.arange(len(product)), product.argmax(axis=1)
        best = product[a, b]
        product[a, b] = -1
        clear = is_clear(best, product.max(axis=1))
        shared[i, j] = shared[j, i] = len(np.unique(b[clear]))
    for i in range(count):
        nearest = np.argsort(-shared[i], kind='stable')[:relatives]
        pairs |= {(min(i, j), max(i, j)) for j in nearest.tolist() if shared[i, j] >= 12}
    return sorted(pairs)


def _candidates(coarse: list[np.ndarray]) -> list[tuple[int, int]]:
    """Pairs of images (i, j), i < j, that may show the same."""
    count = len(coarse)
    if count <= _FEW:
        return [(i, j) for i in range(count) for j in range(i + 1, count)]
    # without a copy of all, which takes as much again
    first = np.cumsum([0, *map(len, coarse)])
    step = max(1, int(first[-1]) // _WORDS)
    words = np.concatenate([looks[-at % step::step] for at, looks in zip(first, coarse)])
    seen = np.zeros((count, len(words)), np.float32)
    for row, looks in zip(seen, coarse):
        if len(looks):
            np.add.at(row, (looks @ words.T).argmax(axis=1), 1)
    # a word that every image has tells nothing
    seen *= np.log(count / np.maximum((seen > 0).sum(axis=0), 1))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True) + 1e-9
    alike = seen @ seen.T
    np.fill_diagonal(alike, -1)
    best = np.argsort(-alike, axis=1, kind='stable')[:, :_CANDIDATES]
    return sorted({(min(i, j), max(i, j)) for i in range(count) for j in best[i].tolist()})
