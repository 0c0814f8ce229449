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
Layouts for viewers name topics that our nodes have, and settings that the viewers have.

The settings are those of the viewers' own sources: RViz's displays and their properties as of
Jazzy, Foxglove's panels as its SDK declares them and Lichtblick's as it reads them.
"""

import json
from pathlib import Path

import pytest
from selfcal_ros.nodes.interfaces import INTERFACES
from selfcal_ros.nodes.parameters import CalibratorParameters
import yaml

#: Properties of RViz's displays that we set, beside those that every display has.
RVIZ_DISPLAYS = {
    'rviz_default_plugins/Grid': {'Plane', 'Cell Size', 'Plane Cell Count', 'Color', 'Alpha'},
    'rviz_default_plugins/Image': {'Topic'},
    'rviz_default_plugins/MarkerArray': {'Topic'},
    'rviz_default_plugins/PointCloud2': {'Topic', 'Style', 'Size (Pixels)', 'Color Transformer',
                                         'Axis'},
    'rviz_default_plugins/Path': {'Topic', 'Color', 'Line Style'},
}
RVIZ_QOS = {'Depth': None, 'History Policy': ('Keep Last', 'Keep All', 'System Default'),
            'Reliability Policy': ('Reliable', 'Best Effort', 'System Default'),
            'Durability Policy': ('Transient Local', 'Volatile', 'System Default')}
#: Foxglove's panels and their settings, as far as we use them.
FOXGLOVE_PANELS = {
    'Image': {'imageMode', 'topics', 'scene', 'layers', 'followMode'},
    '3D': {'cameraState', 'followMode', 'followTf', 'scene', 'transforms', 'topics', 'layers'},
    'Plot': {'showLegend', 'isSynced', 'xAxisVal', 'showXAxisLabels', 'showYAxisLabels',
             'legendDisplay', 'sidebarDimension', 'paths'},
    'DiagnosticSummary': {'minLevel', 'pinnedIds', 'hardwareIdFilter', 'topicToRender',
                          'sortByLevel'},
}
FOXGLOVE_CAMERA = {'perspective', 'distance', 'phi', 'thetaOffset', 'targetOffset', 'target',
                   'targetOrientation', 'fovy', 'near', 'far'}
FOXGLOVE_GRID = {'layerId', 'instanceId', 'visible', 'label', 'size', 'divisions', 'lineWidth',
                 'color', 'position', 'rotation', 'frameId'}
FOXGLOVE_TOPIC = {'sensor_msgs/PointCloud2': {'visible', 'pointSize', 'colorMode', 'colorField',
                                              'colorMap'},
                  'nav_msgs/Path': {'visible', 'lineWidth'},
                  'visualization_msgs/MarkerArray': {'visible'}}
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


def test_rviz_has_every_display_and_property_that_is_set():
    content = yaml.safe_load((CONFIG / 'selfcal.rviz').read_text(encoding='utf-8'))
    manager = content['Visualization Manager']
    for display in manager['Displays']:
        own = set(display) - {'Class', 'Name', 'Enabled', 'Value'}
        assert own <= RVIZ_DISPLAYS[display['Class']], display['Name']
        assert display['Enabled'] is display['Value']
        for name, value in display.get('Topic', {}).items():
            assert name == 'Value' or RVIZ_QOS[name] is None or value in RVIZ_QOS[name]
    assert [panel['Class'] for panel in content['Panels']] == ['rviz_common/Displays',
                                                               'rviz_common/Views']
    assert [tool['Class'] for tool in manager['Tools']] == ['rviz_default_plugins/MoveCamera']
    assert manager['Views']['Current']['Class'] == 'rviz_default_plugins/Orbit'


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


def test_foxglove_has_every_panel_and_setting_that_is_set():
    content = json.loads((CONFIG / 'selfcal.foxglove.json').read_text(encoding='utf-8'))
    assert set(content) == {'configById', 'globalVariables', 'userNodes', 'playbackConfig',
                            'layout'}
    panels = content['configById']
    for name, config in panels.items():
        kind, _, number = name.partition('!')
        assert number and set(config) - {'foxglovePanelTitle'} <= FOXGLOVE_PANELS[kind], name
    scene = panels['3D!scene']
    assert set(scene['cameraState']) == FOXGLOVE_CAMERA
    assert scene['followMode'] in ('follow-pose', 'follow-position', 'follow-none')
    for name, layer in scene['layers'].items():
        assert set(layer) == FOXGLOVE_GRID and layer['layerId'] == 'foxglove.Grid'
        assert layer['instanceId'] == name and layer['frameId'] == scene['followTf']
    for topic, settings in scene['topics'].items():
        assert set(settings) <= FOXGLOVE_TOPIC[outputs()[topic]]
    mode = panels['Image!tracks']['imageMode']
    package, kind = outputs()[mode['imageTopic']].split('/')
    assert mode['imageSchemaName'] == f'{package}/msg/{kind}'
    plot = panels['Plot!intrinsics']
    assert plot['xAxisVal'] == 'timestamp' and plot['legendDisplay'] == 'floating'
    for path in plot['paths']:
        topic, field = path['value'].split('.')
        assert set(path) <= {'value', 'label', 'enabled', 'timestampMethod'}
        assert outputs()[topic] == 'sensor_msgs/CameraInfo' and field in ('k[0]', 'k[4]')


def placed_weights(place):
    """Yield what the splits of a layout say."""
    if not isinstance(place, str):
        assert set(place) == {'direction', 'splitPercentage', 'first', 'second'}
        yield place['direction'], place['splitPercentage']
        for side in ('first', 'second'):
            yield from placed_weights(place[side])


def test_foxglove_gives_every_panel_room():
    content = json.loads((CONFIG / 'selfcal.foxglove.json').read_text(encoding='utf-8'))
    for direction, percentage in placed_weights(content['layout']):
        assert direction in ('row', 'column') and 20 <= percentage <= 80
