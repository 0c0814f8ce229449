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
"""visualization_msgs: the camera path and the structure, for RViz and Foxglove."""

from __future__ import annotations

from msg_adapters.message_types import Message, MessageTypes
from msg_adapters.poses import camera_poses, point_message, pose_message
from msg_adapters.stamps import copy_header

import numpy as np

from selfcal_ros.geometry.camera import Camera

# of visualization_msgs/Marker
_LINE_STRIP, _LINE_LIST, _POINTS = 4, 5, 8
_ADD, _DELETE_ALL = 0, 3


def path_markers(cam_from_world: np.ndarray, header: Message, types: MessageTypes,
                 width: float = 0.02, camera: Camera | None = None,
                 frustum_length: float = 0.1) -> Message:
    """
    Build a MarkerArray of the camera path: a line through the centres, a frustum at each.

    Parameters
    ----------
    cam_from_world : ndarray, shape (V, 3, 4)
        [R | t] of each view; the header names the world.
    header : std_msgs/Header
    types : MessageTypes
    width : float
        Of the line, in the unit of the world.
    camera : Camera, optional
        With its image size; without it there are no frustums.
    frustum_length : float
        Depth of a frustum, in the unit of the world.

    """
    poses = camera_poses(np.reshape(cam_from_world, (-1, 3, 4)))
    markers = [_marker(header, types, 'camera_path', _LINE_STRIP, poses[:, :, 3],
                       (width, 0, 0), (0.1, 0.5, 1.0))]
    if camera is not None and camera.width and camera.height:
        corners = [[-0.5, -0.5], [camera.width - 0.5, -0.5],
                   [camera.width - 0.5, camera.height - 0.5], [-0.5, camera.height - 0.5]]
        rays = np.linalg.solve(camera.K, np.column_stack([corners, np.ones(4)]).T).T
        rays = np.vstack([np.zeros(3), rays * frustum_length])
        ends = np.array([0, 1, 0, 2, 0, 3, 0, 4, 1, 2, 2, 3, 3, 4, 4, 1])
        points = rays[ends] @ np.swapaxes(poses[:, :, :3], 1, 2) + poses[:, None, :, 3]
        markers.append(_marker(header, types, 'camera_frustum', _LINE_LIST,
                               points.reshape(-1, 3), (width / 2, 0, 0), (1.0, 0.6, 0.1)))
    return types.MarkerArray(markers=markers)


def structure_markers(points: np.ndarray, header: Message, types: MessageTypes,
                      size: float = 0.02) -> Message:
    """
    Build a MarkerArray of the structure.

    Parameters
    ----------
    points : ndarray, shape (P, 3) or (P, 4)
        Euclidean or homogeneous; points at infinity are left out.
    header : std_msgs/Header
    types : MessageTypes
    size : float
        Of a point, in the unit of the world.

    """
    points = np.asarray(points, float)
    if points.shape[1] == 4:
        with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
            points = points[:, :3] / points[:, 3:]
    points = points[np.isfinite(points).all(axis=1)]
    return types.MarkerArray(markers=[_marker(header, types, 'structure', _POINTS, points,
                                              (size, size, 0), (0.9, 0.9, 0.9))])


def object_markers(segments: np.ndarray, pose: np.ndarray, header: Message, types: MessageTypes,
                   colour: tuple[float, float, float],
                   width: float, lifetime_s: float = 0.0) -> Message:
    """
    Build a MarkerArray of a wireframe at its pose.

    Parameters
    ----------
    segments : ndarray, shape (N, 2, 3)
        Ends of its lines, metres, in the frame of the object.
    pose : ndarray, shape (3, 4) or (4, 4)
        Maps points of the object to the frame in the header.
    header : std_msgs/Header
    types : MessageTypes
    colour : (float, float, float)
        Red, green, blue, 0 to 1.
    width : float
        Of the lines, metres.
    lifetime_s : float
        The marker vanishes after so long; 0: it stays.

    """
    marker = _marker(header, types, 'object', _LINE_LIST, np.reshape(segments, (-1, 3)),
                     (width, 0, 0), colour)
    marker.pose = pose_message(pose, types)
    seconds = int(lifetime_s)
    marker.lifetime = types.Duration(sec=seconds, nanosec=round((lifetime_s - seconds) * 1e9))
    return types.MarkerArray(markers=[marker])


def delete_markers(header: Message, types: MessageTypes) -> Message:
    """Build a MarkerArray that clears what was shown before."""
    return types.MarkerArray(markers=[types.Marker(header=copy_header(header, types),
                                                   action=_DELETE_ALL)])


def _marker(header: Message, types: MessageTypes, namespace: str, kind: int,
            points: np.ndarray, scale: tuple[float, float, float],
            colour: tuple[float, float, float]) -> Message:
    """Build one marker; the same namespace and id replace it next time."""
    red, green, blue = colour
    return types.Marker(
        header=copy_header(header, types), ns=namespace, id=0, type=kind, action=_ADD,
        pose=types.Pose(orientation=types.Quaternion(w=1.0)),
        scale=types.Vector3(x=scale[0], y=scale[1], z=scale[2]),
        color=types.ColorRGBA(r=red, g=green, b=blue, a=1.0),
        points=[point_message(point, types) for point in points.tolist()])
