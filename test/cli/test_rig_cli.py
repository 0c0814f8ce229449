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
"""`selfcal calibrate --cameras`: files of a stereo pair, and what is wrong in words."""

from contextlib import nullcontext
from dataclasses import replace
import json
from pathlib import Path
from types import SimpleNamespace

import cv2
from msg_adapters.image import image_message
from msg_adapters.message_types import rosbags_types
from msg_adapters.stamps import header_message
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from scipy.spatial.transform import Rotation
from selfcal_ros import CameraFacts
from selfcal_ros.cli.main import main
from selfcal_ros.cli.track_rig import track_rig_recordings
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.calibrate_input import calibrate_input, CalibrationSettings
from selfcal_ros.pipeline.excerpt import Excerpt
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.pipeline.rig_input import calibrate_rig_input, rig_inputs, RigInput
from selfcal_ros.report.camera_files.kalibr_chain import parse_kalibr
from selfcal_ros.report.camera_files.rig_reading import read_rig
from selfcal_ros.report.rig_epipolar import epipolar_distances
from selfcal_ros.report.rig_figure import epipolar_figure
from selfcal_ros.report.rig_files import rectification, why_no_camchain
from selfcal_ros.synthetic.recordings import agv_drive
from selfcal_ros.synthetic.rig_scenes import hand_path, rig_scene
import yaml

SCHEMA = Path(__file__).resolve().parents[2] / 'docs/result.schema.json'


@pytest.fixture(scope='module')
def calibrated(tmp_path_factory):
    """Calibrate a pair once, from tables of tracks; its scene, folder, status and result."""
    folder = tmp_path_factory.mktemp('rig')
    scene = rig_scene(np.random.default_rng(3), hand_path(np.random.default_rng(3), 8),
                      overlap=True, points=120)
    for name, tracks in scene.tracks.items():
        tracks.to_csv(folder / f'{name}.csv')
    status = main(['calibrate', str(folder / 'left.csv'), str(folder / 'right.csv'), '--cameras',
                   'left,right', '--baseline', f'{scene.baseline_m}:0.0005', '--lens', 'none',
                   '--image-size', '640', '480', '--output', str(folder / 'camera.yaml'),
                   '--json', str(folder / 'result.json'), '--report', str(folder / 'rig.html'),
                   '--colmap', str(folder / 'colmap'), '--quiet'])
    return scene, folder, status, json.loads((folder / 'result.json').read_text('utf-8'))


@pytest.mark.long
def test_the_progress_of_a_rig_names_the_camera_and_the_rig(tmp_path):
    scene = rig_scene(np.random.default_rng(3), hand_path(np.random.default_rng(3), 6),
                      overlap=True, points=60)
    for name, tracks in scene.tracks.items():
        tracks.to_csv(tmp_path / f'{name}.csv')
    told = []
    settings = CalibrationSettings(image_size=(640, 480), facts=CameraFacts(
        aspect_ratio=1.0, skew=0.0, distortion='none'))
    result, _ = calibrate_rig_input(
        rig_inputs([tmp_path / 'left.csv', tmp_path / 'right.csv'], 'left,right'), settings,
        progress=lambda text, done, total: told.append(text))
    assert result
    assert told == ['estimating left', 'estimating right', 'estimating the rig']


@pytest.mark.long
def test_the_result_has_every_camera_and_the_rig(calibrated):
    scene, _, status, content = calibrated
    assert status == 0 and content['unit'] == 'm'
    schema = json.loads(SCHEMA.read_text('utf-8'))
    assert set(schema['required']) <= set(content) <= set(schema['properties']) | {'seed'}
    of_pose = schema['properties']['rig']['additionalProperties']
    assert set(content['rig']['right']) == set(of_pose['required'])
    assert list(content['cameras']) == list(content['rig']) == ['left', 'right']
    for name, camera in scene.cameras.items():
        one = content['cameras'][name]
        assert abs(one['camera']['fx'] - camera.K[0, 0]) < 3.5 * one['sigma']['fx']
    right, T = content['rig']['right'], scene.T_rig_camera['right']
    off = np.array(right['T_rig_camera'])[:3, 3] - T[:3, 3]
    assert np.abs(off / [right['sigma'][name] for name in 'xyz']).max() < 3.5
    assert content['joint']['parameter_names'][-1] == 'right.yaw'


