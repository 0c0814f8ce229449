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
"""The monitor: how soon a changed camera is noticed, how often an unchanged one is blamed."""

from __future__ import annotations

from functools import partial
import time

from bench.live.linear_windows import corrected_chance, linear_hours
from bench.live.monitored_drive import (displaced, end_to_end, keyframes, measure_drive,
                                        MeasuredDrive, recalibrated, window_of)
from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from scipy.stats import chi2
from selfcal_ros import Camera
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.monitoring.camera_change import MonitorSettings
from selfcal_ros.calibration.monitoring.change_detector import ChangeMonitor
from selfcal_ros.calibration.monitoring.window_score import window_score, WindowScore
from selfcal_ros.geometry.no_estimate import NoEstimate

RUNS, PERIOD_S = 100, 1.0
#: Keyframes before a change, within which it is to be noticed, and that a slow drift takes.
BEFORE, WITHIN, DRIFT = 48, 50, 400
#: What is done to the camera.
KINDS = {'focal length +2 %': 50, 'principal point +5 px': 50,
         'focal length +2 % over 400 keyframes': DRIFT}
#: Hours that are simulated point by point in pieces of half an hour, and hours that are drawn
#: from their windows.
PIECES, PIECE_KEYFRAMES, DRAWN_HOURS = 20, 1800, 1000
#: Hours that are simulated point by point with the adjustment to first order: none in 300 bounds
#: the rate by one in 100, at 95 percent.
LINEAR_HOURS, LINEAR_PIECE_HOURS = 300, 10
#: A whole drive there and back: windows that are drawn together.
TOGETHER = 10
#: Stated rates that are checked, hours between false alarms.
STATED_HOURS = (1, 10, 100, 1000)


def run(report: Report, options) -> None:
    """Measure the rendered drive, simulate, and judge."""
    runs = options.runs or RUNS
    share = min(1.0, runs / RUNS)
    drive = measure_drive()
    report.section(
        'Monitor: how soon a change is noticed',
        f'{runs} simulated drives each, with the points, the path and the errors of the rendered '
        f'one followed by KLT ({drive.white_px:.3f} px white, {drive.drift_px:.3f} px drift a '
        'keyframe, heavy tails); the calibration in force errs by its covariance. Keyframes from '
        'the first that differs to the alarm.')
    rows, within, seconds = [], {}, []
    for kind, limit in KINDS.items():
        results = run_seeds(partial(noticed, drive, kind), range(runs), options.processes)
        delays = np.array([r[0] for r in results])
        within[kind] = float(np.mean(delays <= limit))
        seconds += [s for r in results for s in r[2]]
        rows.append((kind, f'{np.median(delays):.0f}', f'{np.percentile(delays, 95):.0f}',
                     f'{100 * within[kind]:.0f} of 100 within {limit}',
                     f'{np.median([r[1] for r in results]):.2f}'))
    report.table(('change', 'keyframes, median', 'p95', 'noticed', 'stated change / true'), rows)
    report.say(f'\nProcessor time: a window of {MonitorSettings().keyframes} keyframes takes '
               f'{1000 * np.median(seconds):.0f} ms '
               f'(p99 {1000 * np.percentile(seconds, 99):.0f} ms).')
    for kind, part in within.items():
        report.judge(part >= 0.95, f'{kind}: noticed in {100 * part:.0f} of 100 runs, '
                     'required 95')
    step = MonitorSettings().keyframes - 1
    report.verdict('processor time for a keyframe', 1000 * float(np.mean(seconds)) / step, 50,
                   'ms')
    from_images(report)
    false_alarms(report, drive, options, share)


def changed_camera(camera: Camera, kind: str, onset: int, angle: float, index: int) -> Camera:
    """Camera at a keyframe of a drive."""
    if index < onset:
        return camera
    if 'over' in kind:
        return displaced(camera, 1 + 0.02 * min((index - onset) / DRIFT, 1))
    if 'focal' in kind:
        return displaced(camera, 1.02)
    return displaced(camera, 1.0, 5 * np.array([np.cos(angle), np.sin(angle)]))


