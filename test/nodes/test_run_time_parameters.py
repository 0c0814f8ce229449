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
"""Parameters that change while a node runs, set by service as `ros2 param set` does."""

import json
import time

from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import header_message
from msg_adapters.tracks import tracks_from_message, tracks_message
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.estimation_job import JobResult
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.report.camera_yaml import read_camera_yaml, write_camera_yaml
from selfcal_ros.synthetic.special_scenes import drive
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import String
from test_support import image_stream

pytestmark = pytest.mark.ros

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.mark.long
def test_the_tracker_follows_more_points_and_subscribes_as_it_is_told(graph, launch):
    graph = graph()
    tracks = graph.listen(PointCloud2, 'tracks')
    node = launch('feature_tracker', '-p', 'max_features:=30')
    camera = graph.probe.create_publisher(Image, 'image', 10)
    image_stream.play(graph, camera, image_stream.image, tracks, 3)
    few = len(tracks_from_message(tracks[-1]).track)
    assert graph.set_parameters('feature_tracker', max_features=300) == ['']
    image_stream.play(graph, camera, image_stream.image, tracks, 3, first=3)
    more = tracks_from_message(tracks[-1])
    assert few < 40 and len(more.track) > 2 * few
    # what was followed is followed on
    assert np.isin(tracks_from_message(tracks[-4]).track, more.track).mean() > 0.5

    refused, = graph.set_parameters('feature_tracker', max_features=1)
    assert 'range' in refused
    refused, = graph.set_parameters('feature_tracker', image_transport='smoke')
    assert refused == ('The parameter image_transport must be one of auto, raw, compressed, not '
                       "'smoke'.")

    def reliability():
        return {info.qos_profile.reliability
                for info in graph.probe.get_subscriptions_info_by_topic('image')}

    graph.wait_for(lambda: reliability() == {ReliabilityPolicy.RELIABLE})
    assert graph.set_parameters('feature_tracker', reliability='best_effort') == ['']
    graph.wait_for(lambda: reliability() == {ReliabilityPolicy.BEST_EFFORT})
    assert graph.set_parameters('feature_tracker', image_transport='compressed') == ['']
    graph.wait_for(lambda: not reliability())
    assert graph.set_parameters('feature_tracker', image_transport='auto', silence_s=0.5) == [
        '', '']
    graph.wait_for(lambda: node.has_said('1 publisher on /image, reliable (probe)'))
    image_stream.play(graph, camera, image_stream.image, tracks, 2, first=6)


class Calibration:
    """A calibrator in a process of its own, which is sent the tracks of a drive."""

    def __init__(self, graph, launch, *parameters):
        self.graph, self.sent = graph, 0
        sequence = drive(np.random.default_rng(3), 0.1, 30, 200, 12)
        self.camera, tracks = sequence.camera, sequence.tracks
        self.views = [tracks.in_frames([frame]) for frame in tracks.frames]
        self.infos = graph.listen(CameraInfo, 'camera_info', 100)
        self.results = graph.listen(String, 'planar_calibrator/result', LATCHED)
        self.publisher = graph.probe.create_publisher(PointCloud2, 'tracks', 100)
        self.node = launch('planar_calibrator', '-p', 'distortion:=none', '-p',
                           'keyframe_parallax:=0.001', *parameters)
        graph.wait_for(lambda: self.publisher.get_subscription_count()
                       and graph.probe.count_publishers('camera_info')
                       and graph.probe.count_publishers('planar_calibrator/result'))
        graph.spin_for(0.3)

    def send(self, count):
        """Send the next views, each after the last was answered."""
        types = rclpy_types()
        for number in range(self.sent, self.sent + count):
            known, view = len(self.infos), self.views[number]
            header = header_message(10 ** 18 + number * 10 ** 8, 'camera', types)
            self.publisher.publish(tracks_message(view.track, view.xy, (640, 480), header, types))
            self.graph.wait_for(lambda: len(self.infos) > known, what='camera_info')
        self.sent += count

    def next_result(self, action):
        """Do something, and return the result that follows."""
        known = len(self.results)
        action()
        self.graph.wait_for(lambda: len(self.results) > known, 40, 'result')
        return json.loads(self.results[-1].data)


