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
A focal length that varies: is it found, are the stated sigmas true, is a constant one left alone?

Drives and hand-held sequences of points through a lens that drifts, breathes or zooms; and drives
that are rendered so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
import tempfile

from bench.calibration.coverage import shares
from bench.inputs import grey_frames
from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.geometry.camera import PARAMETER_NAMES
from selfcal_ros.synthetic.hard_scenes import hand, s_curve, vehicle
from selfcal_ros.synthetic.recordings import agv_drive, REALISTIC_DISTORTION, write_image_folder
from selfcal_ros.synthetic.zoomed_scenes import zoomed

VIEWS, POINTS = 16, 250
#: Magnification over the time from 0 to 1.
COURSES = {
    'constant': lambda t: 1 + 0 * t,
    'drift 0.5 %': lambda t: 1 + 0.005 * (t - 0.5),
    'drift 2 %': lambda t: 1 + 0.02 * (t - 0.5),
    'breathing 1.5 %': lambda t: 1 + 0.0075 * np.sin(9 * t),
    'step 8 %': lambda t: np.where(t < 0.4, 1.0, 1.08),
    'zoom 30 %': lambda t: 1 + 0.3 * t}
#: Free parameters whose ellipsoid is counted, beside fx.
FREE = ('fx', 'cx', 'cy', 'k1', 'k2')
#: Rendered drives: magnification, and bound of the error of every view's focal length, percent.
RENDERED = {'zoom 480 to 620 px': (lambda t: (480 + 140 * t) / 520, 0.3),
            'breathing 1.5 %': (lambda t: 1 + 0.0075 * np.sin(9 * t), 0.3)}
RENDERED_VIEWS = 30


@dataclass(frozen=True)
class Outcome:
    """One run: deviations and covariances, of the camera and of every view."""

    deviation: np.ndarray
    covariance: np.ndarray
    view_sigmas: np.ndarray
    view_error: float
    varies: bool


def one_run(seed: int, motion: str, course: str, focal: str = 'auto') -> Outcome | None:
    """Calibrate one sequence; None where it is refused."""
    rng = np.random.default_rng([seed, 77])
    scale = COURSES[course](np.linspace(0, 1, VIEWS))
    if motion == 'planar':
        still = vehicle(rng, s_curve(VIEWS), count=POINTS)
    else:
        still = hand(rng, 12 * rng.standard_normal((VIEWS, 3)), count=POINTS)
    sequence = zoomed(still, scale, rng)
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2', lens_population=False,
                        focal=focal)
    result = calibrate(sequence.tracks, motion=motion, facts=facts)
    if not result:
        return None
    fx = sequence.camera.K[0, 0] * scale[list(result.frames)]
    columns = [PARAMETER_NAMES.index(name) for name in FREE]
    truth = sequence.camera.parameters[columns]
    truth[0] = np.exp(np.log(fx).mean())
    views = [result.focal_of(frame) for frame in result.frames]
    off = np.array([view.value for view in views]) - fx
    return Outcome(result.camera.parameters[columns] - truth,
                   result.covariance[np.ix_(columns, columns)],
                   off / np.array([view.sigma for view in views]),
                   float(np.abs(off / fx).max()), result.focal is not None)


def run(report: Report, options) -> None:
    """Points first, then images."""
    rendered(report)
    runs = options.runs or 100
    report.section(f'Coverage: {runs} runs of each, {VIEWS} views, 0.2 px',
                   'Shares of the runs with fx (the mean), cx, cy, k1 and k2 inside the stated '
                   'ellipsoids; of a single view, the share of all within its sigmas.')
    rows = []
    for motion in ('planar', 'general'):
        for course in COURSES:
            rows.append(coverage(report, motion, course, runs, options))
    report.table(('motion', 'course', 'called varying', 'inside 60', '80', '90', '95',
                  'views within 1 sigma', '2', 'largest, sigmas', 'median worst view %',
                  'refused'), rows)


def coverage(report: Report, motion: str, course: str, runs: int, options) -> tuple:
    """Return a row of the table."""
    found = run_seeds(partial(one_run, motion=motion, course=course), range(runs))
    done = [one for one in found if one is not None]
    inside = shares([(one.deviation, one.covariance) for one in done])
    views = np.concatenate([one.view_sigmas for one in done])
    largest = max(float(np.abs(one.deviation / np.sqrt(np.diag(one.covariance))).max())
                  for one in done)
    called = np.mean([one.varies for one in done])
    if course == 'constant':
        report.judge(called <= 0.01, f'{motion}, constant: {called:.1%} called varying')
    return (motion, course, f'{called:.0%}', *(f'{share:.2f}' for share in inside),
            f'{np.mean(np.abs(views) < 1):.2f}', f'{np.mean(np.abs(views) < 2):.2f}',
            f'{largest:.1f}', f'{100 * np.median([one.view_error for one in done]):.2f}',
            str(len(found) - len(done)))


def rendered(report: Report) -> None:
    """Render drives through a lens that zooms or breathes, and calibrate the images."""
    time = np.linspace(0, 1, RENDERED_VIEWS)
    for name, (course, bound) in RENDERED.items():
        report.section(f'Rendered drive, {RENDERED_VIEWS} views, {name}')
        recording = agv_drive(RENDERED_VIEWS, distortion=REALISTIC_DISTORTION)
        recording = replace(recording, magnification=course(time))
        with tempfile.TemporaryDirectory() as folder:
            images = write_image_folder(recording, Path(folder) / 'drive')
            tracks = extract_tracks(grey_frames(sorted(images.glob('*.png')))).tracks
        result = calibrate(tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
        if not result:
            report.judge(False, str(result))
            continue
        fx = recording.camera.K[0, 0] * recording.magnification[list(result.frames)]
        views = [result.focal_of(frame) for frame in result.frames]
        off = np.array([view.value for view in views]) - fx
        report.verdict('focal length of a view, worst error', 100 * np.abs(off / fx).max(), bound,
                       '%')
        report.verdict('the same in its sigmas', float(np.abs(
            off / [view.sigma for view in views]).max()), 4.0)
        shift = result.camera.K[:2, 2] - recording.camera.K[:2, 2]
        report.say(f'principal point off by ({shift[0]:+.2f}, {shift[1]:+.2f}) px, sigma '
                   f'({result.sigma["cx"]:.2f}, {result.sigma["cy"]:.2f}); noise '
                   f'{result.noise_sigma_px:.3f} px; {result.notes[0] if result.notes else ""}')
