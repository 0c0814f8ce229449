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
Short clips that turn by 2 to 15 degrees in all, as one films an object in passing.

The points of a track wander as patches do that are followed from image to image: a random walk,
beside the noise of each image. What comes of it is a calibration, a hint, or a refusal; neither of
the first two may be off by more than four of its sigmas. A focal length that is known to more than
one per cent only is no calibration.
"""

from __future__ import annotations

from itertools import product

from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from selfcal_ros import calibrate, Camera, CameraFacts, Tracks
from selfcal_ros.calibration.estimators.motion_class import widest_turn_rad
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.paths import look_at

#: A phone's video.
CAMERA = Camera([[1000, 0, 645], [0, 1000, 352], [0, 0, 1]], [0.06, -0.12], 1280, 720)
FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0)
#: Images that are filmed, and every how many of them is a view.
FRAMES, EVERY = 90, 7
#: Noise of each image, and the step of the random walk from image to image, pixels.
NOISE_PX, WALK_PX = 0.15, 0.03
#: Chance that a track ends from one image to the next, and share of gross errors.
LOST, WRONG = 0.01, 0.01
POINTS = 160
#: Beyond so many stated sigmas a result is wrong; beyond this share of itself a sigma is large.
MAX_SIGMAS, MAX_SHARE = 4.0, 0.01
SCENES, PATHS, TURNS_DEG = ('table', 'object', 'room'), ('round', 'aside', 'hand'), (2.0, 15.0)


def _points(rng: np.random.Generator, scene: str) -> np.ndarray:
    """Points (P, 3) about the origin, z up, in units of the distance from the camera."""
    on_floor = np.column_stack([rng.uniform(-0.7, 0.7, (POINTS, 2)), np.zeros(POINTS)])
    side = rng.integers(0, 3, POINTS)
    on_box = rng.uniform(-1, 1, (POINTS, 3))
    on_box[np.arange(POINTS), side] = np.sign(on_box[np.arange(POINTS), side])
    on_box = on_box * rng.uniform(0.08, 0.25, 3)
    on_box[:, 2] += 0.15
    if scene == 'object':
        return on_box
    if scene == 'table':
        return np.where(rng.random(POINTS)[:, None] < 0.5, on_floor, on_box)
    return rng.uniform([-1.2, -0.5, -0.7], [1.2, 2.5, 0.8], (POINTS, 3))


def _smooth(rng: np.random.Generator, size: float, count: int) -> np.ndarray:
    """Wander (FRAMES, count) as a hand does, with a spread of `size`."""
    t = np.linspace(0, 2 * np.pi, FRAMES)[:, None, None]
    waves = np.sin(t * rng.uniform(0.5, 3.0, (3, count)) + rng.uniform(0, 6.28, (3, count)))
    return size * (waves * rng.normal(size=(3, count))).sum(axis=1)


def _path(rng: np.random.Generator, path: str, turn_rad: float, shake: float) -> np.ndarray:
    """Poses (FRAMES, 3, 4) of a camera that is held at a distance of one and turns so far."""
    t = np.linspace(-0.5, 0.5, FRAMES)
    lift = rng.uniform(0.2, 0.8)
    azimuth = turn_rad * t if path == 'round' else np.zeros(FRAMES)
    centres = np.column_stack([np.sin(azimuth), -np.cos(azimuth), np.full(FRAMES, np.tan(lift))])
    centres = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    centres = centres + _smooth(rng, shake * turn_rad, 3)
    turns = _smooth(rng, 0.3 * shake * turn_rad, 3)
    if path == 'aside':
        # the camera goes aside and looks where it goes, as that of a vehicle
        centres[:, 0] += rng.uniform(0.3, 1.5) * turn_rad * t
        centres[:, 1] += rng.uniform(0.0, 2.0) * turn_rad * t
    if path == 'hand':
        centres = centres + _smooth(rng, turn_rad / 3, 3)
    R = np.stack([look_at(c, np.array([0.0, 0.0, 0.1]) if path != 'aside' else
                          np.array([centres[:, 0].mean(), 0.0, 0.1])) for c in centres])
    if path != 'round':
        own = _smooth(rng, 1.0, 3) if path == 'hand' else t[:, None] * [0.0, 1.0, 0.0]
        reach = np.linalg.norm(own[:, None] - own[None], axis=2).max()
        turns = turns + own * turn_rad / reach
    R = rotation_matrix(turns) @ R[:, :, :3]
    return np.concatenate([R, -np.einsum('vij,vj->vi', R, centres)[:, :, None]], axis=2)


def clip(rng: np.random.Generator, scene: str, path: str, turn_deg: float, shake: float = 0.03,
         walk_px: float = WALK_PX, noise_px: float = NOISE_PX) -> Tracks:
    """
    Film a scene in passing.

    Parameters
    ----------
    rng : numpy.random.Generator
    scene : {'table', 'object', 'room'}
    path : {'round', 'aside', 'hand'}
    turn_deg : float
        How far the camera turns in all.
    shake : float
        Trembling of the hand, as a share of the way.
    walk_px, noise_px : float
        Step of a track's random walk from image to image, and noise of each image.

    Returns
    -------
    Tracks

    """
    points, seed = _points(rng, scene), int(rng.integers(2**32))
    turn_rad = np.radians(turn_deg)
    for _ in range(4):
        # as far in all as was asked for
        poses = _path(np.random.default_rng(seed), path, turn_rad, shake)
        turn_rad *= np.radians(turn_deg) / widest_turn_rad(poses[:, :, :3])
    local = np.einsum('vij,pj->vpi', poses[:, :, :3], points) + poses[:, None, :, 3]
    xy = np.full((*local.shape[:2], 2), np.nan)
    ahead = local[..., 2] > 0.05
    xy[ahead] = CAMERA.project(local[ahead])
    xy = xy + np.cumsum(rng.normal(0, walk_px, xy.shape), axis=0)
    inside = ((xy > 4) & (xy < [CAMERA.width - 5, CAMERA.height - 5])).all(axis=2)
    # a patch that is lost is found again as another
    broken = (rng.random(inside.shape) < LOST) | ~inside
    track = np.cumsum(broken, axis=0) * len(points) + np.arange(len(points))
    xy = xy + rng.normal(0, noise_px, xy.shape)
    wrong = rng.random(inside.shape) < WRONG
    xy[wrong] += rng.uniform(-30, 30, (int(wrong.sum()), 2))
    taken = np.zeros(inside.shape, bool)
    taken[::EVERY] = inside[::EVERY]
    view, point = np.nonzero(taken)
    return Tracks(view, track[view, point], xy[view, point],
                  (CAMERA.width, CAMERA.height)).with_at_least(2)


def one_run(task: tuple) -> tuple[str, str, float, float, float]:
    """
    Calibrate one clip; the task is (scene, path, motion, seed).

    Returns
    -------
    status : {'calibrated', 'hint', 'refused'}
    kind : str
        Motion of what came out, or kind of the refusal.
    turn_deg : float
        How far the camera turned.
    worst : float
        Largest deviation of K in stated sigmas; NaN where refused.
    share : float
        Sigma of fx as a share of it; NaN where refused.

    """
    scene, path, motion, seed = task
    rng = np.random.default_rng([seed, SCENES.index(scene), PATHS.index(path)])
    turn_deg = float(np.exp(rng.uniform(*np.log(TURNS_DEG))))
    tracks = clip(rng, scene, path, turn_deg, rng.choice([0.01, 0.03, 0.1]))
    result = calibrate(tracks, motion=motion, facts=FACTS)
    found = result if result else result.hint
    if not found:
        return 'refused', result.kind, turn_deg, np.nan, np.nan
    sigma = np.sqrt(np.diag(found.covariance))[:4]
    away = np.abs(found.camera.parameters[:4] - CAMERA.parameters[:4])
    return ('calibrated' if result else 'hint', found.motion, turn_deg,
            float((away / sigma).max()), float(sigma[0] / found.camera.K[0, 0]))


def run(report: Report, options) -> None:
    """Print one line a kind of clip."""
    seeds = range(options.runs or 100)
    report.section(f'Short clips, {len(seeds)} seeds each', 'A turn of 2 to 15 degrees in all, '
                   f'{NOISE_PX} px of noise and a random walk of {WALK_PX} px an image. coarse: '
                   'accepted with a sigma of f beyond 1 %.')
    tasks = list(product(SCENES, PATHS, ('auto',), seeds))
    outcome = dict(zip(tasks, run_seeds(one_run, tasks, options.processes)))
    rows, beyond, coarse = [], 0, 0
    for scene, path in product(SCENES, PATHS):
        found = [outcome[scene, path, 'auto', seed] for seed in seeds]
        wrong = {name: sum(one[0] == name and one[3] > MAX_SIGMAS for one in found)
                 for name in ('calibrated', 'hint')}
        count = {name: sum(one[0] == name for one in found)
                 for name in ('calibrated', 'hint', 'refused')}
        large = sum(one[0] == 'calibrated' and one[4] > MAX_SHARE for one in found)
        worst = np.array([one[3] for one in found])
        rows.append((scene, path, *count.values(), large, *wrong.values(),
                     f'{np.nanmax(worst):.1f}' if np.isfinite(worst).any() else ''))
        beyond, coarse = beyond + sum(wrong.values()), coarse + large
    report.table(('scene', 'path', 'calibrated', 'hint', 'refused', 'coarse', 'wrong',
                  'wrong hints', 'worst sigma'), rows)
    report.say('')
    report.judge(beyond == 0, f'{beyond} beyond {MAX_SIGMAS:g} sigmas')
    report.judge(coarse == 0, f'{coarse} calibrations with a sigma of f beyond 1 %')
