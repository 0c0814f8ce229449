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
"""Nodes in processes of their own, seen from outside: what cameras and networks do to them."""

import json
import signal

from msg_adapters.stamps import stamp_ns
from msg_adapters.tracks import tracks_from_message
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.frame_source import Frame
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import String
from test_support import image_stream

pytestmark = pytest.mark.ros

BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SHORT = ('-p', 'silence_s:=0.5')


@pytest.mark.long
def test_a_late_best_effort_camera_is_missed_by_name_and_then_heard(graph, launch):
    graph = graph()
    tracks = graph.listen(PointCloud2, 'tracks')
    node = launch('feature_tracker', *SHORT, '-r', 'image:=/cam/image_raw')
    graph.wait_for(lambda: node.has_said('no images on /cam/image_raw or '
                                         '/cam/image_raw/compressed for 0.5 s; no publisher'))
    camera = graph.probe.create_publisher(Image, '/cam/image_raw', BEST_EFFORT)
    image_stream.play(graph, camera, image_stream.image, tracks, 3)
    graph.wait_for(lambda: node.has_said('images arrive again'))
    assert tracks_from_message(tracks[-1]).image_size == (320, 240)


@pytest.mark.long
def test_publishers_that_come_and_go_are_heard_however_they_send(graph, launch):
    graph = graph()
    tracks = graph.listen(PointCloud2, 'tracks')
    launch('feature_tracker')
    made, reliabilities = [], []
    # reliable where everybody is, best effort as soon as one is not
    for number, profile in enumerate((RELIABLE, BEST_EFFORT)):
        made.append(graph.probe.create_publisher(Image, 'image', profile))
        image_stream.play(graph, made[-1], image_stream.image, tracks, 3, first=3 * number)
        reliabilities.append({info.qos_profile.reliability for info in
                              graph.probe.get_subscriptions_info_by_topic('image')})
    assert reliabilities == [{ReliabilityPolicy.RELIABLE}, {ReliabilityPolicy.BEST_EFFORT}]
    graph.probe.destroy_publisher(made.pop())
    graph.wait_for(lambda: {ReliabilityPolicy.RELIABLE} == {
        info.qos_profile.reliability for info in
        graph.probe.get_subscriptions_info_by_topic('image')})
    image_stream.play(graph, made[0], image_stream.image, tracks, 2, first=6)


def test_silence_names_the_publisher_and_how_it_sends(graph, launch):
    graph = graph()
    graph.listen(PointCloud2, 'tracks')
    graph.probe.create_publisher(Image, '/cam/image_raw', BEST_EFFORT)
    node = launch('feature_tracker', *SHORT, '-p', 'image_transport:=raw', '-r',
                  'image:=/cam/image_raw')
    # at first it may not know of the publisher; then the silence has lasted longer
    graph.wait_for(lambda: node.has_said(' s; 1 publisher, best effort (probe)'), what='warning')
    assert node.has_said('no images on /cam/image_raw for ')


@pytest.mark.long
def test_silence_says_when_the_type_is_another(graph, launch):
    graph = graph()
    graph.listen(PointCloud2, 'tracks')
    graph.probe.create_publisher(CompressedImage, 'image', RELIABLE)
    node = launch('feature_tracker', *SHORT, '-p', 'image_transport:=raw')
    graph.wait_for(lambda: node.has_said(
        '1 publisher, reliable (probe), of type sensor_msgs/msg/CompressedImage where '
        'sensor_msgs/msg/Image is read'), what='warning')


@pytest.mark.long
def test_silence_names_the_topic_that_may_be_meant(graph, launch):
    graph = graph()
    graph.probe.create_publisher(PointCloud2, '/left/tracks', RELIABLE)
    node = launch('planar_calibrator', *SHORT)
    # at first it may not know of the publisher; then there is something new to say
    graph.wait_for(lambda: node.has_said('no publisher; tracks may be meant on /left/tracks: '
                                         'remap the input'), what='warning')
    assert node.has_said('no tracks on /tracks for ')


def test_a_tracker_that_waits_for_a_listener_says_so(graph, launch):
    graph = graph()
    node = launch('feature_tracker')
    graph.wait_for(lambda: node.has_said('once somebody subscribes to /tracks'))


@pytest.mark.long
def test_compressed_images_beside_a_remapped_topic_are_found(graph, launch):
    graph = graph()
    tracks = graph.listen(PointCloud2, 'tracks')
    node = launch('feature_tracker', '-r', 'image:=/cam/image_raw')
    camera = graph.probe.create_publisher(CompressedImage, '/cam/image_raw/compressed',
                                          BEST_EFFORT)
    image_stream.play(graph, camera, image_stream.compressed, tracks, 3)
    graph.wait_for(lambda: node.has_said('images arrive on /cam/image_raw/compressed'))


