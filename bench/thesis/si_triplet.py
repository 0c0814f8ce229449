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
"""Sequence SI, one triplet: spread of K over its Cramér-Rao bound, bias, stated covariance."""

from __future__ import annotations

from functools import partial
import time

from bench.fisher import cramer_rao_bound
from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from scipy.stats import chi2
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.planar.fixed_points import calibrate_estimate, fixed_points
from selfcal_ros.geometry.camera import PARAMETER_NAMES
from selfcal_ros.synthetic.scenes import sequence_si

FREE = ('fx', 'cx', 'cy', 'skew')
COLUMNS = [PARAMETER_NAMES.index(name) for name in FREE]
FACTS = CameraFacts(aspect_ratio=1.0, distortion='none')
SHARES = np.array([0.60, 0.80, 0.90, 0.95])
#: Thesis table 6.20: αu, u0, v0, s, linear chain, known aspect ratio, 1000 runs.
THESIS = {0.1: (1.5, 3.2, 1.7, 4.5), 0.3: (4.4, 9.0, 5.2, 12.5)}
MAX_RATIO, MAX_BIAS = 1.10, 0.1


def one_run(seed: int, noise_px: float):
    """
    Calibrate one noisy SI.

    Returns
    -------
    refined : ndarray, shape (4,), or None
        Deviations of `FREE` from the truth after refinement.
    covariance : ndarray, shape (4, 4), or None
        As stated.
    linear : ndarray, shape (4,), or None
        Deviations of the linear chain.
    seconds : float
    reason : str

    """
    sequence = sequence_si(np.random.default_rng([seed, round(1000 * noise_px)]), noise_px)
    truth = sequence.camera.parameters[COLUMNS]
    began = time.perf_counter()
    result = calibrate(sequence.tracks, motion='planar', facts=FACTS)
    seconds = time.perf_counter() - began
    refined = covariance = linear = None
    if result:
        refined = result.camera.parameters[COLUMNS] - truth
        covariance = result.covariance[np.ix_(COLUMNS, COLUMNS)]
    estimate = fixed_points(sequence.tracks)
    chain = calibrate_estimate(estimate, FACTS) if estimate else estimate
    if chain:
        K = chain.K
        linear = np.array([K[0, 0], K[0, 2], K[1, 2], K[0, 1]]) - truth
    return refined, covariance, linear, seconds, '' if result else result.reason


def coverage(deviations, covariances) -> np.ndarray:
    """Shares of runs inside the k-sigma ellipsoids that should hold `SHARES` of them."""
    distance = np.einsum('ni,nij,nj->n', deviations, np.linalg.inv(covariances), deviations)
    return np.mean(distance[:, None] < chi2.ppf(SHARES, deviations.shape[1]), axis=0)


def measure(noise_px: float, runs: int, processes: int = 2) -> dict:
    """Run the Monte Carlo experiment; arrays over the runs that succeeded, and the bound."""
    results = run_seeds(partial(one_run, noise_px=noise_px), range(runs), processes)
    done = [r for r in results if r[0] is not None]
    scene = sequence_si(np.random.default_rng(0), noise_px)
    return {
        'refined': np.array([r[0] for r in done]),
        'covariance': np.array([r[1] for r in done]),
        'linear': np.array([r[2] for r in results if r[2] is not None]),
        'seconds': float(np.median([r[3] for r in results])),
        'refused': [r[4] for r in results if r[0] is None],
        'bound': np.array([cramer_rao_bound(scene, noise_px, FREE).sigma[n] for n in FREE]),
    }


def run(report: Report, options) -> None:
    """Print the tables for 0.1 and 0.3 px."""
    for noise_px in (0.1, 0.3):
        found = measure(noise_px, options.runs or 1000, options.processes)
        count = len(found['refined'])
        report.section(
            f'SI, one triplet, {noise_px} px, aspect ratio known ({count} runs)',
            'σ: spread of the estimates. bound: Cramér-Rao. stated: median sigma of the result.',
            'linear: the closed-form chain alone. thesis: table 6.20 (its camera path is not '
            'printed; ours differs).')
        spread, bias = found['refined'].std(axis=0, ddof=1), found['refined'].mean(axis=0)
        linear = found['linear'].std(axis=0, ddof=1)
        stated = np.sqrt(np.median(found['covariance'].diagonal(axis1=1, axis2=2), axis=0))
        rows = []
        for k, name in enumerate(FREE):
            rows.append((name, spread[k], found['bound'][k], spread[k] / found['bound'][k],
                         bias[k] / spread[k], stated[k] / spread[k], linear[k],
                         linear[k] / found['bound'][k], THESIS[noise_px][k],
                         THESIS[noise_px][k] / spread[k]))
        report.table(('parameter', 'σ px', 'bound px', 'σ / bound', 'bias / σ', 'stated / σ',
                      'linear σ px', 'linear / bound', 'thesis σ px', 'thesis / σ'), rows)
        shares = coverage(found['refined'], found['covariance'])
        report.say('\nRuns inside the stated ellipsoids: ' + ', '.join(
            f'{share:.3f} (should be {wanted:.2f})' for share, wanted in zip(shares, SHARES)))
        report.say(f'Refused: {len(found["refused"])} of {options.runs or 1000}; '
                   f'{1000 * found["seconds"]:.0f} ms a run')
        report.verdict('largest σ / bound', float((spread / found['bound']).max()), MAX_RATIO)
        report.verdict('largest |bias|', float(np.abs(bias / spread).max()), MAX_BIAS, 'σ')
        # binomial spread of a share, three sigmas, and 0.02 for what is of second order
        allowed = 3 * np.sqrt(SHARES * (1 - SHARES) / max(count, 1)) + 0.02
        report.judge(bool((np.abs(shares - SHARES) < allowed).all()),
                     'stated covariance holds the right shares within '
                     f'{", ".join(f"{a:.3f}" for a in allowed)}')
        report.judge(len(found['refused']) <= 0.002 * (options.runs or 1000),
                     'no run is refused')
