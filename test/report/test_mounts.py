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
"""The mount of a camera: told in JSON and words, drawn, in files of others, and compared."""

from dataclasses import replace
import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from selfcal_ros.calibration.mount import Mount, mount_rotation, NAMES
from selfcal_ros.calibration.structure.camera_path import camera_path
from selfcal_ros.calibration.structure.metric_structure import metric_structure
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.report import figures
from selfcal_ros.report.figures import draw_tables
from selfcal_ros.report.mounts.comparison import compare_mounts, PlacedCamera
from selfcal_ros.report.mounts.figure import mount_figure, mount_table
from selfcal_ros.report.mounts.transform_files import (FORMATS, kind_of_name, stored_mount,
                                                       write_transform)
from selfcal_ros.report.mounts.transform_reading import is_transform_file, read_transform
from selfcal_ros.report.mounts.words import mount_lines
from selfcal_ros.report.page import page_html
from selfcal_ros.report.pose_course import pose_course
from selfcal_ros.report.result_json import result_from_dict, result_to_json
from selfcal_ros.report.scene_files.pose_files import euroc_text, tum_text
from test_support.command_line import selfcal
from test_support.result_schema import problems

SIGMA = {'x': 1e-3, 'y': 2e-3, 'z': 4e-3, 'roll': 2e-4, 'pitch': 3e-4, 'yaw': 1e-4,
         'scale': 1e-3, 'time_offset': 0.0}
SCHEMA = json.loads((Path(__file__).resolve().parents[2] / 'docs' / 'result.schema.json')
                    .read_text(encoding='utf-8'))


def mount(is_open=(), **angles):
    """Return a mount; some of its degrees of freedom may be open."""
    turns = {'roll': 0.02, 'pitch': 0.3, 'yaw': -0.4} | angles
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = mount_rotation(**turns), (0.25, -0.1, 0.6)
    status = {name: 'estimated' for name in NAMES} | {'time_offset': 'held'}
    variance = np.array([SIGMA[name]**2 for name in NAMES])
    for name in is_open:
        status[name] = 'unobservable'
        variance[NAMES.index(name)] = np.inf
        pose['xyz'.index(name), 3] = np.nan
    return Mount('base_link', pose, np.diag(variance), status, 0.4, 0.0,
                 {name: 'State it.' for name in is_open}, 60, 2, 0.01, 0.001)


def placed(calibration, *is_open):
    return replace(calibration, mount=mount(is_open))


@pytest.mark.parametrize('is_open', [(), ('z',)])
def test_a_mount_comes_back_from_json(calibration, is_open):
    result = placed(calibration, *is_open)
    stored = json.loads(result_to_json(result))
    assert problems(stored, SCHEMA) == []
    told = stored['mount']
    assert told['status']['z'] == ('unobservable' if is_open else 'estimated')
    assert (told['T_body_camera'][2][3] is None) == (told['sigma']['z'] is None) == bool(is_open)
    assert told['sigma']['x'] == pytest.approx(1e-3) and told['angles']['yaw'] == -0.4
    back = result_from_dict(stored).mount
    assert np.allclose(back.T_body_camera, result.mount.T_body_camera, equal_nan=True)
    assert (back.covariance == result.mount.covariance).all()
    assert replace(back, T_body_camera=0, covariance=0) == replace(
        result.mount, T_body_camera=0, covariance=0)


def test_a_refusal_comes_back_from_json_and_has_no_number(calibration):
    refusal = NoEstimate('note', text='The wheels stood still.')
    stored = json.loads(result_to_json(replace(calibration, mount=refusal)))
    assert problems(stored, SCHEMA) == []
    assert set(stored['mount']['status'].values()) == {'unobservable'}
    assert stored['mount']['T_body_camera'] is None
    assert result_from_dict(stored).mount == refusal