def test_what_was_taken_as_known_is_told(calibrated):
    scene, folder, _, _ = calibrated
    page = (folder / 'rig.html').read_text('utf-8')
    known = page[page.index('Taken as known'):]
    length = f'{1e3 * scene.baseline_m:g} mm (σ = 0.5 mm)'
    for line in ('aspect ratio fy / fx = 1 (exact)', 'skew = 0 px (exact)', 'lens model: none',
                 f'distance of the first two cameras = {length}'):
        assert known.count(f'<li>{line}</li>') == 1
        assert line in known[known.index('As printed'):]


def test_r_and_p_bring_both_images_to_the_same_rows(calibrated):
    scene, folder, _, content = calibrated
    T = np.array(content['rig']['right']['T_rig_camera'])
    X = np.random.default_rng(0).uniform([-1, -1, 3], [1, 1, 9], (20, 3))
    files = [yaml.safe_load((folder / f'camera_{name}.yaml').read_text('utf-8'))
             for name in ('left', 'right')]
    pixels = []
    # P has the baseline, so that both take points of the left rectified camera
    for file in files:
        P = np.array(file['projection_matrix']['data']).reshape(3, 4)
        R_left = np.array(files[0]['rectification_matrix']['data']).reshape(3, 3)
        at = np.column_stack([X @ R_left.T, np.ones(len(X))]) @ P.T
        pixels.append(at[:, :2] / at[:, 2:])
    # the same through the right camera's own frame and R
    R, P = (np.array(files[1][f'{key}_matrix']['data']).reshape(3, -1)
            for key in ('rectification', 'projection'))
    own = (X - T[:3, 3]) @ T[:3, :3] @ R.T @ P[:, :3].T
    assert np.allclose(own[:, :2] / own[:, 2:], pixels[1])
    disparity = pixels[0] - pixels[1]
    assert np.allclose(disparity[:, 1], 0) and (disparity[:, 0] > 0).all()
    assert np.isclose(-P[0, 3] / P[0, 0], scene.baseline_m)


def test_the_chain_of_kalibr_has_the_pose_between_the_cameras(calibrated):
    _, folder, _, content = calibrated
    document = yaml.safe_load((folder / 'camera_camchain.yaml').read_text('utf-8'))
    assert len(parse_kalibr(document, 'the chain')) == 2
    T = np.array(content['rig']['right']['T_rig_camera'])
    assert np.allclose(document['cam1']['T_cn_cnm1'], np.linalg.inv(T))
    assert document['cam1']['rostopic'] == '/right/image_raw'


def test_a_chain_that_was_sorted_by_letters_keeps_its_places(tmp_path):
    # cam10 stands before cam2 there, and was placed beside cam1
    step = np.eye(4)
    step[0, 3] = -0.1
    chain = {f'cam{k}': {'camera_model': 'pinhole', 'distortion_model': 'radtan',
                         'distortion_coeffs': [0, 0, 0, 0], 'intrinsics': [500, 500, 320, 240],
                         'resolution': [640, 480], **({'T_cn_cnm1': step.tolist()} if k else {})}
             for k in range(12)}
    path = tmp_path / 'camchain.yaml'
    path.write_text(yaml.safe_dump(chain), 'utf-8')
    for one in read_rig(path):
        assert one.T_rig_camera[0, 3] == pytest.approx(0.1 * int(one.name[3:]))


def test_why_there_is_no_chain_of_kalibr_is_told():
    camera = Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], [-0.1, 0.05, 0, 0, 0.01], 640, 480)
    path, metres = (SimpleNamespace(unit=unit, poses={}, cameras={
        'left': SimpleNamespace(camera=camera)}) for unit in ('path', 'm'))
    assert '--baseline' in why_no_camchain(path)
    assert 'plumb_bob of left with its k3; --lens radtan' in why_no_camchain(metres)


def test_the_rig_of_colmap_leads_from_the_rig_to_each_camera(calibrated):
    _, folder, _, content = calibrated
    left, right = json.loads((folder / 'colmap/rig_config.json').read_text('utf-8'))[0]['cameras']
    assert left['ref_sensor'] and left['image_prefix'] == 'left/'
    T = np.linalg.inv(content['rig']['right']['T_rig_camera'])
    w, *axis = right['cam_from_rig_rotation']
    assert np.allclose(Rotation.from_quat([*axis, w]).as_matrix(), T[:3, :3])
    assert np.allclose(right['cam_from_rig_translation'], T[:3, 3])
    # COLMAP counts pixels from their corners
    camera = content['cameras']['right']['camera']
    assert right['camera_model_name'] == 'PINHOLE'
    assert np.allclose(right['camera_params'][2:], [camera['cx'] + 0.5, camera['cy'] + 0.5])


