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
"""Which observations to trust when some of their track are gross errors."""

from __future__ import annotations

import numpy as np

#: So many views of a point show which of them is wrong; two only that one is, if at all.
VERIFYING_VIEWS = 3


def verified(point: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """
    Mark the observations of tracks that still vouch for themselves.

    Two views that remain of a track that lost others vouch for nothing: an error along the
    epipolar line is invisible in them, lies anywhere in the image, and has much weight there.

    Parameters
    ----------
    point : ndarray of int, shape (N,)
        Track of every observation, from zero.
    keep : ndarray of bool, shape (N,)
        Observations that agree with the others.

    Returns
    -------
    ndarray of bool, shape (N,)
        False for all of a track that lost some and has fewer than `VERIFYING_VIEWS` left.

    """
    count = int(point.max(initial=-1)) + 1
    lost = np.bincount(point[~keep], minlength=count) > 0
    left = np.bincount(point[keep], minlength=count)
    sound = ~(lost & (left < VERIFYING_VIEWS))
    return np.take(sound, point)
