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
"""What is lost on the way to a node is counted, said once with its cause, and gets its header."""

from diagnostic_msgs.msg import DiagnosticArray
from msg_adapters.tracks import tracks_from_message
import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from selfcal_ros.nodes import image_topics
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.loss_count import LossCount, WINDOW
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from selfcal_ros.nodes.feature_tracker_node import FeatureTrackerNode, MOST_WAITING
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from test_support import image_stream
from test_support.diagnostics_table import not_written


def count_of(numbers, **how):
    count = LossCount()
    for number in numbers:
        count.arrive(number, 6_200_000, **how)
    count.look()
    return count


def test_gaps_in_the_numbers_of_a_publisher_are_losses_and_have_a_cause():
    seen = [n for n in range(1, 31) if n % 10]
    lost = count_of(seen)
    assert (lost.received, lost.lost, lost.overrun) == (27, 2, 0)
    lost = count_of([1, 2, 20, 21])
    assert lost.lost == 17
    text = lost.complaint('images', '/image', True)
    assert text.startswith('17 of the last 21 images on /image were lost on the way')
    assert '6.2 MB' in text and 'config/fastdds.xml' in text
    assert 'depth' in lost.complaint('images', '/image', False)
    slow = count_of([1, 2, 20, 21], overrun=True)
    slow.worked(0.110)
    assert slow.overrun == 17 and '110 ms each' in slow.complaint('images', '/image', True)
    assert 'too slow' in slow.complaint('images', '/image', True)
    # numbers of two publishers, of none, and of another one say nothing
    for quiet in (count_of([1, 50, 2, 51], alone=False), count_of([None] * 9),
                  count_of([7, 8, 900_000, 900_001, 1, 2])):
        assert quiet.lost == quiet.overrun == 0 and not quiet.complaint('images', '/image', True)


def test_a_loss_is_said_once_and_again_only_after_a_quiet_time():
    count = count_of([1, 2, 10])
    where = ('images', '/image', True)
    assert '7 of the last 10' in count.news(*where)
    assert not count.news(*where) and count.complaint(*where)
    for number in range(11, 12 + WINDOW):
        count.arrive(number)
        count.look()
        assert not count.news(*where)
    assert not count.complaint(*where)
    count.arrive(40)
    count.look()
    assert count.news(*where)


def test_images_without_time_get_their_camera_info_and_the_cause_is_said(graph, monkeypatch):
    graph = graph()
    tracker = graph.add(FeatureTrackerNode())
    graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters))
    said = []
    monkeypatch.setattr(type(tracker.get_logger()), 'warning',
                        lambda self, text, **_: said.append(text))
    tracks = graph.listen(PointCloud2, 'tracks')
    infos = graph.listen(CameraInfo, 'camera_info')
    diagnostics = graph.listen(DiagnosticArray, '/diagnostics')
    camera = graph.probe.create_publisher(Image, 'image', 20)
    image_stream.play(graph, camera, image_stream.image, tracks, 1)
    # the node does not get a word in while these come
    burst = [image_stream.image(k) for k in range(1, 5 + MOST_WAITING)]
    for msg in burst:
        camera.publish(msg)
    graph.wait_for(lambda: len(tracks) > len(burst) and len(infos) > len(burst))
    heads = [msg.header for msg in burst]
    assert [msg.header for msg in tracks[-len(burst):]] == heads
    assert [msg.header for msg in infos[-len(burst):]] == heads
    points = [len(tracks_from_message(msg).track) for msg in tracks[-len(burst):]]
    assert points[:4] == [0] * 4 and min(points[4:]) > 30
    graph.wait_for(lambda: [text for text in said if 'still worked on' in text], what='warning')

    def values():
        return [{v.key: v.value for v in status.values} for msg in diagnostics
                for status in msg.status if status.name == 'feature_tracker: images']

    graph.wait_for(lambda: values() and values()[-1]['no time for'] == '4')
    assert not not_written(values()[-1])
    assert sum('still worked on' in text for text in said) == 1


def test_who_is_followed_by_auto_is_left_when_it_falls_silent(graph, monkeypatch):
    graph, now = graph(), [0.0]
    tracker = graph.add(FeatureTrackerNode())
    monkeypatch.setattr(image_topics, 'time', type('Clock', (), {
        'monotonic': staticmethod(lambda: now[0])}))
    tracks = graph.listen(PointCloud2, 'tracks')
    profile = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
    raw = graph.probe.create_publisher(Image, 'image', profile)
    small = graph.probe.create_publisher(CompressedImage, 'image/compressed', profile)
    now[0] = tracker._inputs._heard
    image_stream.play(graph, raw, image_stream.image, tracks, 1)
    graph.wait_for(lambda: tracker._inputs.topics == ['/image'])
    now[0] += image_topics.SILENT_S + 1
    graph.wait_for(lambda: sorted(tracker._inputs.topics) == ['/image', '/image/compressed'])
    image_stream.play(graph, small, image_stream.compressed, tracks, 2, first=1)
    graph.wait_for(lambda: tracker._inputs.topics == ['/image/compressed'])
    # points are followed across
    assert np.isin(tracks_from_message(tracks[-1]).track,
                   tracks_from_message(tracks[0]).track).mean() > 0.5