def noticed(drive: MeasuredDrive, kind: str, seed: int):
    """
    Drive until a change is noticed, at most `DRIFT` and `WITHIN` keyframes.

    Returns
    -------
    delay : int
        Keyframes from the change to the alarm, infinite without one.
    ratio : float
        Change that the alarm states over the true one (at its last keyframe).
    seconds : list of float
        Processor time of every window.

    """
    rng = np.random.default_rng([seed, len(kind)])
    onset, angle = BEFORE + int(rng.integers(8)), rng.uniform(0, 2 * np.pi)
    camera_at = partial(changed_camera, drive.camera, kind, onset, angle)
    monitor, frames, seconds = ChangeMonitor(recalibrated(drive, rng)), [], []
    for frame in keyframes(drive, rng, camera_at):
        frames.append(frame)
        if len(frames) == monitor.settings.keyframes:
            began = time.process_time()
            take(monitor, frames, drive)
            seconds.append(time.process_time() - began)
            frames = frames[-1:]
        if monitor.change is not None and frame[0] >= onset:
            true = (camera_at(frame[0]).parameters - drive.camera.parameters)[[0, 2, 3]]
            return (frame[0] - onset + 1,
                    float(monitor.change.change_px @ true / (true @ true)), seconds)
        if monitor.change is not None or frame[0] > onset + DRIFT + WITHIN:
            return np.inf, np.nan, seconds


def take(monitor: ChangeMonitor, frames, drive: MeasuredDrive) -> WindowScore | None:
    """Score a window and give it to the monitor, as the node does."""
    size = drive.camera.width, drive.camera.height
    score = window_score(window_of(frames, size), monitor.camera, monitor.free,
                         np.random.default_rng(0))
    if isinstance(score, NoEstimate):
        return None
    monitor.add(score)
    return score


def from_images(report: Report) -> None:
    """Render the drive with a camera that changes on the way, from images to the alarm."""
    report.section('Monitor: from images', 'The rendered drive, followed by KLT; calibrated with '
                   'the keyframes before the change, at image 70 of 160; one run each.')
    rows = []
    for name, focal, shift in (('none', 1.0, (0, 0)), ('focal length +2 %', 1.02, (0, 0)),
                               ('principal point +5 px', 1.0, (3, -4))):
        delay, left, change = end_to_end(focal, shift)
        rows.append((name, f'{delay} of {left}' if change else f'- of {left}', change or '-'))
        report.judge(bool(change) == (name != 'none'),
                     f'{name}: {"alarm" if change else "no alarm"}')
    report.say('')
    report.table(('change', 'keyframes to the alarm', 'alarm'), rows)


# ---------------------------------------------------------------------- false alarms

