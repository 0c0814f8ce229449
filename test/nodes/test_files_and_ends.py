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
"""A calibration file is found under every name that drivers use, and begins the next run."""

from dataclasses import replace
import fcntl
from logging import getLogger
import os
from pathlib import Path
import time

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.task import Future
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.calibration_file import CalibrationFile
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.entry_point import spin_until
from selfcal_ros.nodes.file_url import path_of
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from selfcal_ros.nodes.quality_of_service import STEADY
from selfcal_ros.nodes.shared_memory import sweep
from selfcal_ros.nodes.stored_camera import StoredCamera
from selfcal_ros.report.camera_uncertainty import uncertainty_comment
from selfcal_ros.report.camera_yaml import write_camera_yaml
from selfcal_ros.synthetic.special_scenes import drive
from sensor_msgs.msg import CameraInfo, PointCloud2
from test_support.diagnostics_table import not_written


@pytest.mark.parametrize('url, path', [
    ('file:///data/${NAME}.yaml', '/data/front.yaml'),
    ('FILE:///data/a b.yaml', '/data/a b.yaml'),
    ('file://${ROS_HOME}/camera_info/${NAME}.yaml', '/ros/camera_info/front.yaml'),
    ('${ROS_HOME}/x.yaml', '/ros/x.yaml'),
    ('~/x.yaml', '/home/u/x.yaml'), ('x.yaml', 'x.yaml'),
    ('package://my_robot/calibrations/${NAME}.yaml',
     '{prefix}/share/my_robot/calibrations/front.yaml')])
def test_urls_are_read_as_camera_info_manager_does(monkeypatch, tmp_path, url, path):
    index = tmp_path / 'share' / 'ament_index' / 'resource_index' / 'packages'
    index.mkdir(parents=True)
    (index / 'my_robot').touch()
    (tmp_path / 'share' / 'my_robot').mkdir()
    for name, value in (('ROS_HOME', '/ros'), ('HOME', '/home/u'),
                        ('AMENT_PREFIX_PATH', str(tmp_path))):
        monkeypatch.setenv(name, value)
    assert path_of(url, 'front') == Path(path.replace('{prefix}', str(tmp_path)))
    monkeypatch.delenv('ROS_HOME')
    assert CalibrationFile('front').path == Path('/home/u/.ros/camera_info/front.yaml')


@pytest.mark.parametrize('url, words', [
    ('package://no_such_package_here/x.yaml', "no package 'no_such_package_here'"),
    ('package:x.yaml', 'package://PACKAGE/PATH'), ('package://x', 'package://PACKAGE/PATH'),
    ('file://host/x.yaml', 'three slashes'), ('flash:///x', 'a path, file:///PATH or package'),
    ('https://example.org/x.yaml', 'a path, file'), ('${HOME}/x.yaml', 'no ${HOME}')])
def test_urls_of_other_kinds_are_refused_and_no_folder_is_made(monkeypatch, tmp_path, url, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError) as refused:
        CalibrationFile('front', url)
    assert words in str(refused.value) and str(refused.value).endswith('.')
    assert not list(tmp_path.iterdir())


def test_a_place_where_no_file_can_be_is_refused_before_the_drive(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path('folder').mkdir()
    Path('file').touch()
    for place, words in (('folder', 'folder is a folder; give the name of a file in it.'),
                         ('file/x/front.yaml', 'file is not a folder; name another file.')):
        with pytest.raises(InputError) as refused:
            CalibrationFile('front', str(tmp_path / place))
        assert str(refused.value).endswith(words)
        with pytest.raises(InputError):
            CalibrationFile('front', place)
    assert CalibrationFile('front', 'folder/new/front.yaml').path == Path('folder/new/front.yaml')


@pytest.mark.long
def test_a_calibrator_begins_with_its_own_file_until_it_is_reset(graph, tmp_path):
    path = tmp_path / 'front.yaml'
    camera = Camera.from_parameters([500, 500, 320, 240, 0, 0, 0, 0, 0], 640, 480)
    write_camera_yaml(path, camera, 'front')
    graph = graph('-p', 'camera_name:=front', '-p', f'output:={path}')
    node = graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters))
    infos = graph.listen(CameraInfo, 'camera_info')
    statuses = graph.listen(DiagnosticArray, '/diagnostics')
    tracks = graph.probe.create_publisher(PointCloud2, 'tracks', 10)

    def told():
        """Return the next diagnostic status."""
        known = len(statuses)
        graph.wait_for(lambda: len(statuses) > known)
        status = statuses[-1].status[0]
        return status.message, {one.key: one.value for one in status.values}

    def focal(size):
        node._size = size
        known = len(infos)
        tracks.publish(PointCloud2())
        graph.wait_for(lambda: len(infos) > known)
        return infos[-1].k[0]

    graph.wait_for(lambda: tracks.get_subscription_count() and infos is not None)
    assert focal((640, 480)) == 500
    # it is no calibration of images of another size
    assert focal((320, 240)) == 0 and 'in force' not in told()[0]
    assert focal((640, 480)) == 500
    message, values = told()
    assert f'the calibration of {path} is in force' in message
    assert values['calibration file'] == str(path) and values['file fx'] == '500'
    assert not not_written(values)
    # another program's file tells no sigma, and nothing was estimated or saved by this run
    assert not {'file fx sigma', 'fx', 'fx sigma', 'saved', 'saved at'} & set(values)
    answer = graph.call('planar_calibrator/save')
    assert not answer.success and answer.message == (
        'there is no calibration yet; the file of an earlier run stays as it is')
    assert graph.call('planar_calibrator/reset').success
    assert focal((640, 480)) == 0 and 'file fx' not in told()[1]


