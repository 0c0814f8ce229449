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
Visibility tables of the thesis (7.3.4) beside the direct test that the tracker uses.

Both tell exactly the same. The table is filled beforehand, for all view directions.
"""

from __future__ import annotations

import time

from bench.tables import Report
import numpy as np
from selfcal_ros.rorapid.visibility.visibility_table import VisibilityTable
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel
from selfcal_ros.synthetic.object_shapes import SHAPES
from selfcal_ros.synthetic.paths import look_at
from selfcal_ros.values.wireframe import Polygon, WireframeModel

#: Views of each model, and the distance of the camera in diameters of the object.
VIEWS, DISTANCE = 200, 2.9


def run(report: Report, options) -> None:
    """Print the table."""
    report.section('Visible primitives of a view: direct test and table (thesis 7.3.4)',
                   f'{VIEWS} views each, milliseconds a view, 642 view directions in the table. '
                   'Pays after: images until the time that filling took is won back.')
    rows, same = [], True
    for model in (*(make().model for make in SHAPES.values()), stairs(6), stairs(12), gear(8)):
        direct = VisibleModel(model)
        began = time.thread_time()
        distance = DISTANCE * model.diameter_m
        table = VisibilityTable(model, 0.6 * distance, 1.6 * distance)
        filled = time.thread_time() - began
        poses = views(model, distance)
        one, visible = timed(direct, poses)
        other, looked_up = timed(table, poses)
        same &= all(np.array_equal(a, b) for a, b in zip(visible, looked_up))
        won = (one - other) / VIEWS
        rows.append((model.name, len(model.triangles), direct.size, f'{1000 * one / VIEWS:.3f}',
                     f'{1000 * other / VIEWS:.3f}', f'{filled:.1f}',
                     f'{filled / won:.0f} images' if won > 0.01 * one / VIEWS else 'never'))
    report.table(('model', 'triangles', 'control points', 'direct ms', 'table ms', 'filling s',
                  'pays after'), rows)
    report.say('')
    report.judge(same, 'table and direct test see the same points')


def views(model, distance: float) -> list:
    """Poses around an object, within 25 degrees of one direction and 20 % of one distance."""
    rng = np.random.default_rng(0)
    poses = []
    for _ in range(VIEWS):
        way = [0.5, -0.6, 0.5] + 0.3 * rng.normal(size=3)
        way *= distance * rng.uniform(0.8, 1.2) / np.linalg.norm(way)
        poses.append(look_at(model.centre + way, model.centre))
    return poses


def timed(visible_model: VisibleModel, poses) -> tuple[float, list]:
    """Return the seconds for all poses, the best of three, and what is visible."""
    best, seen = np.inf, []
    for _ in range(3):
        began = time.thread_time()
        seen = [visible_model.control_points(pose[:, :3], pose[:, 3]).visible for pose in poses]
        best = min(best, time.thread_time() - began)
    return best, seen


def stairs(steps: int) -> WireframeModel:
    """Make a flight of stairs, 0.1 m high."""
    size = 0.1 / steps
    outline = [(0.0, 0.0)]
    for k in range(steps):
        outline += [(k * size, (steps - k) * size), ((k + 1) * size, (steps - k) * size)]
    return _prism(np.array([*outline, (0.1, 0.0)]), 0.03, f'stairs of {steps}')


def gear(teeth: int) -> WireframeModel:
    """Make a gear wheel, 0.1 m wide."""
    angle = (np.repeat(np.arange(teeth), 4) + np.tile([0, 0.25, 0.5, 0.75], teeth)) \
        * 2 * np.pi / teeth
    radius = np.tile([0.04, 0.04, 0.05, 0.05], teeth)
    outline = radius[:, None] * np.column_stack([np.cos(angle), -np.sin(angle)])
    return _prism(outline, 0.01, f'gear of {teeth} teeth')


def _prism(outline: np.ndarray, half: float, name: str) -> WireframeModel:
    count = len(outline)
    vertices = np.concatenate([np.column_stack([outline[:, 0], np.full(count, y), outline[:, 1]])
                               for y in (-half, half)])
    faces = [Polygon(range(count)), Polygon(range(2 * count - 1, count - 1, -1))]
    faces += [Polygon((k, k + count, (k + 1) % count + count, (k + 1) % count))
              for k in range(count)]
    return WireframeModel.build(vertices, (), faces, name=name)