def test_words_say_what_is_known_and_what_would_help(calibration):
    text = '\n'.join(mount_lines(placed(calibration, 'z')))
    assert 'leaves z open' in text and 'unobservable: State it.' in text
    assert '17.189' in text and '60 poses of the robot (2 set aside)' in text
    assert '0.6' not in text and '1.0e-03' not in text and '0.2500 ±    0.0010 m' in text
    assert 'by the stated time offset' in '\n'.join(
        mount_lines(placed(calibration), frozenset({'time_offset'})))
    refused = replace(calibration, mount=NoEstimate('note', text='The wheels stood still.'))
    assert mount_lines(refused)[-1].endswith('not known: The wheels stood still. Read it.')
    assert mount_lines(calibration) == []


@pytest.mark.parametrize('pitch, words', [
    (-1.4, 'their sum is -34.38 ± 0.12°'), (1.4, 'difference (yaw less roll) is -11.46 ± 0.12°'),
    (-1.2, '')])
def test_roll_and_yaw_are_told_together_where_each_is_hardly_known(calibration, pitch, words):
    steep = mount(roll=-0.2, pitch=pitch)
    steep.covariance[5, 5] = np.radians(0.12)**2
    text = '\n'.join(mount_lines(replace(calibration, mount=steep)))
    assert (words in text) if words else 'roll and yaw do' not in text


def test_the_last_column_of_the_table_is_there_when_it_says_something(calibration):
    table = mount_table(placed(calibration, 'z'))
    assert table.columns[-1].startswith('by, or') and table.rows[2][-1] == 'State it.'
    assert set(table.words) == {3, 4}
    known = replace(mount(), status={name: 'estimated' for name in NAMES})
    assert mount_table(replace(calibration, mount=known)).columns[-1] == 'where from'


def test_path_and_structure_are_in_metres(calibration, sequence):
    steps, metres = camera_path(calibration), camera_path(placed(calibration))
    assert (steps.unit, metres.unit) == ('step', 'm')
    assert np.allclose(metres.centre, 0.4 * steps.centre)
    assert (metres.rotation == steps.rotation).all()
    before = metric_structure(calibration, sequence.tracks)
    after = metric_structure(placed(calibration), sequence.tracks)
    assert np.allclose(after.points, 0.4 * before.points)
    assert np.allclose(after.covariance, 0.16 * before.covariance)
    assert np.allclose(after.centres, metres.centre)
    assert 'metre, by the poses of the robot' in tum_text(metres, None)
    assert 'p_RS_R_x [m]' in euroc_text(metres, None)
    assert pose_course(placed(calibration)).in_metres
    # a mount without scale leaves the path as the images know it
    lone = replace(mount(), scale=np.nan)
    assert camera_path(replace(calibration, mount=lone)).unit == 'step'


def test_the_page_shows_camera_and_robot(calibration, monkeypatch):
    result = placed(calibration, 'z')
    # the other figures take their time, and have tests of their own
    monkeypatch.setattr(figures, 'draw_figures', lambda result, _: [mount_figure(result)])
    html = page_html(result, 'text')
    assert 'id="robot"' in html and 'The camera on base_link' in html and 'State it.' in html
    drawing = mount_figure(result)
    assert len(drawing.panels) == 2 and '100 times' not in drawing.caption
    # the camera stands where it stands, its height at the dotted line
    above, aside = (panel.axes[0] for panel in drawing.panels)
    dots = [next(line for line in axes.lines if line.get_label() == 'camera').get_xydata()[0]
            for axes in (above, aside)]
    assert np.allclose(dots, [(0.25, -0.1), (0.25, 0.0)])
    table = next(one for one in draw_tables(result) if one.section == 'robot')
    assert len(table.rows) == 8
    monkeypatch.setattr(figures, 'draw_figures', lambda *_: [])
    refused = replace(calibration, mount=NoEstimate('note', text='The wheels stood still.'))
    assert 'The wheels stood still.' in page_html(refused, 'text')
    assert 'id="robot"' not in page_html(calibration, 'text')


@pytest.mark.parametrize('kind, name', [('urdf', 'a.urdf'), ('tf', 'a.yaml'),
                                        ('moveit', 'a.launch.py'), ('easy_handeye2', 'a.calib'),
                                        ('easy_handeye', 'a.yaml')])
