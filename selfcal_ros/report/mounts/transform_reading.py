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
"""The files of `transform_files`, read; and our result.json."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import takewhile
import json
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from selfcal_ros.calibration.mount import Mount, TURN
from selfcal_ros.errors import ArgumentError, InputError, SelfcalError
from selfcal_ros.report.mounts.record import mount_from_dict
from selfcal_ros.report.mounts.transform_files import (AXES, FORMATS, LAUNCH_TITLE,
                                                       stored_mount, StoredTransform)
from selfcal_ros.report.yaml_text import decoded, load_yaml, MAX_BYTES, read_bytes

#: So much of what a file says of itself is kept.
_MOST_LINES, _MOST_LETTERS = 10, 300


def is_transform_file(path: str | Path) -> bool:
    """Tell by name and content whether a file holds the transform of a camera on a robot."""
    path = Path(path)
    name = path.name.lower()
    if name.endswith(('.urdf', '.launch.py', '.calib')):
        return True
    if not name.endswith(('.yaml', '.yml')) or not path.is_file():
        return False
    with path.open('rb') as stream:
        head = stream.read(4000)
    return (b'child_frame_id:' in head and b'translation:' in head or b'transformation:' in head
            or b'robot_effector_frame:' in head)


def read_transform(path: str | Path, child: str | None = None, which: str | None = None,
                   ) -> tuple[str, StoredTransform]:
    """
    Read the transform of a camera on a robot.

    Parameters
    ----------
    path : str or Path
        Any of `FORMATS`, or our result.json.
    child : str, optional
        Frame of the camera in a result.json; by default that of its images.
    which : str, optional
        The camera of a rig; by default its first, which has the mount.

    Returns
    -------
    kind : str
    StoredTransform

    Raises
    ------
    InputError
        If there is none.

    """
    path = Path(path)
    source, name = str(path), path.name.lower()
    text = decoded(read_bytes(path, MAX_BYTES), source)
    try:
        if name.endswith('.py'):
            return 'moveit', _from_launch(text)
        if text.lstrip().startswith('<'):
            return 'urdf', _from_urdf(text)
        if text.lstrip().startswith('{'):
            return 'result', _from_result(text, source, child, which)
        kind, stored = _from_yaml(load_yaml(text, source))
        return kind, replace(stored, about=_leading_comment(text))
    except SelfcalError:
        raise
    except (ArithmeticError, AttributeError, ElementTree.ParseError, LookupError,
            RecursionError, TypeError, ValueError):
        raise InputError(f'{source} holds no transform of a camera that can be read; expected '
                         f'{", ".join(one.title for one in FORMATS.values())}, or result.json of '
                         '--robot.') from None


def _pose(place: ArrayLike, quaternion: ArrayLike) -> np.ndarray:
    """Return a matrix (4, 4)."""
    place, quaternion = np.array(place, float), np.array(quaternion, float)
    length = float(np.linalg.norm(quaternion))
    if not (np.isfinite(place).all() and abs(length - 1) < 0.01):
        raise InputError(f'The transform has a quaternion of length {length:.3g} instead of 1, or '
                         'a number that is not finite.')
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    matrix[:3, 3] = place
    return matrix


def _about(lines: Iterable[str]) -> tuple[str, ...]:
    """Return what a file says of itself: lines that can be printed, without what we add anew."""
    said = [''.join(filter(str.isprintable, line)).strip().removeprefix(LAUNCH_TITLE).strip()
            for line in lines]
    return tuple(line[:_MOST_LETTERS] for line in said if line and not line.startswith(
        (AXES, 'ros2 run tf2_ros ')))[:_MOST_LINES]


def _leading_comment(text: str) -> tuple[str, ...]:
    """Return the comment before the content of YAML."""
    lines = takewhile(lambda line: not line.strip() or line.startswith(('#', '---')),
                      text.splitlines())
    return _about(line.lstrip('#') for line in lines if line.startswith('#'))


def _from_launch(text: str) -> StoredTransform:
    """Take the arguments of static_transform_publisher out of a launch file."""
    code = re.sub(r'#[^\n]*', '', text)
    # each transform is a node, with arguments of its own
    groups = [{name[2:]: value for name, value in re.findall(
        r'["\'](--[a-z-]+)["\'],\s*["\']([^"\']*)["\']', part)}
        for part in re.split(r'\barguments\s*=', code)]
    groups = [one for one in groups if 'child-frame-id' in one]
    optical = [one for one in groups if re.search(r'_optical(_frame)?$',
                                                  one.get('child-frame-id', ''))]
    chosen = groups if len(groups) == 1 else optical
    if len(chosen) != 1:
        raise InputError(f'The launch file has {len(groups)} static transforms, {len(optical)} of '
                         'them to an optical frame; one is needed.')
    named = chosen[0]
    place = [float(named.get(name, 0)) for name in 'xyz']
    if 'qw' in named:
        turn = [float(named[name]) for name in ('qx', 'qy', 'qz', 'qw')]
    else:
        rpy = [float(named.get(name, 0)) for name in TURN]
        turn = Rotation.from_euler('xyz', rpy).as_quat().tolist()
    docstring = re.match(r'(?:\s|#[^\n]*\n)*"""(.*?)"""', text, re.DOTALL)
    return StoredTransform(named['frame-id'], named['child-frame-id'], _pose(place, turn),
                           about=_about(docstring[1].splitlines() if docstring else ()))


def _from_urdf(text: str) -> StoredTransform:
    """Take the joint of a camera out of a URDF: the only fixed one, or an optical frame's."""
    if '<!DOCTYPE' in text or '<!ENTITY' in text:
        raise InputError('A URDF with entities is not read; remove its DOCTYPE.')
    joints = [one for one in ElementTree.fromstring(text).iter('joint')
              if one.get('type') == 'fixed']
    optical = [one for one in joints if re.search(r'_optical(_frame)?$', _link(one, 'child'))]
    chosen = joints if len(joints) == 1 else optical
    if len(chosen) != 1:
        raise InputError(f'The URDF has {len(joints)} fixed joints, {len(optical)} of them to an '
                         'optical frame; one is needed.')
    joint = chosen[0]
    origin = joint.find('origin')
    at = {} if origin is None else origin.attrib
    place = [float(word) for word in at.get('xyz', '0 0 0').split()]
    rpy = [float(word) for word in at.get('rpy', '0 0 0').split()]
    turn = Rotation.from_euler('xyz', rpy).as_quat()
    # in the description of a whole robot, comments are about other things
    comments = re.findall(r'<!--(.*?)-->', text, re.DOTALL) if len(joints) == 1 else []
    return StoredTransform(_link(joint, 'parent'), _link(joint, 'child'), _pose(place, turn),
                           about=_about(line for one in comments for line in one.splitlines()))


