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
A fixed transform from the robot to its camera, in the files of those who use one.

URDF (a fixed joint), YAML with the parameters of tf2's static_transform_publisher, a launch file
as MoveIt's hand-eye calibration writes it, and the files of easy_handeye and easy_handeye2. Each
holds the pose of the camera's optical frame in the body; metres, quaternions, or angles about
fixed axes (rad).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
import json
from pathlib import Path
import re
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from selfcal_ros.calibration.mount import FORWARD, Mount, PLACE, TURN
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.rotation import roll_pitch_yaw
from selfcal_ros.report.mounts.record import shown_sigma
from selfcal_ros.values.output_files import atomic_write

#: Frame of the camera where a file or a recording names none.
CAMERA_FRAME = 'camera_optical_frame'
#: Before the joint of a camera_link, in a comment of a URDF.
AXES = 'axes x forward, y left, z up, for a camera_link in the lens'
#: The first line of a launch file.
LAUNCH_TITLE = 'Static transform of a camera on a robot.'
#: Names that frames of TF may have.
_FRAME_NAME = re.compile(r'^[A-Za-z0-9_][A-Za-z0-9_/.-]*$')


@dataclass(frozen=True)
class StoredTransform:
    """
    The pose of a camera on a robot, with the names of both frames.

    Attributes
    ----------
    parent, child : str
    matrix : ndarray, shape (4, 4)
        Parent from child.
    covariance : ndarray, shape (6, 6), or None
        Of x, y, z (metres) and of small turns about the axes of the parent (rad).
    about : tuple of str
        What a person should know, a line each.

    """

    parent: str
    child: str
    matrix: np.ndarray
    covariance: np.ndarray | None = None
    about: tuple[str, ...] = ()

    @property
    def quaternion(self) -> np.ndarray:
        """Of the rotation, x y z w with w not negative, shape (4,)."""
        found: np.ndarray = Rotation.from_matrix(self.matrix[:3, :3]).as_quat(canonical=True)
        return found

    def rpy(self, rotation: np.ndarray | None = None) -> np.ndarray:
        """Roll, pitch and yaw about fixed axes, as URDF and TF have them (rad), shape (3,)."""
        matrix = self.matrix[:3, :3] if rotation is None else rotation
        found: np.ndarray = _angles(matrix)
        return found


def _angles(R: np.ndarray) -> np.ndarray:
    """Take Rz(yaw) Ry(pitch) Rx(roll) apart; straight up or down, yaw is 0."""
    angles = roll_pitch_yaw(R)
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:
        return np.array([np.arctan2(-R[1, 2], R[1, 1]), angles[1], 0.0])
    return angles


def stored_mount(mount: Mount, child: str | None = None, source: str = '') -> StoredTransform:
    """
    Return a mount as a transform.

    Parameters
    ----------
    mount : Mount
    child : str, optional
        Frame of the camera; by default that of the images, or `CAMERA_FRAME` where they name none.
    source : str
        What to say of where it comes from.

    Raises
    ------
    ArgumentError
        If a degree of freedom is not known; the sentence says what would help.

    """
    open_ones = [name for name in (*PLACE, *TURN) if mount.status[name] == 'unobservable']
    if open_ones or not np.isfinite(mount.T_body_camera).all():
        named = ' and '.join(filter(None, (', '.join(open_ones[:-1]), *open_ones[-1:])))
        named = named or 'a part'
        state = f'--mount-fact {(open_ones or ["z"])[0]}=VALUE:SIGMA'
        raise ArgumentError(f'{named} of the mount {"are" if len(open_ones) > 1 else "is"} not '
                            'observable, and a transform needs all six numbers; ' + (
                                f'state it with {state}.' if len(open_ones) < 2 else
                                f'record the motion that shows them, or state each: {state}.'))
    sigma = shown_sigma(mount)
    spread = ', '.join(f'{name} {sigma[name]:.2g} m' for name in PLACE)
    turns = ', '.join(f'{name} {np.degrees(sigma[name] or 0.0):.2g} deg' for name in TURN)
    about = tuple(filter(None, (source, f'one sigma: {spread}, {turns}')))
    return StoredTransform(mount.frame, child or mount.camera_frame or CAMERA_FRAME,
                           mount.T_body_camera, mount.covariance[:6, :6], about)


