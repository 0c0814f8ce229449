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
"""Streams of poses without images, whose errors nobody states."""

from bench.mounts.hand_eye import calibration_of
import numpy as np
import pytest
from selfcal_ros.calibration.mounting import mounting
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.values.body_poses import BodyPoses

#: Of a camera: across and along its optical axis (m), and turns (rad).
ACROSS_M, ALONG_M, TURN_RAD = 0.0005, 0.005, 0.001
POSES = 30


def stream(rng):
    """Return poses of the body and of the camera (V, 4, 4), and the mount."""
    def poses(turns, places):
        found = np.tile(np.eye(4), (len(places), 1, 1))
        found[:, :3, :3], found[:, :3, 3] = rotation_matrix(turns), places
        return found
    body = poses(rng.normal(0, 0.5, (POSES, 3)), rng.uniform(-0.3, 0.3, (POSES, 3)))
    mount = poses(rng.normal(0, 1.0, (1, 3)), rng.uniform(-0.1, 0.1, (1, 3)))[0]
    errors = poses(rng.normal(0, TURN_RAD, (POSES, 3)),
                   rng.normal(0, 1, (POSES, 3)) * [ACROSS_M, ACROSS_M, ALONG_M])
    return body, body @ mount @ errors, mount


def mounted(body, camera):
    """Estimate the mount, both streams pose by pose."""
    return mounting.mount_camera(calibration_of(camera, True), BodyPoses(
        body[:, :3, :3], body[:, :3, 3], frames=np.arange(POSES))).mount


@pytest.mark.long
def test_errors_of_the_camera_are_found_in_its_own_frame(monkeypatch):
    """Errors along the axis are ten times those across: weighed alike, they cost accuracy."""
    streams = [stream(np.random.default_rng(seed)) for seed in range(15)]
    found = [mounted(body, camera) for body, camera, _ in streams]
    away = np.array([one.T_body_camera[:3, 3] - mount[:3, 3]
                     for one, (_, _, mount) in zip(found, streams)])
    sigma = np.array([[one.sigma[name] for name in 'xyz'] for one in found])
    monkeypatch.setattr(mounting, 'with_errors_of_camera', lambda errors, state, camera: errors)
    alike = np.array([mounted(body, camera).T_body_camera[:3, 3] - mount[:3, 3]
                      for body, camera, mount in streams])

    assert 0.8 < np.sqrt(np.mean((away / sigma)**2)) < 1.25
    assert np.abs(away / sigma).max() < 4
    assert np.sqrt(np.mean(away**2)) < 0.8 * np.sqrt(np.mean(alike**2))
