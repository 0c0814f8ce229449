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
"""Good files of robots: poses beside a drive, a bag that holds both, two cameras, meshes."""

from __future__ import annotations

from pathlib import Path
import shutil
import struct

from msg_adapters.message_types import rosbags_types
from msg_adapters.poses import pose_message
from msg_adapters.stamps import header_message
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from selfcal_ros.geometry.rotation import rotation_matrix

VIEWS, START_NS, STEP_NS = 6, 10**18, 10**8
STORE = get_typestore(Stores.ROS2_JAZZY)
CORNERS = ((0, 0, 0), (0.08, 0, 0), (0, 0.06, 0), (0, 0, 0.07))
FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))


def write_robot_files(folder: Path, images: np.ndarray) -> None:
    """
    Write them.

    Parameters
    ----------
    folder : Path
        Holds a folder `images` already.
    images : ndarray of uint8, shape (N, H, W)

    """
    turn = 0.1 * np.arange(VIEWS)
    places = np.column_stack([np.sin(turn), 1 - np.cos(turn), 0 * turn])
    (folder / 'robot.csv').write_text('frame,tx,ty,tz,rx,ry,rz\n' + ''.join(
        f'{k},{x:.6f},{y:.6f},{z:.6f},0,0,{turn[k]:.6f}\n'
        for k, (x, y, z) in enumerate(places)), encoding='utf-8')
    (folder / 'gyro.csv').write_text('stamp_ns,gyro_x,gyro_y,gyro_z\n' + ''.join(
        f'{START_NS + k * STEP_NS // 20},{0.1 * np.sin(k):.5f},0.01,1.0\n'
        for k in range(20 * VIEWS)), encoding='utf-8')
    _write_bag(folder / 'robot_bag', images, turn, places)
    for name in ('left', 'right'):
        shutil.copytree(folder / 'images', folder / name)
    _write_meshes(folder)


def _write_bag(path: Path, images, turn, places) -> None:
    """Write images, odometry and transforms as a vehicle records them."""
    types = rosbags_types(STORE)

    def of(name: str, **values):
        return types._builder(*name.split('/'))(**values)

    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=STORE)
                       for topic, kind in (('/image', 'sensor_msgs/msg/Image'),
                                           ('/odom', 'nav_msgs/msg/Odometry'))}
        for k, image in enumerate(images[:VIEWS]):
            stamp, pose = START_NS + k * STEP_NS, np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation_matrix([0, 0, turn[k]]), places[k]
            header = header_message(stamp, 'odom', types)
            messages = {
                '/image': of('sensor_msgs/Image', header=header, height=image.shape[0],
                             width=image.shape[1], step=image.shape[1], encoding='mono8',
                             data=np.ascontiguousarray(image).ravel()),
                '/odom': of('nav_msgs/Odometry', header=header, child_frame_id='base_link',
                            pose=types.PoseWithCovariance(pose=pose_message(pose, types)))}
            for topic, message in messages.items():
                connection = connections[topic]
                writer.write(connection, stamp,
                             STORE.serialize_cdr(message, connection.msgtype))


def _write_meshes(folder: Path) -> None:
    """Write a tetrahedron in every format."""
    points = ''.join(f'{x} {y} {z}\n' for x, y, z in CORNERS)
    (folder / 'mesh.obj').write_text(
        ''.join(f'v {line}\n' for line in points.splitlines())
        + ''.join(f'f {a + 1} {b + 1} {c + 1}\n' for a, b, c in FACES), encoding='utf-8')
    (folder / 'mesh.ply').write_text(
        f'ply\nformat ascii 1.0\nelement vertex {len(CORNERS)}\nproperty float x\n'
        f'property float y\nproperty float z\nelement face {len(FACES)}\n'
        f'property list uchar int vertex_indices\nend_header\n{points}'
        + ''.join(f'3 {a} {b} {c}\n' for a, b, c in FACES), encoding='utf-8')
    (folder / 'mesh.stl').write_bytes(bytes(80) + struct.pack('<I', len(FACES)) + b''.join(
        struct.pack('<12fH', 0, 0, 0, *CORNERS[a], *CORNERS[b], *CORNERS[c], 0)
        for a, b, c in FACES))
