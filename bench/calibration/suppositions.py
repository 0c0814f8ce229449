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
What is supposed, and is not so: wrong facts, two cameras in one folder, mirrored images, a prism.

Scenes of the package, and those of `../shared/world_cases.py` where it is there. Every case is
counted by what was said: named (a finding or the refusal tells the cause), refused without need
(what is supposed holds), and silent (K beyond four of its sigmas without a word of the cause).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
import importlib.util
from itertools import product
from pathlib import Path

from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from selfcal_ros import calibrate, Camera, CameraFacts, Tracks
from selfcal_ros.synthetic.few_view_scenes import general_views
from selfcal_ros.synthetic.hard_scenes import s_curve, vehicle

#: Beyond so many stated sigmas a result is wrong.
MAX_SIGMAS = 4.0
WORLDS = Path(__file__).resolve().parents[3] / 'shared' / 'world_cases.py'
#: Findings that name a fact, the fact in their values; those that name something else.
FACT_KINDS = ('fact_contradicted', 'fact_contradicted_too', 'fact_doubtful', 'fact_unsure',
              'fact_unchecked')
#: Findings and refusals that say more than a remark: they count as false alarms where all holds.
ALARMS = ('fact_contradicted', 'fact_contradicted_too', 'fact_doubtful', 'two_cameras',
          'other_camera_left_out', 'images_mirrored')
TWO = ('two_cameras', 'other_camera_left_out')
FOCAL = ('focal_varies', 'focal_drifts')


@dataclass(frozen=True)
class Case:
    """
    A camera, what is stated of it, and what of that is wrong.

    Attributes
    ----------
    causes : tuple of str
        Facts or kinds of findings that name the cause; empty where all that is supposed holds.
    camera : dict
        What of the camera is not as usual: aspect, skew.
    facts : dict
        Stated beside, or in place of, square pixels.
    views : str
        What is done to the views: 'two', 'mirrored', or nothing.

    """

    causes: tuple[str, ...] = ()
    camera: dict = field(default_factory=dict)
    facts: dict = field(default_factory=dict)
    views: str = ''


OWN = {
    'all holds': Case(),
    'lens stated': Case(facts={'distortion': 'radial2'}),
    'aspect ratio 1.01': Case(('aspect ratio',), {'aspect': 1.01}),
    'aspect ratio 1.03': Case(('aspect ratio',), {'aspect': 1.03}),
    'aspect ratio 1.01, sigma 0.01': Case((), {'aspect': 1.01}, {'aspect_ratio_sigma': 0.01}),
    'skew 3 px': Case(('skew',), {'skew': 3.0}),
    'principal point 8 px off': Case(('principal point',),
                                     facts={'principal_point': (319.5, 239.5)}),
    'lens "none"': Case(('lens model',), facts={'distortion': 'none'}),
    'two cameras, f 3 %': Case(TWO, views='two'),
    'every third mirrored': Case(('images_mirrored',), views='mirrored'),
}
#: Of the worlds: what each is about, by a part of its name.
_WORLD_CAUSES = {'asp': ('aspect ratio',), 'skew': ('skew',), 'pp_wrong': ('principal point',),
                 'mix2': TWO, 'mirrhalf': ('images_mirrored',), 'prism': ('lens_may_be_prism',),
                 'zoom': FOCAL, 'breathe': FOCAL}
_TRUE_WORLDS = ('base', 'nodist', 'laplace', 'mix.2/1', 't3', 'bias0.15', 'out25', 'barrel_k3',
                'kb90', 'kb110', 'kb140', 'tele20', 'wide110', 'portrait', 'crop', 'perm')


def _own(name: str, hand: bool, seed: int) -> tuple[Tracks, CameraFacts, np.ndarray]:
    case, rng = OWN[name], np.random.default_rng([seed, 11])
    aspect, skew = case.camera.get('aspect', 1.0), case.camera.get('skew', 0.0)
    camera = Camera([[520, skew, 328], [0, 520 * aspect, 235], [0, 0, 1]], [-0.12, 0.05], 640, 480)
    scene = (general_views(rng, camera, views=15, points=150, noise_px=0.2) if hand
             else vehicle(rng, s_curve(15), camera=camera))
    tracks = scene.tracks
    xy = tracks.xy.copy()
    if case.views == 'two':
        second = tracks.frame % 2 == 1
        xy[second] = (xy[second] - [328, 235]) * 1.03 + [328, 235]
    if case.views == 'mirrored':
        second = tracks.frame % 3 == 1
        xy[second, 0] = tracks.image_size[0] - 1 - xy[second, 0]
    facts = CameraFacts(**{'aspect_ratio': 1.0, 'skew': 0.0, **case.facts})
    return Tracks(tracks.frame, tracks.track, xy, tracks.image_size), facts, camera.parameters[:4]


