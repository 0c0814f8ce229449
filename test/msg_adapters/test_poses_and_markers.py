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
"""Poses, paths, diagnostics and markers."""

from msg_adapters.diagnostics import (diagnostics_message, STALE, status_level, status_message,
                                      WARN)
from msg_adapters.markers import (delete_markers, object_markers, path_markers,
                                  structure_markers)
from msg_adapters.poses import (camera_poses, path_message, pose_covariance, pose_matrix,
                                pose_message, pose_stamped_message, pose_with_covariance_message,
                                transform_message)
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera


def random_poses(count=20):
    """Return rigid motions (count, 3, 4)."""
    rng = np.random.default_rng(3)
    rotations = Rotation.random(count, random_state=5).as_matrix()
    return np.concatenate([rotations, rng.normal(size=(count, 3, 1))], axis=2)


def test_poses_come_back(types, header):
    for pose in random_poses():
        msg = pose_stamped_message(pose, header, types)
        assert np.allclose(pose_matrix(msg)[:3], pose, atol=1e-14)
        assert msg.header.stamp.nanosec == 123_456_789
        assert np.allclose(pose_matrix(pose_message(pose_matrix(msg), types)), pose_matrix(msg))


def test_a_known_quaternion(types):
    # 90 degrees about z takes x to y
    pose = np.array([[0., -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]])
    q = pose_message(pose, types).orientation
    assert np.allclose([q.x, q.y, q.z, q.w], [0, 0, np.sqrt(0.5), np.sqrt(0.5)])


def test_covariances_come_back(types, header):
    factor = np.random.default_rng(1).normal(size=(6, 6))
    covariance = factor @ factor.T
    msg = pose_with_covariance_message(random_poses(1)[0], covariance, header, types)
    assert (pose_covariance(msg) == covariance).all()
    assert np.allclose(pose_matrix(msg)[:3], random_poses(1)[0])
    msg.pose.covariance[7] = np.inf
    with pytest.raises(InputError, match='finite'):
        pose_covariance(msg)


def test_impossible_poses(types, header):
    for wrong in (np.eye(3), np.full((3, 4), np.nan), 2 * np.eye(4), np.diag([1, 1, -1, 1])):
        with pytest.raises(ArgumentError):
            pose_message(wrong, types)
    with pytest.raises(ArgumentError, match='covariance'):
        pose_with_covariance_message(np.eye(4), np.eye(3), header, types)
    msg = types.Pose(orientation=types.Quaternion(w=0.0))
    with pytest.raises(InputError, match='length 0'):
        pose_matrix(msg)
    with pytest.raises(InputError, match='finite'):
        pose_matrix(types.Pose(position=types.Point(x=np.inf)))


def test_paths(types, header):
    poses = random_poses(3)
    other = types.Header(stamp=types.Time(sec=5, nanosec=6), frame_id='elsewhere')
    path = path_message(poses, [other] * 3, header, types)
    assert len(path.poses) == 3 and path.poses[1].header.stamp.sec == 5
    assert {pose.header.frame_id for pose in path.poses} == {'camera_optical_frame'}
    with pytest.raises(ValueError):
        path_message(poses, [other], header, types)


def test_camera_poses_invert():
    cameras = random_poses()
    product = np.einsum('vij,vjk->vik', cameras[:, :, :3], camera_poses(cameras))
    product[:, :, 3] += cameras[:, :, 3]
    assert np.allclose(product, np.eye(3, 4))


def test_diagnostics(types, header):
    status = status_message('planar_calibrator: calibration', WARN, 'drive a curve', types,
                            {'fx': 520.123456789, 'frames': 7, 'sigma fx': np.float64(0.25)},
                            'front_camera')
    msg = diagnostics_message([status], header, types)
    assert status_level(msg.status[0]) == WARN
    assert type(status.level) is (bytes if type(types).__name__ == '_RclpyTypes' else int)
    assert [(v.key, v.value) for v in status.values] == [
        ('fx', '520.123'), ('frames', '7'), ('sigma fx', '0.25')]
    assert status_level(status_message('a', STALE, '', types)) == 3


def test_path_markers(types, header):
    cameras = random_poses(4)
    camera = Camera([[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]], width=640, height=480)
    line, frustum = path_markers(cameras, header, types, camera=camera,
                                 frustum_length=0.5).markers
    centres = camera_poses(cameras)[:, :, 3]
    assert np.allclose([[p.x, p.y, p.z] for p in line.points], centres)
    assert line.color.a > 0 and line.scale.x > 0 and line.pose.orientation.w == 1
    assert len(frustum.points) == 4 * 16
    ends = np.array([[p.x, p.y, p.z] for p in frustum.points]).reshape(4, 16, 3)
    # seen from its own camera every corner of a frustum is a corner of the image at depth 0.5
    for pose, points in zip(cameras, ends):
        inside = points[[1, 3, 5, 7]] @ pose[:, :3].T + pose[:, 3]
        assert np.allclose(inside[:, 2], 0.5)
        assert np.allclose(camera.project(inside), [[-.5, -.5], [639.5, -.5], [639.5, 479.5],
                                                    [-.5, 479.5]])
    assert len({(m.ns, m.id) for m in (line, frustum)}) == 2


def test_structure_and_deletion(types, header):
    points = np.array([[2., 4, 6, 2], [1, 1, 1, 0]])
    marker, = structure_markers(points, header, types).markers
    assert [(p.x, p.y, p.z) for p in marker.points] == [(1, 2, 3)]
    assert delete_markers(header, types).markers[0].action == 3


def test_a_wireframe_is_drawn_at_its_pose(types, header):
    segments = np.random.default_rng(4).normal(size=(5, 2, 3))
    pose = random_poses(1)[0]
    marker, = object_markers(segments, pose, header, types, (0.1, 0.6, 0.4), 0.002, 1.5).markers
    points = np.array([[p.x, p.y, p.z] for p in marker.points])
    # a list of lines: two points each, in the frame of the object
    assert (marker.type, len(points)) == (5, 10)
    assert np.allclose(points, segments.reshape(-1, 3))
    assert np.allclose(pose_matrix(marker.pose)[:3], pose)
    assert (marker.lifetime.sec, marker.lifetime.nanosec) == (1, 500_000_000)
    assert marker.color.a == 1.0 and marker.scale.x == 0.002


def test_a_transform_is_its_pose(types, header):
    pose = random_poses(1)[0]
    msg = transform_message(pose, header, 'object', types)
    q, t = msg.transform.rotation, msg.transform.translation
    assert np.allclose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), pose[:, :3])
    assert np.allclose([t.x, t.y, t.z], pose[:, 3])
    assert msg.child_frame_id == 'object' and msg.header.frame_id == header.frame_id
