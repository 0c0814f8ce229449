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
"""Imports go down only, from the nodes and the command line to the geometry."""

import ast
from pathlib import Path
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
#: Storey of each part of the package; a part may import its own and lower storeys.
STOREY = {'errors': 0, 'version': 0, 'findings': 0, 'geometry': 1, 'values': 2, 'features': 3,
          'rorapid': 3, 'calibration': 3, 'synthetic': 3, 'pipeline': 4, 'report': 5, 'cli': 6,
          'nodes': 6}
#: Floors of the calibration: rooms of one floor do not import each other.
CALIBRATION_FLOOR = {
    'known_directions': -1,
    'blas_threads': 0, 'card': 0, 'reconstruction': 0, 'row_readout': 0, 'mount': 0,
    'result': 1, 'observability': 1,
    'bundle': 2, 'planar': 2, 'affine': 2,
    'initialisation': 3, 'uncertainty': 3, 'structure': 3,
    'moving': 4,
    'estimators': 5, 'known_object': 5, 'mounting': 5,
    'calibrate': 6, 'monitoring': 6, 'rigs': 7}
#: The same of the object tracker.
RORAPID_FLOOR = {
    'options': 1, 'tracked_frame': 1, 'projection': 1, 'region': 1, 'visibility': 1, 'model': 1,
    'edges': 2, 'texture': 2,
    'estimation': 3, 'acquisition': 3,
    'tracker': 4, 'several_cameras': 5}
FLOORS = {'calibration': CALIBRATION_FLOOR, 'rorapid': RORAPID_FLOOR}
#: The value types of the top storey that message adapters may name.
VALUE_TYPES = {'selfcal_ros.errors', 'selfcal_ros.geometry.camera',
               'selfcal_ros.values.ros_lenses',
               'selfcal_ros.values.image_headers', 'selfcal_ros.values.tracks',
               'selfcal_ros.calibration.result'}
ROS_PACKAGES = {'rclpy', 'sensor_msgs', 'geometry_msgs', 'std_msgs', 'std_srvs', 'cv_bridge',
                'diagnostic_msgs', 'visualization_msgs', 'builtin_interfaces', 'rosgraph_msgs',
                'launch', 'launch_ros', 'ament_index_python', 'rcl_interfaces'}
GEOMETRY_MAY_USE = {'__future__', 'abc', 'dataclasses', 'math', 'typing', 'functools', 'itertools',
                    'collections', 'enum', 'numpy', 'scipy', 'selfcal_ros'}


def _imports(path):
    """List the absolute names that a file imports, wherever in the file."""
    package = path.relative_to(ROOT).with_suffix('').parts[:-1]
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'), str(path))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = list(package[:len(package) - node.level + 1]) if node.level else []
            module = '.'.join(base + ([node.module] if node.module else []))
            names += [f'{module}.{alias.name}' for alias in node.names]
    return names


def _files(folder):
    return sorted((ROOT / folder).rglob('*.py'))


def _part(dotted):
    """Name the part of selfcal_ros that a dotted name lies in, None for the top level."""
    words = dotted.split('.')
    inside = len(words) > 1 and words[0] == 'selfcal_ros' and words[1] in STOREY
    return words[1] if inside else None


@pytest.mark.parametrize('path', _files('selfcal_ros'), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_down_only(path):
    part = path.relative_to(ROOT / 'selfcal_ros').with_suffix('').parts[0]
    if part == '__init__':
        return
    assert part in STOREY, f'{path} lies in no storey of the house'
    for name in _imports(path):
        words = name.split('.')
        other = _part(name)
        if other is not None:
            assert STOREY[other] <= STOREY[part], f'{path} imports {name}, which lies above it'
            if STOREY[other] == STOREY[part] >= 3:
                assert other == part, f'{path} imports {name}, its neighbour'
        elif words[0] == 'selfcal_ros':
            # the top level re-exports the calibration: only what lies above may use it
            assert STOREY[part] >= 4 or words[1:] == ['__version__'], f'{path} imports {name}'
        if words[0] in ROS_PACKAGES:
            assert part == 'nodes', f'{path} imports {name}: ROS belongs into nodes'
        if words[0] == 'msg_adapters':
            assert STOREY[part] >= 4, f'{path} imports {name}'
        if part == 'geometry':
            assert words[0] in GEOMETRY_MAY_USE, f'{path} imports {name}'
        if words[0] == 'cv2':
            assert part not in ('geometry', 'calibration'), f'{path} imports {name}'


@pytest.mark.parametrize('path', [
    path for part in FLOORS for path in _files(f'selfcal_ros/{part}')],
    ids=lambda p: str(p.relative_to(ROOT)))
def test_rooms_import_lower_floors_only(path):
    part, room = path.relative_to(ROOT / 'selfcal_ros').with_suffix('').parts[:2]
    if room == '__init__':
        return
    floor = FLOORS[part]
    for name in _imports(path):
        words = name.split('.')
        if words[:2] == ['selfcal_ros', part] and len(words) > 2 and words[2] != room:
            assert floor[words[2]] < floor[room], f'{path} imports {name}, which does not lie ' \
                'below it'


@pytest.mark.parametrize('path', _files('msg_adapters'), ids=lambda p: str(p.relative_to(ROOT)))
def test_message_adapters_import_value_types_only(path):
    for name in _imports(path):
        words = name.split('.')
        assert words[0] not in ROS_PACKAGES, f'{path} imports {name}'
        if words[0] == 'selfcal_ros':
            assert any(name == allowed or name.startswith(allowed + '.')
                       for allowed in VALUE_TYPES) \
                or (len(words) == 2 and _part(name) is None), f'{path} imports {name}'


def test_no_module_is_named_utils_or_like_the_standard_library():
    for folder in ('selfcal_ros', 'msg_adapters'):
        for path in _files(folder):
            name = path.stem
            assert 'util' not in name and 'helper' not in name, path
            assert name == '__init__' or name not in sys.stdlib_module_names, path
