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
Are poses right that are called tracked? Plain parts before walls that share their greys.

Part, wall, path and first attitude are drawn. Two were wrong once, and are run first.
"""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from typing import NamedTuple

from bench.tables import Report
from bench.tracking.machined_parts import PARTS
from bench.tracking.tracking_meshes import CAMERA
from bench.tracking.tracking_runs import frame_error, WRONG
import numpy as np
from scipy import ndimage
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState
from selfcal_ros.synthetic.mesh_scenes import MeshRenderer
from selfcal_ros.synthetic.objects import object_poses, perturbed
from selfcal_ros.values.mesh import MeshModel

WALLS = ('plain', 'bright', 'grey', 'slope', 'blobs', 'soft', 'stripes')
#: Sequences of each part and wall, and images of each; the first seed.
SEQUENCES, IMAGES, FIRST = 4, 50, 30
#: Others that were followed to wrong poses once; the tests have more of them.
ONCE_WRONG = (('elbow', 'grey', 7), ('mug', 'plain', 60))
#: Images of the path that a sequence is taken from.
_PATH = 400
#: A pose that is turned by more is far off, degrees.
FAR_DEG = 5.0


class Followed(NamedTuple):
    """One image: state, squared error in the stated covariance, and degrees turned."""

    state: TrackerState
    square: float
    turned_deg: float

    @property
    def is_wrong(self) -> bool:
        """Whether it is called tracked, and is not where it is said to be."""
        return self.state is TrackerState.TRACKING and not self.square < WRONG


def run(report: Report, options) -> None:
    """Print the table; with --runs so many sequences of each part and wall."""
    count = options.runs or SEQUENCES
    report.section('Plain parts before walls', f'{count} sequences of {IMAGES} images each.')
    tasks = [*ONCE_WRONG, *product(PARTS, WALLS, range(FIRST, FIRST + count))]
    table: dict[str, Counter[str]] = {name: Counter() for name in (*PARTS, *WALLS)}
    with ProcessPoolExecutor() as pool:
        for (part, wall, _), frames in zip(tasks, pool.map(follow, *zip(*tasks))):
            for key in (part, wall):
                table[key].update(
                    images=len(frames),
                    tracked=sum(one.state is TrackerState.TRACKING for one in frames),
                    wrong=sum(one.is_wrong for one in frames),
                    far=sum(one.is_wrong and one.turned_deg > FAR_DEG for one in frames))
    columns = ('images', 'tracked', 'wrong', 'far')
    report.table(('', *columns), [(name, *(counted[key] for key in columns))
                                  for name, counted in table.items()])
    wrong, far = (sum(table[part][key] for part in PARTS) for key in ('wrong', 'far'))
    report.say('')
    report.judge(wrong == 0, f'{wrong} images called tracked and wrong, {far} of them by more '
                 f'than {FAR_DEG:.0f}°')


def follow(part: str, wall: str, seed: int) -> list[Followed]:
    """Follow a part through a sequence."""
    own = 1000 * seed + 17 * list(PARTS).index(part) + WALLS.index(wall)
    rng = np.random.default_rng(own)
    vertices, faces = PARTS[part]()
    model = MeshModel.build(vertices, faces, part)
    drawn = MeshRenderer(vertices, faces, CAMERA, behind=ndimage.gaussian_filter(
        _wall(wall, rng), 0.6))
    path = object_poses('general', _PATH, model.diameter_m, speed=rng.uniform(0.5, 0.9))
    first = int(rng.integers(0, _PATH - IMAGES))
    attitude = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    attitude[0] *= np.sign(np.linalg.det(attitude))
    rotations, places = path[first:first + IMAGES, :, :3] @ attitude, path[first:, :, 3]
    tracker = RorapidTracker(model, CAMERA, rng=np.random.default_rng(0))
    tracker.start(*perturbed(rotations[0], places[0], rng, 0.05,
                             0.01 * float(np.linalg.norm(places[0]))))
    followed = []
    for k, (rotation, place) in enumerate(zip(rotations, places)):
        image = drawn.render(np.column_stack([rotation, place]),
                             np.random.default_rng(k + 1000 * own), 1.0)
        frame = tracker.track(image)
        error, square = frame_error(frame, rotation, place)
        followed.append(Followed(frame.state, square, np.rad2deg(np.linalg.norm(error[3:]))))
    return followed


def _wall(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Grey levels of a wall, (height, width)."""
    shape = CAMERA.height, CAMERA.width
    y, x = np.indices(shape)
    if kind in ('plain', 'bright', 'grey'):
        return np.full(shape, rng.uniform(*{'plain': (40, 80), 'bright': (215, 240),
                                            'grey': (120, 160)}[kind]))
    if kind == 'slope':
        rng.normal()
        return 60 + 120 * x / shape[1]
    if kind == 'stripes':
        turn = rng.uniform(0, np.pi)
        return 90 + 50 * np.sign(np.sin((x * np.cos(turn) + y * np.sin(turn))
                                        / rng.uniform(8, 20)))
    size, middle, most, steep = {'blobs': (5, 70, 45, 2), 'soft': (25, 120, 70, 1)}[kind]
    noise = ndimage.gaussian_filter(rng.normal(size=shape), size)
    return middle + most * np.tanh(steep * noise / noise.std())
