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
"""Tables 4.1 and 4.2 of the thesis: affine self-calibration of the grid, K and structure."""

from __future__ import annotations

from functools import partial
import time

from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.affine.affine_calibration import calibrate_affine
from selfcal_ros.calibration.affine.translation_groups import translation_groups
from selfcal_ros.calibration.structure.metric_structure import (distance_error, pattern_error,
                                                                plane_angle)
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.synthetic.grid_scenes import (CORNER_NOISE_PX, CORNERS, grid_camera,
                                               grid_sequence, random_rotations)

NAMES = ('αu', 'αv', 'ζ', 'u0', 'v0', 's')
#: Rows of table 4.1: rotated views, their rotations, is zero skew stated, thesis mean and
#: standard deviation of `NAMES` (None: held).
ROWS = {
    '3 images 5°': (1, '5', True, (625.2, 954.5, 1.53, 242.8, 225.6, None),
                    (41.1, 35.5, 0.11, 20.1, 29.4, None)),
    '3 images 10°': (1, '10', True, (684.4, 1034.0, 1.513, 261.0, 234.2, None),
                     (26.7, 24.9, 0.081, 4.0, 32.0, None)),
    '4 images': (2, '10', False, (661.0, 1018.0, 1.522, 258.0, 239.7, 1.2),
                 (17.0, 22.2, 0.028, 7.7, 11.6, 36.6)),
    '6 images': (4, '10', False, (645.6, 1001.8, 1.552, 260.0, 236.9, 21.8),
                 (13.1, 16.9, 0.021, 4.6, 6.6, 14.4)),
}
#: What the thesis measured against: the known grid.
VERIDICAL = (646.0, 968.7, 1.4996, 246.5, 244.3, 1.5)
#: Table 4.2: distance error (%), pattern error (°), plane angle (°), its standard deviation.
STRUCTURE = {'3 images 5°': (4.5, 2.51, 91.03, 3.80), '3 images 10°': (3.9, 1.66, 91.52, 4.20),
             '4 images': (3.9, 1.12, 89.33, 2.21), '6 images': (3.7, 1.00, 90.35, 1.07)}
#: Degenerate motions: rotated views, rotations, what must be open.
DEGENERATE = {
    'x only': (2, 'x', {'fx'}), 'y only': (2, 'y', {'fy'}), 'z only': (2, 'z', {'fx', 'fy'}),
    'translation only': (2, None, {'fx', 'fy', 'cx', 'cy'}),
    'two views': (0, 'x', {'fx', 'fy', 'cx', 'cy'}),
}
SIZE = (512, 512)
MAX_FOCAL_ERROR = 1.0
METHODS = ('linear', 'affine adjustment', 'calibrate')


def row_of(K) -> np.ndarray:
    """Six numbers of table 4.1."""
    return np.array([K[0, 0], K[1, 1], K[1, 1] / K[0, 0], K[0, 2], K[1, 2], K[0, 1]])


def structure_measures(points) -> np.ndarray:
    """
    Measure a metric reconstruction of the grid as table 4.2 does.

    Parameters
    ----------
    points : ndarray, shape (128, 3)
        In the order of `grid_points`, any scale.

    Returns
    -------
    ndarray, shape (3,)
        Distance error (standard deviation over mean of the distances of neighbours, percent),
        pattern error (standard deviation of the squares' angles, degrees), angle between the
        planes (degrees).

    """
    grids = np.reshape(points, (2, CORNERS, CORNERS, 3))
    return np.array([100 * distance_error(grids), np.degrees(pattern_error(grids)),
                     np.degrees(plane_angle(*grids))])


def scene_of(seed: int, count: int, rotations):
    """Make one sequence: two translated views and `count` more."""
    rng = np.random.default_rng([seed, count])
    turns = np.zeros((count, 3)) if rotations is None else random_rotations(rng, count, rotations)
    return grid_sequence(rng, turns)


