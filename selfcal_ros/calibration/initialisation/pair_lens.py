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
Epipolar geometry of pairs of views, through straight lines or through one bent lens for all.

First the lens, then structure: with strong distortion a straight epipolar line misses true
matches, and beyond 90 degrees there is none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.geometry.division import DivisionModel, refine_division, weighted_eight_point
from selfcal_ros.geometry.epipolar_distance import sampson_distance
from selfcal_ros.geometry.fundamental import eight_point, PairMatches, refine_general
from selfcal_ros.geometry.lifted_homography import lifted_homography_cost
from selfcal_ros.geometry.lifted_ransac import lifted_inliers
from selfcal_ros.geometry.ransac import ransac_inliers
from selfcal_ros.geometry.shared_division import LADDER, shared_division
from selfcal_ros.geometry.two_view_tests import homography_cost, PARALLAX_RATIO

#: So many pairs decide on the lens, each with so many matches at least.
_JUDGES, _LEAST_MATCHES = 6, 20
#: A bent lens leaves at most this share of the truncated squares of straight lines.
_CLEAR_GAIN = 0.85
#: A lens found by homographies leaves at most this share of what they left before; and the best
#: of a few values this one, to look further.
_HOMOGRAPHY_GAIN, _HOMOGRAPHY_HOPE = 0.3, 0.5
#: So many of the worst pairs have to hope.
_WORST_PAIRS = 6

#: Matches of a pair in pixels, (m, 2) twice.
Sample = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class PairLens:
    """
    Fits and judges F of pairs of views; all distances are pixels of the image.

    Attributes
    ----------
    model : DivisionModel, optional
        None for straight lines.
    division : float
        lambda of the lens with one coefficient, radii in half diagonals; 0 for straight lines.

    """

    model: DivisionModel | None = None
    division: float = 0.0

    def inliers(self, samples: list[Sample], rng: np.random.Generator,
                threshold_px: float) -> list[np.ndarray | None]:
        """Tell which matches of every pair agree with one F, (m,) of bool; None without an F."""
        model = self.model
        if model is None:
            found = [ransac_inliers(*xy, rng, threshold_px) for xy in samples]
            return [one[0] if one else None for one in found]
        return lifted_inliers([(model.units(a), model.units(b)) for a, b in samples],
                              np.array(model.coefficients),
                              threshold_px / model.half_diagonal_px, rng)

    def refined(self, samples: list[Sample]) -> np.ndarray:
        """F (n, 3, 3) of all pairs at once, of (straightened) pixels, by least squares."""
        if not samples:
            return np.zeros((0, 3, 3))
        if self.model is None:
            data = PairMatches.from_pixels(samples)
            F, *_ = refine_general(data, eight_point(data))
            return data.pixels_F(F)
        xy_a, xy_b, weight = _padded(samples, self.model)
        coefficients = np.array(self.model.coefficients)
        F = weighted_eight_point(xy_a, xy_b, weight, coefficients)
        F = refine_division(xy_a, xy_b, weight, F, coefficients, held=True).F
        pixels = self.model.to_units.T @ F @ self.model.to_units
        unit: np.ndarray = pixels / np.linalg.norm(pixels, axis=(1, 2), keepdims=True)
        return unit

    def distance(self, F: np.ndarray, xy_a: np.ndarray, xy_b: np.ndarray) -> np.ndarray:
        """Signed first-order distance (m,) of matches (m, 2)."""
        if self.model is None:
            return sampson_distance(F, xy_a, xy_b)
        return self.model.sampson_distance(self._of_units(F), xy_a, xy_b)

    def homography_px(self, samples: list[Sample]) -> np.ndarray:
        """Root mean square per coordinate that a homography leaves of every pair, (n,)."""
        counts = np.array([len(a) for a, _ in samples])
        cost = (homography_cost(PairMatches.from_pixels(samples)) if self.model is None
                else np.array([lifted_homography_cost(self.model, *xy) for xy in samples]))
        left: np.ndarray = np.sqrt(cost / (4 * np.maximum(2 * counts - 8, 1)))
        return left

    def improved(self, samples: list[Sample], F: np.ndarray) -> PairLens:
        """Refine the lens with the inliers of all pairs, begun at their F (n, 3, 3)."""
        if self.model is None or not samples:
            return self
        xy_a, xy_b, weight = _padded(samples, self.model)
        start = np.array(self.model.coefficients)
        units = np.stack([self._of_units(one) for one in F])
        fit = refine_division(xy_a, xy_b, weight, units, start)
        if not np.isfinite(fit.covariance).all() or np.abs(fit.coefficients - start).max() > 0.5:
            return self
        model = replace(self.model, coefficients=tuple(fit.coefficients.tolist()))
        if len(start) == 1:
            return PairLens(model, float(fit.coefficients[0]))
        return replace(self, model=model)

    def _of_units(self, F: np.ndarray) -> np.ndarray:
        assert self.model is not None
        back = np.linalg.inv(self.model.to_units)
        turned: np.ndarray = back.T @ F @ back
        return turned


