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
"""Lenses that look at a sphere: their rays and limits, and the formulas of the papers."""

import numpy as np
import pytest
from selfcal_ros.geometry.camera import Camera

LENSES = [('ucm', [0.8, 0, 0, 0, 0]), ('ucm', [1.6, 0, 0, 0, 0]),
          ('ucm', [1.2, -0.2, 0.05, 1e-3, -2e-3]), ('eucm', [0.6, 1.1]), ('eucm', [0.3, 1.2]),
          ('eucm', [1, 1]), ('eucm', [0, 1]), ('double_sphere', [-0.2, 0.6]),
          ('double_sphere', [0.1, 0.4]), ('double_sphere', [0.3, 0.9]),
          ('double_sphere', [0, 0])]
NAMES = [f'{model} {d}' for model, d in LENSES]


def camera(model, d):
    return Camera([[400, 0, 320], [0, 398, 240], [0, 0, 1]], d, 640, 480, model)


def directions(camera, rng, count=200):
    """Return rays up to 97 % of the widest angle, at any length."""
    angle = rng.uniform(0, 0.97 * camera.lens.widest_angle(camera.distortion), count)
    around, length = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.5, 20, count)
    sine = np.sin(angle)
    return length[:, None] * np.stack([sine * np.cos(around), sine * np.sin(around),
                                       np.cos(angle)], axis=-1)


@pytest.mark.parametrize('model, d', LENSES, ids=NAMES)
def test_rays_undo_the_projection_beyond_ninety_degrees_too(model, d):
    one = camera(model, d)
    points = directions(one, np.random.default_rng(0))
    back = one.rays(one.project(points))
    assert np.abs(back - points / np.linalg.norm(points, axis=1)[:, None]).max() < 1e-12
    widest = 1.001 * one.lens.widest_angle(one.distortion)
    assert np.isnan(one.project([[np.sin(widest), 0, np.cos(widest)]])).all()


def test_the_formulas_of_the_papers():
    x, y, z = point = np.array([0.7, -0.4, 0.3])
    d = np.linalg.norm(point)
    K = camera('ucm', [0.0]).K
    xi, alpha, beta = 0.4, 0.6, 1.2
    second = np.sqrt(x * x + y * y + (xi * d + z)**2)
    ellipsoid = np.sqrt(beta * (x * x + y * y) + z * z)
    for model, coefficients, below in (
            ('ucm', [xi], z + xi * d),
            ('eucm', [alpha, beta], alpha * ellipsoid + (1 - alpha) * z),
            ('double_sphere', [xi, alpha], alpha * second + (1 - alpha) * (xi * d + z))):
        seen = camera(model, coefficients).project(point)
        assert np.allclose(seen, (K @ [x / below, y / below, 1])[:2], rtol=1e-12)


def test_models_that_are_one_another():
    """The unified lens is the extended one with beta 1, but for its scale; xi 0 is a pinhole."""
    rng, xi = np.random.default_rng(2), 0.9
    alpha = xi / (1 + xi)
    one = camera('eucm', [alpha, 1])
    points = directions(one, rng)
    other = Camera(np.diag([1 + xi, 1 + xi, 1]) @ (one.K - [[0, 0, 320], [0, 0, 240], [0, 0, 0]])
                   + [[0, 0, 320], [0, 0, 240], [0, 0, 0]], [xi], 640, 480, 'ucm')
    assert np.allclose(one.project(points), other.project(points), atol=1e-6)
    ahead = rng.uniform([-1, -1, 1], [1, 1, 2], (50, 3))
    distorted = [-0.2, 0.05, 1e-3, -2e-3]
    assert np.allclose(camera('ucm', [0, *distorted]).project(ahead),
                       camera('plumb_bob', distorted).project(ahead), atol=1e-9)
