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
"""One lens for many pairs: the division model with which all their matches agree best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.division import DivisionModel, refine_division, residuals
from selfcal_ros.geometry.lifted_ransac import lifted_ransac
from selfcal_ros.geometry.robust_scale import robust_sigma

#: Values of lambda and kappa to begin with, half diagonals: every second one, then next to the
#: best. Lenses of 185 degrees whose circle fits into the height of the image have lambda from
#: -1.4 (square image) to -3 (16:9). With one number alone wide lenses differ by pixels.
LADDER = ((0.08, 0.0), (0.0, 0.0), (-0.06, 0.0), (-0.14, 0.0), (-0.25, -0.02), (-0.38, -0.05),
          (-0.57, -0.11), (-0.85, -0.25), (-1.2, -0.6), (-1.6, -1.3), (-2.3, -1.8), (-3.2, -4.0))
_STRAIGHT = LADDER.index((0.0, 0.0))
#: Threshold of the first comparison, half diagonals: neighbours in the grid differ by so much.
_COARSE = 0.006
#: The first comparison draws so many samples a pair; so many of its best are refined.
_SAMPLES, _FINALISTS = 300, 2
#: Straight lines that leave a larger cost a match are far from a good fit: more are refined.
_FITS_BADLY, _MANY_FINALISTS = 0.12, 6
#: Matches of a pair used at most.
_MATCHES = 200
#: A curved geometry leaves at most this share of the cost of straight lines.
_CLEAR_GAIN = 0.93
#: A coefficient is there if it is so many of its standard deviations from zero.
_SIGNIFICANT = 5.0
#: One number that leaves more than this share of what straight lines leave says that there is no
#: bend, where straight lines explain the matches.
_HOPELESS = 0.97
#: Straight lines with this share of inliers are at most a little bent, if a pair has so many.
_NEARLY_ALL, _MANY = 0.9, 40
#: Square of the radius about which one coefficient stands for two.
_USUAL_SQUARE = 0.35
#: The last refinement keeps what lies within so many times the noise, or so much of the limit.
_NOISES, _LEAST_LIMIT = 3.0, 0.1


#: Matches in half diagonals (n, m, 2), twice, and which are there (n, m).
_Data = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class SharedDivision:
    """
    The lens that pairs agree on.

    Attributes
    ----------
    model : DivisionModel
        Straight where that does as well.
    sigma : float
        Standard deviation of lambda, from the curvature of the cost; infinite where the pairs
        do not determine it, as when the camera only moves along its axis. With many gross
        errors in images of 180 degrees, where they reach the noise, it is too small by up to 3.
    division : float
        lambda of the best model with one coefficient, whatever was chosen; NaN where none was
        found.
    cost : float
        Truncated squares in units of the threshold, summed over matches.

    """

    model: DivisionModel
    sigma: float
    division: float
    cost: float


def _stacked(pairs: Sequence[tuple[np.ndarray, np.ndarray]], straight: DivisionModel) -> _Data:
    """Matches in units (n, m, 2), twice, and which are there (n, m); evenly thinned."""
    few = [np.linspace(0, len(a) - 1, min(len(a), _MATCHES)).astype(int) for a, _ in pairs]
    size = max(len(k) for k in few)
    xy, there = np.zeros((2, len(pairs), size, 2)), np.zeros((len(pairs), size))
    for n, (k, sides) in enumerate(zip(few, pairs)):
        there[n, :len(k)] = 1
        for side, places in enumerate(sides):
            xy[side, n, :len(k)] = straight.units(np.asarray(places)[k])
    return xy[0], xy[1], there


def shared_division(pairs: Sequence[tuple[np.ndarray, np.ndarray]], image_size: tuple[int, int],
                    rng: np.random.Generator, threshold_px: float = 1.0,
                    clear_gain: float = _CLEAR_GAIN) -> SharedDivision | None:
    """
    Find the lens with which the matches of all pairs obey epipolar geometry.

    Parameters
    ----------
    pairs : sequence of (xy_a (m, 2), xy_b (m, 2))
        Matches in pixels with gross errors, at least eight a pair.
    image_size : (int, int)
    rng : numpy.random.Generator
    threshold_px : float
        Where the squared distance is cut off.
    clear_gain : float
        A curved geometry leaves at most this share of the cost of straight lines.

    Returns
    -------
    SharedDivision or None
        None where no pair has an epipolar geometry.

    """
    straight = DivisionModel((0.0,), image_size)
    pairs = [pair for pair in pairs if len(pair[0]) >= 8]
    if not pairs:
        return None
    data = _stacked(pairs, straight)
    limit = threshold_px / straight.half_diagonal_px
    coarse = max(_COARSE, limit)
    starts: dict[int, tuple[float, np.ndarray]] = {}

    def best_step() -> int:
        return min(starts, key=lambda step: starts[step][0])

    def start(step: int) -> None:
        if 0 <= step < len(LADDER):
            coefficients = np.array(LADDER[step])
            F = _sampled(data, coefficients, coarse, rng)
            starts[step] = _cost(data, F, coefficients, coarse), F

    start(_STRAIGHT)
    flat = _descended(data, starts[_STRAIGHT][1], np.zeros(1), coarse, limit, True, True)
    # where straight lines leave nothing to explain, refinement goes far enough
    inliers, there = np.sum(_distances(data, flat.F, np.zeros(1)) < limit), data[2].sum()
    explained = (inliers > _NEARLY_ALL * there and there > _MANY * len(pairs)
                 and flat.cost < _FITS_BADLY * there)
    for step in range(_STRAIGHT + 2, len(LADDER), 2) if not explained else ():
        start(step)
    middle = best_step()
    for step in (middle - 1, middle + 1) if middle != _STRAIGHT else ():
        start(step)
    one = _descended(data, flat.F, np.zeros(1), coarse, limit, quick=True)
    if explained and one.cost > _HOPELESS * flat.cost:
        return SharedDivision(straight, float(one.sigmas[0]), float(one.coefficients[0]),
                              flat.cost)
    order = [step for step in sorted(starts, key=lambda step: starts[step][0])
             if step != _STRAIGHT or explained]
    # where straight lines leave much, the coarse comparison does not decide
    order = order[:_FINALISTS if flat.cost < _FITS_BADLY * there else _MANY_FINALISTS]
    two = min((_descended(data, starts[step][1], np.array(LADDER[step]), coarse, limit, quick=True)
               for step in order), key=lambda fit: fit.cost)
    best, bent = one, min(one.cost, two.cost) < clear_gain * flat.cost
    if bent:
        two = _descended(data, two.F, two.coefficients, coarse, limit)
        # where straight lines explain nearly all, no pair is caught by wrong matches
        two = two if explained else _again(data, two, coarse, limit, rng)
        usual = two.coefficients[:1] + _USUAL_SQUARE * two.coefficients[1]
        one = min((one, _descended(data, two.F, usual, coarse, limit)),
                  key=lambda fit: fit.cost)
        one = one if explained else _again(data, one, coarse, limit, rng)
        significant = abs(two.coefficients[1]) > _SIGNIFICANT * two.sigmas[1]
        best = two if two.cost < one.cost and significant else one
        if best is two and two.cost < clear_gain * one.cost:
            # one number is far off: the nearest to the two
            one = _Descent(two.F, usual, two.sigmas[:1], two.cost)
        bent = best.cost < clear_gain * flat.cost
        bent &= abs(best.coefficients[0]) > _SIGNIFICANT * best.sigmas[0]
    model = DivisionModel(tuple(best.coefficients.tolist()), image_size) if bent else straight
    return SharedDivision(model, float(one.sigmas[0]), float(one.coefficients[0]), best.cost)


@dataclass(frozen=True)
class _Descent:
    """A local optimum of the truncated cost."""

    F: np.ndarray
    coefficients: np.ndarray
    sigmas: np.ndarray
    cost: float


def _sampled(data: _Data, coefficients: np.ndarray, limit: float,
             rng: np.random.Generator) -> np.ndarray:
    """F (n, 3, 3) of every pair by random samples; zero where none was found."""
    F = np.zeros((len(data[0]), 3, 3))
    for n, (a, b, there) in enumerate(zip(*data)):
        count = int(there.sum())
        found = lifted_ransac(a[:count], b[:count], coefficients, limit, rng, _SAMPLES, False)
        if found:
            F[n] = found[0]
    return F


def _again(data: _Data, fit: _Descent, coarse: float, limit: float,
           rng: np.random.Generator) -> _Descent:
    """Refine once more: a pair caught by wrong matches would pull the others along."""
    F = _sampled(data, fit.coefficients, coarse, rng)
    costs = [np.minimum(_distances(data, some, fit.coefficients) / coarse, 1.0).sum(axis=1)
             for some in (fit.F, F)]
    F = np.where((costs[1] < costs[0])[:, None, None], F, fit.F)
    return min((fit, _descended(data, F, fit.coefficients, coarse, limit)),
               key=lambda fit: fit.cost)


def _distances(data: _Data, F: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Distances (n, m); infinite where there is no F, or no match."""
    distance = np.abs(residuals(data[0], data[1], F, coefficients)[0])
    known = (np.abs(F).sum(axis=(1, 2))[:, None] > 0) & (data[2] > 0)
    distances: np.ndarray = np.where(known, distance, np.inf)
    return distances