@pytest.mark.long
def test_images_that_change_size_midway_start_tracks_and_session_anew(graph, launch):
    graph = graph()
    tracks, results = graph.listen(PointCloud2, 'tracks'), graph.listen(
        String, 'planar_calibrator/result', LATCHED)
    infos = graph.listen(CameraInfo, 'camera_info')
    camera = graph.probe.create_publisher(Image, 'image', BEST_EFFORT)
    nodes = [launch('feature_tracker'), launch('planar_calibrator')]
    image_stream.play(graph, camera, image_stream.image, infos, 4)
    before = tracks_from_message(tracks[-1])

    def larger(frame):
        return image_stream.image(frame, 480, 360)

    image_stream.play(graph, camera, larger, infos, 3, first=4)
    after = tracks_from_message(tracks[-1])
    assert before.image_size == (320, 240) and after.image_size == (480, 360)
    assert len(after.track) > 30 and not np.intersect1d(before.track, after.track).size
    assert (infos[-1].width, infos[-1].height) == (480, 360)
    graph.wait_for(lambda: results, what='result')
    assert 'changed size from 320x240 to 480x360' in json.loads(results[-1].data)['reason']
    assert all(node.process.poll() is None for node in nodes)


@pytest.mark.long
def test_a_bag_in_a_loop_with_its_own_time_starts_anew_each_time(graph, launch, tmp_path):
    start_ns, step_ns = 1_700_000_000_000_000_000, 100_000_000
    write_image_bag(tmp_path / 'bag', [Frame(k, start_ns + k * step_ns, image_stream.wall(k),
                                             'camera_optical_frame') for k in range(6)])
    graph = graph()
    infos, results = graph.listen(CameraInfo, 'camera_info', 100), graph.listen(
        String, 'planar_calibrator/result', LATCHED)
    clock = graph.listen(Clock, '/clock', 100)
    sim_time = ('-p', 'use_sim_time:=true')
    launch('planar_calibrator', *sim_time)
    tracker = launch('feature_tracker', *sim_time)
    launch('bag_player', '-p', f'bag:={tmp_path / "bag"}', '-p', 'rate:=5.0', '-p', 'loop:=true')
    graph.wait_for(lambda: len(infos) > 13 and results, 40, 'two rounds')
    stamps = [stamp_ns(info.header.stamp) for info in infos]
    assert set(stamps) <= {start_ns + k * step_ns for k in range(6)}
    assert sum(a > b for a, b in zip(stamps, stamps[1:])) >= 1
    assert 'jumped back' in json.loads(results[-1].data)['reason']
    graph.wait_for(lambda: tracker.has_said('time jumped back; tracking starts anew'))
    # the player waits for who listens to its images, not for a reader of its clock
    graph.wait_for(lambda: clock, what='the clock of the bag, which plays on')
    assert min(stamp_ns(c.clock) for c in clock) >= start_ns


def test_silence_is_noticed_although_the_clock_of_a_bag_stands_still(graph, launch):
    graph = graph()
    graph.listen(PointCloud2, 'tracks')
    node = launch('feature_tracker', *SHORT, '-p', 'use_sim_time:=true')
    graph.wait_for(lambda: node.has_said('no images on /image'), what='warning')


@pytest.mark.long
def test_two_cameras_in_two_namespaces_keep_apart(graph, launch, tmp_path):
    graph = graph()
    sides = {}
    for side, width in (('left', 320), ('right', 256)):
        launch('feature_tracker', '-r', f'__ns:=/{side}')
        launch('planar_calibrator', '-r', f'__ns:=/{side}', '-p', f'camera_name:={side}')
        infos = graph.listen(CameraInfo, f'/{side}/camera_info')
        camera = graph.probe.create_publisher(Image, f'/{side}/image', BEST_EFFORT)
        sides[side] = (camera, infos, width)
    for side, (camera, infos, width) in sides.items():
        image_stream.play(graph, camera, lambda frame: image_stream.image(
            frame, width, frame_id=f'{side}_optical_frame'), infos, 3)
    for side, (_, infos, width) in sides.items():
        assert {info.header.frame_id for info in infos} == {f'{side}_optical_frame'}
        assert {info.width for info in infos} == {width}
        assert not graph.call(f'/{side}/planar_calibrator/save').success
    names = {name for name, _ in graph.probe.get_topic_names_and_types()}
    assert not {'/tracks', '/camera_info', '/image'} & names


@pytest.mark.long
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_the_middle_of_images_ends_the_tracker_cleanly(graph, launch, number):
    graph = graph()
    tracks = graph.listen(PointCloud2, 'tracks')
    camera = graph.probe.create_publisher(Image, 'image', BEST_EFFORT)
    node = launch('feature_tracker')
    image_stream.play(graph, camera, image_stream.image, tracks, 2)
    camera.publish(image_stream.image(2))
    assert node.end(number) == 0
    assert 'Traceback' not in node.said
