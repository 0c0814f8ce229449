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
"""A body of revolution is followed, and its turn about its own axis is said to be open."""

import numpy as np
import pytest
from scipy.stats import chi2

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.rorapid.estimation.pose_search import turned_by
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.several_cameras.rig_tracker import RigTracker
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState
from selfcal_ros.synthetic.mesh_scenes import bean, handle, MeshRenderer, ring
from selfcal_ros.values.camera_rig import PlacedCamera
from selfcal_ros.values.mesh import MeshModel

CAMERA = Camera(np.array([[520, 0, 320], [0, 520, 240], [0, 0, 1.0]]), (), 640, 480)
IMAGES = 8


def turned_part(radius, height, around=48):
    """Make a part of revolution about z from its profile: vertices and faces."""
    turn = 2 * np.pi * np.arange(around) / around
    vertices = np.stack([np.outer(radius, np.cos(turn)), np.outer(radius, np.sin(turn)),
                         np.repeat(height[:, None], around, axis=1)], axis=-1)
    row, column = (index.ravel() for index in np.indices((len(radius) - 1, around)))
    a, b = row * around + column, row * around + (column + 1) % around
    return vertices.reshape(-1, 3), np.concatenate([
        np.stack([a, b, b + around], axis=1), np.stack([a, b + around, a + around], axis=1)])


def bottle():
    """Make a part that is thick below and thin above, 12 cm high, from its middle."""
    height = np.r_[0, np.linspace(0, 0.12, 40), 0.12]
    radius = np.interp(height, [0, 0.05, 0.08, 0.12], [0.025, 0.03, 0.012, 0.01])
    radius[[0, -1]] = 0
    vertices, faces = turned_part(radius, height)
    return vertices - [0, 0, 0.06], faces


def poses():
    """Make poses of the bottle that sways, and spins on its axis by 4 degrees an image."""
    found = []
    for k in range(IMAGES):
        sway = rotation_matrix(np.array([0.3 * np.sin(0.2 * k) + 1.9, 0.2, 0.02 * k]))
        spin = rotation_matrix(np.array([0, 0, np.deg2rad(4) * k]))
        found.append(np.column_stack([sway @ spin, [0.002 * k, 0.01, 0.4]]))
    return found


def test_a_body_of_revolution_has_one_free_turn_and_a_ball_three():
    height = -np.cos(np.linspace(0, np.pi, 40))
    ball = MeshModel.build(*turned_part(np.sqrt(np.maximum(1 - height**2, 0)), height))
    assert len(ball.free_turns) == 3
    vertices, faces = bottle()
    model = MeshModel.build(vertices + [0.03, 0.01, 0.08], faces)
    theta, shift = model.free_turns[0, :3], model.free_turns[0, 3:]
    assert np.allclose(np.abs(theta), [0, 0, 1], atol=1e-3)
    # points of the axis stay where they are
    assert np.allclose(np.cross(theta, [0.03, 0.01, 0.5] - model.centre) + shift, 0, atol=1e-4)
    for other in (ring(), bean(), handle()):
        assert not len(MeshModel.build(*other).free_turns)


def test_poses_are_compared_up_to_the_free_turn():
    free = np.array([[0, 0, 1.0, 0, 0, 0]])
    one, other = (ObjectPose(rotation_matrix(np.array(turn)), np.zeros(3))
                  for turn in ([0.3, 0, 0], [0, 0, 1.2]))
    spun = ObjectPose(one.rotation @ other.rotation, np.zeros(3))
    assert turned_by(one, spun) == pytest.approx(1.2)
    assert turned_by(one, spun, free) == pytest.approx(0, abs=1e-6)
    assert turned_by(other, spun, free) == pytest.approx(0.3)


def check(frame, pose):
    assert frame.state is TrackerState.TRACKING
    off = np.r_[frame.translation - pose[:, 3], rotation_vector(frame.rotation @ pose[:, :3].T)]
    assert off @ np.linalg.solve(frame.covariance, off) < chi2.ppf(1 - 1e-5, 6)
    assert np.degrees(np.arccos(min(frame.rotation[:, 2] @ pose[:, 2], 1))) < 1.5
    assert np.linalg.norm(off[:3]) < 2e-3
    sigma = np.sqrt(np.linalg.eigvalsh(frame.covariance[3:, 3:]))
    assert sigma[2] > 1.5 and sigma[1] < 0.05     # any turn about the axis, radians; no other


@pytest.mark.long
@pytest.mark.parametrize('cameras', (1, 2))
def test_a_bottle_is_followed_though_nothing_shows_how_it_spins(cameras):
    vertices, faces = bottle()
    model = MeshModel.build(vertices, faces)
    drawn = MeshRenderer(vertices, faces, CAMERA)
    aside = np.column_stack([np.eye(3), [-0.05, 0, 0]])
    places = [np.eye(3, 4), aside][:cameras]
    if cameras == 1:
        tracker = RorapidTracker(model, CAMERA)
    else:
        tracker = RigTracker(model, [
            PlacedCamera(f'camera {k}', CAMERA, np.linalg.inv(np.vstack([place, [0, 0, 0, 1]])))
            for k, place in enumerate(places)])
    first = poses()[0]
    tracker.start(first[:, :3], first[:, 3])
    for k, pose in enumerate(poses()):
        images = [drawn.render(place @ np.vstack([pose, [0, 0, 0, 1]]),
                               np.random.default_rng([k, j]), 1.0)
                  for j, place in enumerate(places)]
        frame = tracker.track(images[0]) if cameras == 1 else tracker.track(images).tracked
        check(frame, pose)
