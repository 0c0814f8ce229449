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

from functools import lru_cache, partial
from itertools import product
from typing import NamedTuple

from bench.monte_carlo import run_seeds
from bench.tables import Report
from bench.tracking.tracking_runs import frame_error, WRONG
import numpy as np
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState
from selfcal_ros.synthetic.objects import ObjectRecording, tracked_object

SHAPES = 'cube', 'step_block', 'box', 'l_block'
#: Images of a sequence, and between two jumps.
IMAGES, BETWEEN = 120, 12
#: Images left out, from and below, and whether there are stamps.
WAYS = tuple(product(((3, 7), (6, 14)), (False, True)))
#: Sequences of each shape, and the first seed.
SEEDS, FIRST = 4, 20


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
    tracked, degraded, lost = TrackerState.TRACKING, TrackerState.DEGRADED, TrackerState.LOST
    rows = []
    for shape in SHAPES:
        sequences = run_seeds(partial(in_every_way, shape), range(FIRST, FIRST + count),
                              options.processes)
        for (missing, stamped), runs in zip(WAYS, zip(*sequences)):
            counts = np.sum([
                (len(one.states), one.count(tracked), one.wrong(tracked), one.count(degraded),
                 one.wrong(degraded), one.count(lost)) for one in runs], axis=0)
            rows.append((shape, f'{missing[0]} to {missing[1] - 1}', 'yes' if stamped else 'no',
                         *counts.tolist()))
    report.table(('shape', 'left out', 'stamps', 'images', 'tracked', 'wrong', 'degraded', 'wrong',
                  'lost'), rows)
    report.say('')
    wrong = sum(row[5] for row in rows)
    report.judge(wrong == 0, f'{wrong} images called tracked and wrong')


def in_every_way(shape: str, seed: int) -> list[Followed]:
    """Follow one sequence in each of `WAYS`."""
    return [follow(shape, missing, stamped, seed) for missing, stamped in WAYS]


@lru_cache(maxsize=1)
def _rendered(shape: str, seed: int, samples: int) -> tuple[ObjectRecording, list[np.ndarray]]:
    """Render a sequence, which takes longer than to follow it."""
    made = tracked_object(IMAGES, shape, seed=seed, supersampling=samples)
    return made, [image for image, _ in made.frames()]


def follow(shape: str, missing: tuple[int, int], stamped: bool, seed: int,
           samples: int = 3) -> Followed:
    """Follow a shape of which images are missing, from the true start."""
    (made, images), rng = _rendered(shape, seed, samples), np.random.default_rng(seed)
    tracker = RorapidTracker(made.model, made.camera, rng=np.random.default_rng(0))
    tracker.start(made.rotations[0], made.translations[0])
    states, squares, at = [], [], 0
    while at < IMAGES:
        frame = tracker.track(images[at], round(at * 1e9 / 30) + 1 if stamped else None)
        states.append(frame.state)
        squares.append(frame_error(frame, made.rotations[at], made.translations[at])[1])
        at += 1 + (int(rng.integers(*missing)) if len(states) % BETWEEN == 0 else 0)
    return Followed(np.array(states), np.array(squares))