def check_frame(name: str) -> str:
    """
    Return the name of a frame, if TF takes it.

    Raises
    ------
    ArgumentError
        If it does not.

    """
    if not _FRAME_NAME.match(name):
        raise ArgumentError(f'{name!r:.60} is no name of a frame; use letters, digits, _ and /.')
    return name


def _number(value: float) -> str:
    # tiny remainders of a turn are zero
    return f'{0.0 if abs(value) < 5e-13 else float(value):.12g}'


def _numbers(values: Iterable[float]) -> str:
    return ' '.join(map(_number, values))


def urdf_text(stored: StoredTransform) -> str:
    """Return a fixed joint, and beside it that of the body axes of the camera."""
    # two hyphens end a comment of XML
    comment = ''.join(f'  <!-- {line.replace("--", "- -")} -->\n' for line in stored.about)
    level = stored.matrix[:3, :3] @ FORWARD.T
    name = f'{stored.parent}_to_{stored.child}'.replace('/', '_')
    origin = (f'<origin xyz="{_numbers(stored.matrix[:3, 3])}" '
              f'rpy="{_numbers(stored.rpy())}"/>')
    link = (f'<origin xyz="{_numbers(stored.matrix[:3, 3])}" '
            f'rpy="{_numbers(stored.rpy(level))}"/>')
    return (f'<?xml version="1.0"?>\n<robot name="camera_mount">\n{comment}'
            f'  <!-- {AXES}: {link} -->\n'
            f'  <link name={quoteattr(stored.parent)}/>\n'
            f'  <link name={quoteattr(stored.child)}/>\n'
            f'  <joint name={quoteattr(name)} type="fixed">\n'
            f'    <parent link={quoteattr(stored.parent)}/>\n'
            f'    <child link={quoteattr(stored.child)}/>\n    {origin}\n  </joint>\n</robot>\n')


def command(stored: StoredTransform) -> str:
    """Return the command line that publishes the transform."""
    return 'ros2 run tf2_ros static_transform_publisher ' + ' '.join(_arguments(stored))


def _arguments(stored: StoredTransform) -> list[str]:
    named = dict(zip(('x', 'y', 'z'), stored.matrix[:3, 3]))
    named |= dict(zip(('qx', 'qy', 'qz', 'qw'), stored.quaternion))
    words = [word for name, value in named.items() for word in (f'--{name}', _number(value))]
    return [*words, '--frame-id', stored.parent, '--child-frame-id', stored.child]


def yaml_text(stored: StoredTransform) -> str:
    """Return the parameters of tf2's static_transform_publisher, and its command line."""
    lines = [*(f'# {line}' for line in stored.about), f'# {command(stored)}', '/**:',
             '  ros__parameters:', f'    frame_id: {json.dumps(stored.parent)}',
             f'    child_frame_id: {json.dumps(stored.child)}', '    translation:']
    lines += [f'      {name}: {_decimal(value)}' for name, value in zip(
        'xyz', stored.matrix[:3, 3])]
    lines += ['    rotation:', *(f'      {name}: {_decimal(value)}' for name, value in zip(
        'xyzw', stored.quaternion))]
    return '\n'.join(lines) + '\n'


def _decimal(value: float) -> str:
    """Write a number that YAML and ROS take for a double."""
    return f'{0.0 if abs(value) < 5e-13 else float(value):.12f}'


