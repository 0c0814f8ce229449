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
"""Tells whether an image pair is fit for planar self-calibration: parallax and rotation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.fundamental import PairMatches, refine_translation

#: Residuals below this are rounding; the tests must not compare rounding with rounding.
FLOOR_PX = 1e-5
#: A homography must leave so many times the noise, or the pair has no usable parallax.
PARALLAX_RATIO = 3.0
#: Pairs whose homographies are found together: what they take must not grow with a drive.
_AT_ONCE = 32
#: Least F statistic by which rotation must improve on pure translation.
ROTATION_STATISTIC = 12.0


@dataclass(frozen=True)
class PairVerdicts:
    """
    Verdicts on n image pairs.

    Attributes
    ----------
    parallax, rotation : ndarray of bool, shape (n,)
    noise_px : ndarray, shape (n,)
        Of one image coordinate, by the general fundamental matrix.
    translation_px, parallax_px : ndarray, shape (n,)
        The same by pure translation, and by a homography.

    """

    parallax: np.ndarray
    rotation: np.ndarray
    noise_px: np.ndarray
    translation_px: np.ndarray
    parallax_px: np.ndarray

    @property
    def sound(self) -> np.ndarray:
        """Pairs with parallax and rotation, shape (n,)."""
        sound: np.ndarray = self.parallax & self.rotation
        return sound


def homography_cost(data: PairMatches) -> np.ndarray:
    """Sum of squared transfer distances in both images of the linear homography, px^2, (n,)."""
    cost = [_transfer_cost(*(part[begin:begin + _AT_ONCE]
                             for part in (data.first, data.second, data.weight[..., None])))
            for begin in range(0, len(data.first), _AT_ONCE)]
    in_pixels: np.ndarray = np.concatenate([np.zeros(0), *cost]) / data.transform[0, 0] ** 2
    return in_pixels


def _transfer_cost(a: np.ndarray, b: np.ndarray, w: np.ndarray) -> np.ndarray:
    """As `homography_cost`, of normalised points (n, m, 3) with weights (n, m, 1)."""
    zero = np.zeros_like(a)
    rows = np.concatenate([
        np.concatenate([a, zero, -b[..., :1] * a], axis=-1) * w,
        np.concatenate([zero, a, -b[..., 1:2] * a], axis=-1) * w], axis=1)
    triangle = np.linalg.qr(rows, mode='r')
    H = np.linalg.svd(triangle)[2][:, -1].reshape(-1, 3, 3)
    adjugate = np.stack([np.cross(H[:, :, 1], H[:, :, 2]), np.cross(H[:, :, 2], H[:, :, 0]),
                         np.cross(H[:, :, 0], H[:, :, 1])], axis=1)
    cost = np.zeros(len(H))
    for matrix, source, target in ((H, a, b), (adjugate, b, a)):
        moved = source @ np.swapaxes(matrix, 1, 2)
        with np.errstate(divide='ignore', invalid='ignore'):
            gap = moved[..., :2] / moved[..., 2:] - target[..., :2]
        cost += (np.where(np.isfinite(gap), gap, 1e3) ** 2 * w).sum(axis=(1, 2))
    return cost


def classify_pairs(data: PairMatches, cost: np.ndarray) -> PairVerdicts:
    """
    Test every pair for parallax and for rotation.

    Parameters
    ----------
    data : PairMatches
    cost : ndarray, shape (n,)
        Costs (A.2) of the refined general fundamental matrices, px^2.

    Returns
    -------
    PairVerdicts

    """
    count = data.counts
    # each of the two distances of a match has variance 2 sigma^2
    noise = np.sqrt(cost / (4 * np.maximum(count - 7, 1)))
    translation_cost = refine_translation(data)[1]
    translation = np.sqrt(translation_cost / (4 * np.maximum(count - 2, 1)))
    homography = np.sqrt(homography_cost(data) / (4 * np.maximum(2 * count - 8, 1)))
    floor = np.maximum(noise, FLOOR_PX)
    # a perfect fit without spare matches says nothing of the noise
    parallax = (homography > PARALLAX_RATIO * floor) & (count >= 8)
    statistic = (translation_cost - cost) / 5 / (4 * floor ** 2)
    return PairVerdicts(parallax, statistic > ROTATION_STATISTIC, noise, translation, homography)
