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
What an uneven ground does to a calibration while it tilts views in a row alike.

The estimate takes the ways x of the views out of the plane for independent ones, with one sigma s.
A ground that rises over several views tilts them alike, and together they tell less. The estimate
stays, and to its covariance comes what wrong weights cost (Liang and Zeger 1986):

    G (Q / s² - I) Gᵀ,   G = cov(lens, x) / s

Q is the covariance of a process that forgets over some views. Its size and its length are those
that make the images probable. With Σ the covariance of x and b = Σ⁻¹ x the images say of x

    J = Σ⁻¹ - I / s²,   log p(Q) = bᵀ (J + Q⁻¹)⁻¹ b / 2 - log |I + J Q| / 2

(Rasmussen, Williams 2006, 5.4). Processes are averaged by that probability.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.uncertainty.random_effects import log_evidence

#: Lengths of a process in views, beside none, and its sizes in sigmas of the estimate: each is as
#: likely beforehand.
LENGTHS, SIZES = np.geomspace(0.7, 8.0, 7), np.geomspace(0.7, 4.0, 6)
#: How it forgets: as a rough process does, and as a smooth one.
POWERS = (1.0, 2.0)
#: So many views tell whether it forgets at all, and so many tell enough.
FEWEST_VIEWS, MOST_VIEWS = 4, 48


def uneven_ground(fit: RobustFit, variance_inflation: float = 1.0) -> np.ndarray | None:
    """
    Tell what ways out of the plane that are alike in views in a row add to the covariance.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    variance_inflation : float
        Variance of the estimate over that with independent errors of the images.

    Returns
    -------
    ndarray, shape (k, k), or None
        To add to the covariance of the unknowns of the lens; None where nothing leaves the plane.

    """
    motion, path, unknowns = fit.motion, fit.state.path, fit.bundle.unknowns
    if not motion.keeps_plane or not motion.tilt_sigma_rad:
        return None
    of_lens = fit.covariance[unknowns.lens]
    excess = np.zeros((len(of_lens), len(of_lens)))
    for names, values, sigma in (
            (('tilt_x', 'tilt_y'), path.tilt, motion.tilt_sigma_rad),
            (('height',), path.translation[:, 2:], motion.height_sigma * path.step_length())):
        places = unknowns.of_views(*names)
        # views that move with others, and the first, whose place is the world's, have no own way
        views = np.flatnonzero(np.isin(places, unknowns.members).all(axis=1))
        if len(views) < FEWEST_VIEWS:
            continue
        middle = views[max(0, (len(views) - MOST_VIEWS) // 2):][:MOST_VIEWS]
        some = places[middle].T.ravel()
        processes = likely_processes(
            values[middle].T / sigma, fit.covariance[some[:, None], some] / sigma**2,
            variance_inflation)
        shape = sum(variance * _correlations(len(views), length, power)
                    for variance, length, power in processes)
        for one in places[views].T:
            response = of_lens[:, one] / sigma
            excess += response @ (shape - np.eye(len(views))) @ response.T
    size, along = np.linalg.eigh(excess)
    positive: np.ndarray = (along * np.maximum(size, 0)) @ along.T
    return positive


def likely_processes(x: np.ndarray, covariance: np.ndarray, variance_inflation: float = 1.0,
                     ) -> list[tuple[float, float, float]]:
    """
    Average the processes that may have made some series, by how probable they make the images.

    Parameters
    ----------
    x : ndarray, shape (c, n)
        Series that are alike and independent of each other, in views in a row. They were estimated
        as if all values were independent, of variance 1.
    covariance : ndarray, shape (c n, c n)
        Of that estimate.
    variance_inflation : float
        Variance over that with independent errors of the images.

    Returns
    -------
    list of (float, float, float)
        Variance times probability, length in views, and power of each.

    """
    count, length = x.shape
    precision = np.linalg.inv(covariance)
    images = (precision - np.eye(x.size)) / variance_inflation
    pull = precision @ x.ravel() / variance_inflation
    kinds = [(0.0, 1.0), *product(LENGTHS.tolist(), POWERS)]
    log = np.empty((len(kinds), len(SIZES)))
    for k, kind in enumerate(kinds):
        values, vectors = np.linalg.eigh(_correlations(length, *kind))
        root = np.kron(np.eye(count), vectors * np.sqrt(np.maximum(values, 0)))
        told, along = np.linalg.eigh(root.T @ images @ root)
        log[k] = log_evidence(np.maximum(told, 0), along.T @ (root.T @ pull), SIZES)
    probability = np.exp(log - log.max())
    variances = (probability / probability.sum()) @ SIZES**2
    return [(float(variance), *kind) for variance, kind in zip(variances, kinds)]


def _correlations(count: int, length: float, power: float) -> np.ndarray:
    """Correlate values in a row, (n, n), of a process that forgets over a length."""
    if not length:
        return np.eye(count)
    lag = np.abs(np.arange(count) - np.arange(count)[:, None])
    correlated: np.ndarray = np.exp(-0.5 * (lag / length)**power)
    return correlated
