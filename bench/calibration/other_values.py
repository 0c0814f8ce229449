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
The kinds of the independent simulation, each with other values drawn, and with another camera.

What `../shared/world_cases.py` has with a few fixed values is drawn here: how much moves, how fast
the rows are read, how far it zooms. Recordings are also longer, and hands walk through its room.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
import zlib

from bench.calibration.further_worlds import JUSTIFIED, SQUARE, World
from bench.calibration.suppositions import load_worlds, MAX_SIGMAS
from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from selfcal_ros import Calibration

#: Findings that tell why K is far off: facts that are not so, and two cameras.
TOLD = ('fact_contradicted', 'fact_contradicted_too', 'fact_doubtful', 'fact_unchecked',
        'two_cameras', 'other_camera_left_out')
#: Kinds with a drive, a hand before a cloud of points, or a hand in the room.
BASES = {'hand': 'gen', 'walk': 'genroom', 'drive': 'agv'}
#: Frames of the simulation where nothing else is said.
VIEWS = 20
#: Draws a number between two.
Draw = Callable[[float, float], float]


def kinds() -> dict[str, Callable[[Draw], dict]]:
    """Name the kinds, and draw options of `world_cases.cond` for each; empty without the file."""
    cases = load_worlds()
    if cases is None:
        return {}

    def step(at: float, growth: float) -> dict:
        return {'fs': lambda time: 1.0 if time < at else 1 + growth}

    def drift(growth: float) -> dict:
        return {'fs': lambda time: 1 + growth * (2 * time - 1)}

    def rows(draw: Draw) -> dict:
        return {'rs': draw(0.004, 0.036), 'path': {'T': draw(5, 9)}}

    def crossing(draw: Draw, most: float = 0.35) -> dict:
        return {'moving': {'share': draw(0.08, most), 'f': cases.cross(draw(0.3, 1.2))}}

    def fisheye(draw: Draw) -> dict:
        half = np.radians(draw(40, 80))
        return {'cam': cases.Cam(f=320 / half * draw(0.9, 1.1),
                                 kb=(draw(-0.04, 0.03), draw(-0.006, 0.006), 0, 0))}

    return {
        'as it should be': lambda draw: {},
        'crossing': crossing,
        'rows': rows,
        'rows and crossing': lambda draw: {**rows(draw), **crossing(draw, 0.25)},
        'zoom in a step': lambda draw: step(draw(0.3, 0.7), draw(0.01, 0.1)),
        'focal length drifts': lambda draw: drift(draw(0.003, 0.03)),
        'rows and drift': lambda draw: {**rows(draw), **drift(draw(0.005, 0.03))},
        'fisheye': fisheye,
        'barrel': lambda draw: {'cam': cases.Cam(f=draw(400, 500), d=(
            draw(-0.36, -0.25), draw(0.08, 0.16), draw(-1e-3, 1e-3), draw(-1e-3, 1e-3),
            draw(-0.05, 0)))},
        'few points': lambda draw: {'per_view': int(draw(22, 60))},
        'few views': lambda draw: {'n': int(draw(3, 9))},
        'many views': lambda draw: {'n': int(draw(50, 120)), 'hazard': draw(0.02, 0.1)},
        'short tracks': lambda draw: {'tracklen': int(draw(3, 5))},
        'pattern': lambda draw: {'alias': (draw(0.1, 0.35), draw(0.15, 0.4), draw(0, 1) < 0.5)},
        'patches drift': lambda draw: {'bias': draw(0.05, 0.5)},
        'noise': lambda draw: {'noise': draw(0.1, 1.2),
                               'kind': ('gauss', 'laplace', 'mix', 't3')[int(draw(0, 4))]},
        'gross errors': lambda draw: {'out': draw(0.05, 0.3)},
        'long lens': lambda draw: {'cam': cases.Cam(f=draw(1100, 1900),
                                                    d=(draw(-0.2, 0.2), 0, 0, 0, 0))},
        'wide lens': lambda draw: {'cam': cases.Cam(f=draw(210, 300), d=(
            draw(-0.03, -0.005), draw(0, 0.002), 0, 0, 0))},
        'decentred': lambda draw: {'cam': cases.Cam(d=(-0.12, 0.05, draw(-0.005, 0.005),
                                                       draw(-0.005, 0.005), 0))},
        'nothing stated': lambda draw: {'facts': {}},
        'two cameras': lambda draw: {'post': cases.mix2(draw(-0.1, 0.1), draw(-8, 8))},
    }


