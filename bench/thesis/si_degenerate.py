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
"""Degenerate relatives of sequence SI: the right answer or the right refusal, never a wrong K."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product
import re

from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from selfcal_ros import calibrate, CameraFacts, Tracks
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.synthetic import special_scenes
from selfcal_ros.synthetic.scenes import sequence_si

NOISE_PX = 0.2
#: Beyond so many stated sigmas a result is wrong.
MAX_SIGMAS = 4.0


@dataclass(frozen=True)
class Case:
    """
    One scene with one set of facts.

    Attributes
    ----------
    name : str
    scene : callable
        scene(rng, noise_px, **options), returns a PointSequence.
    facts : dict
        For CameraFacts; true ones.
    expected : {'right', 'refused', 'either'}
    reason : str
        Regular expression that a refusal must match.
    options : dict
        For the scene.

    """

    name: str
    scene: Callable
    facts: dict
    expected: str
    reason: str = '.'
    options: dict = field(default_factory=dict)


def off_centre(rng, noise_px: float, **options):
    """SI with the principal point off the middle, which nobody must suppose."""
    sequence, shift = sequence_si(rng, noise_px, **options), np.array([45.0, -30.0])
    tracks, camera = sequence.tracks, sequence.camera
    K = camera.K + np.pad(shift[:, None], ((0, 1), (2, 0)))
    moved = Tracks(tracks.frame, tracks.track, tracks.xy + shift, tracks.image_size)
    return replace(sequence, tracks=moved, true_pixels=sequence.true_pixels + shift,
                   camera=Camera(K, camera.distortion, camera.width, camera.height, camera.model))


SQUARE = {'aspect_ratio': 1.0, 'skew': 0.0}
ASPECT = {'aspect_ratio': 1.0}
OPEN = 'one parameter|aspect ratio|fact'
ODD = {'aspect_ratio': 1.1, 'skew': 5.0}

CASES = (
    Case('aspect 1.1, skew 5', sequence_si, {'aspect_ratio': 1.1}, 'right', options=ODD),
    Case('aspect 1.1, skew 5', sequence_si, ODD, 'right', options=ODD),
    Case('aspect 1.1, skew 5', sequence_si, {'principal_point': (400.0, 300.0)}, 'right',
         options=ODD),
    Case('aspect 1.1, skew 5', sequence_si, {'skew': 5.0}, 'either', 'skew|horizon|determine',
         options=ODD),
    Case('aspect 1.1, skew 5', sequence_si, {}, 'refused', OPEN, options=ODD),
    Case('principal point off the middle', off_centre, SQUARE, 'right'),
    Case('level horizon', special_scenes.level_horizon, ASPECT, 'right'),
    Case('level horizon', special_scenes.level_horizon, SQUARE, 'right'),
    Case('level horizon', special_scenes.level_horizon, {'skew': 0.0}, 'refused',
         'horizon is level'),
    Case('circular, 3 views', special_scenes.circular_motion, SQUARE, 'either',
         'circular|determine', {'aside': 0.3}),
    Case('circular, 9 views', special_scenes.circular_motion, SQUARE, 'either',
         'circular|determine', {'aside': 0.3, 'views': 9}),
    Case('circular, 9 views', special_scenes.circular_motion, ASPECT, 'refused',
         'circular|determine', {'aside': 0.3, 'views': 9}),
    # a camera that only turns is calibrated by the homographies, if its pixels are square
    Case('three nearly equal positions', special_scenes.nearly_equal_positions, SQUARE,
         'either', 'parallax|move|determine|position|homography'),
    Case('three nearly equal positions', special_scenes.nearly_equal_positions, ASPECT,
         'either', 'parallax|move|determine|position|homography'),
    Case('no rotation', special_scenes.pure_translation, SQUARE, 'refused', 'rotat'),
    Case('no rotation', special_scenes.pure_translation, ASPECT, 'refused', 'rotat'),
    Case('no translation', special_scenes.pure_rotation, SQUARE, 'either',
         'parallax|move|determine|position|homography|only turn'),
    Case('4 points', special_scenes.few_points, SQUARE, 'refused', 'points|freedom|tracks'),
    Case('one plane', special_scenes.coplanar_points, SQUARE, 'either',
         'plane|parallax|determine|homography'),
    Case('one plane', special_scenes.coplanar_points, ASPECT, 'either',
         'plane|parallax|determine|homography'),
    Case('not planar', special_scenes.general_motion, SQUARE, 'either',
         'planar|determine'),
)


def one_run(task: tuple) -> tuple:
    """
    Calibrate one seeded scene; the task is (index of the case, distortion, seed).

    Returns
    -------
    kind : {'right', 'refused', 'WRONG'}
    largest deviation in stated sigmas, relative sigma of fx, relative error of fx : float
    reason : str

    """
    index, distortion, seed = task
    case = CASES[index]
    sequence = case.scene(np.random.default_rng([seed, 77]), NOISE_PX, **case.options)
    result = calibrate(sequence.tracks, facts=CameraFacts(**case.facts, distortion=distortion))
    if not result:
        return 'refused', np.nan, np.nan, np.nan, result.reason
    deviation = result.camera.parameters - sequence.camera.parameters
    sigma = np.array([result.sigma[name] for name in PARAMETER_NAMES])
    free = np.array([result.status[name] == 'estimated' for name in PARAMETER_NAMES])
    ratio = float(np.max(np.abs(deviation[free]) / np.maximum(sigma[free], 1e-12)))
    truth = sequence.camera.K[0, 0]
    return ('right' if ratio < MAX_SIGMAS else 'WRONG', ratio, sigma[0] / truth,
            abs(deviation[0]) / truth, '')


def facts_text(facts: dict) -> str:
    """Facts in a few words."""
    words = [f'{name.replace("_", " ")} {value}' for name, value in facts.items()]
    return ', '.join(words) or 'none'


def without_numbers(reason: str) -> str:
    """Return a reason with its numbers replaced, so that reasons can be counted."""
    return re.sub(r'\d+(\.\d+)?(e-?\d+)?', '#', reason)


def run(report: Report, options) -> None:
    """Print a table for each handling of distortion."""
    seeds = range(options.runs or 20)
    tasks = list(product(range(len(CASES)), ('none', 'auto'), seeds))
    outcome = dict(zip(tasks, run_seeds(one_run, tasks, options.processes)))
    for distortion in ('none', 'auto'):
        report.section(
            f'Degenerate relatives of SI, {NOISE_PX} px, distortion {distortion} '
            f'({len(seeds)} seeds each)',
            f'wrong: an estimated parameter more than {MAX_SIGMAS:g} stated sigmas from the '
            'truth. σ, error: median of fx.',
            *(['Where the lens is found to distort, the centre of distortion tells the principal '
               'point: then scenes', 'that lack a fact may also come out right.']
              if distortion == 'auto' else []))
        rows, reasons, misses, wrong = [], [], [], 0
        for index, case in enumerate(CASES):
            results = [outcome[index, distortion, seed] for seed in seeds]
            kinds = Counter(kind for kind, *_ in results)
            told = [r[4] for r in results if r[0] == 'refused']
            apt = sum(bool(re.search(case.reason, text)) for text in told)
            done = np.array([r[1:4] for r in results if r[0] != 'refused']).reshape(-1, 3)
            middle = np.median(done, axis=0) if len(done) else [np.nan] * 3
            wrong += kinds['WRONG']
            met = {'right': kinds['right'] == len(seeds), 'either': True,
                   'refused': kinds['refused'] == len(seeds) or distortion == 'auto',
                   }[case.expected]
            label = f'{case.name} [{facts_text(case.facts)}]'
            if not met or apt < len(told) or kinds['WRONG']:
                misses.append(label)
            rows.append((case.name, facts_text(case.facts), case.expected, kinds['right'],
                         kinds['refused'], kinds['WRONG'], f'{apt}/{len(told)}',
                         f'{100 * middle[1]:.2g}', f'{100 * middle[2]:.2g}',
                         f'{np.max(done[:, 0], initial=0):.2g}'))
            if told:
                text, _ = Counter(map(without_numbers, told)).most_common(1)[0]
                reasons.append((case.name, facts_text(case.facts),
                                next(t for t in told if without_numbers(t) == text)))
        report.table(('scene', 'facts', 'expected', 'right', 'refused', 'wrong', 'apt reason',
                      'σ fx %', 'error fx %', 'worst σ'), rows)
        report.say('\nThe most frequent reason of each refusal:\n')
        report.table(('scene', 'facts', 'reason'), reasons)
        report.say('')
        report.judge(wrong == 0, f'{wrong} wrong results with a small sigma')
        report.judge(not misses, 'every scene comes out as expected' if not misses else
                     f'not as expected: {"; ".join(misses)}')
