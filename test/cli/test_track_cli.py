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
"""selfcal track and selfcal calibrate --track, as a user calls them."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.report.camera_yaml import read_camera_yaml, write_camera_yaml
from selfcal_ros.report.poses_csv import read_poses
from selfcal_ros.report.shutter_comment import shutter_comment
from selfcal_ros.rorapid.model import write_model
from selfcal_ros.synthetic.objects import pose_errors, tracked_object
from selfcal_ros.synthetic.recordings import write_image_folder
from test_support.command_line import selfcal

ROOT = Path(__file__).resolve().parents[2]
BAG = ROOT / 'bags' / 'tracked_object'
OBJECT = ['--model', f'{BAG}.model.yaml', '--init', f'{BAG}.pos']
CAMERA = ['--camera', f'{BAG}.camera.yaml']


def test_the_recorded_object_is_tracked_to_its_end(capsys):
    assert selfcal('track', BAG, *OBJECT, *CAMERA) == 0
    said = capsys.readouterr().out
    assert 'Tracked in 75 of 75 images' in said and 'Written: poses.csv.' in said
    assert 'the size of the model, 0.1 x 0.07 x 0.1 m:' in said
    poses = read_poses('poses.csv')
    truth = json.loads(Path(f'{BAG}.truth.json').read_text(encoding='utf-8'))
    true = np.array(truth['cam_from_object'])
    angle, share = pose_errors(poses['rotation'], poses['translation'], true[:, :, :3],
                               true[:, :, 3])
    assert np.sqrt(np.mean(np.rad2deg(angle)**2)) < 0.3
    assert np.sqrt(np.mean(share**2)) < 0.005
    assert list(poses['stamp_ns']) == truth['stamps_ns']


@pytest.mark.long
def test_rows_are_read_as_the_camera_file_says_or_the_user(capsys):
    recording = tracked_object(4, 'cube', size=(480, 360), speed=2.5, readout_s=0.02)
    write_image_folder(recording, 'rolling')
    readout = RowReadout(0.02 / 360, 1e-7, 'estimated', 0.6, 0.001, 360)
    write_camera_yaml('rows.yaml', recording.camera, 'camera', shutter_comment(readout))
    write_camera_yaml('none.yaml', recording.camera, 'camera')
    poses = {}
    for camera, more in (('rows.yaml', ()), ('none.yaml', ('--line-delay', str(0.02 / 360))),
                         ('rows.yaml', ('--line-delay', '0'))):
        selfcal('track', 'rolling', *OBJECT, '--camera', camera, *more)
        said = capsys.readouterr().out
        assert ('as rows.yaml says' in said) == (camera == 'rows.yaml' and not more)
        assert ('55.6 µs apart' in said) == (more != ('--line-delay', '0'))
        poses[camera, more] = read_poses('poses.csv')['rotation'][-1]
    by_file, by_option, at_once = poses.values()
    assert np.allclose(by_file, by_option, atol=1e-6)
    assert np.abs(by_file - at_once).max() > 1e-3


def test_an_object_that_is_not_there_is_status_1_with_a_reason(capsys):
    write_image_folder(tracked_object(1, 'cube', size=(480, 360)), 'one')
    grey = np.full((360, 480), 90, np.uint8)
    for k in range(1, 9):
        cv2.imwrite(f'one/{k:04d}.png', grey)
    assert selfcal('track', 'one', *OBJECT, *CAMERA, '--quiet') == 1
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err.startswith('Lost at the end')
    # a lost image has no pose
    assert ',lost,,,' in Path('poses.csv').read_text(encoding='utf-8')


def test_poses_of_an_earlier_run_are_said_to_be_replaced(capsys):
    write_image_folder(tracked_object(2, 'cube', size=(480, 360)), 'two')
    Path('poses.csv').write_text('of an earlier run', encoding='utf-8')
    selfcal('track', 'two', *OBJECT, *CAMERA)
    assert 'Written: poses.csv (replaced).' in capsys.readouterr().out
    assert 'earlier' not in Path('poses.csv').read_text(encoding='utf-8')


@pytest.mark.parametrize('arguments, words', [
    (['nowhere.mcap', *OBJECT, *CAMERA], 'nowhere.mcap does not exist'),
    ([BAG, *OBJECT[:2], *CAMERA], 'Say where the object is'),
    ([BAG, '--model', 'missing.cao', *OBJECT[2:], *CAMERA], 'missing.cao'),
    ([BAG, '--model', 'broken.cao', *OBJECT[2:], *CAMERA], 'broken.cao'),
    ([BAG, *OBJECT[:2], '--init', '0 0 nan 0 0 0', *CAMERA], 'finite'),
    ([BAG, *OBJECT[:2], '--init', '0 0 -1 0 0 0', *CAMERA], 'behind the camera'),
    ([BAG, '--model', 'open.ply', '--init', '0 0 -1 0 0 0', *CAMERA], 'behind the camera'),
    ([BAG, *OBJECT, '--camera', 'small.yaml'], '480x360, the calibration is for 320x240'),
    ([BAG, *OBJECT, *CAMERA, '--overlay', 'video.txt'], '.mp4'),
    ([BAG, *OBJECT, *CAMERA, '--output', 'v.csv', '--overlay', 'v.csv'], 'same name'),
    ([BAG, *OBJECT, *CAMERA, '--output', 'p.json'], 'are a table, and must be named .csv.'),
    ([BAG, *OBJECT, *CAMERA, '--output', 'tracks.csv/p.csv'], 'tracks.csv is a file'),
    ([BAG, *OBJECT, *CAMERA, '--camera-model', 'affine', '--motion', 'planar'], 'affine'),
    ([BAG, *OBJECT, *CAMERA, '--lines', 'columns'], '--lines needs --line-delay'),
    ([BAG, *OBJECT, *CAMERA, '--line-delay', '0.02'], 'line_delay_s must lie between'),
    (['tracks.csv', *OBJECT, *CAMERA], 'tracks')])
def test_a_wrong_input_is_status_2_in_one_sentence(capsys, arguments, words):
    Path('broken.cao').write_text('V1\n3\n0 0 0\n1 0 0\n0 1 0\n0\n0\n1\n3 0 1 7\n0\n0\n')
    # a mesh with a hole, which is remarked where it is tracked
    Path('open.ply').write_text(
        'ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n'
        'property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n'
        '0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 0 1 3\n')
    Path('tracks.csv').write_text('frame,track,x,y\n0,1,3,2\n', encoding='utf-8')
    camera, _ = read_camera_yaml(f'{BAG}.camera.yaml')
    write_camera_yaml('small.yaml', type(camera)(camera.K, (), 320, 240), 'small')
    before = sorted(Path().iterdir())
    assert selfcal('track', *arguments) == 2
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err.count('\n') == 1
    assert heard.err.startswith('selfcal track: ') and words in heard.err
    assert sorted(Path().iterdir()) == before, 'nothing half-written'


@pytest.mark.long
def test_an_object_under_an_unknown_lens_calibrates_the_camera(capsys, without_figures):
    recording = tracked_object(36, 'step_block', size=(480, 360), speed=4.0, supersampling=2)
    write_image_folder(recording, 'images')
    write_model(recording.model, 'model.yaml')
    pose = ' '.join(f'{v:.4f}' for v in (*recording.translations[0],
                                         *rotation_vector(recording.rotations[0])))
    status = selfcal('calibrate', 'images', '--motion', 'known-object', '--track', '--model',
                     'model.yaml', '--init', pose, '--distortion', 'none', '--json', 'r.json',
                     '--report', 'r.html', '--poses', 'path.txt')
    said = capsys.readouterr().out
    assert status == 0, said
    content = json.loads(Path('r.json').read_text(encoding='utf-8'))
    true = recording.camera.K
    for name, value in (('fx', true[0, 0]), ('cx', true[0, 2]), ('cy', true[1, 2])):
        assert abs(content['camera'][name] - value) < 4 * content['sigma'][name], name
    assert abs(content['camera']['fx'] / true[0, 0] - 1) < 0.01
    assert content['motion'] == 'known-object' and 'was followed in' in said
    # the camera in the frame of the object, in metres, against where it was; folders have no clock
    rows = np.loadtxt('path.txt')
    assert rows[:, 0].astype(int).tolist() == content['frames']['used']
    off = [row[1:4] + recording.rotations[int(row[0])].T @ recording.translations[int(row[0])]
           for row in rows]
    assert np.linalg.norm(off, axis=1).max() < 0.03 * np.linalg.norm(recording.translations[0])


@pytest.mark.parametrize('arguments, words', [
    (['--track'], 'needs the shape'),
    (['--track', '--model', f'{BAG}.model.yaml'], 'where the object is'),
    (['--model', f'{BAG}.model.yaml'], 'add --track'),
    (['--track', '--object', 'chessboard:9x6:0.025'], 'exclude each other'),
    (['--track', *OBJECT, '--motion', 'planar'], '--track and --motion planar'),
    (['--track', *OBJECT, '--image-size', '640', '480'], 'leave it out'),
    (['--track', *OBJECT, '--line-delay', '4e-5', '--line-delay-sigma', '1e-6'], 'for exact'),
    (['--motion', 'known-object'], '--track')])
def test_options_that_do_not_go_together_are_refused(capsys, arguments, words):
    assert selfcal('calibrate', BAG, *arguments) == 2
    assert words in capsys.readouterr().err


@pytest.mark.long
def test_the_demo_follows_the_object_without_ros(capsys):
    assert selfcal('demo', '--recording', 'object', '--no-ros', '--output-dir', 'out') == 0
    said = capsys.readouterr().out
    assert 'straight from the bag' in said and 'against the truth' in said
    assert {path.name for path in Path('out').iterdir()} == {'poses.csv', 'overlay.mp4'}