def test_the_page_of_a_rig_tells_of_every_camera_and_of_its_matches(calibrated):
    _, folder, _, content = calibrated
    page = (folder / 'rig.html').read_text('utf-8')
    assert page.count('<svg') == 2 and 'http://' not in page.replace('http://www.w3.org', '')
    for name in ('left', 'right'):
        assert f'Camera file of {name}' in page
    assert f'{content["cameras"]["right"]["camera"]["fx"]:.1f}' in page
    assert 'right sits 1' in page and 'mm from left' in page and 'Rectification' in page
    # the rig is drawn first; R and P of each are matrices
    assert 0 < page.index('id="rig"') < page.index('id="cameras"')
    assert page.count('<table class="matrix">') == 4


def test_every_sigma_is_printed_with_two_digits(calibrated, capsys):
    _, folder, _, content = calibrated
    tables = str(folder / 'left.csv'), str(folder / 'right.csv')
    assert main(['calibrate', *tables, '--cameras', 'left,right', '--lens', 'none',
                 '--image-size', '640', '480', '--output', str(folder / 'steps.yaml')]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()
            if line.endswith((' steps', ' deg'))]
    assert [row[0] for row in rows] == ['x', 'y', 'z', 'roll', 'pitch', 'yaw']
    assert {len(row[3].replace('.', '').lstrip('0')) for row in rows} == {2}


def test_the_cameras_of_a_result_are_chosen_as_those_of_a_chain(calibrated, tmp_path, capsys,
                                                                monkeypatch):
    _, folder, _, content = calibrated
    monkeypatch.chdir(tmp_path)
    result, right = str(folder / 'result.json'), str(folder / 'camera_right.yaml')
    assert main(['convert', result, 'right.yaml', '--camera', 'right', '-q']) == 0
    assert main(['compare', 'right.yaml', right, '--json', '-']) == 0
    assert json.loads(capsys.readouterr().out)['difference_px']['max'] < 1e-6
    # the one of the same name is the same, with the covariance that the rig gave it
    assert main(['compare', result, 'right.yaml', '--camera-a', 'right', '--json', '-']) == 0
    told = json.loads(capsys.readouterr().out)
    assert told['difference_px']['max'] < 1e-6
    assert told['parameters']['fx']['sigma'] == pytest.approx(
        content['cameras']['right']['sigma']['fx'])
    # a camera file finds it beside itself, too
    assert main(['compare', right, 'right.yaml', '--result-a', result, '--json', '-']) == 0
    assert json.loads(capsys.readouterr().out)['parameters']['fx']['sigma'] == pytest.approx(
        content['cameras']['right']['sigma']['fx'])
    for words, option in ((['convert', result, 'any.yaml'], '--camera'),
                          (['compare', result, right], '--camera-a'),
                          (['compare', right, result], '--camera-b')):
        assert main(words) == 2
        assert f'holds 2 cameras, choose one with {option}: left, right.' in \
            capsys.readouterr().err
    for words in (['convert', result, 'any.yaml', '--camera', 'top'],
                  ['convert', result, 'any.urdf', '--camera', 'top'],
                  ['compare', result, right, '--camera-a', 'top']):
        assert main(words) == 2
        assert f'{result} has no camera top; it has left, right.' in capsys.readouterr().err


def test_matches_lie_as_far_from_epipolar_planes_as_their_noise():
    rng = np.random.default_rng(5)
    scene = rig_scene(rng, hand_path(rng, 6), overlap=True, points=100)
    T = scene.T_rig_camera['right']
    rig = SimpleNamespace(cameras={name: SimpleNamespace(camera=camera) for name, camera in
                                   scene.cameras.items()}, between=lambda first, second: T)
    (px,) = epipolar_distances(rig, scene.tracks).values()
    assert len(px) > 100
    assert np.std(px) == pytest.approx(0.3, rel=0.1)
    figure = epipolar_figure({('left', 'right'): px})
    assert len(figure.svgs()) == 1 and epipolar_figure({}) is None


