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
Make the recorded sequences of this folder again, with their truth beside them.

Run from the root of the repository: ``python bags/make_recordings.py [--output DIR] [NAME ...]``.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import shutil
import tempfile

from msg_adapters.image import compressed_image_message
from msg_adapters.message_types import rosbags_types
from msg_adapters.poses import camera_poses
from msg_adapters.stamps import header_message

import numpy as np

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from selfcal_ros.calibration.mount import mount_rotation
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.report.camera_yaml import write_camera_yaml
from selfcal_ros.rorapid.model import write_model
from selfcal_ros.synthetic import objects, recordings
from selfcal_ros.values.output_files import atomic_write

TOPIC = '/camera/image_raw/compressed'
FRAME_ID = 'camera_optical_frame'
JPEG_QUALITY = 90
_KIND = 'sensor_msgs/msg/CompressedImage'


def agv_drive() -> recordings.Recording:
    """Drive an S of 3.2 m at 0.54 m/s: 90 images at 15 Hz."""
    return recordings.agv_drive(90, distortion=recordings.REALISTIC_DISTORTION)


def arm_move() -> recordings.Recording:
    """Move the arm over the bench: 8 translations, 8 rotations, 8 general moves."""
    return recordings.arm_move(24, distortion=recordings.REALISTIC_DISTORTION, rate_hz=2.0)


def tracked_object() -> recordings.Recording:
    """Turn and move a step block before a camera that stands still: 75 images at 15 Hz."""
    return objects.tracked_object(75, 'step_block', size=(480, 360), rate_hz=15.0,
                                  distortion=recordings.REALISTIC_DISTORTION)


#: Where the cameras sit on their robots, which nobody told the calibration: x forward, y left, z
#: up (metres); roll, pitch and yaw against a level camera that looks straight ahead (degrees).
MOUNTS = {'agv_drive': ((0.31, 0.04, 1.1), (0.0, 20.0, 3.0)),
          'arm_move': ((0.06, -0.02, 0.09), (5.0, -80.0, 30.0))}
#: The clock of the camera is ahead of that of the wheels.
CLOCK_OFFSET_NS = 37_000_000
#: Odometry: instants a second, error of a metre (forward, sideways) and of a radian.
ODOMETRY_HZ, ODOMETRY_M, ODOMETRY_RAD = 50, (0.004, 0.001), 0.01
#: An arm: error of a coordinate, and of a small turn about an axis.
ARM_M, ARM_RAD = 0.0003, 0.0003


#: Name of the bag's folder to what makes it.
RECIPES = {'agv_drive': agv_drive, 'arm_move': arm_move, 'tracked_object': tracked_object}
#: Where it is not JPEG_QUALITY.
QUALITIES = {'tracked_object': 70}
#: How far the start pose of a tracker is from the truth: radians, and share of the distance.
START_ANGLE_RAD, START_FRACTION = 0.04, 0.01


def write(name: str, output) -> Path:
    """
    Write the bag ``<output>/<name>`` and ``<output>/<name>.truth.json``, replacing both.

    Of an object that is to be tracked, also its model, the camera and a rough start pose.

    Parameters
    ----------
    name : str
        One of `RECIPES`.
    output : str or Path
        Folder that exists.

    Returns
    -------
    Path
        The bag.

    """
    recording, output = RECIPES[name](), Path(output)
    store = get_typestore(Stores.ROS2_JAZZY)
    types = rosbags_types(store)
    with tempfile.TemporaryDirectory(dir=output) as temporary:
        # the file inside is named after the folder
        bag = Path(temporary) / name
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection(TOPIC, _KIND, typestore=store)
            for image, stamp_ns in recording.frames():
                header = header_message(stamp_ns, FRAME_ID, types)
                message = compressed_image_message(image, header, types, 'jpeg',
                                                   QUALITIES.get(name, JPEG_QUALITY))
                writer.write(connection, stamp_ns, store.serialize_cdr(message, _KIND))
        if (output / name).exists():
            shutil.rmtree(output / name)
        os.replace(bag, output / name)
    recordings.write_truth(recording, output / f'{name}.truth.json')
    if name in MOUNTS:
        _write_robot(name, recording, output)
    if getattr(recording, 'model', None) is not None:
        _write_object(recording, output / name)
    return output / name


