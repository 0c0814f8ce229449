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
"""Horizon l and vanishing point v of sequence SI: pairs and batch method, bound, thesis."""

from __future__ import annotations

from bench.fisher import cramer_rao_bound
from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from scipy.stats import chi2
from selfcal_ros.calibration.planar.fixed_points import fixed_points
from selfcal_ros.geometry.projective import euclidean_covariance
from selfcal_ros.synthetic.scenes import sequence_si

SHARES = (0.60, 0.80, 0.90, 0.95)
METHODS = ('pairs', 'batch')
#: Thesis, 500 runs: statistical variances of v and l (tables 6.11-6.13), and the shares of runs
#: inside the analytical ellipsoids (tables 6.5, 6.6 for pairs, 6.8, 6.9 for the batch method).
THESIS_VARIANCE = {
    (0.1, 'pairs'): ((6.492e3, 1.047e5), (7.576e-14, 4.692e-13)),
    (0.1, 'batch'): ((5.513e3, 8.895e4), (5.868e-14, 3.739e-13)),
    (0.3, 'pairs'): ((5.716e4, 9.378e5), (5.628e-13, 4.461e-12)),
    (0.3, 'batch'): ((4.670e4, 7.614e5), (4.498e-13, 3.362e-12)),
}
THESIS_FRACTIONS = {
    (0.1, 'pairs'): ((0.667, 0.724, 0.763, 0.793), (0.716, 0.837, 0.899, 0.934)),
    (0.1, 'batch'): ((0.665, 0.830, 0.900, 0.954), (0.493, 0.661, 0.790, 0.866)),
    (0.3, 'pairs'): ((0.592, 0.599, 0.607, 0.618), (0.702, 0.832, 0.900, 0.943)),
    (0.3, 'batch'): ((0.677, 0.832, 0.904, 0.953), (0.502, 0.681, 0.819, 0.894)),
}


def one_run(task: tuple):
    """
    Estimate v and l once; the task is (noise_px, method, seed).

    Returns
    -------
    list of (ndarray shape (2,), ndarray shape (2, 2)), or None
        v and l, each with its stated covariance.

    """
    noise_px, method, seed = task
    sequence = sequence_si(np.random.default_rng([seed, round(1000 * noise_px)]), noise_px)
    found = fixed_points(sequence.tracks, method=method)
    if not found:
        return None
    return [euclidean_covariance(found.fixed.vanishing_point,
                                 found.pairs.vanishing_point_covariance),
            euclidean_covariance(found.fixed.horizon, found.pairs.horizon_covariance)]


def inside(deviations, covariances) -> np.ndarray:
    """Shares of runs inside the ellipsoids that should hold `SHARES`."""
    distance = np.einsum('ni,nij,nj->n', deviations, np.linalg.inv(covariances), deviations)
    return np.mean(distance[:, None] < chi2.ppf(SHARES, 2), axis=0)


def run(report: Report, options) -> None:
    """Print variances and shares for 0.1 and 0.3 px, both methods."""
    count = options.runs or 1000
    tasks = [(noise, method, seed) for noise in (0.1, 0.3) for method in METHODS
             for seed in range(count)]
    results = run_seeds(one_run, tasks, options.processes)
    scene = sequence_si(np.random.default_rng(0))
    truths = [p[:2] / p[2] for p in (scene.vanishing_point, scene.horizon)]
    rows, shares, gains = [], [], []
    for number, (noise_px, method) in enumerate((n, m) for n in (0.1, 0.3) for m in METHODS):
        done = [r for r in results[number * count:(number + 1) * count] if r is not None]
        bound = cramer_rao_bound(scene, noise_px)
        limits = bound.vanishing_point_covariance, bound.horizon_covariance
        for k, name in enumerate('vl'):
            values = np.array([r[k][0] for r in done])
            stated = np.array([r[k][1] for r in done])
            variance = values.var(axis=0, ddof=1)
            ratio = np.sqrt(variance / np.diag(limits[k]))
            thesis = THESIS_VARIANCE[noise_px, method][k]
            held = inside(values - truths[k], stated)
            bias = (values.mean(axis=0) - truths[k]) / np.sqrt(variance)
            rows.append((noise_px, method, name, len(done),
                         *(f'{v:.3g}' for v in variance), *(f'{r:.2f}' for r in ratio),
                         *(f'{b:.2f}' for b in bias), *(f'{t:.3g}' for t in thesis),
                         *(f'{t / v:.2f}' for t, v in zip(thesis, variance))))
            shares.append((noise_px, method, name, *(f'{share:.3f}' for share in held),
                           *(f'{share:.3f}' for share in THESIS_FRACTIONS[noise_px, method][k])))
            if method == 'batch':
                gains.append(held - SHARES)
    report.section(
        f'SI: vanishing point v and horizon l ({count} runs each)',
        'σ / bound: against the Cramér-Rao bound of all parameters together. thesis: tables '
        '6.11, 6.12, whose camera path is not printed; ours differs.')
    report.table(('noise px', 'method', 'of', 'runs', 'var x', 'var y', 'σ/bound x', 'σ/bound y',
                  'bias/σ x', 'bias/σ y', 'thesis var x', 'thesis var y', 'thesis/ours x',
                  'thesis/ours y'), rows)
    report.section('SI: share of runs inside the stated ellipsoids of v and l')
    report.table(('noise px', 'method', 'of', *(f'{share:.2f}' for share in SHARES),
                  *(f'thesis {share:.2f}' for share in SHARES)), shares)
    report.say('')
    allowed = 0.02 + 3 * np.sqrt(0.24 / count)
    report.verdict('batch method, largest deviation of a share', float(np.abs(gains).max()),
                   round(allowed, 3))