def _write_two_topics(path, images, interval_ns, late_ns):
    """Write a bag of two cameras that see the same, the right one later."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        types = get_typestore(Stores.ROS2_JAZZY)
        for name, late in (('left', 0), ('right', late_ns)):
            topic = writer.add_connection(f'/{name}/image_raw', 'sensor_msgs/msg/Image',
                                          typestore=types)
            for k, image in enumerate(images):
                stamp = 10**18 + k * interval_ns + late
                message = image_message(image, header_message(stamp, name, rosbags_types()),
                                        rosbags_types())
                writer.write(topic, stamp, types.serialize_cdr(message, topic.msgtype))


def test_cameras_of_a_bag_with_few_images_that_are_apart_are_refused(tmp_path, capsys):
    images = np.random.default_rng(0).integers(0, 255, (8, 48, 64), np.uint8)
    _write_two_topics(tmp_path / 'bag', images, 400_000_000, 16_000_000)
    assert main(['calibrate', str(tmp_path / 'bag'), '--cameras', 'left,right', '--output',
                 str(tmp_path / 'camera.yaml')]) == 2
    said = capsys.readouterr().err.strip()
    assert 'right are 16 ms away' in said and 'trigger the cameras together' in said
    assert len(said.splitlines()) == 1 and not (tmp_path / 'camera_left.yaml').exists()


@pytest.mark.long
def test_a_camera_of_a_bag_that_has_a_clock_of_its_own_is_told(tmp_path, capsys):
    noise = np.random.default_rng(0).integers(0, 255, (120, 200), np.uint8)
    wall = cv2.normalize(cv2.GaussianBlur(noise, None, 2), None, 0, 255, cv2.NORM_MINMAX)
    images = [wall[:60, :80].copy()] * 5
    _write_two_topics(tmp_path / 'bag', images, 66_000_000, 16_000_000)
    # where nothing moves there is nothing to calibrate by
    assert main(['calibrate', str(tmp_path / 'bag'), '--cameras', 'left,right', '--json', '-',
                 '--motion', 'general', '--distortion', 'none', '--output',
                 str(tmp_path / 'camera.yaml')]) == 1
    told = {one['kind']: one for one in json.loads(capsys.readouterr().out)['findings']}
    assert told['rig_own_clock']['apart_ms'] == 16


@pytest.mark.parametrize('words, reason', [
    (['--cameras', 'left'], 'two or more'),
    (['--cameras', 'left,right,top'], '3 cameras'),
    (['--cameras', 'left,left'], 'same name'),
    (['--cameras', 'left,right', '--output', '/'], 'is a folder'),
    (['--cameras', 'left,right', '--baseline', '11cm'], 'metres'),
    (['--cameras', 'left,right', '--ply', 'r.ply'], 'single camera'),
    (['--baseline', '0.1'], '--cameras')])
def test_what_is_wrong_is_one_sentence(words, reason, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ('left', 'right'):
        (tmp_path / f'{name}.csv').write_text('frame,track,x,y\n0,0,1,1\n', 'utf-8')
    try:
        status = main(['calibrate', 'left.csv', 'right.csv', *words])
    except SystemExit as end:
        status = end.code
    assert status == 2
    said = capsys.readouterr().err
    assert reason in said and len(said.strip().splitlines()) == 1


def test_an_input_that_is_not_there_is_told_as_such(tmp_path):
    with pytest.raises(ArgumentError, match='does not exist'):
        rig_inputs([str(tmp_path / 'away')], '/left/image_raw,/right/image_raw')


def test_one_folder_may_hold_a_folder_of_images_for_each_camera(tmp_path):
    for name in ('cam0', 'cam1'):
        (tmp_path / name).mkdir()
    assert rig_inputs([str(tmp_path)], 'left=cam0,cam1') == [
        RigInput('left', str(tmp_path / 'cam0')), RigInput('cam1', str(tmp_path / 'cam1'))]
    with pytest.raises(ArgumentError, match='holds no folder for each camera'):
        rig_inputs([str(tmp_path)], 'cam0,cam2')
    with pytest.raises(ArgumentError, match='holds no folder for each camera'):
        rig_inputs([str(tmp_path / 'nowhere')], 'cam0,cam1')


def test_a_file_of_a_bag_holds_the_cameras_as_its_folder_does(tmp_path):
    _write_two_topics(tmp_path / 'bag', [np.zeros((48, 64), np.uint8)], 10**9, 0)
    for path in (tmp_path / 'bag', *(tmp_path / 'bag').glob('*.mcap')):
        assert rig_inputs([str(path)], 'left,right') == [
            RigInput(name, str(path), f'/{name}/image_raw') for name in ('left', 'right')]


def test_halves_of_the_images_are_two_cameras(tmp_path):
    images = tmp_path / 'stereo'
    images.mkdir()
    assert rig_inputs([str(images)], 'right,left') == [
        RigInput(half, str(images), half=half) for half in ('right', 'left')]
    assert [one.half for one in rig_inputs([str(images)], 'top,bottom')] == ['top', 'bottom']
    write_image_bag(tmp_path / 'bag', [Frame(0, 10**18, np.zeros((48, 64), np.uint8))],
                    '/stereo/image_raw')
    assert rig_inputs([str(tmp_path / 'bag')], 'left,right')[0].half == 'left'
    # of a topic of one camera the other was not recorded
    write_image_bag(tmp_path / 'lone', [Frame(0, 10**18, np.zeros((48, 64), np.uint8))],
                    '/left/image_raw')
    with pytest.raises(InputError, match='no image topics of a camera right'):
        rig_inputs([str(tmp_path / 'lone')], 'left,right')
    # a folder, a topic of its own, or a name that is no half
    for name in ('left', 'right'):
        (images / name).mkdir()
    assert {one.half for one in rig_inputs([str(images)], 'left,right')} == {None}
    for words in ('left,top', 'left,right,top', 'left,rear'):
        with pytest.raises(ArgumentError, match='holds no folder for each camera'):
            rig_inputs([str(images)], words)


@pytest.mark.long
def test_two_views_in_one_image_are_calibrated_together(tmp_path):
    """The right camera is 12 cm beside the left one, and turned nowhere."""
    drive = agv_drive(8, (320, 240), distortion=(), pitch_deg=12, noise_sigma=1.0)
    aside = drive.cam_from_world.copy()
    aside[:, 0, 3] -= 0.12
    renderer = drive.renderer(2)
    for index in range(len(drive)):
        views = [np.rint(renderer.intensity(poses[index])).clip(0, 255).astype(np.uint8)
                 for poses in (drive.cam_from_world, aside)]
        cv2.imwrite(str(tmp_path / f'{index}.png'), np.hstack(views))
    with pytest.raises(InputError, match='two views .* --cameras left,right, or one with --half'):
        calibrate_input(tmp_path, CalibrationSettings())
    settings = CalibrationSettings(facts=CameraFacts(1.0, 0.0, distortion='none'))
    found, _ = calibrate_rig_input(rig_inputs([str(tmp_path)], 'left,right'), settings,
                                   baseline=(0.12, 0.0))
    assert 'images_halved' in [one.kind for one in found.findings]
    pose = found.poses['right'].T_rig_camera
    assert np.abs(pose[:3, 3] - [0.12, 0, 0]).max() < 0.001
    # whichever was named first, P of the right one has the baseline; one above is no such pair
    for place, right in (([0.12, 0.002, -0.003], 'right'), ([-0.12, 0.002, -0.003], 'left'),
                         ([0.001, 0.12, 0.0005], None), ([0, 0.12, 0], None),
                         ([0.1, 0.01, 0.2], None)):
        T = np.eye(4)
        T[:3, 3] = place
        moved = {**found.poses, 'right': replace(found.poses['right'], T_rig_camera=T)}
        pair = rectification(replace(found, poses=moved))
        if right is None:
            assert pair is None
            continue
        assert [name for name, (_, P) in pair.items() if P[0, 3]] == [right]
        P = pair[right][1]
        assert P[0, 3] == pytest.approx(-P[0, 0] * np.linalg.norm(place))
    for name in ('left', 'right'):
        camera, sigma = found.cameras[name].camera, found.cameras[name].sigma
        assert (camera.width, camera.height) == (320, 240)
        assert abs(camera.K[0, 0] - drive.camera.K[0, 0]) < 3 * sigma['fx']


def test_the_same_images_are_no_two_cameras():
    with pytest.raises(ArgumentError, match='the same images'):
        rig_inputs(['drive/cam0', 'drive/../drive/cam0'], 'left,right')
    with pytest.raises(ArgumentError, match='the same images'):
        rig_inputs(['drive', 'drive'], 'left=/cam/image_raw,right=/cam/image_raw/compressed')


@pytest.mark.parametrize('halves, opened', [((None, None), ['right', 'right']),
                                            (('left', 'right'), ['left', 'right'])])
def test_a_half_that_is_asked_for_is_tracked_unless_each_camera_has_its_own(monkeypatch, halves,
                                                                            opened):
    asked = []

    def opening(path, topic, colour=False, excerpt=None):
        asked.append(excerpt.half)
        if len(asked) == len(halves):
            raise InputError('Enough.')
        return nullcontext()

    monkeypatch.setattr('selfcal_ros.pipeline.sources.open_source', opening)
    inputs = [RigInput(f'camera{k}', f'{k}.mp4', half=half) for k, half in enumerate(halves)]
    with pytest.raises(InputError, match='Enough'):
        track_rig_recordings(inputs, [], [], excerpt=Excerpt(half='right'))
    assert asked == opened