def _write_robot(name: str, recording, output: Path) -> None:
    """Write the poses of the robot beside a bag, with errors as robots have them."""
    rng = np.random.default_rng(4)
    place, angles = MOUNTS[name]
    mount = np.eye(4)
    mount[:3, :3], mount[:3, 3] = mount_rotation(*np.radians(angles)), place
    camera = np.broadcast_to(np.eye(4), (len(recording.cam_from_world), 4, 4)).copy()
    camera[:, :3] = camera_poses(recording.cam_from_world)
    body = camera @ np.linalg.inv(mount)
    if name == 'arm_move':
        turns = Rotation.from_rotvec(rng.normal(0, ARM_RAD, (len(body), 3)))
        quaternions = (turns * Rotation.from_matrix(body[:, :3, :3])).as_quat()
        rows = np.column_stack([body[:, :3, 3] + rng.normal(0, ARM_M, (len(body), 3)),
                                quaternions[:, [3, 0, 1, 2]]])
        lines = ['frame,tx,ty,tz,qw,qx,qy,qz',
                 *(','.join([str(k), *(f'{value:.6f}' for value in row)])
                   for k, row in enumerate(rows))]
        atomic_write(output / f'{name}.poses.csv', '\n'.join(lines) + '\n')
        return
    stamps = np.asarray(recording.stamps_ns) - CLOCK_OFFSET_NS
    seconds = (stamps - stamps[0]) / 1e9
    heading = np.unwrap(np.arctan2(body[:, 1, 0], body[:, 0, 0]))
    course = CubicSpline(seconds, np.column_stack([body[:, :2, 3], heading]))
    when = np.arange(0, seconds[-1], 1 / ODOMETRY_HZ)
    x, y, theta = course(when).T
    # what wheels tell: each step in the frame of the step before, with its own error
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    forward, left = c * np.diff(x) + s * np.diff(y), c * np.diff(y) - s * np.diff(x)
    way, turned = np.hypot(forward, left), np.abs(np.diff(theta))
    forward = forward + rng.normal(0, ODOMETRY_M[0] * np.sqrt(way))
    left = left + rng.normal(0, ODOMETRY_M[1] * np.sqrt(way))
    theta = np.append(0, np.cumsum(np.diff(theta) + rng.normal(
        0, ODOMETRY_RAD * np.sqrt(turned))))
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    x, y = (np.append(0, np.cumsum(step)) for step in (c * forward - s * left,
                                                       s * forward + c * left))
    lines = ['stamp_ns,x,y,theta', *(
        f'{int(stamps[0]) + round(1e9 * t)},{a:.6f},{b:.6f},{c:.6f}'
        for t, a, b, c in zip(when, x, y, theta))]
    atomic_write(output / f'{name}.odometry.csv', '\n'.join(lines) + '\n')


def _write_object(recording, bag: Path) -> None:
    """Write what a tracker needs beside a bag: model, camera and start pose."""
    write_model(recording.model, bag.with_name(bag.name + '.model.yaml'))
    write_camera_yaml(bag.with_name(bag.name + '.camera.yaml'), recording.camera, bag.name,
                      ['the true camera of the recording'])
    distance = np.linalg.norm(recording.translations[0])
    R, t = objects.perturbed(recording.rotations[0], recording.translations[0],
                             np.random.default_rng(0), START_ANGLE_RAD, START_FRACTION * distance)
    numbers = ' '.join(f'{value:.6f}' for value in (*t, *rotation_vector(R)))
    atomic_write(bag.with_name(bag.name + '.pos'),
                 '# tx ty tz rx ry rz, object in the optical frame, as a person would guess it\n'
                 f'{numbers}\n')


def main(arguments=None) -> None:
    """Read the command line and write the bags."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('names', nargs='*', metavar='NAME',
                        help=f'which recordings to make: {", ".join(RECIPES)}; all by default')
    parser.add_argument('--output', type=Path, default=Path(__file__).parent,
                        help='folder to write to; this one by default')
    options = parser.parse_args(arguments)
    unknown = set(options.names) - set(RECIPES)
    if unknown:
        parser.error(f'unknown recording {sorted(unknown)[0]!r}; choose from '
                     f'{", ".join(RECIPES)}')
    for name in options.names or RECIPES:
        bag = write(name, options.output)
        size = sum(file.stat().st_size for file in bag.iterdir())
        print(f'{bag}: {size / 1e6:.2f} MB')


if __name__ == '__main__':
    main()
