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
"""What is written of the nodes' topics, services and parameters is what the nodes have."""

import os
from pathlib import Path
import re
import subprocess
import sys

import numpy as np
import pytest

from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.interfaces import INTERFACES
from selfcal_ros.nodes.parameters_table import (interface_table, main, PARAMETERS,
                                                parameters_table, updated)
from selfcal_ros.nodes.player_node import BagPlayer
from selfcal_ros.nodes.feature_tracker_node import FeatureTrackerNode
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.frame_source import Frame
from test_support.node_interfaces import has, written

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize('name', ['planar_calibrator', 'affine_calibrator'])
def test_calibrators_have_what_is_written(graph, name):
    # in TF it speaks where it is asked to
    assert has(graph().add(CalibratorNode(name, PARAMETERS[name]))) == {
        end for end in written(name) if end[1] != '/tf_static'}


def test_the_tracker_has_what_is_written(graph):
    assert has(graph('-p', 'lazy:=false').add(FeatureTrackerNode())) == written('feature_tracker')


def test_the_player_has_what_is_written_for_the_type_of_its_bag(graph, tmp_path):
    write_image_bag(tmp_path / 'bag', [Frame(0, 10 ** 18, np.zeros((48, 64), np.uint8))])
    node = graph('-p', f'bag:={tmp_path / "bag"}').add(BagPlayer())
    assert has(node) == {end for end in written('bag_player') if 'compressed' not in end[1]}


@pytest.mark.long
def test_a_service_is_called_as_the_page_says(graph, tmp_path):
    text = (ROOT / 'docs' / 'nodes.md').read_text(encoding='utf-8')
    program, = re.findall(r'```python\n(.*?)```', text, re.S)
    world = graph()
    world.add(CalibratorNode('planar_calibrator', PARAMETERS['planar_calibrator']))
    caller = subprocess.Popen([sys.executable, '-c', program], stdout=subprocess.PIPE, text=True,
                              cwd=tmp_path, env=dict(os.environ))
    try:
        world.wait_for(lambda: caller.poll() is not None, 30, 'end of the program')
        assert 'three are needed' in caller.communicate()[0]
    finally:
        caller.kill()
        caller.wait()


@pytest.mark.parametrize('name', sorted(PARAMETERS))
def test_tables_have_a_row_for_everything(name):
    rows = parameters_table(name).splitlines()
    assert len(rows) == 2 + len(PARAMETERS[name].__dataclass_fields__)
    assert len({row.count('|') for row in rows}) == 1
    assert len(interface_table(name).splitlines()) == 2 + len(INTERFACES[name])


def test_update_fills_in_what_lies_between_the_markers(tmp_path):
    path = tmp_path / 'README.md'
    path.write_text('before\n<!-- parameters:bag_player -->\nold\n<!-- /parameters:bag_player -->'
                    '\nafter\n', encoding='utf-8')
    for _ in range(2):
        assert main(['--update', str(path)]) == 0
        assert path.read_text(encoding='utf-8') == (
            f'before\n<!-- parameters:bag_player -->\n{parameters_table("bag_player")}'
            '<!-- /parameters:bag_player -->\nafter\n')


def test_readme_is_up_to_date():
    files = [ROOT / 'README.md', *(ROOT / 'docs').rglob('*.md')]
    marked = [path for path in files
              if '<!-- parameters:' in path.read_text(encoding='utf-8')
              or '<!-- interface:' in path.read_text(encoding='utf-8')]
    if not marked:
        pytest.skip('no document has markers for the tables yet')
    for path in marked:
        text = path.read_text(encoding='utf-8')
        assert text == updated(text), (
            f'run: python -m selfcal_ros.nodes.parameters_table --update {path.name}')
