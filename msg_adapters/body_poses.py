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
Poses of a robot's body from messages: odometry, poses with and without covariance, transforms.

Messages of rclpy and of rosbags alike: only their fields count.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from msg_adapters.message_types import Message
from msg_adapters.poses import pose_matrix
from msg_adapters.stamps import stamp_ns

import numpy as np

from selfcal_ros.errors import InputError

#: Types of messages that hold the pose of one body.
ODOMETRY_TYPE = 'nav_msgs/msg/Odometry'
POSE_TYPES = (ODOMETRY_TYPE, 'geometry_msgs/msg/PoseStamped',
              'geometry_msgs/msg/PoseWithCovarianceStamped')
#: That of transforms.
TRANSFORM_TYPE = 'tf2_msgs/msg/TFMessage'


def body_pose(msg: Message) -> tuple[int, np.ndarray, str, str]:
    """
    Read an Odometry, a PoseStamped or a PoseWithCovarianceStamped.

    Returns
    -------
    stamp_ns : int
    pose : ndarray, shape (4, 4)
        World from body, metres.
    world_frame, body_frame : str
        As the message names them; a message of a pose does not name the body.

    Raises
    ------
    InputError
        If a value is not finite, or the quaternion is not near unit length.

    """
    return (stamp_ns(msg.header.stamp), pose_matrix(msg), str(msg.header.frame_id),
            str(getattr(msg, 'child_frame_id', '')))


def transforms(msg: Message, drop: Callable[[str], object], is_static: bool = False,
               ) -> Iterator[tuple[int, np.ndarray, str, str]]:
    """
    Yield stamp, matrix, parent and child frame of the transforms of a TFMessage.

    The matrix takes points of the child to the parent. One message holds transforms of many
    programs' frames, so one that is of no use does not cost the others.

    Parameters
    ----------
    msg : tf2_msgs/TFMessage
    drop : callable
        Called as drop(why) for each that is left out: a value is not finite, the quaternion is
        not near unit length, or there is no stamp.
    is_static : bool
        They hold at all times, and need no stamp.

    """
    for one in msg.transforms:
        parent, child = (str(name).lstrip('/') for name in (one.header.frame_id,
                                                            one.child_frame_id))
        stamp = stamp_ns(one.header.stamp)
        try:
            if stamp <= 0 and not is_static:
                raise InputError('There is no stamp; what publishes it must fill the header.')
            matrix = pose_matrix(_AsPose(one.transform))
        except InputError as error:
            drop(f'{child} in {parent} at {stamp / 1e9:.3f} s: {error}')
        else:
            yield stamp, matrix, parent, child


class _AsPose:
    """A Transform under the names of a Pose."""

    def __init__(self, transform: Message) -> None:
        self.position, self.orientation = transform.translation, transform.rotation