def test_a_stored_calibration_brings_its_sigmas(tmp_path):
    path = tmp_path / 'front.yaml'
    camera = Camera.from_parameters([500, 501, 320, 240, 0, 0, 0, 0, 0], 640, 480)
    sigma = np.arange(1.0, 1 + len(camera.parameters)) / 10
    write_camera_yaml(path, camera, 'front', uncertainty_comment(camera, np.diag(sigma ** 2)))
    stored = StoredCamera(CalibrationFile('front', str(path)), getLogger('test'))
    values = stored.values()
    assert not not_written(values)
    names = camera.parameter_names
    np.testing.assert_allclose([values[f'file {name} sigma'] for name in names], sigma)
    np.testing.assert_allclose([values[f'file {name}'] for name in names], camera.parameters)
    # somebody has changed the numbers: the sigmas are those of others
    path.write_text('\n'.join(line if line.startswith('#') else line.replace('501', '502')
                              for line in path.read_text().splitlines()))
    values = StoredCamera(CalibrationFile('front', str(path)), getLogger('test')).values()
    assert values['file fx'] == 500 and 'file fx sigma' not in values


def test_an_estimate_that_brings_nothing_new_counts_as_saved(tmp_path):
    file = CalibrationFile('front', str(tmp_path / 'front.yaml'))
    tracks = drive(np.random.default_rng(11), noise_px=0.1, views=12, tracks=300).tracks
    first = calibrate(tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none'))
    assert first and 'saved at' not in file.values(first)
    file.write(first)
    assert file.values(first)['saved'] and not file.values(None)['saved']

    def moved(sigmas, share=1.0):
        parameters = first.camera.parameters.copy()
        parameters[2] += sigmas * first.sigma['cx']
        return replace(first, camera=Camera.from_parameters(parameters, 640, 480),
                       covariance=first.covariance * share ** 2)

    assert file.values(moved(0.05))['saved']
    assert not file.values(moved(0.5))['saved'], 'other numbers'
    assert not file.values(moved(0.0, 0.5))['saved'], 'better known'


def test_a_node_that_waits_for_its_end_does_not_grow_while_it_waits(graph):
    graph, added, ticks = graph(), [], []

    class Finished(Future):
        def add_done_callback(self, callback):
            added.append(callback)
            super().add_done_callback(callback)

    node, finished = Node('player'), Finished()

    def tick():
        ticks.append(1)
        if len(ticks) == 50:
            finished.set_result(True)

    graph.add(node).create_timer(0.001, tick, clock=STEADY)
    spin_until(graph.executor, finished)
    assert len(ticks) == 50 and len(added) == 1


def test_shared_memory_of_processes_that_are_no_more_is_freed(tmp_path):
    names = [f'fastrtps_{k:016x}' for k in range(3)]
    for name in (*names, 'fastrtps_port7661', 'another'):
        for file in (tmp_path / name, tmp_path / f'{name}_el'):
            file.touch()
            os.utime(file, (time.time() - 100, time.time() - 100))
    # the first lives, the second has just begun, the third was killed
    os.utime(tmp_path / f'{names[1]}_el')
    with (tmp_path / f'{names[0]}_el').open('rb') as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert sweep(tmp_path) == 1
    left = {file.name.removesuffix('_el') for file in tmp_path.iterdir()}
    assert left == {*names[:2], 'fastrtps_port7661', 'another'}
    assert sweep(tmp_path / 'none') == 0
