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
"""`selfcal compare` and `selfcal convert`: cameras of several programs, images as a bag."""

import json
from pathlib import Path
import shutil

from msg_adapters.copied_camera import CopiedCamera
import numpy as np
import pytest
from selfcal_ros import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.report.camera_yaml import read_camera_yaml, write_camera_yaml
from selfcal_ros.report.comparison import compare_cameras
from selfcal_ros.report.copied_camera_yaml import read_copied_camera, write_copied_camera
from test_support.command_line import selfcal, SIZE
import yaml


def test_compare_says_in_pixels_and_words_how_far_apart(capsys):
    a = Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], [-0.1, 0.02, 0, 0], 640, 480)
    b = Camera([[505, 0, 322], [0, 505, 241], [0, 0, 1]], [-0.1, 0.02, 0, 0], 640, 480)
    write_camera_yaml('a.yaml', a, 'a')
    write_camera_yaml('b.yaml', b, 'b')
    assert selfcal('compare', 'a.yaml', 'a.yaml') == 0
    assert 'the same, but for rounding' in capsys.readouterr().out
    assert selfcal('compare', 'a.yaml', 'b.yaml') == 0
    said = capsys.readouterr().out
    apart = compare_cameras(a, b).distance_px
    assert f'{np.nanmax(apart):.3f} px at most' in said and 'Without covariances' in said
    # the same from other programs' files
    assert selfcal('convert', 'b.yaml', 'b.bin', '--quiet') == 0
    assert selfcal('compare', 'a.yaml', 'b.bin', '--json', '-') == 0
    content = json.loads(capsys.readouterr().out)
    assert content['difference_px']['max'] == pytest.approx(np.nanmax(apart), abs=1e-9)
    assert content['agree'] is None and content['parameters']['fx']['difference'] == 5
    write_camera_yaml('c.yaml', Camera(a.K, a.distortion, 320, 240), 'c')
    assert selfcal('compare', 'a.yaml', 'c.yaml') == 2
    assert 'one size' in capsys.readouterr().err


@pytest.fixture(scope='module')
def calibrated(driven, tmp_path_factory):
    """Calibrate once; returns a folder with the camera file and its result, and the truth."""
    folder = tmp_path_factory.mktemp('calibrated')
    assert selfcal('calibrate', driven[0], *SIZE, '--output', folder / 'camera.yaml', '--json',
                   folder / 'camera.json', '--quiet') == 0
    return folder, driven[1]


@pytest.fixture
def beside(calibrated):
    """Put a result and the truth where the test runs; returns the truth."""
    shutil.copytree(calibrated[0], '.', dirs_exist_ok=True)
    return calibrated[1]


def test_compare_finds_the_covariance_beside_a_camera_file(beside, capsys):
    truth = beside
    write_camera_yaml('truth.yaml', truth, 'truth')
    assert selfcal('compare', 'camera.yaml', 'truth.yaml') == 0
    said = capsys.readouterr().out
    assert 'agree' in said and 'within their uncertainties' in said
    assert 'B has no covariance and counts as exact.' in said
    changed = Camera(np.diag([1.02, 1.02, 1]) @ truth.K, truth.distortion, 640, 480)
    write_camera_yaml('zoomed.yaml', changed, 'zoomed')
    assert selfcal('compare', 'camera.yaml', 'zoomed.yaml', '--json', 'c.json') == 0
    content = json.loads(Path('c.json').read_text(encoding='utf-8'))
    assert content['agree'] is False and 'the camera has changed' in content['verdict']
    assert content['parameters']['fx']['sigmas'] > 4
    assert selfcal('compare', 'zoomed.yaml', 'truth.yaml', '--result-a', 'camera.json') == 2
    assert 'is not the result that zoomed.yaml comes from' in capsys.readouterr().err


