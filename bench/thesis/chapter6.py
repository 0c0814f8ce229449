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
Chapter 6 of the thesis on sequence SI: lines, v, l and K with their covariances, theirs and ours.

The table that it left open, coverage of K after the last refinement, is
`bench.calibration.coverage`.
"""

from __future__ import annotations

from functools import partial

from bench.monte_carlo import run_seeds
from bench.tables import Report
from bench.thesis import thesis_chapter6 as thesis
import numpy as np
from scipy.stats import chi2
from selfcal_ros import CameraFacts
from selfcal_ros.calibration.planar.fixed_points import calibrate_estimate, fixed_points
from selfcal_ros.calibration.planar.pair_means import agreed_pairs
from selfcal_ros.geometry.fundamental import eight_point, PairMatches, refine_general
from selfcal_ros.geometry.planar_pairs import pair_lines
from selfcal_ros.geometry.projective import completed_frame, euclidean_covariance, unit, unit_slope
from selfcal_ros.synthetic.scenes import sequence_si

SHARES = np.array([0.60, 0.80, 0.90, 0.95])
ALLOWED = 0.03
NOISES_PX = (0.1, 0.3, 1.0)
PAIRS = ((0, 1), (1, 2), (0, 2))
K_NAMES = ('fx', 'cx', 'cy', 'skew')
_K_ROWS = [0, 2, 3, 4]


def true_lines(sequence) -> dict:
    """Lines m of the three pairs and l, from the true poses, pixels."""
    K, poses = sequence.camera.K, sequence.cam_from_world
    lines = {}
    for k, (a, b) in enumerate(PAIRS):
        turn = poses[b, :, :3].T @ poses[a, :, :3]
        centres = [-poses[v, :, :3].T @ poses[v, :, 3] for v in (a, b)]
        # the point of the plane of motion that the motion of the camera from a to b leaves
        local = poses[a, :, :3] @ (centres[1] - centres[0])
        R = poses[a, :, :3] @ turn @ poses[a, :, :3].T
        fixed = np.linalg.lstsq(np.eye(3) - R, local, rcond=1e-10)[0]
        lines[f'm{k + 1}'] = np.cross(K @ fixed, sequence.vanishing_point)
        lines[f'l{k + 1}'] = sequence.horizon
    return lines


def one_run(seed: int, noise_px: float) -> dict:
    """
    Every estimate of one noisy SI.

    Returns
    -------
    dict of str to (ndarray (k,), ndarray (k, k))
        Lines and points as unit vectors with their covariances, 'K' as fx, cx, cy, skew less
        the truth; what was refused is missing.

    """
    sequence = sequence_si(np.random.default_rng([seed, round(1000 * noise_px)]), noise_px)
    xy = np.moveaxis(sequence.tracks.xy.reshape(len(sequence.points), -1, 2), 1, 0)
    data = PairMatches.from_pixels([(xy[a], xy[b]) for a, b in PAIRS])
    F, cost, _, _ = refine_general(data, eight_point(data))
    _, _, state, planar_cost = agreed_pairs(data, F, cost)
    lines = pair_lines(data, state, planar_cost)
    found = {}
    spare = len(xy[0]) - 6
    for name, vectors, covariances in zip('lm', (lines.horizons, lines.axes), lines.covariances):
        for k, (x, covariance) in enumerate(zip(vectors, covariances)):
            x, slope = unit_slope(data.transform.T, x)
            found[f'{name}{k + 1}'] = x, slope @ covariance @ slope.T * spare / (spare - 2)
    for method in ('pairs', 'batch'):
        estimate = fixed_points(sequence.tracks, method=method)
        if not estimate:
            continue
        found[f'l {method}'] = estimate.fixed.horizon, estimate.pairs.horizon_covariance
        if estimate.motion == 'planar':
            # not told from a circle, at 1 px, v is any point of its axis
            found[f'v {method}'] = (estimate.fixed.vanishing_point,
                                    estimate.pairs.vanishing_point_covariance)
        chain = calibrate_estimate(estimate, CameraFacts(aspect_ratio=1.0))
        if method == 'batch' and chain:
            K, true = chain.K, sequence.camera.K
            found['K'] = (np.array([(K - true)[entry] for entry in
                                    ((0, 0), (0, 2), (1, 2), (0, 1))]),
                          chain.covariance[np.ix_(_K_ROWS, _K_ROWS)])
    return found


def along_sphere(x, covariance, truth) -> float:
    """Squared distance in sigmas of a true vector from a unit vector, in its tangent plane."""
    across = completed_frame(x)[:, 1:]
    truth = unit(truth)
    offset = across.T @ truth / (truth @ x)
    inner = across.T @ covariance @ across
    scale = np.sqrt(np.diag(inner))
    return float(offset / scale @ np.linalg.solve(inner / np.outer(scale, scale), offset / scale))


def robust_covariance(values) -> np.ndarray:
    """Covariance (2, 2) of (n, 2) from quantiles: v passes through infinity at 1 px."""
    def variance(x):
        return ((np.quantile(x, 0.8413) - np.quantile(x, 0.1587)) / 2) ** 2
    x, y = values.T / np.median(np.abs(values - np.median(values, axis=0)), axis=0)[:, None]
    cross = (variance(x + y) - variance(x - y)) / 4
    size = np.median(np.abs(values - np.median(values, axis=0)), axis=0)
    return np.array([[variance(x), cross], [cross, variance(y)]]) * np.outer(size, size)


def shares_of(distances, size: int) -> np.ndarray:
    """Shares of squared distances inside the ellipsoids that should hold `SHARES`."""
    return np.mean(np.asarray(distances)[:, None] < chi2.ppf(SHARES, size), axis=0)


def _row(name, truth, results, published):
    found = [r[name] for r in results if name in r]
    flat = [euclidean_covariance(*one) for one in found]
    seen = robust_covariance(np.array([xy for xy, _ in flat]))
    stated = np.median([covariance for _, covariance in flat], axis=0)
    held = shares_of([along_sphere(*one, truth) for one in found], 2)
    cells = [f'{c[i, j]:.3g}' for c in (seen, stated) for i, j in ((0, 0), (0, 1), (1, 1))]
    theirs = [f'{value:.3g}' for part in published[:2] for value in part]
    return held, (name, len(found), *cells, *(f'{s:.3f}' for s in held)), (
        name, 'thesis', *theirs, *(f'{s:.3f}' for s in published[2]))


def run(report: Report, options) -> None:
    """Print tables 6.2-6.13 and 6.20 beside the thesis's."""
    runs = options.runs or 1000
    sequence = sequence_si(np.random.default_rng(0), 0.0)
    truths = true_lines(sequence)
    truths |= {f'{name} {method}': vector for method in ('pairs', 'batch')
               for name, vector in (('v', sequence.vanishing_point), ('l', sequence.horizon))}
    header = ('of', 'runs', 'seen xx', 'xy', 'yy', 'stated xx', 'xy', 'yy',
              *(f'{share:.2f}' for share in SHARES))
    means, calibrations = [], []
    for noise_px in NOISES_PX:
        results = run_seeds(partial(one_run, noise_px=noise_px), range(runs), options.processes)
        for title, published in (('tables 6.2-6.4: lines of single pairs', thesis.LINES),
                                 ('tables 6.5-6.10: v and l', thesis.FIXED)):
            report.section(
                f'SI, {noise_px} px, {title} ({runs} runs)',
                'seen: covariance of the estimates as (x, y, 1), by quantiles; stated: median of '
                'theirs. Shares: the truth inside',
                'the stated ellipsoid of each run, as a unit vector. The thesis does not print '
                'its camera path; ours differs, and so do the sizes.')
            rows, worst = [], 0.0
            for name, numbers in published[noise_px].items():
                held, *both = _row(name, truths[name], results, numbers)
                rows += both
                worst = max(worst, float(np.abs(held - SHARES).max()))
            report.table(header, rows)
            report.say('')
            if noise_px < 1 or published is thesis.FIXED:
                report.verdict('largest deviation of a share', worst, tolerance(runs))
            else:
                report.say(f'Largest deviation of a share: {worst:.3f}; a single pair is far from '
                           'linear at 1 px, and only starts the batch.')
        for name in thesis.MEANS[noise_px]:
            xy = np.array([r[name][0][:2] / r[name][0][2] for r in results if name in r])
            true = truths[name][:2] / truths[name][2]
            means.append((noise_px, name, *(f'{x:.4g}' for x in true),
                          *(f'{x:.4g}' for x in np.median(xy, axis=0)),
                          *(f'{x:.4g}' for x in thesis.MEANS[noise_px][name])))
        calibrations.append((noise_px, [r['K'] for r in results if 'K' in r]))
    report.section('Tables 6.11-6.13: v and l on average (ours: medians)')
    report.table(('noise px', 'of', 'true x', 'y', 'ours x', 'y', 'thesis x', 'y'), means)
    report.section('Table 6.20: K by the closed form, aspect ratio known',
                   'The stated covariance is what 6.4 could not give. After refinement K is three '
                   'times better: see si_triplet and coverage.')
    rows, worst = [], 0.0
    for noise_px, found in calibrations:
        away, covariances = (np.array(part) for part in zip(*found))
        scale = np.sqrt(np.einsum('nii->ni', covariances))
        correlation = covariances / (scale[:, :, None] * scale[:, None])
        distance = np.einsum('ni,ni->n', away / scale, np.linalg.solve(
            correlation, (away / scale)[..., None])[..., 0])
        held = shares_of(distance, 4)
        if noise_px < 1:
            # at 1 px the closed form is far from linear; only the refined K is for use
            worst = max(worst, float(np.abs(held - SHARES).max()))
        seen = (np.quantile(away, 0.8413, axis=0) - np.quantile(away, 0.1587, axis=0)) / 2
        published = thesis.K_SIGMAS.get(noise_px, ('',) * 4)
        rows += [(noise_px, name, len(found), float(s), float(t), p,
                  *((f'{share:.3f}' for share in held) if k == 0 else ('',) * 4))
                 for k, (name, s, t, p) in enumerate(zip(
                     K_NAMES, seen, np.median(scale, axis=0), published))]
    report.table(('noise px', 'of', 'runs', 'seen σ px', 'stated σ px', 'thesis σ px',
                  *(f'{share:.2f}' for share in SHARES)), rows)
    report.say('')
    report.verdict('largest deviation of a share, 0.1 and 0.3 px', worst, tolerance(runs))


def tolerance(runs: int) -> float:
    """Deviation of a share that is allowed; few runs do not know a share that well."""
    return ALLOWED if runs >= 1000 else round(ALLOWED + 3 * float(np.sqrt(0.24 / runs)), 3)