@pytest.mark.parametrize('pitch', [0.3, np.pi / 2, -1.0])
def test_a_transform_comes_back_from_every_file(tmp_path, kind, name, pitch):
    stored = stored_mount(mount(pitch=pitch), 'cam/optical_frame', 'of a -- test')
    path = write_transform(tmp_path / name, stored, kind)
    assert is_transform_file(path)
    found, back = read_transform(path)
    assert (found, back.parent, back.child) == (kind, 'base_link', 'cam/optical_frame')
    assert np.allclose(back.matrix, stored.matrix, atol=1e-9)
    if kind == 'urdf':
        # x y z and rpy about fixed axes, as urdfdom reads them
        origin = ElementTree.parse(path).find('joint/origin')
        rpy = [float(one) for one in origin.get('rpy').split()]
        assert np.allclose(Rotation.from_euler('xyz', rpy).as_matrix(), stored.matrix[:3, :3])
    if kind == 'moveit':
        compile(path.read_text(encoding='utf-8'), str(path), 'exec')


def test_two_transforms_of_a_launch_file_are_not_mixed(tmp_path):
    stored = stored_mount(mount(), 'camera_optical_frame')
    path = write_transform(tmp_path / 'camera.launch.py', stored)
    text = path.read_text('utf-8')
    laser = ("Node(package='tf2_ros', arguments=['--z', '0.9', '--frame-id', 'base_link', "
             "'--child-frame-id', 'laser']),\n")

    def with_laser(text):
        begin = text.index('Node(')
        beside = tmp_path / 'two.launch.py'
        beside.write_text(text[:begin] + laser + text[begin:], 'utf-8')
        return beside

    _, back = read_transform(with_laser(text))
    assert (back.parent, back.child) == ('base_link', 'camera_optical_frame')
    assert np.allclose(back.matrix, stored.matrix, atol=1e-9)
    with pytest.raises(InputError, match='2 static transforms, 0 of them to an optical frame'):
        read_transform(with_laser(text.replace('camera_optical_frame', 'camera')))


@pytest.mark.parametrize('name', ['b.urdf', 'b.yaml', 'b.launch.py', 'b.calib'])
def test_what_a_file_says_of_itself_stays_through_others(tmp_path, name):
    about = ('selfcal_ros 1: a "bag" & 90 images', 'one sigma: x 0.001 m')
    stored = replace(stored_mount(mount(), 'camera'), about=about)
    path = write_transform(tmp_path / name, stored)
    text = path.read_text('utf-8')
    lines = text.replace("'bag'", '"bag"').splitlines()
    assert all(any(line in one for one in lines) for line in about)
    assert not any(about[0] in one and about[1] in one for one in lines)
    _, back = read_transform(path)
    again = write_transform(tmp_path / 'again.calib', back).read_text('utf-8')
    assert [line.replace("'", '"') for line in again.splitlines()[:2]] == [
        f'# {line}' for line in about]
    assert again.splitlines()[2] == 'parameters:'
    # nothing to say is no comment, and nothing gets out of one
    silent = write_transform(path, replace(stored, about=())).read_text('utf-8')
    assert '<!--  -->' not in silent and '# \n' not in silent and 'robot. ' not in silent
    hostile = replace(stored, about=('""" --> \\',))
    assert np.allclose(read_transform(write_transform(path, hostile))[1].matrix, stored.matrix)
    if name.endswith('.py'):
        compile(path.read_text('utf-8'), name, 'exec')