def _cost(data: _Data, F: np.ndarray, coefficients: np.ndarray, limit: float) -> float:
    """Sum of squares cut off at one, in units of the limit."""
    ratio = np.minimum(_distances(data, F, coefficients) / limit, 1.0)
    return float((ratio ** 2 * data[2]).sum())


def _descended(data: _Data, F: np.ndarray, coefficients: np.ndarray, coarse: float,
               limit: float, held: bool = False, quick: bool = False) -> _Descent:
    """Refine on the inliers, from the coarse limit down to the fine one."""
    best = None
    for width in (coarse, limit) if quick else (coarse, limit, limit, 0.0):
        distance = _distances(data, F, coefficients)
        if not width:
            # a wrong match next to an epipole pulls hard: keep no more than the noise asks for
            noise = robust_sigma(distance[distance < limit]) if np.any(distance < limit) else 0.0
            width = min(limit, max(_NOISES * noise, _LEAST_LIMIT * limit))
        near = (distance < width).astype(float)
        enough: np.ndarray = near.sum(axis=1) >= 12
        near[~enough] = 0
        if not enough.any():
            break
        fit = refine_division(data[0][enough], data[1][enough], near[enough], F[enough],
                              coefficients, held, 7 if quick else 12, 1e-2 if quick else 1e-4)
        F = F.copy()
        F[enough] = fit.F
        coefficients = fit.coefficients
        cost = _cost(data, F, coefficients, limit)
        spare = max(near.sum() - 7 * enough.sum() - 1, 1)
        sigmas = np.sqrt(np.diag(fit.covariance) * fit.cost / spare)
        if best is None or cost <= best.cost or width < limit:
            best = _Descent(F, coefficients, sigmas, cost)
    if best is None:
        return _Descent(F, coefficients, np.full(len(coefficients), np.inf),
                        _cost(data, F, coefficients, limit))
    return best
