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
Robots of everyday life that nothing was tuned to: right, or refused?

Every run draws a robot's camera, scene and path (`everyday_robots`), and what troubles it: a
fisheye, patches that drift, long tails, gross errors, rows read in turn, a zoom, few points, few
views. The kinds of motion are others than those of `mixed_worlds`.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

from bench.calibration.everyday_robots import Path, Pose, Robot, ROBOTS
from bench.calibration.further_worlds import SQUARE, WARNINGS, World
from bench.calibration.suppositions import load_worlds, MAX_SIGMAS
from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np

#: What has to be refused, for it never turns; and the refusal that needs no excuse elsewhere.
NEVER_TURNS, JUSTIFIED = 'arm that only shifts', 'only_a_hint'
#: Observations in a view, and noise in pixels, between which they are drawn.
PER_VIEW, FEW, NOISE_PX = 130, (35, 80), (0.08, 0.5)
#: Seconds from view to view.
STEP_S = (0.25, 0.5)
#: Worlds that were found wrong once, and take too long for the tests: rows that each view reads
#: in its own way were told as shifts, twice, as an aspect ratio, and not at all; and a view that a
#: few gross errors link was kept.
ONCE_WRONG = (('head on a vehicle', 2202), ('drone, straight down', 2305), ('stops often', 1502),
              ('round an object', 108), ('hand that rests', 2103))


def troubled(robot: Robot, rng: np.random.Generator) -> tuple[Robot, dict, list[str]]:
    """Draw troubles: the robot with them, options of `world_cases.observe`, and their names."""
    options = {'noise': float(np.exp(rng.uniform(*np.log(NOISE_PX)))), 'per_view': PER_VIEW}
    has = []
    if rng.random() < 0.3:
        lens = {'f': robot.camera.f * rng.uniform(0.6, 0.9), 'd': (0, 0, 0, 0, 0),
                'kb': (float(rng.normal(-0.01, 0.02)), float(rng.normal(0, 0.004)), 0, 0)}
        robot = replace(robot, camera=replace(robot.camera, **lens))
        has.append('fisheye')
    if rng.random() < 0.35:
        options['bias'] = float(rng.uniform(0.03, 0.2))
        has.append('drift')
    if rng.random() < 0.3:
        options['kind'] = str(rng.choice(['laplace', 'mix', 't3']))
        has.append(options['kind'])
    if rng.random() < 0.3:
        options['out'] = float(rng.choice([0.05, 0.1, 0.2]))
        has.append(f'{100 * options["out"]:.0f} % gross')
    # an arm stands still while it takes an image
    if rng.random() < 0.3 and not robot.stops:
        options['rs'] = float(rng.uniform(0.004, 0.03))
        has.append(f'rows in {1e3 * options["rs"]:.0f} ms')
    if rng.random() < 0.15:
        growth = float(rng.uniform(0.002, 0.03))
        options['fs'] = lambda time: 1 + growth * (2 * time - 1)
        has.append('zoom')
    if rng.random() < 0.3:
        options['per_view'] = int(rng.uniform(*FEW))
        has.append('few points')
    if rng.random() < 0.3 and not robot.stops:
        robot = replace(robot, views=max(6, int(robot.views * rng.uniform(0.35, 0.6))))
        has.append('few views')
    return robot, options, has


def build(name: str, seed: int) -> tuple[World, list[str]]:
    """Build a world, and name its troubles."""
    cases = load_worlds()
    rng = np.random.default_rng([seed, list(ROBOTS).index(name)])
    robot, options, has = troubled(ROBOTS[name](rng), rng)

    def within(path: Path, time: float) -> Pose:
        return path(min(max(time, 0.0), 1.0))
    path = cases.Fn(lambda time: within(robot.path, time), robot.views * rng.uniform(*STEP_S))
    frame, track, xy = cases.observe(robot.camera, path, *robot.scene, rng=rng, n=robot.views,
                                     **{**options, **robot.options})
    camera = robot.camera
    return World(frame, track, xy, (camera.w, camera.h), camera.truth[:4]), has


def one_run(task: tuple[str, int]) -> tuple[str, float, bool, str]:
    """Calibrate once: kind of refusal, distance, whether something was said, and troubles."""
    world, has = build(*task)
    result = world.calibrated(SQUARE)
    if not result:
        return result.kind, np.nan, True, ', '.join(has)
    told = any(one.kind in WARNINGS for one in result.findings)
    return '', world.away(result), told, ', '.join(has)


def run(report: Report, options) -> None:
    """Print a line a robot, and what was wrong or refused."""
    if load_worlds() is None:
        report.say('left out: ../shared/world_cases.py is not there')
        return
    seeds = range(1, 1 + (options.runs or 20))
    report.section(f'Robots of everyday life, {len(seeds)} seeds each',
                   f'silent: K beyond {MAX_SIGMAS:g} sigmas, and nothing said that is about K. '
                   'Zooms have no single truth, and do not count.')
    tasks = list(dict.fromkeys((*ONCE_WRONG, *product(ROBOTS, seeds))))
    outcome = dict(zip(tasks, run_seeds(one_run, tasks, options.processes)))
    rows, wrong, needless = [], [], []
    for name in ROBOTS:
        some = {seed: outcome[robot, seed] for robot, seed in tasks if robot == name}
        right = [away for kind, away, _, has in some.values() if not kind and 'zoom' not in has]
        silent = [(name, seed, f'{away:.1f} sigmas', has)
                  for seed, (kind, away, told, has) in some.items()
                  if away > MAX_SIGMAS and not told and 'zoom' not in has]
        refused = [(name, seed, kind, has) for seed, (kind, _, _, has) in some.items() if kind]
        wrong += silent
        needless += [one for one in refused if NEVER_TURNS not in one and JUSTIFIED not in one]
        rows.append((name, len(some), len(refused),
                     ', '.join(sorted({one[2] for one in refused})) or '-',
                     f'{max(right):.1f}' if right else '-', len(silent)))
    report.table(('robot', 'runs', 'refused', 'as', 'worst, sigmas', 'silent'), rows)
    for name, seed, what, has in (*wrong, *needless):
        report.say(f'- {name}, seed {seed}: {what} ({has or "no troubles"})')
    report.say('')
    report.verdict('silent', len(wrong), 0)
    report.verdict('needless refusals', 100 * len(needless) / len(tasks), 3, '%')
