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

from selfcal_ros.features.detection import Features, look_of
from selfcal_ros.features.matching import RATIO


def propose_pairs(features: list[Features], neighbours: int = 3, relatives: int = 3):
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
    coarse = [look_of(feature.sift[:min(300, len(feature.xy))]) for feature in features]
    shared = np.zeros((count, count))
    for i in range(count):
        for j in range(i + neighbours + 1, count):
            product = coarse[i] @ coarse[j].T
            if not product.size:
                continue
            a, b = np.arange(len(product)), product.argmax(axis=1)
            best = product[a, b]
            product[a, b] = -1
            clear = (1 - best) < RATIO ** 2 * (1 - product.max(axis=1))
            shared[i, j] = shared[j, i] = len(np.unique(b[clear]))
    for i in range(count):
        nearest = np.argsort(-shared[i], kind='stable')[:relatives]
        pairs |= {(min(i, j), max(i, j)) for j in nearest.tolist() if shared[i, j] >= 12}
    return sorted(pairs)
