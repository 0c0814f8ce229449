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
"""Two publishers where there should be one: who they are is said, and one camera is kept to."""

from diagnostic_msgs.msg import DiagnosticArray
from msg_adapters.tracks import tracks_from_message
from nav_msgs.msg import Odometry
import pytest
from rclpy.node import Node
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.camera_info_node import CameraInfoPublisher
from selfcal_ros.nodes.diagnostic_name import diagnostic_name
from selfcal_ros.nodes.feature_tracker_node import FeatureTrackerNode
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from selfcal_ros.pipeline.size_guard import MIXED_S, PATIENCE_S, SizeGuard
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from test_support import image_stream

LARGE, SMALL = (640, 480), (320, 240)


def test_of_two_cameras_on_one_topic_the_first_is_followed():
    guard, now = SizeGuard(), 0.0
    taken = []
    for k in range(60):
        now += 1 / 60
        taken.append((guard.takes(SMALL if k % 2 else LARGE, now), k % 2))
    assert {even for is_taken, even in taken if is_taken} == {0}
    assert guard.size == LARGE and guard.mixed_with(now) == SMALL
    for _ in range(30):
        now += MIXED_S / 20
        assert guard.takes(LARGE, now)
    assert guard.mixed_with(now) is None


@pytest.mark.parametrize('rate', [30.0, 1.0])
def test_a_camera_that_changes_its_resolution_is_followed(rate):
    guard, now = SizeGuard(), 0.0
    for _ in range(20):
        now += 1 / rate
        assert guard.takes(LARGE, now)
    began = now
    while guard.size != SMALL:
        now += 1 / rate
        guard.takes(SMALL, now)
    assert PATIENCE_S < now - began < max(0.6, 4.5 / rate) and guard.mixed_with(now) is None
    assert guard.takes(SMALL, now + 1 / rate)


def test_a_second_publisher_of_our_camera_info_is_named(graph, monkeypatch):
    graph = graph('-p', 'silence_s:=600.0')
    ours, said = graph.add(CameraInfoPublisher()), []
    monkeypatch.setattr(type(ours.get_logger()), 'warning',
                        lambda self, text, **_: said.append(text))
    driver = graph.add(Node('usb_cam', namespace='left'))
    theirs = driver.create_publisher(CameraInfo, '/camera_info', 10)
    graph.wait_for(lambda: said, what='warning')
    assert said[0].startswith('/camera_info has 2 publishers (/camera_info_publisher, '
                              '/left/usb_cam): whoever listens gets both')
    driver.destroy_publisher(theirs)
    graph.wait_for(lambda: not ours._rivals.complaint)
    assert len(said) == 1


def test_two_trackers_or_two_robots_on_one_topic_are_named(graph, monkeypatch):
    graph = graph('-p', 'silence_s:=600.0', '-p', 'robot:=/odom')
    ours = graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters))
    statuses, said = graph.listen(DiagnosticArray, '/diagnostics'), []
    monkeypatch.setattr(type(ours.get_logger()), 'warning',
                        lambda self, text, **_: said.append(text))
    other = graph.add(Node('base', namespace='right'))
    for kind, topic in ((PointCloud2, '/tracks'), (Odometry, '/odom')):
        theirs = [node.create_publisher(kind, topic, 10) for node in (graph.probe, other)]
        sentence = (f'{topic} has 2 publishers (/probe, /right/base): what they say is mixed '
                    'here; end all but one, or remap the input')
        graph.wait_for(lambda: sentence in said, what=sentence)
        graph.wait_for(lambda: statuses and statuses[-1].status[0].message.startswith(sentence))
        assert statuses[-1].status[0].level == b'\x01'
        graph.probe.destroy_publisher(theirs[0])
        other.destroy_publisher(theirs[1])


def test_two_cameras_on_one_topic_are_named_once_and_one_is_followed(graph, monkeypatch):
    graph = graph()
    tracker, said = graph.add(FeatureTrackerNode()), []
    for level in ('info', 'warning'):
        monkeypatch.setattr(type(tracker.get_logger()), level,
                            lambda self, text, **_: said.append(text))
    tracks = graph.listen(PointCloud2, 'tracks')
    other = graph.add(Node('usb_cam', namespace='right')).create_publisher(Image, '/image', 5)
    ours = graph.probe.create_publisher(Image, 'image', 5)
    image_stream.play(graph, ours, image_stream.image, tracks, 1)
    for frame in range(1, 9):
        other.publish(image_stream.image(frame, 480, 360))
        ours.publish(image_stream.image(frame))
        graph.wait_for(lambda: len(tracks) > frame)
    graph.wait_for(lambda: tracker._rivals.complaint)
    assert {tracks_from_message(msg).image_size for msg in tracks} == {(320, 240)}
    assert 'images of 480x360 pixels come between those of 320x240' in tracker._mixed()
    # a handful of lines, not one an image
    assert len(said) < 6 and any('(/probe, /right/usb_cam)' in text for text in said)


def test_nodes_of_two_cameras_have_two_names_in_the_diagnostics(graph):
    graph = graph()
    names = [diagnostic_name(graph.add(Node('feature_tracker', namespace=space)))
             for space in ('left', 'right', '')]
    assert names == ['left/feature_tracker', 'right/feature_tracker', 'feature_tracker']