@pytest.mark.long
def test_facts_and_the_file_of_a_calibrator_change_on_the_way(graph, launch, tmp_path):
    drive = Calibration(graph(), launch, '-p', 'idle_s:=600.0', '-p', 'first_estimate:=24')
    first = drive.next_result(lambda: drive.send(24))
    assert first['status'] == 'calibrated' and first['parameters']['skew'] == 'held'

    def change(**values):
        assert drive.graph.set_parameters('planar_calibrator', **values) == [''] * len(values)

    # another fact: an estimate by itself, from what is there
    second = drive.next_result(lambda: change(aspect_ratio_sigma=0.001))
    assert second['facts']['aspect_ratio_sigma'] == 0.001
    assert second['sigma']['fy'] != first['sigma']['fy']
    assert abs(second['camera']['fx'] - drive.camera.K[0, 0]) < 4 * second['sigma']['fx']
    # another file
    path = tmp_path / 'elsewhere' / 'front.yaml'
    change(output=str(path))
    saved = drive.graph.call('planar_calibrator/save')
    assert saved.success and str(path) in saved.message
    assert read_camera_yaml(path)[0].K[0, 0] == second['camera']['fx']
    # views go on to be gathered, as they are told
    change(first_estimate=3, max_keyframes=10, auto_save=True)
    drive.send(4)
    third = drive.next_result(lambda: drive.graph.call('planar_calibrator/calibrate'))
    assert len(third['frames']) <= 10

    refused, = drive.graph.set_parameters('planar_calibrator', first_estimate=11)
    assert refused == 'The first estimate needs 3 to 10 keyframes (max_keyframes), not 11.'
    for name, value in (('camera_name', 'rear'), ('world_frame', 'map')):
        assert drive.graph.set_parameters('planar_calibrator', **{name: value}) != ['']
    assert drive.node.process.poll() is None


@pytest.mark.long
def test_a_player_changes_its_pace_on_the_way(graph, launch, tmp_path):
    frames = [Frame(k, 10 ** 18 + k * 10 ** 9, image_stream.wall(k, 64, 48)) for k in range(21)]
    write_image_bag(tmp_path / 'bag', frames)
    graph = graph()
    images = graph.listen(Image, 'image', 50)
    player = launch('bag_player', '-p', f'bag:={tmp_path / "bag"}', '-p', 'rate:=0.1')
    graph.wait_for(lambda: images)
    began = time.monotonic()
    # an integer, as a person types it
    assert graph.set_parameters('bag_player', rate=20) == ['']
    assert graph.set_parameters('bag_player', bag='another') != ['']
    graph.wait_for(lambda: len(images) == 21, what='end of the bag')
    # ten seconds each before, a twentieth of one now
    assert 0.8 < time.monotonic() - began < 10
    assert player.process.wait(15) == 0


@pytest.mark.long
def test_a_publisher_takes_another_file_and_refuses_one_that_is_none(graph, launch, tmp_path):
    paths = []
    for focal in (500.0, 600.0):
        camera = Camera.from_parameters([focal, focal, 320, 240, 0, 0, 0, 0, 0], 640, 480)
        paths.append(write_camera_yaml(tmp_path / f'{focal:.0f}.yaml', camera, 'camera'))
    graph = graph()
    infos = graph.listen(CameraInfo, 'camera_info')
    launch('camera_info_publisher', '-p', f'camera_info_url:={paths[0]}', '-p', 'source:=image')
    images = graph.probe.create_publisher(Image, 'image', 10)

    def focal(first):
        image_stream.play(graph, images, lambda k: image_stream.image(k, 640, 480), infos, 1,
                          first=first)
        return infos[-1].k[0]

    assert focal(0) == 500
    refused, = graph.set_parameters('camera_info_publisher', camera_info_url='/nowhere.yaml')
    assert '/nowhere.yaml' in refused and focal(1) == 500
    assert graph.set_parameters('camera_info_publisher',
                                camera_info_url=f'file://{paths[1]}') == ['']
    assert focal(2) == 600


#: What no calibrator can do anything with: names of services, and a home that nobody has.
IMPOSSIBLE = {'set_camera_info_service': ('bad name', 'left//camera', '{camera}/set', '1st'),
              'output': ('~nobody_of_this_name/x.yaml',)}