def test_what_is_open_is_written_nowhere(tmp_path):
    with pytest.raises(ArgumentError, match='z of the mount is not observable.*--mount-fact z='):
        stored_mount(mount(['z']), 'camera')
    with pytest.raises(ArgumentError, match='x, y and z of the mount are not .* or state each: '):
        stored_mount(mount(['x', 'y', 'z']), 'camera')
    with pytest.raises(ArgumentError, match='.urdf, .yaml'):
        kind_of_name(tmp_path / 'mount.xyz')
    broken = tmp_path / 'a.calib'
    broken.write_text('parameters: {robot_effector_frame: a}\n', encoding='utf-8')
    with pytest.raises(InputError, match='easy_handeye2'):
        read_transform(broken)
    with pytest.raises(ArgumentError, match='no name of a frame'):
        write_transform(tmp_path / 'b.urdf', stored_mount(mount(), '<camera>'))
    assert set(FORMATS) == {'urdf', 'tf', 'moveit', 'easy_handeye2', 'easy_handeye'}


def test_mounts_are_compared_in_millimetres_degrees_and_sigmas():
    moved = mount(yaw=-0.4 + np.radians(0.5))
    pose = moved.T_body_camera.copy()
    pose[0, 3] += 0.004
    found = compare_mounts(PlacedCamera.of(mount()),
                           PlacedCamera.of(replace(moved, T_body_camera=pose)))
    assert found.difference['x'] == pytest.approx(0.004)
    assert found.difference['yaw'] == pytest.approx(np.radians(0.5))
    assert found.sigma['x'] == pytest.approx(np.sqrt(2) * 1e-3)
    assert np.degrees(found.angle_rad) == pytest.approx(0.5)
    assert found.joint_sigmas > 30
    same = compare_mounts(PlacedCamera.of(mount()), PlacedCamera.of(mount(['z'])))
    assert 'z' not in same.difference and same.joint_sigmas == 0
    assert np.isnan(same.distance_m) and '0.000 degrees apart' in same.verdict
    assert same.sentences()[-1] == 'The place is not compared in full: z is open in B.'
    assert ': 0.0 sigmas, all degrees of freedom that both know together.' in same.verdict
    # a unit stands beside its number, and nothing is minus zero
    rows = {row[:7].strip(): row[7:].split() for row in found.sentences()[1:7]}
    assert rows['x'] == ['+4.000', 'mm', '1.41', 'mm', '2.8']
    assert rows['z'] == ['+0.000', 'mm', '5.66', 'mm', '0.0']
    assert rows['about z'] == ['+0.500', '°', '0.0081', '°', '61.7']
    assert '-0.0' not in '\n'.join(same.sentences())
    # of other bodies the numbers say nothing
    tool = compare_mounts(PlacedCamera.of(mount()), replace(PlacedCamera.of(mount()),
                                                            frame='tool0'))
    assert 'A is told in base_link and B in tool0' in '\n'.join(tool.sentences())
    assert not same.bodies


def test_files_are_converted_and_compared_on_the_command_line(calibration, tmp_path, capsys):
    a, b, c = (tmp_path / name for name in ('a.json', 'b.json', 'c.urdf'))
    a.write_text(result_to_json(placed(calibration)), encoding='utf-8')
    b.write_text(result_to_json(placed(calibration, 'z')), encoding='utf-8')
    assert selfcal('convert', a, c, '--camera-frame', 'front') == 0
    assert 'front on base_link' in capsys.readouterr().out and c.is_file()
    named = replace(calibration, mount=replace(mount(), camera_frame='rear_optical'))
    (tmp_path / 'named.json').write_text(result_to_json(named), encoding='utf-8')
    assert problems(json.loads(result_to_json(named)), SCHEMA) == []
    assert selfcal('convert', tmp_path / 'named.json', tmp_path / 'named.urdf') == 0
    assert 'rear_optical on base_link' in capsys.readouterr().out
    assert selfcal('compare', a, b) == 0
    out = capsys.readouterr().out
    assert 'fx' in out and '0.000 degrees apart' in out
    assert selfcal('compare', a, c, '--json', '-', '--sigmas', '3') == 0
    told = json.loads(capsys.readouterr().out)
    assert told['mount']['distance_mm'] == pytest.approx(0, abs=1e-6)
    assert selfcal('convert', b, tmp_path / 'd.calib') == 2
    assert 'z of the mount is not observable' in capsys.readouterr().err