def false_alarms(report: Report, drive: MeasuredDrive, options, share: float) -> None:
    """Simulate hours point by point, then draw many more from their windows."""
    pieces = max(2, int(PIECES * share))
    hours = pieces * PIECE_KEYFRAMES * PERIOD_S / 3600
    drawn = max(20, int(DRAWN_HOURS * share))
    report.section(
        'Monitor: false alarms', f'{hours:g} h of the drive at 1 keyframe a second are simulated '
        f'point by point; {drawn} h are drawn from their windows, {TOGETHER} successive ones '
        '(one drive there and back) at a time, each 100 h with a calibration of their own. An '
        'alarm at a stated rate: the statistic exceeds the threshold for it.')
    scored = run_seeds(partial(unchanged, drive), range(pieces), options.processes)
    alarms = sum(piece[0] for piece in scored)
    windows = [piece[1] for piece in scored]
    chances = run_seeds(partial(drawn_chances, drive, windows), range(max(1, drawn // 100)),
                        options.processes)
    length = min(100, drawn)
    drawn = length * len(chances)
    full = np.concatenate([piece[2] for piece in scored])
    rows = []
    for stated in STATED_HOURS:
        limit = (MonitorSettings().keyframes - 1) * PERIOD_S / (stated * 3600)
        rows.append((f'1 in {stated} h', f'{hours / stated:.3g}', episodes(full, limit),
                     f'{drawn / stated:.3g}', sum(episodes(c, limit) for c in chances)))
    report.table(('stated', f'allowed in {hours:g} h', 'simulated', f'allowed in {drawn} h',
                  'drawn'), rows)
    report.say('')
    report.judge(alarms == 0, f'{alarms} alarms in {hours:g} h simulated point by point')
    least = min(float(c.min()) for c in chances)
    report.judge(rows[-1][-1] <= drawn / 100, f'{rows[-1][-1]} alarms in {drawn} h drawn from '
                 f'windows, allowed {drawn / 100:g} (1 in 100 h); the least chance that a test '
                 f'gave was {least:.1g}, the alarm is at {limit:.1g}')
    linear_false_alarms(report, drive, options, share, scored)


def linear_false_alarms(report: Report, drive: MeasuredDrive, options, share: float,
                        whole) -> None:
    """Simulate many hours point by point, the adjustment of every window to first order."""
    pieces = max(1, int(LINEAR_HOURS / LINEAR_PIECE_HOURS * share))
    began = time.perf_counter()
    found = run_seeds(partial(linear_hours, drive, LINEAR_PIECE_HOURS, PERIOD_S), range(pieces),
                      options.processes)
    hours = pieces * LINEAR_PIECE_HOURS
    errors = np.concatenate([[score[0] for score in piece[1]] for piece in whole])
    linear = np.concatenate([piece[2] for piece in found])
    report.say(f'\n{hours} h point by point, every window adjusted to first order; '
               f'{(time.perf_counter() - began) / hours:.1f} s for an hour.')
    report.say('scatter of the windows over that with the whole adjustment, a parameter each: '
               + ', '.join(f'{ratio:.2f}' for ratio in linear.std(axis=0) / errors.std(axis=0)))
    tests = np.concatenate([piece[1] for piece in found])
    report.table(('stated', f'allowed in {hours} h', 'to first order'), [
        (f'1 in {stated} h', f'{hours / stated:.3g}',
         episodes(tests, (MonitorSettings().keyframes - 1) * PERIOD_S / (stated * 3600)))
        for stated in STATED_HOURS])
    alarms = sum(piece[0] for piece in found)
    report.judge(alarms <= hours / 100, f'{alarms} alarms in {hours} h to first order, allowed '
                 f'{hours / 100:g} (1 in 100 h)')
    bound = rate_bound(alarms, hours)
    sentence = f'with 95 % confidence no more than {100 * bound:.3g} alarms in 100 h'
    if hours < LINEAR_HOURS:
        report.say(f'{sentence}; fewer hours than {LINEAR_HOURS} cannot show 1 in 100 h.')
    else:
        report.judge(100 * bound <= 1, sentence)


def rate_bound(events: int, hours: float) -> float:
    """Rate of a Poisson process, an hour, that exceeds the true one with 95 % confidence."""
    return float(chi2.ppf(0.95, 2 * (events + 1)) / 2 / hours)


def unchanged(drive: MeasuredDrive, seed: int):
    """
    Drive with the camera as it is.

    Returns
    -------
    alarms : int
    scores : list of tuple
        Error of the window about the true camera, information, dependence.
    chances : ndarray
        `corrected_chance` of every test.

    """
    rng = np.random.default_rng([seed, 99])
    monitor, frames, scores, chances = ChangeMonitor(recalibrated(drive, rng)), [], [], []
    true = Lens.of(drive.camera).take(monitor.free)
    for frame in keyframes(drive, rng):
        frames.append(frame)
        if len(frames) == monitor.settings.keyframes:
            score = take(monitor, frames, drive)
            frames = frames[-1:]
            if score is not None:
                scores.append((score.at + score.step - true, score.information,
                               score.variance_inflation))
                chances.append(corrected_chance(monitor))
        if frame[0] >= PIECE_KEYFRAMES:
            return int(monitor.change is not None), scores, np.array(chances)


def drawn_chances(drive: MeasuredDrive, pieces, seed: int, hours: float = 100) -> np.ndarray:
    """Chances of all tests of so many hours whose windows are drawn from simulated ones."""
    rng = np.random.default_rng([seed, 98])
    monitor = ChangeMonitor(recalibrated(drive, rng))
    true = Lens.of(drive.camera).take(monitor.free)
    at = monitor.in_force
    step = monitor.settings.keyframes - 1
    count = int(hours * 3600 / PERIOD_S / step)
    chances = []
    while len(chances) < count:
        piece = pieces[rng.integers(len(pieces))]
        first = int(rng.integers(max(1, len(piece) - TOGETHER)))
        for error, information, variance_inflation in piece[first:first + TOGETHER]:
            frame = len(chances) * step
            monitor.add(WindowScore((frame, frame + step), at, true + error - at, information,
                                    variance_inflation, 0.0, 1.0))
            chances.append(corrected_chance(monitor))
    return np.array(chances)


def episodes(chances: np.ndarray, limit: float, apart: int = 12) -> int:
    """Count the alarms: exceedances that are not within so many tests of another."""
    at = np.flatnonzero(chances < limit)
    return int(np.sum(np.diff(at, prepend=-apart - 1) > apart))
