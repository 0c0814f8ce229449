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
"""An image has one CameraInfo, as early as it can be, whatever comes first or not at all."""

from msg_adapters.camera_info import camera_info_message
from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import header_message
from msg_adapters.tracks import tracks_message
import numpy as np
import pytest
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from test_support import image_stream

pytestmark = pytest.mark.ros
TYPES = rclpy_types()
SIZE = (640, 480)


class Images:
    """Sends what a tracker sends of images to a calibrator, and hears its answers."""

    def __init__(self, graph):
        self.graph = graph
        node = graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters))
        self.infos = graph.listen(CameraInfo, 'camera_info')
        self.tracks = graph.probe.create_publisher(PointCloud2, 'tracks', 60)
        self.announced = graph.probe.create_publisher(CameraInfo, 'tracks/announced', 60)
        graph.wait_for(lambda: self.tracks.get_subscription_count()
                       and self.announced.get_subscription_count()
                       and graph.probe.count_publishers('camera_info'))
        graph.meet(node)
        # the size of the images is known from their first tracks
        self.follow(1)
        self.is_heard(1)

    def announce(self, stamp, size=SIZE):
        self.announced.publish(camera_info_message(
            None, header_message(stamp, 'camera', TYPES), TYPES, size))

    def follow(self, stamp, size=SIZE):
        xy = np.random.default_rng(stamp).uniform(20, 400, (50, 2))
        self.tracks.publish(tracks_message(
            np.arange(50), xy, size, header_message(stamp, 'camera', TYPES), TYPES))

    def is_heard(self, count):
        """Wait for so many CameraInfo in all, and see that no more come."""
        self.graph.wait_for(lambda: len(self.infos) >= count)
        self.graph.spin_for(0.2)
        assert len(self.infos) == count


@pytest.mark.long
def test_a_camera_info_does_not_wait_for_tracks_and_comes_once(graph):
    images = Images(graph('-p', 'begin_with_file:=false'))
    images.announce(1000)
    images.is_heard(2)
    assert images.infos[-1].header.stamp.nanosec == 1000
    assert images.infos[-1].header.frame_id == 'camera'
    images.follow(1000)
    images.is_heard(2)
    # who does not announce, or whose announcement is overtaken, is answered all the same
    images.follow(2000)
    images.is_heard(3)
    images.announce(2000)
    images.is_heard(3)


def test_images_without_a_clock_have_a_camera_info_each(graph):
    images = Images(graph('-p', 'begin_with_file:=false'))
    for k in range(3):
        images.announce(0)
        images.is_heard(2 + k)
        images.follow(0)
        images.is_heard(2 + k)


def test_an_image_of_another_size_waits_for_its_tracks(graph):
    images = Images(graph('-p', 'begin_with_file:=false'))
    images.announce(1000, (320, 240))
    images.is_heard(1)
    images.follow(1000, (320, 240))
    images.is_heard(2)
    assert (images.infos[-1].width, images.infos[-1].height) == (320, 240)
    images.announce(2000, (320, 240))
    images.is_heard(3)


@pytest.mark.long
def test_of_two_processes_each_image_has_one_camera_info(graph, launch):
    graph = graph()
    infos, tracks = graph.listen(CameraInfo, 'camera_info'), graph.listen(PointCloud2, 'tracks')
    camera = graph.probe.create_publisher(Image, 'image', 5)
    launch('feature_tracker')
    launch('planar_calibrator', '-p', 'begin_with_file:=false')
    graph.wait_for(lambda: graph.probe.count_subscribers('tracks/announced') > 0
                   and graph.probe.count_publishers('camera_info') > 0, 60)
    # from here on everybody knows of everybody
    image_stream.play(graph, camera, image_stream.image, infos, 1)
    graph.spin_for(0.3)
    infos.clear()
    tracks.clear()
    image_stream.play(graph, camera, image_stream.image, tracks, 8, first=1)

    def stamps(messages):
        return [(msg.header.stamp.sec, msg.header.stamp.nanosec) for msg in messages]

    graph.wait_for(lambda: infos and stamps(infos)[-1] == stamps(tracks)[-1])
    graph.spin_for(0.2)
    assert stamps(infos) == stamps(tracks) and len(infos) >= 8
