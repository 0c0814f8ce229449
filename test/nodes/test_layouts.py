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
"""Layouts for viewers name topics that our nodes have."""

import json
from pathlib import Path

import pytest
from selfcal_ros.nodes.interfaces import INTERFACES
from selfcal_ros.nodes.parameters import CalibratorParameters
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config'


def outputs():
    """Map what the nodes publish, as it resolves without a namespace, to the type."""
    return {(f'/{node}{end.name[1:]}' if end.name[0] == '~' else '/' + end.name.lstrip('/')):
            end.type for node, ends in INTERFACES.items() for end in ends
            if end.direction == 'out'}


def rviz_displays():
    content = yaml.safe_load((CONFIG / 'selfcal.rviz').read_text(encoding='utf-8'))
    return [one for one in content['Visualization Manager']['Displays'] if 'Topic' in one]


@pytest.mark.parametrize('display', rviz_displays(), ids=lambda display: display['Name'])
def test_rviz_shows_what_is_published_in_the_type_of_the_display(display):
    kind = display['Class'].split('/')[1]
    topic = display['Topic']['Value']
    # relative, so that a namespace shows another camera
    assert not topic.startswith('/')
    assert outputs()['/' + topic].split('/')[1] == kind
    latched = kind != 'Image'
    assert (display['Topic']['Durability Policy'] == 'Transient Local') == latched


def test_rviz_is_fixed_in_the_frame_of_the_scene():
    content = yaml.safe_load((CONFIG / 'selfcal.rviz').read_text(encoding='utf-8'))
    frame = content['Visualization Manager']['Global Options']['Fixed Frame']
    assert frame == CalibratorParameters.world_frame


def test_foxglove_shows_what_is_published_and_every_panel_has_a_place():
    content = json.loads((CONFIG / 'selfcal.foxglove.json').read_text(encoding='utf-8'))
    panels = content['configById']

    def placed(place):
        return [place] if isinstance(place, str) else [
            *placed(place['first']), *placed(place['second'])]

    assert sorted(placed(content['layout'])) == sorted(panels)
    scene = panels['3D!scene']
    topics = [panels['Image!tracks']['imageMode']['imageTopic'], *scene['topics'],
              panels['DiagnosticSummary!state']['topicToRender'],
              *(path['value'].split('.')[0] for path in panels['Plot!intrinsics']['paths'])]
    assert set(topics) <= set(outputs())
    assert scene['followTf'] == CalibratorParameters.world_frame