def _padded(samples: list[Sample], model: DivisionModel,
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places in half diagonals (n, m, 2), twice, and which are there (n, m)."""
    most = max(len(a) for a, _ in samples)
    xy, weight = np.zeros((2, len(samples), most, 2)), np.zeros((len(samples), most))
    for n, sides in enumerate(samples):
        weight[n, :len(sides[0])] = 1
        for side, places in enumerate(sides):
            xy[side, n, :len(places)] = model.units(places)
    return xy[0], xy[1], weight


def choose_lens(compared: list[Sample], image_size: tuple[int, int] | None,
                rng: np.random.Generator, threshold_px: float) -> PairLens:
    """
    Bend the epipolar lines where the matches ask for it.

    Parameters
    ----------
    compared : list of (xy_a, xy_b)
        Matches of pairs, with gross errors.
    image_size : (int, int) or None
        Without it no lens has a centre.
    rng : numpy.random.Generator
    threshold_px : float
        Where squared distances are cut off.

    Returns
    -------
    PairLens

    """
    rich = [pair for pair in compared if len(pair[0]) >= _LEAST_MATCHES]
    if image_size is None or not rich:
        return PairLens()
    # of the better half, for pairs with few matches say little
    rich = sorted(rich, key=lambda pair: -len(pair[0]))[:max((len(rich) + 1) // 2, _JUDGES)]
    judges = np.unique(np.linspace(0, len(rich) - 1, _JUDGES).astype(int))
    found = shared_division([rich[k] for k in judges], image_size, rng, threshold_px,
                            _CLEAR_GAIN)
    if found is None or found.model.straight:
        return PairLens()
    return PairLens(found.model, found.division)


def homography_lens(lens: PairLens, samples: list[Sample], noise_px: float,
                    image_size: tuple[int, int] | None) -> tuple[PairLens, np.ndarray]:
    """
    Find a lens with which homographies explain what they leave through straight lines.

    While the camera only turns, or sees one plane, straight epipolar lines find room for any
    lens: the lens shows in homographies alone.

    Parameters
    ----------
    lens : PairLens
        That of the epipolar geometry.
    samples : list of (xy_a, xy_b)
        Inliers of all pairs.
    noise_px : float
    image_size : (int, int) or None

    Returns
    -------
    PairLens
        The given one, unless the other explains the worst pair.
    ndarray, shape (n,)
        Root mean square per coordinate that homographies leave of every pair then, pixels.

    """
    left = lens.homography_px(samples)
    if image_size is None or left.max() < PARALLAX_RATIO * noise_px:
        return lens, left
    # the worst pairs, the last of all the worst
    bad = np.argsort(left)[-_WORST_PAIRS:]

    def left_px(coefficients: Sequence[float] | np.ndarray,
                which: int | np.integer = bad[-1]) -> float:
        model = DivisionModel(tuple(coefficients), image_size)
        return float(PairLens(model).homography_px([samples[which]])[0])

    def disagree(coefficients: Sequence[float] | np.ndarray, share: float) -> bool:
        return any(left_px(coefficients, which) > share * left.max() for which in bad)

    start = min(LADDER, key=left_px)
    if disagree(start, _HOMOGRAPHY_HOPE):
        return lens, left
    # loaded by the few that need it
    from scipy.optimize import minimize
    found = minimize(left_px, start, method='Nelder-Mead', options={
        'maxfev': 120, 'xatol': 1e-4, 'fatol': 1e-3 * noise_px,
        'initial_simplex': [start, (1.1 * start[0], start[1]), (start[0], 0.5 * start[1] - 0.01)]})
    # every pair has to agree, the worst before the others: a lens is no excuse for parallax
    if disagree(found.x, _HOMOGRAPHY_GAIN):
        return lens, left
    other = PairLens(DivisionModel(tuple(found.x.tolist()), image_size), float(found.x[0]))
    left_by_other = other.homography_px(samples)
    gains = left_by_other.max() < _HOMOGRAPHY_GAIN * left.max()
    return (other, left_by_other) if gains else (lens, left)
