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
Motions that leave part of a mount open: right, or refused with the reason.

Run: python -m bench.mounts.mount_degenerate [--seeds 40] [--only NAME]. The images' Gaussian is
simulated; a row is printed as soon as it is measured.
"""

from __future__ import annotations

import argparse
from collections import Counter
from functools import partial

from bench.monte_carlo import run_seeds
from bench.mounts import mount_worlds as worlds
import numpy as np
from scipy.stats import chi2
from selfcal_ros.calibration.mount import NAMES
from selfcal_ros.calibration.mounting.mounting import mount_camera
from selfcal_ros.geometry.rotation import rotation_matrix

VIEWS = 24
#: Forward, sideways (m) and heading (rad), of a metre or radian of the way.
USUAL, QUIET, NOISY = (0.01, 0.003, 0.01), (0.002, 0.001, 0.002), (0.03, 0.01, 0.03)
#: Absolute poses: metres, radians.
MEASURED = (1e-3, 1e-3)
#: An estimate that is farther off counts as wrong: in sigmas, and as a chance of all together.
WRONG_SIGMAS, WRONG_CHANCE = 4.5, 1e-5


def _along(heading: np.ndarray, step_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations and places of a vehicle with such headings (V,), a step between each."""
    middle = (heading[1:] + heading[:-1]) / 2
    steps = step_m * np.stack([np.cos(middle), np.sin(middle), 0 * middle], axis=1)
    none = 0 * heading
    return (rotation_matrix(np.stack([none, none, heading], axis=1)),
            np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]))