def test_compare_reads_the_covariance_out_of_the_camera_file_itself(beside, capsys):
    stored = json.loads(Path('camera.json').read_text(encoding='utf-8'))
    Path('camera.json').unlink()
    write_camera_yaml('truth.yaml', beside, 'truth')
    assert selfcal('compare', 'camera.yaml', 'truth.yaml', '--sigmas', 4, '--json', '-') == 0
    content = json.loads(capsys.readouterr().out)
    assert content['parameters']['fx']['sigma'] == pytest.approx(stored['sigma']['fx'], rel=1e-6)
    assert content['agree'] is True
    # whoever changes a number changes the camera, which the covariance is not of
    text = Path('camera.yaml').read_text(encoding='utf-8')
    f = repr(stored['camera']['fx'])
    body = text.index('image_width')
    assert f in text[body:]
    Path('edited.yaml').write_text(text[:body] + text[body:].replace(f, '600.5'),
                                   encoding='utf-8')
    assert selfcal('compare', 'edited.yaml', 'truth.yaml') == 0
    assert 'Without covariances' in capsys.readouterr().out
    Path('broken.yaml').write_text(text.replace('"covariance": [', '"covariance": ["x", '),
                                   encoding='utf-8')
    assert selfcal('compare', 'broken.yaml', 'truth.yaml') == 0
    assert 'Without covariances' in capsys.readouterr().out


def test_sigmas_decide_the_exit_status_and_the_picture_shows_the_difference(beside, capsys):
    truth = beside
    write_camera_yaml('truth.yaml', truth, 'truth')
    zoomed = Camera(np.diag([1.02, 1.02, 1]) @ truth.K, truth.distortion, 640, 480)
    write_camera_yaml('zoomed.yaml', zoomed, 'zoomed')
    assert selfcal('compare', 'camera.yaml', 'truth.yaml', '--sigmas', 4) == 0
    assert 'not more than 4.' in capsys.readouterr().out
    assert selfcal('compare', 'camera.yaml', 'zoomed.yaml', '--sigmas', 4, '--json', 'c.json',
                   '--picture', 'c.png') == 1
    said = capsys.readouterr().out
    assert ': more than 4.' in said and 'Written: c.png.' in said
    content = json.loads(Path('c.json').read_text(encoding='utf-8'))
    assert content['beyond'] is True and content['limit_sigmas'] == 4
    assert selfcal('compare', 'camera.yaml', 'zoomed.yaml', '--sigmas', 4, '-q') == 1
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err.startswith(
        f'They are {content["joint_sigmas"]:.1f} sigmas apart')
    assert selfcal('compare', 'camera.yaml', 'truth.yaml', '--sigmas', 4, '-q') == 0
    assert capsys.readouterr() == ('', '')
    import cv2
    picture = cv2.imread('c.png')
    # two panels side by side: pixels, and sigmas
    assert picture.shape[1] > 2 * picture.shape[0]
    # twice at the truth: neither knows its uncertainty, so that the question has no answer
    assert selfcal('compare', 'truth.yaml', 'zoomed.yaml', '--sigmas', 3) == 2
    assert '--result-a' in capsys.readouterr().err
    assert selfcal('compare', 'truth.yaml', 'zoomed.yaml', '--sigmas', 0) == 2
    assert selfcal('compare', 'truth.yaml', 'zoomed.yaml', '--picture', 'c.bmp') == 2


