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
"""rorapid_tracker as a process: cameras that come late, send otherwise, or send compressed."""

from importlib.util import find_spec

import cv2
from msg_adapters.image import image_message
from msg_adapters.message_types import rclpy_types
from msg_adapters.poses import pose_matrix
from msg_adapters.stamps import header_message
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.report.camera_yaml import write_camera_yaml
from selfcal_ros.rorapid.model import write_model
from selfcal_ros.synthetic.objects import pose_errors, tracked_object
from sensor_msgs.msg import CompressedImage, Image

pytestmark = pytest.mark.ros

VIEWS = 12
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)


@pytest.fixture(scope='module')
def recording():
    """Render a few images of a cube, once."""
    made = tracked_object(VIEWS, 'cube', size=(320, 240), rate_hz=30.0)
    return made, [image for image, _ in made.frames()]


class Station:
    """A tracker that knows all but the images, and who sends them."""

    def __init__(self, graph, launch, folder, recording, *parameters):
        from geometry_msgs.msg import PoseWithCovarianceStamped
        self.graph, (self.made, self.images) = graph, recording
        pose = [*self.made.translations[0], *rotation_vector(self.made.rotations[0])]
        (folder / 'start.pos').write_text(' '.join(map(str, pose)))
        values = {'model': write_model(self.made.model, folder / 'cube.yaml'),
                  'camera_file': write_camera_yaml(folder / 'camera.yaml', self.made.camera,
                                                   'camera'),
                  'start_pose': folder / 'start.pos'}
        words = [word for name, value in values.items() for word in ('-p', f'{name}:={value}')]
        self.poses = graph.listen(PoseWithCovarianceStamped, 'pose')
        self.node = launch('rorapid_tracker', *words, *parameters)
        graph.wait_for(lambda: graph.probe.count_publishers('pose') > 0)

    def message(self, index, compressed=False):
        header = header_message(int(self.made.stamps_ns[index]), 'camera', rclpy_types())
        if not compressed:
            return image_message(self.images[index], header, rclpy_types())
        msg = CompressedImage(header=header, format='mono8; png compressed')
        msg.data.frombytes(cv2.imencode('.png', self.images[index])[1].tobytes())
        return msg

    def track(self, publisher, indices, compressed=False):
        """Send images, each until its pose has come: the first may come before the match."""
        for index in indices:
            message, known = self.message(index, compressed), len(self.poses)
            for _ in range(30):
                publisher.publish(message)
                try:
                    self.graph.wait_for(lambda: len(self.poses) > known, 1.0)
                    break
                except AssertionError:
                    continue
            pose = pose_matrix(self.poses[-1])
            angle, share = pose_errors(pose[:3, :3], pose[:3, 3], self.made.rotations[index],
                                       self.made.translations[index])
            assert self.poses[-1].header == message.header and angle < 0.02 and share < 0.02

    def reliability(self):
        return {info.qos_profile.reliability for info in
                self.graph.probe.get_subscriptions_info_by_topic('image')}


@pytest.fixture
def station(graph, launch, tmp_path, recording):
    def make(*parameters):
        return Station(graph(), launch, tmp_path, recording, *parameters)

    return make


@pytest.mark.long
def test_a_late_best_effort_camera_is_missed_by_name_and_then_tracked_in(station):
    station = station('-p', 'silence_s:=0.5', '-r', 'image:=/cam/image_raw')
    graph, node = station.graph, station.node
    graph.wait_for(lambda: node.has_said('no images on /cam/image_raw or '
                                         '/cam/image_raw/compressed for 0.5 s; no publisher'))
    camera = graph.probe.create_publisher(Image, '/cam/image_raw', BEST_EFFORT)
    graph.wait_for(lambda: node.has_said('1 publisher on /cam/image_raw, best effort (probe)'))
    station.track(camera, range(3))
    graph.wait_for(lambda: node.has_said('images arrive again'))


@pytest.mark.long
def test_publishers_that_come_and_go_are_heard_however_they_send(station):
    station = station()
    reliable = station.graph.probe.create_publisher(Image, 'image', RELIABLE)
    # a reliable subscription loses no image that is larger than the buffers
    station.graph.wait_for(lambda: station.reliability() == {ReliabilityPolicy.RELIABLE})
    station.track(reliable, range(3))
    best_effort = station.graph.probe.create_publisher(Image, 'image', BEST_EFFORT)
    station.graph.wait_for(lambda: station.reliability() == {ReliabilityPolicy.BEST_EFFORT})
    station.track(best_effort, range(3, 6))
    station.graph.probe.destroy_publisher(best_effort)
    station.graph.wait_for(lambda: station.reliability() == {ReliabilityPolicy.RELIABLE})
    station.track(reliable, range(6, 8))


@pytest.mark.long
def test_compressed_images_beside_a_remapped_topic_are_tracked_in(station):
    station = station('-r', 'image:=/cam/image_raw')
    camera = station.graph.probe.create_publisher(
        CompressedImage, '/cam/image_raw/compressed', BEST_EFFORT)
    station.track(camera, range(3), compressed=True)
    assert station.node.has_said('images arrive on /cam/image_raw/compressed')


@pytest.mark.long
def test_the_search_changes_while_an_object_is_tracked(station):
    station = station()
    camera = station.graph.probe.create_publisher(Image, 'image', RELIABLE)
    station.track(camera, range(4))

    def change(**values):
        return station.graph.set_parameters('rorapid_tracker', **values)

    assert change(search_least_px=30.0) == ['search_least_px must not exceed search_most_px.']
    # a person types whole numbers
    assert change(search_most_px=40, least_contrast=6, control_points_per_line=9,
                  texture=False, recovery=False) == [''] * 5
    # it goes on from where the object is: in the image after, no start is needed
    station.track(camera, range(4, 8))
    assert change(model='other.cao') != [''] and change(camera_model='zoom') != ['']
    assert not station.node.has_said('lost') and station.node.process.poll() is None


@pytest.mark.long
@pytest.mark.skipif(find_spec('tf2_msgs') is not None, reason='tf2_msgs is installed')
def test_what_needs_a_package_that_is_missing_is_refused_and_the_node_goes_on(station):
    station = station()
    camera = station.graph.probe.create_publisher(Image, 'image', RELIABLE)
    station.track(camera, range(2))
    refused, = station.graph.set_parameters('rorapid_tracker', publish_tf=True)
    assert refused.startswith('publish_tf needs the package tf2_msgs')
    station.track(camera, range(2, 4))