def _camera(draw: Draw):
    """Draw an ordinary camera of the simulation."""
    k1 = draw(-0.3, 0.05)
    return load_worlds().Cam(f=draw(400, 800), cx=320 + draw(-15, 15), cy=240 + draw(-12, 12), d=(
        k1, 0.6 * k1 * k1 + draw(-0.02, 0.02), draw(-1e-3, 1e-3), draw(-1e-3, 1e-3), 0))


def build(kind: str, base: str, seed: int) -> tuple[World, dict, np.ndarray | None] | None:
    """
    Build a world.

    Returns
    -------
    World
    dict
        The facts that are stated.
    ndarray or None
        The factor of the focal length of each frame, if it varies. None in place of all three
        where nothing is seen.

    """
    cases = load_worlds()
    rng = np.random.default_rng([seed, zlib.crc32(f'{kind} {base}'.encode())])

    def draw(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    options = {'base': BASES[base], 'facts': dict(SQUARE), 'cam': _camera(draw),
               **kinds()[kind](draw)}
    name = f'{kind}, {base}'
    cases.C[name] = options
    try:
        case = cases.build(name, seed)
    except ValueError:
        return None
    # its last frames may show nothing: time is that of all
    times = np.linspace(0, 1, options.get('n', VIEWS))
    factor = np.array([options['fs'](time) for time in times]) if 'fs' in options else None
    return World.of(case), case['facts'], factor


def away(world: World, result: Calibration, factor: np.ndarray | None) -> float:
    """Largest deviation in stated sigmas: of K, or of every view's focal length if it varies."""
    if factor is None:
        return world.away(result)
    course = result.focal
    true = world.truth[0] * factor[np.asarray(result.frames if course is None else course.frames)]
    if course is None:
        # constant over the views that were used, or else one of them is far off
        focal_px = result.camera.parameters[0]
        worst = float(np.max(np.abs(focal_px - true))) / result.sigma['fx']
    else:
        worst = float(np.max(np.abs(course.fx - true) / course.sigma))
    centre = replace(world, truth=np.concatenate([result.camera.parameters[:2], world.truth[2:]]))
    return max(worst, centre.away(result))


def one_run(task: tuple[str, str, int]) -> tuple[str, float, bool]:
    """Calibrate once: why it was refused ('none' where nothing is seen), distance, told."""
    built = build(*task)
    if built is None:
        return 'none', np.nan, False
    world, facts, factor = built
    result = world.calibrated(facts)
    if not result:
        return result.kind, np.nan, False
    told = any(one.kind in TOLD for one in result.findings)
    return '', away(world, result, factor), told


def run(report: Report, options) -> None:
    """Print one line a kind."""
    seeds = range(40001, 40001 + (options.runs or 10))
    report.section(f'Other values, {len(seeds)} seeds each',
                   f'silent: beyond {MAX_SIGMAS:g} sigmas, and no fact is said to be wrong.')
    if not kinds():
        report.say('left out: ../shared/world_cases.py is not there')
        return
    tasks = list(product(kinds(), BASES, seeds))
    outcome = {task: one for task, one in zip(tasks, run_seeds(one_run, tasks, options.processes))
               if one[0] != 'none'}
    rows, silent, needless = [], [], []
    for kind in kinds():
        some = {task: one for task, one in outcome.items() if task[0] == kind}
        refused = [one[0] for one in some.values() if one[0]]
        wrong = [task for task, one in some.items() if one[1] > MAX_SIGMAS and not one[2]]
        silent += wrong
        needless += [task for task, one in some.items() if one[0] and one[0] not in JUSTIFIED]
        rows.append((kind, len(some), len(refused), ', '.join(sorted(set(refused))) or '-',
                     f'{np.nanmax([one[1] for one in some.values()], initial=0):.1f}',
                     len(wrong)))
    report.table(('kind', 'runs', 'refused', 'as', 'worst, sigmas', 'silent'), rows)
    for task in silent:
        report.say(f'- {task[0]}, {task[1]}, seed {task[2]}: {outcome[task][1]:.1f} sigmas')
    report.verdict('silent', len(silent), 0)
    report.verdict('needless refusals', 100 * len(needless) / max(len(outcome), 1), 3, '%')
