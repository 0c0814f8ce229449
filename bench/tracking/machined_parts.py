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
"""Parts that are tracked in no test that set a limit: bent sheet, tubes, vessels with a handle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from selfcal_ros.synthetic.mesh_scenes import SMOOTH

#: Vertices (V, 3) metres, and triangles (F, 3).
Mesh = tuple[np.ndarray, np.ndarray]
#: Small triangles along each side of a large one: they are drawn from far to near.
_CELLS = 6


def prism(outline: np.ndarray, thick: float) -> Mesh:
    """Make a flat part of a polygon (N, 2), counterclockwise, and a thickness."""
    half, count = thick / 2, len(outline)
    flat = [outline[list(corners)] for corners in _ears(outline)]
    large = [np.column_stack([one, np.full(3, half)]) for one in flat]
    large += [np.column_stack([one[::-1], np.full(3, -half)]) for one in flat]
    for k in range(count):
        a, b = ((*outline[j % count],) for j in (k, k + 1))
        large += [np.array([(*a, -half), (*b, -half), (*b, half)]),
                  np.array([(*a, -half), (*b, half), (*a, half)])]
    n = _CELLS
    place = {(i, j): k for k, (i, j) in enumerate(
        (i, j) for i in range(n + 1) for j in range(n + 1 - i))}
    weights = np.array([(n - i - j, i, j) for i, j in place]) / n
    small = [(place[i, j], place[i + 1, j], place[i, j + 1]) for i, j in place if i + j < n]
    small += [(place[i + 1, j], place[i + 1, j + 1], place[i, j + 1])
              for i, j in place if i + j < n - 1]
    vertices = np.concatenate([weights @ one for one in large])
    triangles = np.concatenate([np.array(small) + k * len(weights) for k in range(len(large))])
    vertices, same = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    return vertices, same.ravel()[triangles]


def _ears(outline):
    """Cut a simple polygon (N, 2) into triangles: triples of its corners."""
    def turn(a, b, c):
        (ux, uy), (vx, vy) = outline[b] - outline[a], outline[c] - outline[a]
        return ux * vy - uy * vx

    left, cut = list(range(len(outline))), []
    while len(left) > 3:
        for k, b in enumerate(left):
            a, c = left[k - 1], left[(k + 1) % len(left)]
            free = all(min(turn(a, b, q), turn(b, c, q), turn(c, a, q)) < 0
                       for q in left if q not in (a, b, c))
            if turn(a, b, c) > 1e-12 and free:
                cut.append((a, b, c))
                left.remove(b)
                break
    return [*cut, tuple(left)]


def tube(path: np.ndarray, radius: np.ndarray | float, around: int = 28) -> Mesh:
    """Make a closed tube along a path (N, 3)."""
    way = np.gradient(path, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    one = np.cross(way, [0.13, 0.9, 0.3])
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    other = np.cross(way, one)
    path, one, other = (np.concatenate([v[:1], v, v[-1:]]) for v in (path, one, other))
    radius = np.concatenate([[0.0], np.broadcast_to(radius, len(path) - 2), [0.0]])
    angle = 2 * np.pi * np.arange(around) / around
    rings = path[:, None] + radius[:, None, None] * (
        np.cos(angle)[:, None] * one[:, None] + np.sin(angle)[:, None] * other[:, None])
    row, column = np.meshgrid(np.arange(len(path) - 1), np.arange(around), indexing='ij')
    a, b = row * around + column, row * around + (column + 1) % around
    faces = np.stack([np.stack([a, b, b + around], -1), np.stack([a, b + around, a + around], -1)])
    return rings.reshape(-1, 3), faces.reshape(-1, 3)


def _joined(one: Mesh, other: Mesh) -> Mesh:
    return (np.concatenate([one[0], other[0]]),
            np.concatenate([one[1], other[1] + len(one[0])]))


def _bow(middle: tuple[float, float], radius: float, angle: float, count: int) -> np.ndarray:
    """Path of a handle (N, 3) in the plane y = 0."""
    turn = np.linspace(-angle, angle, count)
    return np.column_stack([middle[0] + radius * np.cos(turn), 0 * turn,
                            middle[1] + (radius + 0.002) * np.sin(turn)])


def bracket() -> Mesh:
    """Make an angle of two unequal legs."""
    return prism(0.1 * np.array([[0, 0], [1, 0], [1, 0.25], [0.25, 0.25], [0.25, 0.8], [0, 0.8]])
                 - [0.04, 0.03], 0.045)


def tee() -> Mesh:
    """Make a T whose stem is not in the middle."""
    return prism(0.1 * np.array([[-0.5, 0], [0.5, 0], [0.5, 0.22], [0.15, 0.22], [0.15, 0.9],
                                 [-0.1, 0.9], [-0.1, 0.22], [-0.5, 0.22]]) - [0, 0.04], 0.03)


def plate() -> Mesh:
    """Make a thin plate, round at one end and notched at the other."""
    turn = np.linspace(0, np.pi, 12)[:-1]
    corners = [[-0.6, -0.4], [0.3, -0.4], [0.3, -0.1], [0.6, -0.1]]
    return prism(0.1 * np.concatenate([corners, np.column_stack(
        [0.6 * np.cos(turn), 0.5 + 0.5 * np.sin(turn)])]), 0.015)


def elbow() -> Mesh:
    """Make a bent pipe of unequal ends."""
    turn, bend = np.linspace(0, np.pi / 2, 16), 0.035
    arc = bend * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    return tube(np.concatenate([np.linspace([bend, -0.045, 0], [bend, -0.003, 0], 10), arc,
                                np.linspace([-0.003, bend, 0], [-0.025, bend, 0], 6)]), 0.018)


def lever() -> Mesh:
    """Make a wavy rod with thick ends."""
    x = np.linspace(0, 0.11, 40)
    return tube(np.column_stack([x, 0.012 * np.sin(40 * x), 0.008 * np.cos(55 * x)]),
                0.009 + 0.009 * (x > 0.085) + 0.004 * (x < 0.02))


def mug() -> Mesh:
    """Make a full mug."""
    z = np.linspace(-0.045, 0.045, 24)
    return _joined(tube(np.column_stack([0 * z, 0 * z, z]), 0.032),
                   tube(_bow((0.028, 0.0), 0.026, 1.3, 20), 0.006, 16))


def bottle() -> Mesh:
    """Make a bottle with a small handle."""
    z = np.linspace(-0.06, 0.06, 40)
    radius = np.where(z < 0.02, 0.026, np.where(z < 0.04, 0.026 - 0.7 * (z - 0.02), 0.012))
    return _joined(tube(np.column_stack([0 * z, 0 * z, z]), radius),
                   tube(_bow((0.022, -0.02), 0.018, 1.2, 16), 0.005, 16))


PARTS: dict[str, Callable[[], Mesh]] = {
    **SMOOTH, 'bracket': bracket, 'tee': tee, 'plate': plate, 'elbow': elbow, 'lever': lever,
    'mug': mug, 'bottle': bottle}