def _link(joint: Element, end: str) -> str:
    """Return the name of the parent or the child of a joint."""
    found = joint.find(end)
    return '' if found is None else str(found.get('link', ''))


def _from_yaml(document: dict[str, Any]) -> tuple[str, StoredTransform]:
    """Read easy_handeye's files, or the parameters of static_transform_publisher."""
    if 'parameters' in document:
        names = document['parameters']
        # scalars are the strings that were written
        in_hand = (names.get('calibration_type', 'eye_in_hand') == 'eye_in_hand'
                   and names.get('eye_on_hand', 'true').lower() != 'false')
        parent = names['robot_effector_frame' if in_hand else 'robot_base_frame']
        child = str(names['tracking_base_frame'])
        if 'transformation' in document:
            at = document['transformation']
            matrix = _pose([at[name] for name in 'xyz'],
                           [at[name] for name in ('qx', 'qy', 'qz', 'qw')])
            return 'easy_handeye', StoredTransform(str(parent), child, matrix)
        at = document['transform']
        kind = 'easy_handeye2'
    else:
        at = next(iter(document.values()))['ros__parameters']
        parent, child, kind = at['frame_id'], str(at['child_frame_id']), 'tf'
    matrix = _pose([at['translation'][name] for name in 'xyz'],
                   [at['rotation'][name] for name in 'xyzw'])
    return kind, StoredTransform(str(parent), child, matrix)


def _from_result(text: str, source: str, child: str | None, which: str | None) -> StoredTransform:
    """Take the mount out of our result.json."""
    whole = json.loads(text)
    stored = stored_of(whole, which, source)
    mount = mount_from_dict(stored.get('mount'))
    if mount is None and whole.get('mount') is not None:
        raise InputError(f'{source} has no mount of {which}, the first camera has it; leave '
                         '--camera out.')
    if mount is None:
        raise InputError(f'{source} says nothing of a robot; calibrate with --robot.')
    if not isinstance(mount, Mount):
        raise InputError(f'{source} has no mount: {mount.reason}')
    try:
        return stored_mount(mount, child, stored.get('software', ''))
    except ArgumentError as error:
        raise InputError(f'{source}: {error}') from None


def stored_of(stored: dict[str, Any], which: str | None, source: str) -> dict[str, Any]:
    """
    Return what a result.json says of one camera: all of it, unless it is of a rig.

    Raises
    ------
    InputError
        If it has no camera of that name.

    """
    cameras = stored.get('cameras')
    if which is None or cameras is None:
        return stored
    if which not in cameras:
        raise InputError(f'{source} has no camera {which}; it has {", ".join(cameras)}.')
    plain: dict[str, Any] = cameras[which]
    return plain
