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
Four general views, and equal objects in one image: every method against truth.

The modulus constraint (thesis 4.1.2), Kruppa's equations (3.1.2) and repeated structure (4.2.2)
stand beside the main path on the same scenes.
"""

from __future__ import annotations

from collections import Counter
from functools import partial
import time
from unittest import mock

from bench.monte_carlo import run_seeds
from bench.tables import percent, Report
import numpy as np
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.affine.kruppa import calibrate_kruppa
from selfcal_ros.calibration.affine.modulus import calibrate_modulus
from selfcal_ros.calibration.affine.repeated_structure import (calibrate_repeated,
                                                               objects_from_tracks)
from selfcal_ros.calibration.initialisation import multi_start
from selfcal_ros.geometry.camera import PARAMETER_NAMES
from selfcal_ros.geometry.fundamental import fundamental
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.few_view_scenes import cut_camera, equal_objects, general_views

NO_FACT = CameraFacts(distortion='none')
SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
#: Cameras of the four views: focal length, aspect ratio, principal point from the middle.
CAMERAS = {
    'usual': cut_camera(),
    'aspect 1.5': cut_camera(600.0, 1.5),
    'wide, 330 px': cut_camera(330.0),
    'tele, 2200 px': cut_camera(2200.0),
    'principal point at a corner': cut_camera(700.0, 1.0, (250.0, -190.0)),
    'principal point outside': cut_camera(900.0, 1.0, (580.0, -390.0)),
}
#: Methods of four views, in the order of the table.
GENERAL_METHODS = ('sweep alone', '--motion general', '--views 4', 'modulus alone', 'Kruppa')
#: Rotation vectors of the objects, degrees.
ARRANGEMENTS = {
    '2 parallel, 1 turned': ((0, 0, 0), (0, 0, 0), (25, 35, 10)),
    '2 parallel, 2 turned': ((0, 0, 0), (0, 0, 0), (25, 35, 10), (-30, 20, 5)),
    '4 turned': ((0, 0, 0), (10, -40, 5), (25, 35, 10), (-30, 20, 5)),
    '6 turned': ((0, 0, 0), (10, -40, 5), (25, 35, 10), (-30, 20, 5), (40, -10, 20),
                 (-15, -25, -60)),
    '5 on a table': ((0, 0, 0), (0, 70, 0), (0, 150, 0), (0, -60, 0), (0, 30, 0)),
}
REPEATED_METHODS = ('--motion general', '--motion repeated', 'parallel stated', 'affine chain')
OBJECT_CAMERA = cut_camera(1100.0, 1.0, (20.0, -10.0), (1280, 960))
#: Scenes that do not suffice: name, whether of objects, options of the scene.
DEGENERATE = {
    'four views about one axis': (False, {'turns': rotation_matrix(np.radians(
        [[0, 0, 0], [0, 15, 0], [0, -12, 0], [0, 25, 0]]))}),
    'four parallel views': (False, {'turns': np.array([np.eye(3)] * 4)}),
    'two views': (False, {'views': 2}),
    'four views of 8 points': (False, {'points': 8}),
    'four parallel objects': (True, {'turns_deg': np.zeros((4, 3))}),
    'two objects': (True, {'turns_deg': ((0, 0, 0), (25, 35, 10))}),
    'four small, far objects': (True, {'turns_deg': ARRANGEMENTS['4 turned'], 'farness': 30.0}),
}
#: Of these, the scenes that may be calibrated or refused, but never wrongly calibrated; all others
#: must be refused. For the far objects the Cramér-Rao bound of fx is 4.5 to 5.4 % of fx, and the
#: cameras found state 4 to 9 %. That is below `observability.FOCAL_FRACTION`, 15 %: a camera says
#: something. The bound is 0.30 of that or more (`hard_scenes.DETERMINED`): none is required.
EITHER = ('four small, far objects',)
#: Beyond so many stated sigmas a result is wrong.
MAX_SIGMAS = 3.0
#: A camera counts as found within so many percent of the true focal length.
FOUND_PERCENT = 5.0


def general_run(seed: int, name: str, facts: CameraFacts = NO_FACT) -> dict:
    """
    Calibrate four general views by all methods.

    Returns
    -------
    dict of str to (float, float, float)
        Error and sigma of fx in percent (NaN where there is none), and milliseconds.

    """
    camera = CAMERAS[name]
    tracks = general_views(np.random.default_rng(seed), camera).tracks
    size, truth = (camera.width, camera.height), camera.K[0, 0]

    def sweep():
        with mock.patch.object(multi_start, 'MODULUS_MAX_VIEWS', 0):
            return calibrate(tracks, motion='general', facts=facts)

    def kruppa():
        pairs = [fundamental(*tracks.matches(a, b)[1:]) for a, b in zip(*np.triu_indices(4, 1))]
        return calibrate_kruppa([pair.F for pair in pairs if pair], size, facts)
    return {method: _timed(compute, truth) for method, compute in zip(GENERAL_METHODS, (
        sweep, lambda: calibrate(tracks, motion='general', facts=facts),
        lambda: calibrate(tracks, motion='general', facts=facts, views=4),
        lambda: calibrate_modulus(tracks, size, facts), kruppa))}


def repeated_run(seed: int, name: str) -> dict:
    """Calibrate equal objects in one image by all methods; see `general_run`."""
    camera = OBJECT_CAMERA
    tracks = equal_objects(np.random.default_rng(seed), camera, ARRANGEMENTS[name])
    methods = {
        '--motion general': lambda: calibrate(tracks, motion='general', facts=SQUARE),
        '--motion repeated': lambda: calibrate(tracks, motion='repeated', facts=SQUARE)}
    if 'parallel' in name:
        methods['parallel stated'] = lambda: calibrate(
            tracks, motion='repeated', facts=SQUARE, parallel_objects=(0, 1))
        methods['affine chain'] = lambda: calibrate_repeated(
            objects_from_tracks(tracks), (camera.width, camera.height), SQUARE, (0, 1))
    return {method: _timed(compute, camera.K[0, 0]) for method, compute in methods.items()}


def _timed(compute, truth: float) -> tuple[float, float, float]:
    """Error and sigma of fx in percent, NaN for none, and milliseconds."""
    began = time.perf_counter()
    found = compute()
    spent = 1000 * (time.perf_counter() - began)
    if not found:
        return np.nan, np.nan, spent
    K = found.camera.K if hasattr(found, 'camera') else found.K
    # Kruppa and the modulus constraint state none: what they find is a start
    structure = getattr(found, 'structure', None)
    covariance = found.conic.covariance if structure else getattr(found, 'covariance', None)
    sigma = np.nan if covariance is None else 100 * float(np.sqrt(covariance[0, 0])) / truth
    return percent(K[0, 0], truth), sigma, spent


def degenerate_run(seed: int, name: str) -> tuple[str, tuple[str, ...]]:
    """
    Calibrate a degenerate scene by its door, and by the general motion.

    Returns
    -------
    verdict : {'refused', 'right', 'WRONG'}
        By all; a camera by one or more, each within `MAX_SIGMAS`; a camera beyond.
    kinds : tuple of str
        Of the refusals.

    """
    objects, options = DEGENERATE[name]
    rng = np.random.default_rng(seed)
    if objects:
        truth = OBJECT_CAMERA
        tracks = equal_objects(rng, truth, **options)
        answers = [calibrate(tracks, motion=motion, facts=SQUARE)
                   for motion in ('repeated', 'general')]
    else:
        truth = CAMERAS['usual']
        tracks = general_views(rng, truth, **options).tracks
        answers = [calibrate(tracks, motion='general', facts=NO_FACT, views=views)
                   for views in (4, None)]
    deviations = [_deviation_sigmas(answer, truth) for answer in answers if answer]
    # where objects do not suffice, `why` holds the reason that they share with images
    kinds = tuple(answer.values.get('why', answer).kind for answer in answers if not answer)
    return ('refused' if not deviations else
            'right' if max(deviations) < MAX_SIGMAS else 'WRONG'), kinds


def _deviation_sigmas(result, truth) -> float:
    """Largest deviation of an estimated parameter from the truth, in stated sigmas."""
    deviation = np.abs(result.camera.parameters - truth.parameters)
    return max(deviation[k] / max(result.sigma[name], 1e-12)
               for k, name in enumerate(PARAMETER_NAMES) if result.status[name] == 'estimated')


def summary(results: list[dict], method: str) -> tuple:
    """
    Summarise one method over all runs.

    Returns
    -------
    tuple
        Runs with a camera within `FOUND_PERCENT`; runs with another camera; median and 95th
        percentile of |error| and median sigma of fx, percent; fraction within 1.96 sigma;
        median milliseconds.

    """
    rows = np.array([result[method] for result in results])
    given = np.isfinite(rows[:, 0])
    error = np.abs(rows[given, 0])
    if not given.any():
        return 0, 0, np.nan, np.nan, np.nan, np.nan, float(np.median(rows[:, 2]))
    sigma = rows[given, 1]
    stated = np.isfinite(sigma).any()
    inside = float(np.mean(error < 1.96 * sigma)) if stated else np.nan
    return (int(np.sum(error < FOUND_PERCENT)), int(np.sum(error >= FOUND_PERCENT)),
            float(np.median(error)), float(np.percentile(error, 95)),
            float(np.nanmedian(sigma)) if stated else np.nan, inside,
            float(np.median(rows[:, 2])))


HEADER = ('method', f'within {FOUND_PERCENT:g} %', 'worse', 'refused', 'median |error| %',
          '95th percentile %', 'median sigma %', 'inside 95 %', 'ms')


def _table(report: Report, results: list[dict], methods) -> dict[str, tuple]:
    """Print a row a method; returns the summaries."""
    found = {method: summary(results, method) for method in methods if method in results[0]}
    report.table(HEADER, [
        (method, good, bad, len(results) - good - bad,
         *('-' if np.isnan(v) else f'{v:.3g}' for v in (*rest[:3],)),
         '-' if np.isnan(rest[3]) else f'{100 * rest[3]:.0f} %', f'{rest[4]:.0f}')
        for method, (good, bad, *rest) in found.items()])
    report.say('')
    return found


def _judge(report: Report, found: dict[str, tuple], methods, runs: int) -> None:
    """A camera nearly always, and the stated sigma true."""
    for method in methods:
        if method not in found:
            continue
        good, bad, *_, inside, _ = found[method]
        given = good + bad
        report.judge(given >= 0.97 * runs, f'{method}: a camera in {given} of {runs}')
        # three deviations of the fraction that is counted
        least = 0.95 - 3 * np.sqrt(0.95 * 0.05 / max(given, 1))
        report.judge(inside >= least, f'{method}: truth inside 95 % in {100 * inside:.0f} %, '
                                      f'required {100 * least:.0f} %')


def run(report: Report, options) -> None:
    """Print the tables and the verdicts."""
    runs = options.runs or 100
    for name in CAMERAS:
        results = run_seeds(partial(general_run, name=name), range(runs), options.processes)
        report.section(f'Four general views, camera: {name} ({runs} scenes)',
                       '80 points, 0.1 px, turns up to 25 degrees; no fact but that the lens has '
                       'no distortion. Errors are of fx.')
        found = _table(report, results, GENERAL_METHODS)
        _judge(report, found, ('--motion general', '--views 4'), runs)
    for name in ARRANGEMENTS:
        results = run_seeds(partial(repeated_run, name=name), range(runs), options.processes)
        report.section(f'Equal objects in one image: {name} ({runs} scenes)',
                       '40 points an object, 0.1 px, square pixels, no distortion. Errors are of '
                       'fx.')
        found = _table(report, results, REPEATED_METHODS)
        _judge(report, found, ('--motion repeated', 'parallel stated'), runs)
    _degenerate(report, min(runs, 50), options.processes)


def _degenerate(report: Report, runs: int, processes: int) -> None:
    """Print which scenes are refused and why; never a wrong camera, never a false reason."""
    report.section(f'What does not suffice ({runs} scenes)',
                   'Scenes that both the door and the general motion refuse. Where the images may '
                   'suffice:', f'a camera within {MAX_SIGMAS:g} stated sigmas, or a refusal.')
    rows, verdicts, false = [], {}, Counter()
    for name in DEGENERATE:
        results = run_seeds(partial(degenerate_run, name=name), range(runs), processes)
        verdicts[name] = count = Counter(verdict for verdict, _ in results)
        kinds = Counter(kind for _, kinds in results for kind in kinds)
        # a camera and a motion do explain every scene: the true ones
        false[name] = kinds['tracks_unexplained']
        rows.append((name, 'either' if name in EITHER else 'refused', count['right'],
                     count['refused'], count['WRONG'],
                     ', '.join(f'{kind} {n}' for kind, n in kinds.most_common())))
    report.table(('scene', 'expected', 'right', 'refused', 'wrong', 'refusals by kind'), rows)
    report.say('')
    for name, count in verdicts.items():
        if name in EITHER:
            report.judge(count['WRONG'] == 0, f'{name}: wrong in {count["WRONG"]} of {runs}')
        else:
            report.judge(count['refused'] == runs,
                         f'{name}: refused in {count["refused"]} of {runs}')
        report.judge(false[name] == 0, f'{name}: {false[name]} refusals say that no camera '
                                       'explains the tracks, required none')
