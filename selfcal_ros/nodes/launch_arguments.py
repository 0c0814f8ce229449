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
"""What can be wrong with the arguments of our launch files, looked at before anything starts."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
import os

from selfcal_ros.errors import ArgumentError
from selfcal_ros.nodes.given_paths import given_path, model_paths

CALIBRATORS = ('planar_calibrator', 'affine_calibrator')

#: Arguments that name a file or folder, which must be there where it is given.
_PATHS = ('bag', 'params_file', 'camera_file')
#: Arguments that are true or false, and those that are numbers.
_SWITCHES = ('auto_save', 'composed', 'loop', 'publish_tf', 'respawn', 'rviz', 'use_sim_time',
             'watch')
_NUMBERS = {'rate': float, 'model_scale': float, 'watch_port': int}
#: Arguments that name what only one camera can have.
_OF_ONE_CAMERA = ('image', 'camera_info', 'driver_camera_info', 'set_camera_info_service')


def launch_problem(values: Mapping[str, str]) -> str:
    """
    Say what is wrong with the arguments of a launch file; '' if nothing is.

    What a node cannot do it says itself, but by then the others run. A launch file that fails
    half way leaves behind what it has started.

    Parameters
    ----------
    values : mapping of str
        Of those arguments that there are, as text.

    """
    paths = {name: [given_path(values.get(name, ''))] for name in _PATHS}
    try:
        paths['model'] = model_paths(values.get('model', ''))
    except ArgumentError as error:
        return str(error)
    for name, those in paths.items():
        for path in those:
            if path and not os.path.exists(path):
                return f'{name}:={path}: there is no such file or folder.'
    if values.get('model') == '':
        return 'model:= must name the object to track, such as model:=/path/to/object.cao.'
    problem = _value_problem(values)
    if problem:
        return problem
    calibrator = values.get('calibrator', CALIBRATORS[0])
    if calibrator not in CALIBRATORS:
        return f'calibrator:={calibrator}: it must be one of {", ".join(CALIBRATORS)}.'
    if values.get('rviz', '').lower() == 'true' and not is_installed('rviz2'):
        return ('rviz:=true needs the package rviz2, which is not installed '
                '(sudo apt install ros-jazzy-rviz2).')
    if values.get('watch', '').lower() == 'true' and find_spec('tornado') is None:
        return ("watch:=true needs Tornado: sudo apt install python3-tornado (or pip install "
                "'.[watch]' in the clone).")
    return ''


def _value_problem(values: Mapping[str, str]) -> str:
    """Say which argument has no value of its type; '' if each has."""
    for name in _SWITCHES:
        if values.get(name, 'true').lower() not in ('true', 'false'):
            return f'{name}:={values[name]}: it must be true or false.'
    for name, number in _NUMBERS.items():
        try:
            number(values.get(name, '1'))
        except ValueError:
            kind = 'a whole number' if number is int else 'a number'
            return f'{name}:={values[name]}: it must be {kind}.'
    return ''


def shared_file_problem(names: list[str], output: str) -> str:
    """
    Say that several cameras would write one file; '' if each has its own.

    Parameters
    ----------
    names : list of str
        Of the cameras.
    output : str
        The argument `output`.

    """
    if len(names) < 2 or not output or '${NAME}' in output:
        return ''
    return (f"output:={output}: {len(names)} cameras cannot share one file; let the path hold "
            "${NAME}, in quotes: 'output:=/path/to/${NAME}.yaml'.")


def shared_topic_problem(names: list[str], values: Mapping[str, str]) -> str:
    """
    Say that several cameras would have one topic or service; '' if each has its own.

    Parameters
    ----------
    names : list of str
        Of the cameras.
    values : mapping of str
        The arguments of each.

    """
    for argument in _OF_ONE_CAMERA if len(set(names)) > 1 else ():
        given = values.get(argument, '')
        if given.startswith('/'):
            return (f'{argument}:={given}: {len(set(names))} cameras cannot share it; name it '
                    f'relative to the namespace of each, such as {given.rpartition("/")[2]}.')
    return ''


def is_installed(package: str) -> bool:
    """Tell whether there is a package of ROS in the sourced workspaces."""
    from ament_index_python.packages import get_package_prefix
    try:
        get_package_prefix(package)
    except (LookupError, OSError, ValueError):
        return False
    return True
