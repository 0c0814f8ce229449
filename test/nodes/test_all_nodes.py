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
"""Nodes that share a process."""

import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from msg_adapters.tracks import tracks_from_message
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from selfcal_ros.cli.demo import read_truth
from selfcal_ros.errors import ArgumentError
from selfcal_ros.nodes.composition import DEFAULT, wanted_nodes
from selfcal_ros.nodes.estimation_job import Job, JobKind
from selfcal_ros.nodes.estimation_process import EstimationProcess
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import String
from test_support import image_stream
from test_support.child_requests import Request

BAG = Path(__file__).resolve().parents[2] / 'bags' / 'agv_drive'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

pytestmark = pytest.mark.ros


def children(pid):
    """List the processes that a process has started and that still run."""
    found = []
    for task in Path(f'/proc/{pid}/task').iterdir():
        found += (task / 'children').read_text(encoding='ascii').split()
    return [int(number) for number in found]


def is_running(pid):
    try:
        state = Path(f'/proc/{pid}/stat').read_text(encoding='ascii').rsplit(')', 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in 'ZX'


def test_each_image_gets_its_tracks_and_before_them_its_camera_info(graph, launch):
    graph = graph()
    order, tracks = [], []

    def on_tracks(msg):
        tracks.append(msg)
        order.append(('tracks', msg))

    graph.probe.create_subscription(CameraInfo, 'camera_info',
                                    lambda msg: order.append(('camera_info', msg)), 10)
    graph.probe.create_subscription(PointCloud2, 'tracks', on_tracks, 10)
    camera = graph.probe.create_publisher(Image, 'image', 5)
    launch('composition')
    image_stream.play(graph, camera, image_stream.image, tracks, 5)
    infos = [msg.header for topic, msg in order if topic == 'camera_info'][-2:]
    assert infos == [msg.header for msg in tracks[-2:]]
    # one after the other through one process: the CameraInfo does not wait for the points
    assert [topic for topic, _ in order[-4:]] == ['camera_info', 'tracks'] * 2
    assert len(tracks_from_message(tracks[-1]).track) > 30
    # images of another size end the session at once
    image_stream.play(graph, camera, lambda frame: image_stream.image(frame, 480, 360), tracks, 1,
                      first=5)
    last = [msg for topic, msg in order if topic == 'camera_info'][-1]
    assert (last.width, last.height) == (480, 360) and not any(last.k)


@pytest.mark.long
def test_the_recorded_drive_through_one_process_gives_the_true_camera(graph, launch, tmp_path):
    graph = graph()
    results = graph.listen(String, 'planar_calibrator/result', LATCHED)
    infos = graph.listen(CameraInfo, 'camera_info', 100)
    node = launch('composition', '-p', f'bag:={BAG}', '-p', 'rate:=3.0',
                  '-p', 'camera_name:=front',
                  before=('bag_player', 'feature_tracker', 'planar_calibrator'))
    graph.wait_for(lambda: node.has_said('played'), 120, 'end of the bag')
    graph.wait_for(lambda: results and json.loads(results[-1].data)['status'] == 'calibrated',
                   180, 'result')
    # nothing ends with the bag: the calibrator still answers
    for _ in range(600):
        if graph.call('planar_calibrator/calibrate').success:
            break
        graph.spin_for(0.1)
    graph.wait_for(lambda: infos and infos[-1].header.frame_id)
    result, truth = json.loads(results[-1].data), read_truth(BAG)
    for name in ('fx', 'cx', 'cy'):
        assert abs(result['camera'][name] - truth[name]) < max(
            4 * result['sigma'][name], 0.002 * truth['fx'])
    stamps = [(info.header.stamp.sec, info.header.stamp.nanosec) for info in infos]
    assert len(set(stamps)) == len(stamps), 'one CameraInfo an image'
    answer = graph.call('planar_calibrator/save')
    assert answer.success and (tmp_path / 'ros_home/camera_info/front.yaml').is_file()


@pytest.mark.long
@pytest.mark.skipif(not Path('/proc/self/stat').exists(), reason="needs Linux's /proc")
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_signal_ends_the_nodes_and_the_child_that_estimates(graph, launch, number):
    graph = graph()
    node = launch('composition')
    graph.wait_for(lambda: graph.probe.count_subscribers('image') > 0, what='tracker')
    started = children(node.process.pid)
    assert started
    if number == signal.SIGINT:
        # as a terminal does: to everybody at once
        os.killpg(node.process.pid, number)
        status = node.end(number)
    else:
        status = node.end(number)
    assert status == (-9 if number == signal.SIGKILL else 0), node.said
    assert 'Traceback' not in node.said
    deadline = time.monotonic() + 10
    while any(map(is_running, started)):
        assert time.monotonic() < deadline, 'a child is left behind'
        time.sleep(0.02)


@pytest.mark.skipif(not Path('/proc/self/stat').exists(), reason="needs Linux's /proc")
def test_a_child_amid_an_estimate_ends_with_the_process_that_is_killed():
    killed = subprocess.Popen(
        [sys.executable, '-c',
         'import time\n'
         'from selfcal_ros.nodes.estimation_job import Job, JobKind\n'
         'from selfcal_ros.nodes.estimation_process import EstimationProcess\n'
         'from test_support.child_requests import Request\n'
         'worker = EstimationProcess()\n'
         'worker.submit(Job(JobKind.ESTIMATE, Request("endless")))\n'
         'while worker.poll() is None:\n'
         '    time.sleep(0.02)'], stdout=subprocess.PIPE, text=True)
    child = int(killed.stdout.readline())
    try:
        killed.kill()
        killed.wait()
        deadline = time.monotonic() + 10
        while is_running(child):
            assert time.monotonic() < deadline, 'it goes on'
            time.sleep(0.02)
    finally:
        if is_running(child):
            os.kill(child, signal.SIGKILL)
        killed.stdout.close()


def test_the_command_line_names_the_nodes():
    assert wanted_nodes(['--ros-args', '-p', 'x:=1']) == DEFAULT
    some = ['bag_player', 'feature_tracker']
    assert wanted_nodes([*some, '--ros-args']) == tuple(some)
    for wrong in (['os'], ['feature_tracker', 'feature_tracker']):
        with pytest.raises(ArgumentError, match='all_nodes takes'):
            wanted_nodes(wrong)


def test_a_wrong_name_is_one_sentence_and_status_2(launch):
    node = launch('composition', before=('tracker',))
    assert node.process.wait(30) == 2
    node._reader.join(5)
    assert node.has_said("not 'tracker'") and 'Traceback' not in node.said


def answer(worker, timeout_s=30):
    deadline = time.monotonic() + timeout_s
    while (done := worker.poll()) is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return done


@pytest.mark.long
def test_the_child_survives_faults_and_is_replaced_when_it_dies(capfd):
    worker = EstimationProcess()
    jobs = [Job(JobKind.ESTIMATE, Request(what)) for what in ('first', 'fault', 'death', 'last',
                                                              'loaded')]
    for job in jobs:
        worker.submit(job)
    said = []
    for job in jobs:
        done = answer(worker, 120)
        assert done.job is job and not done.value and done.prepared is None
        said.append(str(done.value))
    assert 'first from' in said[0] and str(os.getpid()) not in said[0]
    assert 'ValueError: of the program' in said[1]
    assert 'ended unexpectedly' in said[2] and 'last from' in said[3]
    # the first estimate need not wait for its libraries
    assert 'loaded True' in said[4]
    assert worker.poll() is None
    assert 'ValueError' in capfd.readouterr().err


def test_a_large_job_does_not_wait_in_the_caller_until_the_child_has_loaded():
    """A pipe holds 64 kB: the caller, an executor, stood still until the child read the rest."""
    worker = EstimationProcess()
    began = time.monotonic()
    worker.submit(Job(JobKind.ESTIMATE, Request('x' * 10_000_000)))
    submitted = time.monotonic() - began
    while not worker._is_ready:
        assert worker.poll() is None and time.monotonic() - began < 120
        time.sleep(0.01)
    loaded = time.monotonic() - began
    assert submitted < loaded / 4
    assert answer(worker, 120).job.request.what.startswith('xxx')
