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
"""Camera models: the rows are derivatives, and those of the thesis."""

import numpy as np
import pytest

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.projection.camera_models import Projection

PLAIN = Camera([[540, 0, 330], [0, 520, 235], [0, 0, 1]], width=640, height=480)
BENT = Camera([[540, 2, 330], [0, 520, 235], [0, 0, 1]], [-0.25, 0.08, 1e-3, -2e-3, 0.01])
MODELS = ('perspective', 'zoom', 'weak', 'affine')


@pytest.fixture
def points():
    return np.random.default_rng(1).uniform(-0.05, 0.05, (12, 3))


def state_of(projection):
    return projection.from_pose(rotation_matrix([0.4, -0.7, 0.3]), [0.05, -0.03, 0.6], 1.2)


@pytest.mark.parametrize('camera', (PLAIN, BENT))
@pytest.mark.parametrize('model', MODELS)
def test_rows_are_the_derivative(camera, model, points):
    projection = Projection(camera, model)
    state = state_of(projection)
    seen = projection.project(state, points)
    for axis in np.eye(2):
        rows = projection.rows(state, seen, np.tile(axis, (len(points), 1)))
        for k in range(projection.size):
            step = np.zeros(projection.size)
            step[k] = 1e-6
            ahead = projection.project(projection.moved(state, step), points).pixels
            behind = projection.project(projection.moved(state, -step), points).pixels
            slope = (ahead - behind) @ axis / 2e-6
            assert np.allclose(rows[:, k], slope, rtol=1e-4, atol=1e-3)


def test_rows_are_those_of_the_thesis(points):
    """Equations (7.4)-(7.8): a and b, and with zoom, in normalised coordinates."""
    camera = Camera(np.eye(3))
    projection = Projection(camera)
    state = state_of(projection)
    state = projection.from_pose(state.rotation, state.translation)
    seen = projection.project(state, points)
    x, y = seen.pixels.T
    X, Y, Z = seen.turned.T
    D = state.translation[2] + Z
    one, zero = np.ones_like(x), np.zeros_like(x)
    a = np.column_stack([-x * Y, x * X + Z, -Y, one, zero, -x]) / D[:, None]
    b = np.column_stack([-y * Y - Z, y * X, X, zero, one, -y]) / D[:, None]
    alpha = np.linspace(0, 3, len(x))
    c = a * np.sin(alpha)[:, None] - b * np.cos(alpha)[:, None]
    normal = np.column_stack([-np.sin(alpha), np.cos(alpha)])
    assert np.allclose(projection.rows(state, seen, normal), -c, atol=1e-12)


def test_weak_perspective_is_the_limit_of_perspective(points):
    far = 200.0
    rotation = rotation_matrix([0.4, -0.7, 0.3])
    camera = Camera([[5e5, 0, 320], [0, 5e5, 240], [0, 0, 1]])
    seen = [Projection(camera, model).project(
        Projection(camera, model).from_pose(rotation, [0.01, 0.02, far]), points).pixels
        for model in ('perspective', 'weak', 'affine')]
    assert np.abs(seen[0] - seen[1]).max() < 0.05
    assert np.abs(seen[1] - seen[2]).max() < 1e-6


@pytest.mark.parametrize('model', MODELS)
def test_difference_undoes_moved(model):
    projection = Projection(PLAIN, model)
    state = state_of(projection)
    step = 0.01 * np.random.default_rng(2).normal(size=projection.size)
    other = projection.moved(state, step)
    assert np.allclose(projection.difference(other, state), step, atol=1e-9)
    big = projection.moved(state, 0 * step)
    assert np.allclose(big.rotation @ big.rotation.T, np.eye(3), atol=1e-12)


def test_rotations_stay_rotations_over_many_corrections():
    projection = Projection(PLAIN)
    state = state_of(projection)
    rng = np.random.default_rng(3)
    for _ in range(3000):
        state = projection.moved(state, 0.1 * rng.normal(size=6))
    assert np.abs(state.rotation @ state.rotation.T - np.eye(3)).max() < 1e-12


def test_points_behind_the_camera_do_not_come_back():
    projection = Projection(PLAIN)
    state = projection.from_pose(np.eye(3), [0, 0, 0.01])
    seen = projection.project(state, np.array([[0.001, 0.0, -0.05]]))
    assert not (np.abs(seen.pixels) < 5000).all()


def test_the_pose_nearest_to_an_affine_camera():
    projection = Projection(PLAIN, 'affine')
    state = state_of(projection)
    again = projection.moved(state, np.zeros(8))
    assert np.allclose(again.rotation, state.rotation, atol=1e-9)
    assert np.allclose(again.translation, state.translation, atol=1e-9)
    covariance = projection.covariance_of_pose(state, 1e-6 * np.eye(8))
    assert covariance.shape == (6, 6) and np.linalg.eigvalsh(covariance).min() > -1e-15


@pytest.mark.parametrize('values, lens', (
    ((-0.3, 0, 0, 0), 'plumb_bob'), ((-0.3, 0.09, 0, 0, -0.01), 'plumb_bob'),
    ((0.02, -0.02, -0.01, 0), 'equidistant')))
def test_what_a_lens_does_not_see_is_not_in_the_image(values, lens):
    camera = Camera([[400, 0, 320], [0, 400, 240], [0, 0, 1]], values, 640, 480, lens)
    projection = Projection(camera)
    state = projection.from_pose(np.eye(3), [0, 0, 1.0])
    widest = np.tan(camera.lens.widest_angle(camera.distortion))
    radius = np.r_[np.linspace(0.02, 0.98, 20), np.geomspace(1.02, 1e3, 400)] * widest
    turn = np.linspace(0, 2 * np.pi, 7)[:, None, None]
    direction = np.concatenate([np.cos(turn), np.sin(turn)], axis=2)
    points = np.concatenate([radius[:, None] * direction, np.zeros((7, 420, 1))], axis=2)
    pixels = projection.project(state, points.reshape(-1, 3)).pixels.reshape(7, 420, 2)
    away = pixels - camera.K[:2, 2]
    # on the side of the ray, farther and farther out
    assert (np.einsum('nci,ni->nc', away, direction[:, 0]) > 0).all()
    assert (np.linalg.norm(away[:, 20:], axis=2) > 4000).all()
    seen = camera.project(points[:, :20].reshape(-1, 3) + [0, 0, 1])
    assert np.allclose(pixels[:, :20].reshape(-1, 2), seen)