def test_an_image_folder_becomes_a_bag(capsys):
    import cv2
    folder = Path('images')
    folder.mkdir()
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 256, (48, 64), np.uint8) for _ in range(4)]
    for k, image in enumerate(images):
        cv2.imwrite(str(folder / f'{k:03d}.png'), image)
    assert selfcal('convert', folder, 'bag', '--topic', '/front/image_raw') == 0
    assert '4 images' in capsys.readouterr().out
    with open_source('bag') as source:
        assert source.topic == '/front/image_raw'
        for frame, image in zip(source, images, strict=True):
            assert np.array_equal(frame.image, image)
    assert selfcal('convert', folder, 'bag') == 2
    assert 'exists' in capsys.readouterr().err
    # a topic of a bag is read, and no raw images are called compressed
    assert selfcal('convert', 'bag', 'jpegs', '--topic', '/front/image_raw', '--compressed',
                   'png') == 0
    assert 'on the topic /front/image_raw/compressed.' in capsys.readouterr().out
    for words, topic in (([], '/camera/image_raw'),
                         (['--topic', 'front/image_raw/compressed'], '/front/image_raw'),
                         (['--topic', '/rear', '--input-topic', '/front/image_raw/compressed'],
                          '/rear'), (['--topic', 'new'], 'new')):
        status = selfcal('convert', 'jpegs', topic.replace('/', '_'), *words)
        if not topic.startswith('/'):
            assert status == 2 and 'no absolute topic name' in capsys.readouterr().err
            continue
        with open_source(topic.replace('/', '_')) as source:
            assert source.topic == topic
            assert np.array_equal(next(iter(source)).image, images[0])
    for path in ('jpegs', folder):
        assert selfcal('convert', path, 'raw', '--topic', '/rear/compressed') == 2
        assert '/rear/compressed is a name of compressed images' in capsys.readouterr().err


def test_a_camera_of_a_stereo_pair_keeps_its_r_and_p_under_another_name(capsys):
    R = rotation_matrix(np.array([0.01, -0.02, 0.03]))
    K, P = np.diag([500.0, 505, 1]), np.array([[500, 0, 332.5, -60], [0, 500, 240, 0],
                                               [0, 0, 1, 0.0]])
    K[:2, 2] = 320, 240
    pair = CopiedCamera(640, 480, 'plumb_bob', np.array([-0.1, 0.02, 0, 0, 0]), K, R, P)
    write_copied_camera('right.yaml', pair, 'right', ['uncertainty: of a test'])
    assert selfcal('convert', 'right.yaml', 'renamed.yaml', '--to', 'ros', '--camera-name',
                   'front_right') == 0
    found, name = read_copied_camera('renamed.yaml')
    assert name == 'front_right'
    np.testing.assert_allclose(found.R, R)
    np.testing.assert_array_equal(found.P, P)
    assert Path('renamed.yaml').read_text('utf-8').startswith('# uncertainty: of a test\n')


def test_a_camera_file_becomes_that_of_another_program_and_comes_back(capsys):
    camera = Camera([[505, 0, 322], [0, 505, 241], [0, 0, 1]], [-0.1, 0.02, 0, 0], 640, 480)
    write_camera_yaml('front.yaml', camera, 'front')
    for path in ('opencv.xml', 'cameras.txt', 'cameras.bin', 'camchain.yaml'):
        assert selfcal('convert', 'front.yaml', path) == 0
    assert selfcal('convert', 'front.yaml', 'opencv.yaml', '--to', 'opencv', '--quiet') == 0
    said = capsys.readouterr().out
    assert 'half a pixel' in said
    assert 'front of front.yaml written to opencv.xml for OpenCV' in said
    assert '322.5 241.5' in Path('cameras.txt').read_text(encoding='utf-8')
    for path in ('opencv.xml', 'opencv.yaml', 'cameras.txt', 'cameras.bin', 'camchain.yaml'):
        # what the reader of camera files advises works
        assert selfcal('convert', path, 'back.yaml', '--force', '--quiet', '--camera-name', 'front'
                       ) == 0
        assert selfcal('compare', path, 'front.yaml', '--json', '-') == 0
        assert json.loads(capsys.readouterr().out)['difference_px']['max'] < 1e-6
        back, name = read_camera_yaml('back.yaml')
        assert np.array_equal(back.parameters, camera.parameters) and name == 'front'


def test_a_name_that_kalibr_gives_makes_a_chain(capsys):
    """Kalibr puts the name of the bag before, and `selfcal calibrate` that of the cameras."""
    camera = Camera([[505, 0, 322], [0, 505, 241], [0, 0, 1]], [-0.1, 0.02, 0, 0], 640, 480)
    write_camera_yaml('front.yaml', camera, 'front')
    for name in ('drive-camchain.yaml', 'front_camchain.yaml'):
        assert selfcal('convert', 'front.yaml', name, '--quiet') == 0
        assert yaml.safe_load(Path(name).read_text('utf-8'))['cam0']['intrinsics'] == [
            505, 505, 322, 241]


