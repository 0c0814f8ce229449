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
Objects that jump: images that are missing, in a recording without time stamps.

After every twelfth image some are left out, and the object has moved and turned on at once. With
stamps the same is a longer time between two images.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState
from selfcal_ros.synthetic.objects import tracked_object

SHAPES = 'cube', 'step_block', 'box', 'l_block'
#: Images of a sequence, and between two jumps; images left out, from and below.
IMAGES, BETWEEN, MISSING = 120, 12, ((3, 7), (6, 14))
#: Sequences of each shape, and the first seed.
SEEDS, FIRST = 4, 20
#: A pose is wrong with a squared error of six numbers above this; one in 10^8 is by chance.
WRONG = 50.0


class Followed(NamedTuple):
    """States of a sequence, and squared errors in the stated covariances, (N,) each."""

    states: np.ndarray
    squares: np.ndarray

    def count(self, *states: TrackerState) -> int:
        """Count the images in one of some states."""
        return int(np.isin(self.states, states).sum())

    def wrong(self, *states: TrackerState) -> int:
        """Count those whose pose is not where it is said to be."""
        return int((np.isin(self.states, states) & ~(self.squares < WRONG)).sum())


def run(report: Report, options) -> None:
    """Print the table; with --runs so many sequences of each shape."""
    count = options.runs or SEEDS
    report.section('Objects that jump', f'{count} sequences of each shape, images left out after '
                   f'every {BETWEEN}th; wrong: a squared error above {WRONG:g}.')
    rows, wrong = [], 0
    for missing in MISSING:
        for stamped in (False, True):
            for shape in SHAPES:
                runs = run_seeds(partial(follow, shape, missing, stamped),
                                 range(FIRST, FIRST + count), options.processes)
                told = sum(one.wrong(TrackerState.TRACKING) for one in runs)
                wrong += told
                rows.append((
                    f'{missing[0]} to {missing[1] - 1}', 'yes' if stamped else 'no', shape,
                    sum(len(one.states) for one in runs),
                    sum(one.count(TrackerState.TRACKING) for one in runs), told,
                    sum(one.count(TrackerState.DEGRADED) for one in runs),
                    sum(one.wrong(TrackerState.DEGRADED) for one in runs),
                    sum(one.count(TrackerState.LOST) for one in runs)))
    report.table(('left out', 'stamps', 'shape', 'images', 'tracked', 'wrong', 'degraded', 'wrong',
                  'lost'), rows)
    report.say('')
    report.judge(wrong == 0, f'{wrong} images called tracked and wrong')


def follow(shape: str, missing: tuple[int, int], stamped: bool, seed: int) -> Followed:
    """Follow a shape of which images are missing, from the true start."""
    made, rng = tracked_object(IMAGES, shape, seed=seed), np.random.default_rng(seed)
    tracker = RorapidTracker(made.model, made.camera, rng=np.random.default_rng(0))
    tracker.start(made.rotations[0], made.translations[0])
    images = [image for image, _ in made.frames()]
    states, squares, at = [], [], 0
    while at < IMAGES:
        frame = tracker.track(images[at], round(at * 1e9 / 30) + 1 if stamped else None)
        error = np.concatenate([frame.translation - made.translations[at], rotation_vector(
            frame.rotation @ made.rotations[at].T)])
        states.append(frame.state)
        squares.append(float(error @ np.linalg.solve(frame.covariance, error)))
        at += 1 + (int(rng.integers(*missing)) if len(states) % BETWEEN == 0 else 0)
    return Followed(np.array(states), np.array(squares))