def _about(vectors: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations and places of a body that is turned by angle-axis vectors (V, 3)."""
    return rotation_matrix(vectors), place


def _path(name: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the path of a motion, with lengths and angles that vary a little."""
    k, step = np.linspace(0, 1, VIEWS), rng.uniform(0.1, 0.3)
    free = rng.uniform(0.2, 0.4) * np.sin(np.outer(k, rng.uniform(4, 9, 3))
                                          + rng.uniform(0, 6, 3))
    none = np.zeros((VIEWS, 3))
    if name.startswith('straight'):
        return _along(0 * k, step)
    if name.startswith('circle'):
        return _along(rng.uniform(3, 6) * k, step)
    if name.startswith('turns on the spot'):
        return _about(np.outer(rng.uniform(3, 6) * k, [0, 0, 1]), none)
    if name.startswith('one turn'):
        return _along(np.deg2rad(40) * np.clip(4 * k - 1.5, 0, 1), step)
    if name.startswith('bend'):
        return _along(np.deg2rad(3) * k, step)
    if name.startswith('curves'):
        return _along(0.6 * np.sin(rng.uniform(6, 12) * k), step)
    if name.startswith('fixed point'):
        return _about(free, none)
    if name.startswith('one axis'):
        return _about(np.outer(np.sin(7 * k), [0.3, 0.2, 0.6]), free)
    if name.startswith('without turns'):
        return _about(none, free)
    # the camera moves, and its body does not know
    return _along(_turns_of_another(name) * np.sin(9 * k), step)


def _turns_of_another(name: str) -> float:
    """Return by how much a body turns that is not the camera's, radians."""
    return 0.1 if 'slight' in name else 0.4


#: Of every motion: sizes of the errors of odometry, or None for absolute poses.
MOTIONS = {
    'straight drive, odometry': USUAL,
    'straight drive, absolute poses': None,
    'circle, odometry': USUAL,
    'circle, absolute poses': None,
    'turns on the spot, quiet odometry': QUIET,
    'turns on the spot, noisy odometry': NOISY,
    'one turn of 40 degrees between straight drives, odometry': USUAL,
    'bend of 3 degrees, odometry': USUAL,
    'bend of 3 degrees, noisy odometry': NOISY,
    'bend of 3 degrees, absolute poses': None,
    'curves to both sides, odometry': USUAL,
    'fixed point, absolute poses': None,
    'one axis, absolute poses': None,
    'without turns, absolute poses': None,
    'another body moves, odometry': USUAL,
    'another body moves, slight turns, odometry': USUAL,
    'stood still, odometry': QUIET,
}


def _poses(name: str, rng: np.random.Generator, world: worlds.World):
    frames, sigmas = {'frames': np.arange(VIEWS)}, MOTIONS[name]
    path = world.rotation, world.position
    if name.startswith('another body'):
        # a heading of its own: the wrong frame, or a camera that is not fixed
        step = np.linalg.norm(np.diff(world.position, axis=0), axis=1).mean()
        phase = rng.uniform(3, 7) * np.linspace(0, 1, VIEWS) + rng.uniform(0, 6)
        path = _along(_turns_of_another(name) * np.sin(phase), step)
    elif name.startswith('stood still'):
        # encoders that creep
        creep = 2e-4 * rng.standard_normal((VIEWS, 2))
        path = _along(np.cumsum(creep[:, 0]), 2e-4)
    if sigmas is None:
        return worlds.measured(rng, *path, *MEASURED, **frames)
    return worlds.odometry(rng, *path, sigmas, **frames)


def one_run(name: str, seed: int):
    """Return what is open and the errors in sigmas, or the kind of the refusal."""
    rng = np.random.default_rng([seed, list(MOTIONS).index(name)])
    planar = MOTIONS[name] is not None or name.startswith(('circle', 'straight', 'bend'))
    world = worlds.World(*_path(name, rng), worlds.mount_of(rng), planar)
    calibration = worlds.calibrated(rng, world)
    result = mount_camera(calibration, _poses(name, rng, world))
    mount = result.mount
    if not mount:
        return mount.kind, np.zeros(0), 1.0, ()
    errors = worlds.mount_errors(mount, world.T_body_camera,
                                 worlds.true_scale(world, calibration))
    if mount.axis is not None:
        # pitch and yaw are those of the axis that the camera sees
        seen = world.T_body_camera[:3, :3].T @ mount.axis.axis - mount.axis.in_camera
        along = np.linalg.svd(mount.axis.in_camera[None])[2][1:] @ seen / mount.axis.sigma
    else:
        along = np.zeros(0)
    use = [k for k, one in enumerate(NAMES) if mount.status[one] == 'estimated'
           and np.isfinite(errors[k])]
    inside = mount.covariance[np.ix_(use, use)]
    chance = chi2.sf(errors[use] @ np.linalg.solve(inside, errors[use]), len(use)) \
        if use else 1.0
    return (', '.join(one for one in NAMES if mount.status[one] == 'unobservable') or 'nothing',
            np.r_[errors[use] / np.sqrt(np.diag(inside)), along], float(chance),
            tuple(one.kind for one in result.findings))


def row(name: str, seeds: int) -> str:
    """Run a motion, and return its row."""
    runs = run_seeds(partial(one_run, name), range(seeds), 1)
    verdicts = Counter(run[0] for run in runs)
    z = np.concatenate([run[1] for run in runs])
    wrong = sum(bool(len(run[1]) and (np.abs(run[1]).max() > WRONG_SIGMAS
                                      or run[2] < WRONG_CHANCE)) for run in runs)
    told = Counter(kind for run in runs for kind in run[3] if kind != 'metre_of_odometry')
    size = f'{np.sqrt(np.mean(z**2)):.2f} | {np.abs(z).max():.1f}' if len(z) else ' | '
    return (f'| {name} | ' + '; '.join(f'{count} {kind}' for kind, count in verdicts.most_common())
            + f' | {size} | {wrong} | '
            + ', '.join(f'{count} {kind}' for kind, count in told.items()) + ' |')


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=40)
    parser.add_argument('--only', default='', help='motions whose name begins so')
    args = parser.parse_args()
    print('| motion | open, or refused | error rms, sigmas | worst | wrong | told |')
    print('|---' * 6 + '|')
    for name in MOTIONS:
        if name.startswith(args.only):
            print(row(name, args.seeds), flush=True)


if __name__ == '__main__':
    main()