@pytest.mark.parametrize('arguments, words', [
    (['a.yaml', 'b.yaml'], 'say with --to'), (['a.yaml', './a.yaml'], 'choose another name'),
    (['a.yaml', 'b.dat'], 'does not tell'),
    (['a.yaml', 'taken.txt'], '--force'), (['a.yaml', 'b.xml', '--camera', 'cam1'], 'cam1'),
    (['a.yaml', 'b.xml', '--fisheye'], '--fisheye'), (['none.yaml', 'b.xml'], 'none.yaml'),
    (['a.yaml', 'b.xml', '--image-size', '0', '4'], 'image size'),
    (['a.yaml', 'a.yaml/folder/b.xml'], 'is not a folder'),
    (['k3.yaml', 'camchain.yaml'], 'calibrate with --lens radtan.')])
def test_what_cannot_be_converted_is_status_2_in_one_sentence(capsys, arguments, words):
    K = [[505, 0, 322], [0, 505, 241], [0, 0, 1]]
    write_camera_yaml('a.yaml', Camera(K, [], 640, 480), 'a')
    write_camera_yaml('k3.yaml', Camera(K, [0, 0, 0, 0, 0.1], 640, 480), 'a')
    Path('taken.txt').write_text('mine\n', encoding='utf-8')
    before = sorted(Path().iterdir())
    assert selfcal('convert', *arguments) == 2
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err.count('\n') == 1 and words in heard.err
    assert sorted(Path().iterdir()) == before


REPORT = b'<!DOCTYPE html>\n<html lang="en">' + 2_000_000 * b' '


@pytest.mark.parametrize('name, content, words', [
    ('report.html', REPORT, 'is a report, and no camera file; give camera.yaml or result.json of'),
    ('run/report.html', REPORT, 'give run/camera.yaml or run/result.json of the same'),
    ('image.jpg', b'\xff\xd8\xff\xe0', 'is an image, and no camera file; give camera.yaml'),
    ('image.yaml', b'\x89PNG\r\n', 'is an image, and no camera file'),
    ('film.mp4', b'\0\0\0 ftypisom', 'is a video, and no camera file; give the camera.yaml that'),
    ('drive.mcap', b'\x89MCAP0\r\n', 'is a bag, and no camera file; give the camera.yaml'),
    ('drive/metadata.yaml', b'', 'drive is a bag, and no camera file'),
    ('run/log/some.log', b'', 'run/log is a folder, and no camera file; name a file in it.'),
    ('run', None, 'is a folder, and no camera file; name run/camera.yaml or run/result.json.')])
def test_what_is_given_for_a_camera_file_is_named_with_what_to_give(capsys, name, content, words):
    write_camera_yaml('a.yaml', Camera([[505, 0, 322], [0, 505, 241], [0, 0, 1]], [], 640, 480),
                      'a')
    given = Path(name)
    Path('run').mkdir()
    for beside in ('camera.yaml', 'result.json'):
        Path('run', beside).touch()
    if content is not None:
        given.parent.mkdir(parents=True, exist_ok=True)
        given.write_bytes(content)
    if given.name in ('metadata.yaml', 'some.log'):
        given = given.parent
    for arguments in (['compare', 'a.yaml', given], ['compare', given, 'a.yaml'],
                      ['convert', given, 'b.yaml'], ['convert', given, 'b.xml', '--to', 'opencv'],
                      ['convert', given, 'b.urdf', '--to', 'urdf'],
                      ['track', 'x', '--model', 'm.cao', '--camera', given, '--init', '0 0 1'],
                      ['model', 'x', '--length', '1', '--camera', given]):
        assert selfcal(*arguments) == 2
        heard = capsys.readouterr()
        assert heard.out == '' and heard.err.count('\n') == 1 and words in heard.err
