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
Drives that go round and find their points again, and drives that pause: right, or refused?

Views, turns, step, camera and points of each are drawn. The turns between the views of a loop
contradict each other by any but the true focal length, which starts have to bear. A vehicle that
stands or turns on the spot sees points without depth, which must not hold the camera.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import time

from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.synthetic.lap_scenes import laps
from selfcal_ros.synthetic.pause_scenes import pauses
from selfcal_ros.synthetic.scenes import PointSequence

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0)
#: Beyond so many stated sigmas a result is wrong.
MAX_SIGMAS = 4.0
#: From view to view.
SHARP_DEG = 20.0


def run(report: Report, options) -> None:
    """Print a table of loops, and one of pauses."""
    runs = options.runs or 100
    for scene, title in ((laps, 'drives of 24 to 69 views that turn by 300 to 900°, 0.3 px'),
                         (pauses, 'drives that stand or turn on the spot for a while, 0.2 px')):
        report.section(f'{runs} {title}', 'Nothing stated but square pixels.')
        _print_drives(report, run_seeds(partial(one_run, scene), range(runs), options.processes))


def _print_drives(report: Report, found: list[dict]) -> None:
    """Print a line for gentle turns from view to view, one for sharp ones, and the wrong."""
    rows = []
    gentle = [one for one in found if one['step_deg'] < SHARP_DEG]
    sharp = [one for one in found if one['step_deg'] >= SHARP_DEG]
    for name, some in ((f'turns from view to view below {SHARP_DEG:g}°', gentle),
                       ('above', sharp)):
        errors = np.array([one['errors'] for one in some if one['errors'] is not None])
        if some:
            rms = np.sqrt(np.mean(np.square(errors), axis=0)) if len(errors) else [np.nan] * 3
            rows.append((name, len(some), len(some) - len(errors),
                         ' '.join(f'{one:.2f}' for one in rms),
                         f'{np.abs(errors).max(initial=0):.1f}',
                         f"{np.median([one['seconds'] for one in some]):.1f}",
                         f"{max(one['seconds'] for one in some):.0f}"))
    report.table(('', 'drives', 'refused', 'rms of fx, cx, cy in sigmas', 'largest',
                  'median s', 'longest'), rows)
    wrong = [(seed, one) for seed, one in enumerate(found)
             if one['errors'] is None or np.abs(one['errors']).max() > MAX_SIGMAS]
    for seed, one in wrong:
        report.say(f'- seed {seed}: {one["reason"] or np.round(one["errors"], 1)}')
    report.say('')
    report.verdict('wrong or refused', len(wrong), 0)


def one_run(drive: Callable[..., PointSequence], seed: int) -> dict:
    """Calibrate from one drive."""
    scene = drive(np.random.default_rng(seed))
    turned = scene.cam_from_world[1:, :, :3] @ np.swapaxes(scene.cam_from_world[:-1, :, :3], 1, 2)
    step = np.degrees(np.linalg.norm(rotation_vector(turned), axis=1))
    began = time.process_time()
    result = calibrate(scene.tracks, facts=FACTS)
    spent = {'seconds': time.process_time() - began, 'step_deg': float(step.mean())}
    if not result:
        return {**spent, 'errors': None, 'reason': result.kind}
    K, truth = result.camera.K, scene.camera.K
    errors = [(K[at] - truth[at]) / result.sigma[name]
              for name, at in (('fx', (0, 0)), ('cx', (0, 2)), ('cy', (1, 2)))]
    return {**spent, 'errors': errors, 'reason': ''}