@lru_cache(maxsize=1)
def load_worlds():
    """Load the independent simulation, if it is there."""
    if not WORLDS.exists():
        return None
    spec = importlib.util.spec_from_file_location('world_cases', WORLDS)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def world_causes() -> dict[str, tuple[str, ...]]:
    """Name the worlds that are about what is supposed, and what names the cause."""
    worlds = load_worlds()
    if worlds is None:
        return {}
    found = {}
    for name in worlds.C:
        kind = name.split('_', 1)[-1]
        if kind in _TRUE_WORLDS or kind == 'asp1.02_free':
            found[name] = ()
        for part, causes in _WORLD_CAUSES.items():
            if kind.startswith(part) and not kind.endswith('free'):
                found[name] = causes
    return found


def one_run(task: tuple) -> tuple[bool, bool, bool, float]:
    """
    Calibrate once; the task is (name, hand, seed), hand None for a world.

    Returns
    -------
    named, alarmed, refused : bool
    worst : float
        Largest deviation of K in stated sigmas; NaN where refused, or where it is another
        camera's.

    """
    name, hand, seed = task
    if hand is None:
        world = load_worlds().build(name, seed)
        tracks = Tracks(world['F'], world['T'], world['XY'], tuple(world['size']))
        facts, truth, causes = CameraFacts(**world['facts']), world['truth'][:4], world_causes()[
            name]
    else:
        tracks, facts, truth = _own(name, hand, seed)
        causes = OWN[name].causes
    result = calibrate(tracks, facts=facts)
    found = [(one.kind, one.values.get('fact')) for one in result.findings]
    if not result:
        found.append((result.kind, result.values.get('fact')))
    named = any(kind in causes or kind in FACT_KINDS and fact in causes for kind, fact in found)
    alarmed = any(kind in ALARMS for kind, _ in found)
    kinds = [kind for kind, _ in found]
    if not result or set(kinds) & {*TWO, *FOCAL}:
        return named, alarmed, not result, np.nan
    sigma = np.sqrt(np.diag(result.covariance))[:4]
    away = np.abs(result.camera.parameters[:4] - truth)
    judged = sigma > 0
    return named, alarmed, False, float(np.max(away[judged] / sigma[judged], initial=0))


def run(report: Report, options) -> None:
    """Print one line a case."""
    seeds = range(options.runs or 10)
    for title, tasks, causes in (
            ('Scenes of the package', [*product(OWN, (True, False))],
             {name: case.causes for name, case in OWN.items()}),
            ('Independent worlds', [(name, None) for name in world_causes()], world_causes())):
        report.section(f'{title}, {len(seeds)} seeds each', f'named: the cause is told. silent: '
                       f'accepted beyond {MAX_SIGMAS:g} sigmas of K without a word of it. alarmed:'
                       ' something is said to be wrong.')
        if not tasks:
            report.say('left out: ../shared/world_cases.py is not there')
            continue
        every = [(*task, seed) for task, seed in product(tasks, seeds)]
        outcome = dict(zip(every, run_seeds(one_run, every, options.processes)))
        rows, total = [], np.zeros(5)
        for name, hand in tasks:
            results = [outcome[name, hand, seed] for seed in seeds]
            named, alarmed, refused = np.array([one[:3] for one in results], int).sum(axis=0)
            worst = np.array([one[3] for one in results])
            silent = sum(one[3] > MAX_SIGMAS and not one[0] for one in results)
            wrong = bool(causes[name])
            total += ([silent, named, len(seeds), 0, 0] if wrong else
                      [silent, 0, 0, max(alarmed, refused), len(seeds)])
            where = '' if hand is None else ', hand' if hand else ', drive'
            largest = np.nanmax(worst) if np.isfinite(worst).any() else np.nan
            rows.append((name + where, named if wrong else '', alarmed, refused, silent,
                         '' if np.isnan(largest) else f'{largest:.1f}'))
        report.table(('case', 'named', 'alarmed', 'refused', 'silent', 'worst sigma'), rows)
        report.say('')
        report.judge(total[0] == 0, f'{total[0]:.0f} silent errors')
        report.judge(total[1] >= 0.9 * total[2], f'{total[1]:.0f} of {total[2]:.0f} causes named, '
                     'required 90 %')
        report.judge(total[3] <= 0.01 * total[4], f'{total[3]:.0f} of {total[4]:.0f} alarms and '
                     'refusals where all holds, at most 1 %')