def launch_text(stored: StoredTransform) -> str:
    """Return a launch file as MoveIt's hand-eye calibration writes it."""
    words = ',\n'.join(f'                {json.dumps(word)}' for word in _arguments(stored))
    # neither quotes nor a backslash may end or escape the docstring
    lines = [line.replace('"', "'").replace('\\', '/') for line in stored.about]
    about = '\n\n' + '\n'.join(lines) + '\n' if lines else ''
    return (f'"""{LAUNCH_TITLE}{about}"""\n'
            f'# EYE-IN-HAND: {stored.parent} -> {stored.child}\n'
            'from launch import LaunchDescription\nfrom launch_ros.actions import Node\n\n\n'
            'def generate_launch_description() -> LaunchDescription:\n'
            '    return LaunchDescription([\n        Node(\n            package="tf2_ros",\n'
            '            executable="static_transform_publisher",\n            output="log",\n'
            f'            arguments=[\n{words},\n            ],\n        ),\n    ])\n')


def _handeye(stored: StoredTransform, head: list[str], transform: list[str]) -> str:
    lines = [*(f'# {line}' for line in stored.about), 'parameters:', *head,
             f'  robot_effector_frame: {json.dumps(stored.parent)}',
             f'  tracking_base_frame: {json.dumps(stored.child)}',
             '  robot_base_frame: ""', '  tracking_marker_frame: ""',
             '  freehand_robot_movement: true', '  move_group_namespace: /',
             '  move_group: manipulator', *transform]
    return '\n'.join(lines) + '\n'


def easy_handeye2_text(stored: StoredTransform) -> str:
    """Return a .calib file of easy_handeye2, the camera in the hand."""
    place = [f'    {name}: {_decimal(value)}' for name, value in zip(
        'xyz', stored.matrix[:3, 3])]
    turn = [f'    {name}: {_decimal(value)}' for name, value in zip('xyzw', stored.quaternion)]
    return _handeye(stored, ['  name: selfcal', '  calibration_type: eye_in_hand'],
                    ['transform:', '  translation:', *place, '  rotation:', *turn])


def easy_handeye_text(stored: StoredTransform) -> str:
    """Return a file of easy_handeye (ROS 1), the camera on the hand."""
    named = [*zip('xyz', stored.matrix[:3, 3]), *zip(('qx', 'qy', 'qz', 'qw'),
                                                     stored.quaternion)]
    return _handeye(stored, ['  namespace: /selfcal_eye_on_hand/', '  eye_on_hand: true'],
                    ['transformation:', *(f'  {name}: {_decimal(value)}'
                                          for name, value in named)])


@dataclass(frozen=True)
class TransformFormat:
    """
    A kind of file that can be written.

    Attributes
    ----------
    title : str
        Whose it is.
    text : callable

    """

    title: str
    text: Callable[[StoredTransform], str]


FORMATS = {'urdf': TransformFormat('URDF', urdf_text),
           'tf': TransformFormat('static_transform_publisher', yaml_text),
           'moveit': TransformFormat('MoveIt', launch_text),
           'easy_handeye2': TransformFormat('easy_handeye2', easy_handeye2_text),
           'easy_handeye': TransformFormat('easy_handeye', easy_handeye_text)}


def kind_of_name(path: Path) -> str:
    """
    Guess the kind of file to write from its name.

    Raises
    ------
    ArgumentError
        If the name tells nothing.

    """
    name = path.name.lower()
    for ends, kind in (('.urdf', 'urdf'), ('.xacro', 'urdf'), ('.launch.py', 'moveit'),
                       ('.calib', 'easy_handeye2'), ('.yaml', 'tf'), ('.yml', 'tf')):
        if name.endswith(ends):
            return kind
    raise ArgumentError(f'The name {path.name!r:.80} tells no file of a transform; end it in '
                        '.urdf, .yaml, .launch.py or .calib.')


def write_transform(path: Path, stored: StoredTransform, kind: str | None = None,
                    replace: bool = True) -> Path:
    """
    Write a transform; the file appears whole or not at all. See `atomic_write` for `replace`.

    Raises
    ------
    ArgumentError, InputError
        If a name is impossible, or the file cannot be written.

    """
    check_frame(stored.parent)
    check_frame(stored.child)
    return atomic_write(path, FORMATS[kind or kind_of_name(path)].text(stored), replace)
