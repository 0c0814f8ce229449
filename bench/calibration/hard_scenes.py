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
Forty-eight sequences at the edge: never confidently wrong, never refused without need.

Whether the images determine the camera is told by the Fisher information at the truth. In exactly
planar motion that is the bench's own bound, else the adjustment's normal equations.
"""

from __future__ import annotations

from collections import Counter
from itertools import product

from bench.fisher import cramer_rao_bound
from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.lens import Lens, to_parameters
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.bundle.scene_model import SceneModel
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.observability import observability_limits
from selfcal_ros.geometry.camera import PARAMETER_NAMES
from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.synthetic.hard_scenes import HARD_SCENES, NOISE_PX

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0)
#: Beyond so many stated sigmas a result is wrong.
MAX_SIGMAS = 4.0
#: The images determine the camera where every bound is below this share of the sigma that makes
#: a parameter unobservable.
DETERMINED = 0.3
#: Images that are not what the model supposes: what is there may be refused.
BROKEN = ('two thirds', 'a third', 'rolling', 'k3')
#: The truth of these has coefficients that the model has not: only these are judged.
LENS_APART = ('fx', 'cx', 'cy')


def is_determined(sequence, noise_px: float) -> bool:
    """Ask the Fisher information whether square pixels and the images determine fx, cx, cy."""
    poses = sequence.cam_from_world
    turn = np.swapaxes(poses[0, :, :3], 0, 1) @ poses[:, :, :3]
    planar = (np.allclose(turn[:, 2], [0, 0, 1], atol=1e-9)
              and np.allclose(np.diff(camera_centres(poses)[:, 2]), 0, atol=1e-9))
    names = ('fx', 'cx', 'cy')
    try:
        if planar:
            bound = cramer_rao_bound(sequence, noise_px, (*names, 'k1', 'k2'))
            sigma = np.array([bound.sigma[name] for name in names])
        else:
            sigma = _general_bound(sequence, noise_px)
    except np.linalg.LinAlgError:
        return False
    limits = observability_limits(sequence.camera)[[PARAMETER_NAMES.index(n) for n in names]]
    return bool(np.isfinite(sigma).all() and (sigma < DETERMINED * limits).all())


def _general_bound(sequence, noise_px) -> np.ndarray:
    tracks = sequence.tracks
    kept = tracks.with_at_least(2)
    ids, point = np.unique(kept.track, return_inverse=True)
    order = np.lexsort((kept.frame, point))
    first = sequence.cam_from_world[0]
    R = sequence.cam_from_world[:, :, :3] @ first[:, :3].T
    t = sequence.cam_from_world[:, :, 3] - np.einsum('vij,j->vi', R, first[:, 3])
    path = AxisPath.of_poses(np.eye(3), np.concatenate([R, t[:, :, None]], axis=2))
    local = sequence.points[ids] @ first[:, :3].T + first[:, 3]
    points = np.column_stack([local, np.ones(len(local))])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    state = SceneState(Lens.of(sequence.camera), path, points)
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2')
    bundle = Bundle(SceneModel(GENERAL), kept.frame[order], point[order], kept.xy[order],
                    priors=priors_from_facts(facts), sigma_px=noise_px)
    covariance = to_parameters(bundle.covariance(state), state.lens)
    return np.sqrt(np.diag(covariance))[[0, 2, 3]]


def one_run(task: tuple) -> tuple:
    """
    Calibrate one sequence; the task is (name, seed).

    Returns
    -------
    kind : {'right', 'WRONG', 'refused', 'NEEDLESS'}
    worst deviation in stated sigmas, relative sigma of fx : float
    reason : str

    """
    name, seed = task
    sequence = HARD_SCENES[name](np.random.default_rng([seed, 5]))
    result = calibrate(sequence.tracks, facts=FACTS)
    # a hint must be as true as a calibration
    result = result if result else result.hint or result
    if not result:
        needless = not any(word in name for word in BROKEN) and is_determined(
            sequence, 3.0 if '3 px' in name else NOISE_PX)
        return 'NEEDLESS' if needless else 'refused', np.nan, np.nan, result.reason
    away = result.camera.parameters - sequence.camera.parameters
    judged = [k for k, one in enumerate(PARAMETER_NAMES) if result.status[one] == 'estimated'
              and (one in LENS_APART or 'k3' not in name)]
    sigma = np.array([result.sigma[one] for one in PARAMETER_NAMES])
    worst = float(np.max(np.abs(away[judged]) / np.maximum(sigma[judged], 1e-12)))
    return ('right' if worst < MAX_SIGMAS else 'WRONG', worst,
            sigma[0] / sequence.camera.K[0, 0], '')


def run(report: Report, options) -> None:
    """Print one line a sequence."""
    seeds = range(options.runs or 5)
    report.section(
        f'{len(HARD_SCENES)} sequences, {len(seeds)} seeds each, square pixels stated, '
        'motion and distortion found out',
        f'wrong: an estimated parameter more than {MAX_SIGMAS:g} stated sigmas from the truth. '
        'needless: refused, though', f'the Fisher information gives fx, cx, cy within '
        f'{DETERMINED:g} of what makes them unobservable.')
    tasks = list(product(HARD_SCENES, seeds))
    outcome = dict(zip(tasks, run_seeds(one_run, tasks, options.processes)))
    rows, total = [], Counter()
    for name in HARD_SCENES:
        results = [outcome[name, seed] for seed in seeds]
        kinds = Counter(kind for kind, *_ in results)
        total += kinds
        figures = np.array([r[1:3] for r in results if r[0] in ('right', 'WRONG')])
        figures = figures.reshape(-1, 2)
        rows.append((name, kinds['right'], kinds['refused'], kinds['WRONG'], kinds['NEEDLESS'],
                     f'{np.max(figures[:, 0], initial=0):.1f}' if len(figures) else '',
                     f'{100 * np.median(figures[:, 1]):.2g}' if len(figures) else '',
                     next((r[3] for r in results if r[3]), '')[:70]))
    report.table(('sequence', 'right', 'refused', 'wrong', 'needless', 'worst σ', 'σ fx %',
                  'first reason'), rows)
    report.say('')
    report.judge(total['WRONG'] == 0, f'{total["WRONG"]} of {len(tasks)} confidently wrong')
    report.judge(total['NEEDLESS'] == 0, f'{total["NEEDLESS"]} of {len(tasks)} refused without '
                 'need')
