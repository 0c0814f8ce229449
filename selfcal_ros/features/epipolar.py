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
Epipolar verification of matches, for lenses with distortion.

The epipolar lines of a distorted image are curves; a straight line misses true matches near the
border by many pixels. One parameter is enough to bend them: the division model
x_u = x_d / (1 + lambda r_d^2) (Fitzgibbon, CVPR 2001, eq. 6) with r in half diagonals, about the
image centre. It serves verification alone; calibration estimates its own distortion.
"""

from __future__ import annotations

import cv2
import numpy as np

from selfcal_ros.geometry.epipolar_distance import sampson_distance
from selfcal_ros.geometry.fundamental import PairMatches, refine_general

#: Values of lambda that are tried; barrel distortion is negative.
_DIVISION_GRID = (0.0, -0.02, -0.04, -0.07, -0.1, -0.14, -0.19, -0.25, -0.33, 0.03, 0.07)
_LARGEST_SAMPLE = 700


def straighten(xy: np.ndarray, division: float, image_size: tuple[int, int]) -> np.ndarray:
    """
    Remove the distortion of the division model.

    Parameters
    ----------
    xy : ndarray, shape (N, 2)
        Pixels.
    division : float
        lambda for radii in half image diagonals.
    image_size : (int, int)
        Width and height in pixels.

    Returns
    -------
    ndarray, shape (N, 2)
        Pixels; the image centre stays.

    """
    if division == 0:
        return np.asarray(xy, dtype=float)
    centre = (np.array(image_size) - 1) / 2
    offset = np.asarray(xy, dtype=float) - centre
    radius_square = (offset ** 2).sum(axis=1) / (centre ** 2).sum()
    return centre + offset / (1 + division * radius_square)[:, None]


def estimate_fundamental(xy_a: np.ndarray, xy_b: np.ndarray, threshold_px: float = 1.0,
                         iterations: int = 2000, seed: int = 0) -> np.ndarray | None:
    """
    Fit F with x_b' F x_a = 0 to matches that hold outliers (MAGSAC++).

    Parameters
    ----------
    xy_a, xy_b : ndarray, shape (N, 2)
        Pixels.
    threshold_px : float
        Largest distance of an inlier.
    iterations : int
        Samples drawn at most.
    seed : int
        State of the sampler.

    Returns
    -------
    ndarray, shape (3, 3), or None
        None where fewer than eight matches are given or no F was found.

    """
    if len(xy_a) < 8:
        return None
    settings = cv2.UsacParams()
    settings.score = cv2.SCORE_METHOD_MAGSAC
    settings.sampler = cv2.SAMPLING_UNIFORM
    settings.loMethod = cv2.LOCAL_OPTIM_SIGMA
    settings.loIterations, settings.loSampleSize = 10, 50
    settings.threshold, settings.confidence = float(threshold_px), 0.9999
    settings.maxIterations = int(iterations)
    settings.randomGeneratorState = int(seed)
    settings.isParallel = False
    try:
        F, _ = cv2.findFundamentalMat(np.ascontiguousarray(xy_a, dtype=np.float64),
                                      np.ascontiguousarray(xy_b, dtype=np.float64), settings)
    except cv2.error:
        return None
    if F is None or F.shape != (3, 3) or not np.isfinite(F).all() or not F.any():
        return None
    return _polished(F, xy_a, xy_b, threshold_px)


def _polished(F, xy_a, xy_b, threshold_px) -> np.ndarray:
    """Bring F to the optimum of its inliers: some releases of OpenCV stop well before it."""
    near = np.abs(sampson_distance(F, xy_a, xy_b)) < threshold_px
    if near.sum() < 8:
        return F
    data = PairMatches.from_pixels([(xy_a[near], xy_b[near])])
    scale = data.transform
    inverse = np.linalg.inv(scale)
    refined, *_ = refine_general(data, (inverse.T @ F @ inverse)[None], iterations=4)
    return data.pixels_F(refined)[0]


def choose_division(pairs, image_size: tuple[int, int], threshold_px: float = 1.0) -> float:
    """
    Find the lambda with which matches obey epipolar geometry best.

    Parameters
    ----------
    pairs : list of (xy_a, xy_b)
        Matches (N, 2) of several pairs, outliers allowed.
    image_size : (int, int)
    threshold_px : float
        Scale of the truncated cost.

    Returns
    -------
    float
        0 unless another value lowers the cost clearly.

    """
    pairs = [(a, b) for a, b in pairs if len(a) >= 30]
    if not pairs:
        return 0.0
    pairs = [(a[::-(-len(a) // _LARGEST_SAMPLE)], b[::-(-len(b) // _LARGEST_SAMPLE)])
             for a, b in pairs]

    def cost(division):
        total = 0.0
        for a, b in pairs:
            a, b = (straighten(xy, division, image_size) for xy in (a, b))
            F = estimate_fundamental(a, b, threshold_px, 1000)
            if F is None:
                total += len(a)
                continue
            residual = sampson_distance(F, a, b) / threshold_px
            total += np.minimum(residual ** 2, 1.0).sum()
        return total

    costs = {division: cost(division) for division in _DIVISION_GRID}
    best = min(costs, key=lambda division: costs[division])
    return best if costs[best] < 0.93 * costs[0.0] else 0.0
