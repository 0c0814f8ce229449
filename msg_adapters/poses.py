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
Poses to geometry_msgs and back.

A pose is a matrix [R | t], shape (3, 4) or (4, 4), that maps points of the object (or camera) to
the frame in the header. Quaternions are unit, in ROS's order x y z w.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from msg_adapters.message_types import Message, MessageTypes
from msg_adapters.stamps import copy_header

import numpy as np
from scipy.spatial.transform import Rotation

from selfcal_ros.errors import ArgumentError, InputError


def pose_message(pose: np.ndarray, types: MessageTypes) -> Message:
    """
    Build a geometry_msgs/Pose.

    Raises
    ------
    ArgumentError
        If the matrix is not finite or its left part is no rotation.

    """
    pose = np.asarray(pose, float)
    if pose.shape not in ((3, 4), (4, 4)) or not np.isfinite(pose).all():
        raise ArgumentError(f'A pose must be a finite matrix (3, 4) or (4, 4), not {pose.shape}.')
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        raise ArgumentError('The left part of the pose is no rotation matrix.')
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    if w < 0:
        x, y, z, w = -x, -y, -z, -w
    return types.Pose(position=point_message(pose[:3, 3], types),
                      orientation=types.Quaternion(x=x, y=y, z=z, w=w))


def point_message(xyz: Sequence[float] | np.ndarray, types: MessageTypes) -> Message:
    """Build a geometry_msgs/Point."""
    return types.Point(x=xyz[0], y=xyz[1], z=xyz[2])


def pose_stamped_message(pose: np.ndarray, header: Message, types: MessageTypes) -> Message:
    """Build a geometry_msgs/PoseStamped with a copy of the header."""
    return types.PoseStamped(header=copy_header(header, types), pose=pose_message(pose, types))


def pose_with_covariance_message(pose: np.ndarray, covariance: np.ndarray, header: Message,
                                 types: MessageTypes) -> Message:
    """
    Build a geometry_msgs/PoseWithCovarianceStamped with a copy of the header.

    Parameters
    ----------
    pose : ndarray, shape (3, 4) or (4, 4)
    covariance : ndarray, shape (6, 6)
        Of x, y, z (metres) and rotations about the fixed x, y, z axes of the header's frame
        (radians), as ROS orders them.
    header : std_msgs/Header
    types : MessageTypes

    Raises
    ------
    ArgumentError
        If the pose is impossible or the covariance has another shape or is not finite.

    """
    covariance = np.asarray(covariance, float)
    if covariance.shape != (6, 6) or not np.isfinite(covariance).all():
        raise ArgumentError('The covariance of a pose must be a finite matrix (6, 6), not '
                            f'{covariance.shape}.')
    both = types.PoseWithCovariance(pose=pose_message(pose, types), covariance=covariance)
    return types.PoseWithCovarianceStamped(header=copy_header(header, types), pose=both)


def transform_message(pose: np.ndarray, header: Message, child_frame: str,
                      types: MessageTypes) -> Message:
    """
    Build a geometry_msgs/TransformStamped from the header's frame to that of an object.

    Parameters
    ----------
    pose : ndarray, shape (3, 4) or (4, 4)
        Maps points of the object to the frame in the header.
    header : std_msgs/Header
    child_frame : str
        Frame of the object.
    types : MessageTypes

    """
    at = pose_message(pose, types)
    moved = types.Vector3(x=at.position.x, y=at.position.y, z=at.position.z)
    return types.TransformStamped(
        header=copy_header(header, types), child_frame_id=child_frame,
        transform=types.Transform(translation=moved, rotation=at.orientation))


def path_message(poses: Iterable[Message], headers: Iterable[Message], header: Message,
                 types: MessageTypes) -> Message:
    """
    Build a nav_msgs/Path.

    Parameters
    ----------
    poses : iterable of ndarray, shape (3, 4) or (4, 4)
    headers : iterable of std_msgs/Header
        One a pose; their frame is replaced by that of `header`.
    header : std_msgs/Header
        Of the path.
    types : MessageTypes

    """
    items = []
    for pose, each in zip(poses, headers, strict=True):
        own = types.Header(stamp=types.Time(sec=each.stamp.sec, nanosec=each.stamp.nanosec),
                           frame_id=header.frame_id)
        items.append(types.PoseStamped(header=own, pose=pose_message(pose, types)))
    return types.Path(header=copy_header(header, types), poses=items)


def camera_poses(cam_from_world: np.ndarray) -> np.ndarray:
    """Invert [R | t] of many cameras, shape (V, 3, 4): their poses in the world."""
    matrices = np.asarray(cam_from_world, float)
    transposed = np.swapaxes(matrices[:, :, :3], 1, 2)
    return np.concatenate([transposed, -transposed @ matrices[:, :, 3:]], axis=2)


def pose_matrix(msg: Message) -> np.ndarray:
    """
    Return the matrix (4, 4) of a Pose, PoseStamped or PoseWithCovariance[Stamped].

    Raises
    ------
    InputError
        If a value is not finite, or the quaternion is not near unit length.

    """
    while hasattr(msg, 'pose'):
        msg = msg.pose
    position, orientation = msg.position, msg.orientation
    t = np.array([position.x, position.y, position.z], float)
    q = np.array([orientation.x, orientation.y, orientation.z, orientation.w], float)
    if not (np.isfinite(t).all() and np.isfinite(q).all()):
        raise InputError('The pose message holds a number that is not finite.')
    if not abs(np.linalg.norm(q) - 1) < 0.01:
        raise InputError(f'The quaternion of the pose message has length {np.linalg.norm(q):.3g} '
                         'instead of 1; check what publishes it.')
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(q).as_matrix()
    matrix[:3, 3] = t
    return matrix


def pose_covariance(msg: Message) -> np.ndarray:
    """
    Return the covariance (6, 6) of a PoseWithCovariance[Stamped].

    Raises
    ------
    InputError
        If it is not finite.

    """
    holder = msg if hasattr(msg, 'covariance') else msg.pose
    covariance = np.asarray(holder.covariance, float)
    if covariance.size != 36 or not np.isfinite(covariance).all():
        raise InputError('The covariance of the pose message is not 36 finite numbers.')
    return covariance.reshape(6, 6)
