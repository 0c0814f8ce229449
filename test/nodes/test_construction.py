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
"""A node that is refused while it is made leaves nothing behind."""

from functools import partial
import threading

import pytest
from rclpy.exceptions import InvalidNodeNameException
from rclpy.node import Node
from selfcal_ros.errors import SelfcalError
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.camera_info_node import CameraInfoPublisher
from selfcal_ros.nodes.construction import whole_or_none
from selfcal_ros.nodes.feature_tracker_node import FeatureTrackerNode
from selfcal_ros.nodes.object_tracker_node import ObjectTrackerNode
from selfcal_ros.nodes.page_node import CalibrationPage
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from selfcal_ros.nodes.player_node import BagPlayer
from selfcal_ros.rorapid.model import write_model
from selfcal_ros.synthetic.object_shapes import cube

MODEL = 'model:={folder}/model.cao'


def threads_started_here(monkeypatch):
    """Return the list that the threads which this thread starts will be in; others start, too."""
    here, started, start = threading.current_thread(), [], threading.Thread.start

    def noted(thread):
        start(thread)
        if threading.current_thread() is here:
            started.append(thread)

    monkeypatch.setattr(threading.Thread, 'start', noted)
    return started


@pytest.mark.parametrize('make, parameters', [
    (FeatureTrackerNode, ['mask:={folder}/none.png']),
    (partial(CalibratorNode, 'planar_calibrator', PlanarCalibratorParameters),
     ['set_camera_info_service:=two words']),
    (CameraInfoPublisher, ['source:=nobody']),
    (CalibrationPage, ['calibrator:=no name']),
    (BagPlayer, ['bag:={folder}/none']),
    (ObjectTrackerNode, [MODEL, 'start_pose:={folder}/none.yaml']),
    # all is there by then but its inputs: its thread, too
    (ObjectTrackerNode, [MODEL, 'image_transport:=theora'])])
def test_a_refused_node_is_gone_at_once(graph, ros, tmp_path, monkeypatch, make, parameters):
    write_model(cube().model, tmp_path / 'model.cao')
    graph(*(word for one in parameters for word in ('-p', one.format(folder=tmp_path))))
    started = threads_started_here(monkeypatch)
    names = sorted(ros.get_node_names())
    # the error is held, and with it the frame in which the node was made
    with pytest.raises(SelfcalError) as refused:
        make()
    assert sorted(ros.get_node_names()) == names, refused
    assert not [thread.name for thread in started if thread.is_alive()]


def test_whatever_breaks_the_making_off_ends_the_node(graph, ros):
    graph()
    names = sorted(ros.get_node_names())

    class Broken(Node):
        @whole_or_none
        def __init__(self):
            super().__init__('broken')
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as refused:
        Broken()
    assert sorted(ros.get_node_names()) == names, refused


def test_rclpy_says_itself_what_it_refuses(graph):
    graph()

    class Misnamed(Node):
        @whole_or_none
        def __init__(self, name):
            super().__init__(name)

    with pytest.raises(InvalidNodeNameException):
        Misnamed('two words')