@pytest.mark.long
def test_names_and_paths_that_cannot_be_are_refused_and_the_calibrator_goes_on(graph, launch):
    graph = graph()
    node = launch('planar_calibrator')
    for name, values in IMPOSSIBLE.items():
        for value in values:
            refused, = graph.set_parameters('planar_calibrator', **{name: value})
            assert value in refused and refused.endswith('.') and '\n' not in refused
    # what there was stays, and what can be is taken
    assert graph.call('planar_calibrator/save').message == 'there is no calibration yet'
    for value in ('camera/set_camera_info', '~/mine', '/{node}/set', ''):
        assert graph.set_parameters('planar_calibrator', set_camera_info_service=value) == ['']
    assert node.process.poll() is None


@pytest.mark.long
@pytest.mark.parametrize('module, given', [
    ('planar_calibrator', 'set_camera_info_service:=bad name'),
    ('planar_calibrator', 'output:=~nobody_of_this_name/x.yaml'),
    ('camera_info_publisher', 'camera_info_url:=~nobody_of_this_name/x.yaml')])
def test_names_and_paths_that_cannot_be_are_a_sentence_at_the_start(ended, module, given):
    status, said = ended(module, '-p', given)
    assert status == 2
    assert given.partition(':=')[2] in said and 'Traceback' not in said


@pytest.mark.long
def test_a_publisher_without_a_file_takes_what_does_not_concern_the_file(graph, launch):
    graph = graph()
    # how long the silence has lasted by now is up to the machine
    node = launch('camera_info_publisher', '-p', 'silence_s:=3600.0')
    assert graph.set_parameters('camera_info_publisher', silence_s=0.5) == ['']
    graph.wait_for(lambda: node.has_said(' s; no publisher'))
    refused, = graph.set_parameters('camera_info_publisher', camera_info_url='/nowhere.yaml')
    assert '/nowhere.yaml' in refused


def test_a_publisher_with_a_wrong_file_does_not_speak_of_a_last_calibration(graph, launch,
                                                                            tmp_path):
    (tmp_path / 'report.html').write_text('<!DOCTYPE html>', encoding='utf-8')
    node = launch('camera_info_publisher', '-p', f'camera_info_url:={tmp_path}/report.html')
    graph().wait_for(lambda: node.has_said('K is zero until it can be read.'))
    assert 'report.html is a report, and no camera file' in node.said


class Waiting:
    """A worker that works when it is told to."""

    def __init__(self):
        self.jobs, self.done = [], []

    @property
    def requests(self):
        return [job.request for job in self.jobs]

    def submit(self, job):
        self.jobs.append(job)

    def poll(self):
        return self.done.pop() if self.done else None


def test_who_asks_while_an_estimate_is_dropped_is_told_so_and_gets_the_next(graph):
    graph = graph('-p', 'keyframe_parallax:=0.001', '-p', 'idle_s:=600.0')
    node = graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters, Waiting))
    worker = node._worker

    def calibrate():
        answer = graph.call('planar_calibrator/calibrate')
        return answer.success, answer.message

    assert calibrate() == (False, '0 views with parallax so far, three are needed: keep moving')
    tracks = drive(np.random.default_rng(3), 0.1, 5, 200, 5).tracks
    for number, frame in enumerate(tracks.frames):
        view = tracks.in_frames([frame])
        header = header_message(10 ** 18 + number * 10 ** 8, 'camera', rclpy_types())
        node.announce(header, (640, 480))
        node.take(header, (640, 480), view.track, view.xy)
    assert calibrate()[0] and len(worker.requests) == 1
    assert calibrate() == (False, 'an estimate is under way; its result comes on ~/result')
    assert graph.set_parameters('planar_calibrator', aspect_ratio=0.0) == ['']
    asked, message = calibrate()
    assert not asked and 'is dropped; another follows' in message
    worker.done.append(JobResult(worker.jobs[0], NotCalibrated('of old facts')))
    # too few views for one by itself: it was asked for
    graph.wait_for(lambda: len(worker.requests) == 2, what='the next estimate')
    assert worker.requests[1].settings.facts.aspect_ratio is None
    graph.spin_for(0.2)
    assert len(worker.requests) == 2
