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
border by many pixels. One or two numbers are enough to bend them: the division model
(`geometry/division.py`; Fitzgibbon, CVPR 2001, eq. 6), for lenses up to 185 degrees.
It serves verification alone; calibration estimates its own distortion.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import cv2
import numpy as np

from selfcal_ros.geometry.division import DivisionModel
from selfcal_ros.geometry.epipolar_distance import sampson_distance
from selfcal_ros.geometry.fundamental import PairMatches, refine_general
from selfcal_ros.geometry.lifted_ransac import best_sample, lifted_fits, lifted_ransac
from selfcal_ros.geometry.shared_division import shared_division

#: Pairs with fewer matches have no say on the lens.
_LEAST_MATCHES = 30
#: One run finds the best F of a scene with a dominant plane half of the time; so many are made,
#: unless more than this share of the matches agree with the first.
_ATTEMPTS, _CLEAR = 4, 0.9
#: Pairs that are polished together, and matches of each that are enough for it: with so many F
#: is known to a fraction of the bands that it is used for.
_AT_ONCE, _AT_ONCE_BENT, _WITNESSES = 32, 8, 500

#: Matches of a pair of images in pixels, (N, 2) twice.
Pair = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class EpipolarImages:
    """
    Epipolar geometry between images of one lens, straight or bent; distances in their pixels.

    Parameters
    ----------
    model : DivisionModel
        Where it is straight, F is that of pixels; else that of lifted points.

    """

    model: DivisionModel

    def fit(self, xy_a: np.ndarray, xy_b: np.ndarray, threshold_px: float = 1.0,
            seed: int = 0) -> np.ndarray | None:
        """Fit F (3, 3) to matches (N, 2) that hold outliers; None where none was found."""
        if self.model.straight:
            return estimate_fundamental(xy_a, xy_b, threshold_px, seed=seed)
        found = lifted_ransac(self.model.units(xy_a), self.model.units(xy_b),
                              np.array(self.model.coefficients),
                              threshold_px / self.model.half_diagonal_px,
                              np.random.default_rng(seed))
        return None if found is None else found[0]

    def fit_each(self, pairs: Sequence[Pair], threshold_px: float, seed: int,
                 pool: Executor) -> list[np.ndarray | None]:
        """Fit F to each of several pairs [(xy_a (N, 2), xy_b), ...]; the pool shares the work."""
        if not self.model.straight:
            coefficients = np.array(self.model.coefficients)
            threshold = threshold_px / self.model.half_diagonal_px
            found = list(pool.map(lambda pair: best_sample(
                self.model.units(pair[0]), self.model.units(pair[1]), coefficients, threshold,
                np.random.default_rng(seed)), pairs))
            return self._polished_bent(found, pairs, threshold_px, pool)
        # OpenCV releases the interpreter lock
        found = list(pool.map(lambda pair: _sampled_F(pair[0], pair[1], threshold_px, seed=seed),
                              pairs))
        return _polished(found, pairs, threshold_px)

    def refit_each(self, found: list[np.ndarray | None], pairs: Sequence[Pair],
                   threshold_px: float, pool: Executor) -> list[np.ndarray | None]:
        """As `fit_each`, for matches that were found near F already."""
        if not self.model.straight:
            return self._polished_bent(found, pairs, threshold_px, pool)
        return _polished(_polished(found, pairs, 2 * threshold_px), pairs, threshold_px)

    def _polished_bent(self, found: list[np.ndarray | None], pairs: Sequence[Pair],
                       threshold_px: float, pool: Executor) -> list[np.ndarray | None]:
        """Bring each F for lifted points to the optimum of its inliers."""
        def polished(begin: int) -> list[np.ndarray | None]:
            some = slice(begin, begin + _AT_ONCE_BENT)
            witnesses = [(self.model.units(a[::len(a) // _WITNESSES + 1]),
                          self.model.units(b[::len(b) // _WITNESSES + 1]))
                         for a, b in pairs[some]]
            return lifted_fits(witnesses, np.array(self.model.coefficients),
                               threshold_px / self.model.half_diagonal_px, found[some])

        return [F for part in pool.map(polished, range(0, len(pairs), _AT_ONCE_BENT))
                for F in part]

    def of_lifted(self, F: np.ndarray) -> np.ndarray:
        """Return F (3, 3) of lifted points, whatever `fit` gives."""
        if not self.model.straight:
            return F
        back = np.linalg.inv(self.model.to_units)
        of_units = back.T @ F @ back
        unit: np.ndarray = of_units / np.linalg.norm(of_units)
        return unit

    def distance(self, F: np.ndarray, xy_a: np.ndarray, xy_b: np.ndarray) -> np.ndarray:
        """Signed first-order distance (N,) of matches (N, 2), pixels."""
        if self.model.straight:
            return sampson_distance(F, xy_a, xy_b)
        return self.model.sampson_distance(F, xy_a, xy_b)

    def curves(self, F: np.ndarray, xy_a: np.ndarray) -> np.ndarray:
        """Epipolar curves (N, 3) in the second image of pixels (N, 2) in the first."""
        if self.model.straight:
            line = np.column_stack([xy_a, np.ones(len(xy_a))]) @ F.T
            unit: np.ndarray = line / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
            return unit
        curves: np.ndarray = self.model.lifted(xy_a) @ F.T
        return curves

    def raised(self, xy: np.ndarray) -> np.ndarray:
        """Return what `off_curve` asks of pixels (m, 2), once for many curves: (k, m)."""
        return xy.T.copy() if self.model.straight else self.model.raised(xy)

    def off_curve(self, curve: np.ndarray, raised: np.ndarray) -> np.ndarray:
        """Distance (...) of `raised` pixels to curves (..., 3); NaN where a curve is NaN."""
        if self.model.straight:
            near: np.ndarray = (curve[..., 0] * raised[0] + curve[..., 1] * raised[1]
                                + curve[..., 2])
            return near
        return self.model.curve_distance(curve, raised)


def sampler_seed(rng: np.random.Generator | None) -> int:
    """
    Draw the number that seeds OpenCV's sampler, which takes no generator.

    Parameters
    ----------
    rng : numpy.random.Generator, optional
        None: always 0.

    Returns
    -------
    int
        Below 2^31 - 1. Every pair of images starts from it, so that the order in which threads
        take the pairs does not matter.

    """
    return int(rng.integers(2 ** 31 - 1)) if rng is not None else 0


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
    found = _sampled_F(np.asarray(xy_a), np.asarray(xy_b), threshold_px, iterations, seed)
    return _polished([found], [(xy_a, xy_b)], threshold_px)[0]


def _sampled_F(xy_a: np.ndarray, xy_b: np.ndarray, threshold_px: float, iterations: int = 2000,
               seed: int = 0) -> np.ndarray | None:
    """Best F of several runs of OpenCV's sampler, or None."""
    if len(xy_a) < 8:
        return None
    settings = cv2.UsacParams()
    settings.score = cv2.SCORE_METHOD_MAGSAC
    settings.sampler = cv2.SAMPLING_UNIFORM
    settings.loMethod = cv2.LOCAL_OPTIM_SIGMA
    settings.loIterations, settings.loSampleSize = 10, 50
    settings.threshold, settings.confidence = float(threshold_px), 0.9999
    settings.maxIterations = int(iterations)
    settings.isParallel = False
    xy_a, xy_b = (np.ascontiguousarray(xy, dtype=np.float64) for xy in (xy_a, xy_b))
    best, most = None, 0.0
    for attempt in range(_ATTEMPTS):
        settings.randomGeneratorState = int(seed) + attempt
        try:
            F, _ = cv2.findFundamentalMat(xy_a, xy_b, settings)
        except cv2.error:
            continue
        if F is None or F.shape != (3, 3) or not np.isfinite(F).all() or not F.any():
            continue
        near = 1 - (sampson_distance(F, xy_a, xy_b) / threshold_px) ** 2
        score = float(np.maximum(near, 0).sum())
        if score > most:
            best, most = F, score
        if np.count_nonzero(near > 0) > _CLEAR * len(near):
            break
    return best


def _polished(found: list[np.ndarray | None], pairs: Sequence[Pair], threshold_px: float,
              ) -> list[np.ndarray | None]:
    """Bring each F to the optimum of its inliers: some releases of OpenCV stop well before it."""
    near, polished = [], list(found)
    for F, (xy_a, xy_b) in zip(found, pairs):
        fits = np.zeros(len(xy_a), bool) if F is None else (
            np.abs(sampson_distance(F, xy_a, xy_b)) < threshold_px)
        rows = np.flatnonzero(fits)
        rows = rows[::len(rows) // _WITNESSES + 1]
        near.append((xy_a[rows], xy_b[rows]))
    enough = [k for k, (xy_a, _) in enumerate(near) if len(xy_a) >= 8]
    for begin in range(0, len(enough), _AT_ONCE):
        some = enough[begin:begin + _AT_ONCE]
        data = PairMatches.from_pixels([near[k] for k in some])
        inverse = np.linalg.inv(data.transform)
        start = inverse.T @ np.array([found[k] for k in some]) @ inverse
        refined, *_ = refine_general(data, start, iterations=3)
        for k, F in zip(some, data.pixels_F(refined)):
            polished[k] = F
    return polished


def choose_division(pairs: Sequence[Pair], image_size: tuple[int, int],
                    threshold_px: float = 1.0, seed: int = 0) -> DivisionModel:
    """
    Find the lens with which matches obey epipolar geometry best.

    Parameters
    ----------
    pairs : list of (xy_a, xy_b)
        Matches (N, 2) of several pairs, outliers allowed.
    image_size : (int, int)
    threshold_px : float
        Scale of the truncated cost.
    seed : int
        State of the sampler.

    Returns
    -------
    DivisionModel
        Straight unless another one lowers the cost clearly.

    """
    pairs = [(a, b) for a, b in pairs if len(a) >= _LEAST_MATCHES]
    found = shared_division(pairs, image_size, np.random.default_rng(seed), threshold_px)
    return found.model if found else DivisionModel((0.0,), image_size)