def one_run(seed: int, name: str):
    """
    Calibrate one sequence of a row by all methods.

    Returns
    -------
    rows : dict of str to (ndarray (6,), ndarray (3,)) or None
        Per method, the numbers of both tables.
    seconds : dict of str to float
    found : bool
        Whether the translated views were found from the images alone.

    """
    count, rotations, zero_skew, *_ = ROWS[name]
    scene = scene_of(seed, count, rotations)
    facts = CameraFacts(skew=0.0 if zero_skew else None, distortion='none')
    rows, seconds = dict.fromkeys(METHODS), {}
    began = time.perf_counter()
    chain = calibrate_affine(scene.tracks, (0, 1), SIZE, facts, refine=False)
    seconds['linear'] = time.perf_counter() - began
    if chain and chain.conic.linear_K is not None:
        K = chain.conic.linear_K
        rows['linear'] = row_of(K), structure_measures(chain.metric(K))
    began = time.perf_counter()
    chain = calibrate_affine(scene.tracks, (0, 1), SIZE, facts)
    seconds['affine adjustment'] = time.perf_counter() - began
    if chain:
        rows['affine adjustment'] = row_of(chain.K), structure_measures(chain.metric())
    began = time.perf_counter()
    result = calibrate(scene.tracks, motion='general', facts=facts)
    seconds['calibrate'] = time.perf_counter() - began
    # turns of 5 degrees give a hint, whose numbers are compared as any
    result = result or result.hint
    if result:
        X, shape = result.reconstruction.points, np.full(3, np.nan)
        # a corner may have been left out as an outlier: then there is no whole grid to measure
        if len(X) == len(scene.points):
            shape = structure_measures(X[:, :3] / X[:, 3:])
        rows['calibrate'] = row_of(result.camera.K), shape
    groups = translation_groups(scene.tracks, SIZE).groups
    return rows, seconds, bool(groups) and {0, 1} <= set(groups[0])


def degenerate_run(seed: int, name: str):
    """Tell what is open, by the chain and by `calibrate`; None where there is a number."""
    count, rotations, _ = DEGENERATE[name]
    scene = scene_of(seed, count, rotations)
    facts = CameraFacts(skew=0.0, distortion='none')
    answers = []
    for method in (lambda: calibrate_affine(scene.tracks, (0, 1), SIZE, facts),
                   lambda: calibrate(scene.tracks, motion='general', facts=facts)):
        try:
            found = method()
        except ArgumentError:
            # an answer that is no camera is as bad as a number
            answers.append(None)
            continue
        answers.append(None if found else frozenset(
            name for name, state in _status(found).items()
            if state == 'unobservable' and name in ('fx', 'fy', 'cx', 'cy')))
    return answers


def _status(refused) -> dict:
    """Return what is known of each parameter where a method gave no camera."""
    return refused.values.get('status', {}) if isinstance(refused, NoEstimate) else refused.status


def error_of(mean, spread, truth) -> float:
    """Root mean square error of mean ± spread against the truth."""
    return float(np.hypot(mean - truth, spread))


