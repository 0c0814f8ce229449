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
"""Objects that the limits of the tracker were not set on; the faces' greys come from a seed."""

from __future__ import annotations

import numpy as np
from selfcal_ros.synthetic.object_shapes import SolidObject
from selfcal_ros.synthetic.render import PYRAMID_LEVELS, Surface
from selfcal_ros.values.wireframe import Polygon, WireframeModel

#: Corners of a box's faces, counter-clockwise from outside: +x, -x, +y, -y, +z, -z.
_FACES = ((1, 3, 7, 5), (2, 0, 4, 6), (3, 2, 6, 7), (0, 1, 5, 4), (4, 5, 7, 6), (2, 3, 1, 0))
#: Grey levels that are dealt out to the faces; neighbours differ by some levels at the least.
_GREYS = (30, 62, 94, 138, 172, 206, 238)


def slanted(seed: int) -> SolidObject:
    """Make a slanted box: no two of its faces are square to each other."""
    bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
    sides = 0.1 * np.array([[0.9, 0, 0], [0.18, 0.62, 0], [-0.12, 0.2, 0.7]])
    vertices = (bits - 0.5) @ sides
    return _solid('slanted', vertices, [Polygon(face) for face in _FACES],
                  [vertices[list(face)] for face in _FACES], seed)


def slab(seed: int) -> SolidObject:
    """Make a flat box."""
    bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
    vertices = (bits - 0.5) * 0.1 * np.array([0.7, 1.0, 0.28])
    return _solid('slab', vertices, [Polygon(face) for face in _FACES],
                  [vertices[list(face)] for face in _FACES], seed)


def channel(seed: int) -> SolidObject:
    """Make a U of unequal walls: a concave prism."""
    x = 0.1 * np.array([-0.5, -0.27, 0.22, 0.5])
    z = 0.1 * np.array([-0.4, -0.2, 0.15, 0.42])
    outline = np.array([(x[0], z[0]), (x[3], z[0]), (x[3], z[2]), (x[2], z[2]), (x[2], z[1]),
                        (x[1], z[1]), (x[1], z[3]), (x[0], z[3])])
    count, half = len(outline), 0.03
    front = np.column_stack([outline[:, 0], np.full(count, -half), outline[:, 1]])
    vertices = np.concatenate([front, front * [1, -1, 1]])
    faces = [Polygon(range(count)), Polygon(range(2 * count - 1, count - 1, -1))]
    pieces = []
    for k in range(count):
        following = (k + 1) % count
        corners = (k, k + count, following + count, following)
        faces.append(Polygon(corners))
        pieces.append(vertices[list(corners)])
    sides = len(pieces)
    # the ends are three rectangles each, of one grey: no seam shows
    for y, order in ((-half, 1), (half, -1)):
        for x0, x1, z0, z1 in ((x[0], x[3], z[0], z[1]), (x[0], x[1], z[1], z[3]),
                               (x[2], x[3], z[1], z[2])):
            corners = np.array([(x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1)])
            pieces.append(corners[::order])
    return _solid('channel', vertices, faces, pieces, seed, sides)


NEW_OBJECTS = {'slanted': slanted, 'slab': slab, 'channel': channel}


def _solid(name, vertices, faces, pieces, seed, sides=None) -> SolidObject:
    """Paint parallelograms; those after the first `sides` are the two ends, three each."""
    rng = np.random.default_rng([seed, 5])
    order = rng.permutation(len(_GREYS))
    greys = [_GREYS[order[k % len(_GREYS)]] for k in range(len(pieces))]
    if sides is not None:
        for end in (0, 1):
            first = sides + 3 * end
            greys[first:first + 3] = [118 + 34 * end] * 3
    unit = 2 ** PYRAMID_LEVELS
    surfaces = [Surface(c[0], c[1] - c[0], c[3] - c[0], np.full((unit, unit), float(grey)))
                for c, grey in zip(pieces, greys)]
    return SolidObject(WireframeModel.build(vertices, (), faces, name=name), surfaces)
