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
"""What the calibrators show of the scene: structure, camera path, markers."""

from __future__ import annotations

from dataclasses import dataclass

from msg_adapters.clouds import structure_cloud
from msg_adapters.markers import delete_markers, path_markers, structure_markers
from msg_adapters.message_types import rclpy_types
from msg_adapters.poses import camera_poses, path_message
from msg_adapters.stamps import header_message
from nav_msgs.msg import Path
import numpy as np
from rclpy.node import Node
from rclpy.serialization import serialize_message
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.metric_structure import metric_structure
from selfcal_ros.nodes.quality_of_service import LATCHED
from selfcal_ros.pipeline.estimate_request import EstimateRequest
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

#: In steps between views, the unit of the scene.
LINE_WIDTH, FRUSTUM_LENGTH, POINT_SIZE = 0.05, 0.5, 0.1


@dataclass(frozen=True)
class SceneMessages:
    """Serialised messages: thousands of points take a callback more than a millisecond."""

    structure: bytes
    path: bytes
    markers: bytes


def prepare_scene(frame_id: str, calibration: Calibration,
                  request: EstimateRequest) -> SceneMessages | None:
    """Build the messages, where the estimate was made; None where there is no depth."""
    if calibration.motion == 'rotation':
        return None
    types, scene = rclpy_types(), metric_structure(calibration, request.tracks)
    stamps = request.tracks.stamps_ns or {}
    headers = [header_message(stamps[frame], frame_id, types) for frame in scene.frames.tolist()]
    # data time: that of the last view
    header = headers[-1]
    markers = path_markers(scene.cam_from_world, header, types, LINE_WIDTH,
                           calibration.camera, FRUSTUM_LENGTH).markers
    markers += structure_markers(scene.points, header, types, POINT_SIZE).markers
    return SceneMessages(
        serialize_message(structure_cloud(scene.points, header, types)),
        serialize_message(path_message(camera_poses(scene.cam_from_world), headers, header,
                                       types)),
        serialize_message(types.MarkerArray(markers=markers)))


class ScenePublisher:
    """
    Publishes `structure`, `camera_path` and `~/markers`, all latched.

    Parameters
    ----------
    node : rclpy.node.Node
    world_frame : str
        Frame of the messages; nothing connects it to the robot's own frames, and its unit is the
        median step between successive views.

    """

    def __init__(self, node: Node, world_frame: str) -> None:
        self._node, self._frame, self._types = node, world_frame, rclpy_types()
        self._structure = node.create_publisher(PointCloud2, 'structure', LATCHED)
        self._path = node.create_publisher(Path, 'camera_path', LATCHED)
        self._markers = node.create_publisher(MarkerArray, '~/markers', LATCHED)

    def publish(self, scene: SceneMessages) -> None:
        """Publish what was prepared."""
        self._structure.publish(scene.structure)
        self._path.publish(scene.path)
        self._markers.publish(scene.markers)

    def clear(self) -> None:
        """Replace what was published by nothing, also for those who come late."""
        header = header_message(self._node.get_clock().now().nanoseconds, self._frame,
                                self._types)
        self._structure.publish(structure_cloud(np.zeros((0, 3)), header, self._types))
        self._path.publish(path_message([], [], header, self._types))
        self._markers.publish(delete_markers(header, self._types))