def run(report: Report, options) -> None:
    """Print both tables, the degenerate motions, and the verdicts."""
    runs = options.runs or 100
    truth = row_of(grid_camera().K)
    structure = []
    for name, (_, _, _, mean, spread) in ROWS.items():
        results = run_seeds(partial(one_run, name=name), range(runs), options.processes)
        report.section(f'Table 4.1, {name} ({runs} sequences)',
                       f'Mean ± standard deviation; corner noise {CORNER_NOISE_PX} px. linear: '
                       "the thesis's chain. thesis: real images,",
                       'veridical values in its last row; the positions of its views are not '
                       'printed.')
        table, measured = [], {}
        for method in METHODS:
            done = [r[0][method] for r in results if r[0][method] is not None]
            if not done:
                table.append((method, *['-'] * len(NAMES), 0, ''))
                continue
            values = np.array([d[0] for d in done])
            shape = np.array([d[1] for d in done])
            shape = shape[np.isfinite(shape).all(axis=1)]
            measured[method] = values
            milliseconds = 1000 * np.median([r[1][method] for r in results])
            table.append((method, *(f'{m:.4g} ± {s:.2g}' for m, s in zip(
                values.mean(axis=0), values.std(axis=0))), len(done), f'{milliseconds:.0f}'))
            structure.append((name, method, *(f'{v:.2f}' for v in shape.mean(axis=0)),
                              f'{shape[:, 2].std():.2f}', shape))
        table.append(('truth', *(f'{v:.5g}' for v in truth), '', ''))
        table.append(('thesis', *('0' if m is None else f'{m:g} ± {s:g}'
                                  for m, s in zip(mean, spread)), '', ''))
        table.append(('thesis, known grid', *(f'{v:g}' for v in VERIDICAL), '', ''))
        report.table(('method', *NAMES, 'runs', 'ms'), table)
        report.say('')
        found = sum(r[2] for r in results)
        report.judge(found >= 0.98 * runs,
                     f'the translated views are found from the images in {found} of {runs}')
        values = measured.get('calibrate', np.full((1, 6), np.nan))
        report.judge(len(values) >= 0.98 * runs, f'calibrate gives a camera in {len(values)} of '
                                                 f'{runs}')
        for k, parameter in enumerate(NAMES):
            if mean[k] is None:
                continue
            ours = error_of(values[:, k].mean(), values[:, k].std(), truth[k])
            theirs = error_of(mean[k], spread[k], VERIDICAL[k])
            report.judge(ours <= theirs, f'{parameter}: rms error {ours:.3g}, thesis {theirs:.3g}')
        if name == '6 images':
            report.verdict('worst error of αu', float(np.abs(
                100 * (values[:, 0] / truth[0] - 1)).max()), MAX_FOCAL_ERROR, '%')
    report.section('Table 4.2, metric structure', 'Mean over the sequences, and the spread of '
                   'the angle between the planes (90° in truth).')
    header = ('sequence', 'method', 'distance error %', 'pattern error °', 'plane angle °', '±')
    rows = [entry[:6] for entry in structure]
    rows += [(name, 'thesis', *(f'{v:.2f}' for v in values)) for name, values in STRUCTURE.items()]
    order = {name: k for k, name in enumerate(ROWS)}
    report.table(header, sorted(rows, key=lambda row: order[row[0]]))
    report.say('')
    for name, method, *_, shape in structure:
        if method != 'calibrate':
            continue
        distance, pattern, angle, spread = STRUCTURE[name]
        ours = shape.mean(axis=0)
        report.judge(ours[0] <= distance and ours[1] <= pattern
                     and error_of(ours[2], shape[:, 2].std(), 90) <= error_of(angle, spread, 90),
                     f"{name}: structure no worse than the thesis's in all three measures")
    _degenerate(report, runs, options.processes)


def _degenerate(report, runs, processes) -> None:
    """Print what is open in degenerate motions (4.1.3)."""
    report.section('Degenerate rotations, zero skew stated (4.1.3)',
                   'Sequences in which exactly these are open, or all of them and more; a number '
                   'in none.')
    rows, sentences = [], []
    for name, (_, _, expected) in DEGENERATE.items():
        results = run_seeds(partial(degenerate_run, name=name), range(runs), processes)
        for k, method in enumerate(('calibrate_affine', 'calibrate')):
            numbers = sum(r[k] is None for r in results)
            exact = sum(r[k] == expected for r in results)
            covered = sum(r[k] is not None and expected <= r[k] for r in results)
            rows.append((name, method, ', '.join(sorted(expected)), exact, covered, numbers))
            sentences.append((numbers == 0, f'{name}, {method}: never a number'))
            if name != 'two views' or k == 0:
                sentences.append((covered == runs, f'{name}, {method}: '
                                                   f'{", ".join(sorted(expected))} open'))
    report.table(('motion', 'by', 'must be open', 'exactly', 'at least', 'a number'), rows)
    report.say('')
    for held, sentence in sentences:
        report.judge(held, sentence)
