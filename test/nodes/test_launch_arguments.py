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
"""Arguments of launch files and nodes: what is wrong is one sentence, and nothing starts."""

from pathlib import Path
import re

import pytest

from selfcal_ros.cli import ros_environment
from selfcal_ros.nodes import launch_arguments, launch_hooks
from selfcal_ros.nodes.entry_point import refusal, run_node
from selfcal_ros.nodes.launch_arguments import launch_problem, shared_file_problem
from selfcal_ros.nodes.parameter_words import in_parameters
from selfcal_ros.nodes.parameters_table import PARAMETERS

ROOT = Path(__file__).resolve().parents[2]


def test_a_launch_looks_at_its_arguments_first(monkeypatch, tmp_path):
    fine = {'bag': '', 'rviz': 'false', 'calibrator': 'affine_calibrator',
            'params_file': str(ROOT / 'config' / 'arm.yaml'), 'image': '/nope'}
    assert launch_problem(fine) == ''
    assert launch_problem({**fine, 'bag': str(tmp_path)}) == ''
    assert launch_problem({**fine, 'bag': '/nope'}) == (
        'bag:=/nope: there is no such file or folder.')
    assert 'model:=' in launch_problem({'model': str(tmp_path / 'x.cao')})
    assert 'planar_calibrator' in launch_problem({**fine, 'calibrator': 'planar'})
    monkeypatch.setattr(launch_arguments, 'is_installed', lambda package: False)
    assert 'rviz2, which is not installed' in launch_problem({**fine, 'rviz': 'true'})
    monkeypatch.setattr(launch_arguments, 'is_installed', lambda package: True)
    assert launch_problem({**fine, 'rviz': 'true'}) == ''
    monkeypatch.setattr(launch_arguments, 'find_spec', lambda package: None)
    assert "pip install '.[watch]' in the clone" in launch_problem({**fine, 'watch': 'true'})
    assert launch_problem(fine) == ''


@pytest.mark.parametrize('name, wrong, right, words', [
    ('rate', 'fast', '0.5', 'a number'), ('model_scale', '1/1000', '1e-3', 'a number'),
    ('watch_port', '80.5', '0', 'a whole number'), ('loop', 'maybe', 'True', 'true or false'),
    ('composed', 'yes', 'false', 'true or false'), ('respawn', '', 'true', 'true or false')])
def test_a_value_of_another_type_is_named(name, wrong, right, words):
    # launch meets it half way, when nodes run already
    assert launch_problem({name: wrong}) == f'{name}:={wrong}: it must be {words}.'
    assert launch_problem({name: right}) == ''


def test_switches_and_numbers_of_the_launch_files_are_looked_at():
    text = ''.join((ROOT / 'launch' / f'{name}.launch.py').read_text(encoding='utf-8')
                   for name in ('agv', 'track'))
    switches = set(re.findall(r"'(\w+)': \('(?:true|false)'", text))
    numbers = set(re.findall(r"'(\w+)': \('[\d.]+'", text))
    assert switches == set(launch_arguments._SWITCHES)
    assert numbers == set(launch_arguments._NUMBERS)


def test_a_launch_that_tracks_needs_a_model():
    assert 'model:=/path/to/object.cao' in launch_problem({'model': ''})


def test_a_package_that_is_not_there_is_not_installed(monkeypatch, tmp_path):
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    assert not launch_arguments.is_installed('rviz2')
    index = tmp_path / 'share' / 'ament_index' / 'resource_index' / 'packages'
    index.mkdir(parents=True)
    (index / 'rviz2').touch()
    assert launch_arguments.is_installed('rviz2')


def test_cameras_do_not_share_a_file():
    assert 'hold ${NAME}' in shared_file_problem(['left', 'right'], '/data/camera.yaml')
    for names, output in ((['left'], '/data/camera.yaml'), (['left', 'right'], ''),
                          (['left', 'right'], '/data/${NAME}.yaml')):
        assert shared_file_problem(names, output) == ''


def test_the_settings_of_fast_dds_have_the_names_of_both_versions():
    # up to Jazzy, and from Kilted on
    assert launch_hooks.PROFILES == ros_environment.PROFILES == (
        'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
    for path in (ROOT / 'launch').glob('*.launch.py'):
        text = path.read_text(encoding='utf-8')
        assert '*dds_settings()' in text or 'agv.launch.py' in text, path


@pytest.mark.parametrize('name', ['agv', 'track'])
def test_launch_files_look_before_they_start(name):
    text = (ROOT / 'launch' / f'{name}.launch.py').read_text(encoding='utf-8')
    first = text.index('look_at_arguments(ARGUMENTS)')
    body = text.index('return LaunchDescription(')
    starts = [text.find(word, body) for word in ('        node(', '        Node(')]
    assert body < first < min(start for start in starts if start > 0)
    for argument in ("'respawn': ", "'use_sim_time': ", 'on_exit=end_on_refusal'):
        assert argument in text


@pytest.mark.parametrize('given, words', [
    (['bag:=/x'], "takes no argument 'bag:=/x'; say --ros-args -p bag:=/x"),
    (['image:=/cam'], '--ros-args -r image:=/cam'),
    (['--rate', '5'], "takes no argument '--rate'; parameters follow --ros-args -p"),
    (['--ros-args', '-p', 'rate:=1.0', '--', 'late'], "takes no argument 'late'")])
def test_an_argument_that_a_node_does_not_take_is_refused(capsys, given, words):
    assert run_node(lambda: pytest.fail('no node is to start'), given) == 2
    said = capsys.readouterr().err
    assert words in said and said.count('\n') == 1
    for fine in ([], ['--ros-args', '-p', 'bag:=/x', '-r', '__ns:=/left']):
        assert refusal('bag_player', fine) == ''


def test_sentences_of_nodes_name_parameters_and_not_options():
    # of what a node can come to say, every option has a parameter, but where there is none
    none = {'--parallel-objects', '--principal-point', '--image-size', '--object', '--overlay'}
    known = {name for table in PARAMETERS.values() for name in table.__dataclass_fields__}
    sources = [*(ROOT / 'selfcal_ros' / 'findings').glob('refusals.py'),
               ROOT / 'selfcal_ros' / 'pipeline' / 'bag_source.py']
    said = re.findall(r"(?<![\w`-])--[a-z][a-z-]*(?: (?:\w+|\"))?", ' '.join(
        in_parameters(path.read_text(encoding='utf-8')) for path in sources))
    assert {one.split()[0] for one in said} <= none
    assert in_parameters('nothing (--aspect-ratio free, --skew free), or say --trust-facts') == (
        'nothing (aspect_ratio:=0.0, zero_skew:=false), or say trust_facts:=true')
    assert in_parameters('Pick: `selfcal model --vertices --motion auto`; --motion auto') == (
        'Pick: `selfcal model --vertices --motion auto`; motion:=auto')
    assert in_parameters('choose one with --topic, or several with --cameras: /a') == (
        'choose one with the parameter topic: /a')
    assert in_parameters('--robot takes poses.csv, a topic of the bag such as /odom') == (
        'the parameter robot takes a topic, such as /odom')
    for given in ('--topic', '--init takes', '--motion auto', '--lens plumb_bob', '--camera)',
                  '--camera-model zoom', '--model-scale 1e-3;', '--model-scale (',
                  '--focal varying', '--shutter auto)', '--trust-facts', '--skew free'):
        words = in_parameters(given)
        assert '--' not in words and set(re.findall(r'[a-z_]+', words)) & known
