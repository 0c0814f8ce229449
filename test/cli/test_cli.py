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
"""The command line: exit statuses, sentences instead of tracebacks, files whole or not at all."""

from dataclasses import replace
import io
import json
from pathlib import Path
import re
import subprocess
import sys
import time

import numpy as np
import pytest

from selfcal_ros import Camera, CameraFacts
from selfcal_ros.cli import main as command
from selfcal_ros.cli.colours import coloured
from selfcal_ros.cli.facts import add_fact_arguments, facts_from
from selfcal_ros.cli.shared_files import shared_file
from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.report.camera_yaml import read_camera_yaml, write_camera_yaml
from selfcal_ros.report.comparison import compare_cameras
from selfcal_ros.synthetic.special_scenes import drive, pure_translation

ROOT = Path(__file__).resolve().parents[2]
SIZE = ['--image-size', '640', '480', '--distortion', 'none']


@pytest.fixture(scope='module')
def driven(tmp_path_factory):
    """Write the tracks of a drive; returns the file and the true camera."""
    sequence = drive(np.random.default_rng(3), noise_px=0.1, views=14, tracks=500)
    path = tmp_path_factory.mktemp('drive') / 'tracks.csv'
    sequence.tracks.to_csv(path)
    return path, sequence.camera


@pytest.fixture(autouse=True)
def in_tmp(tmp_path, monkeypatch):
    """Let default outputs land in the temporary folder."""
    monkeypatch.chdir(tmp_path)


def selfcal(*arguments):
    """Run the command in this process; returns the exit status."""
    try:
        return command.main([str(argument) for argument in arguments])
    except SystemExit as stop:
        return stop.code


def test_calibrate_writes_what_was_asked_for_and_it_is_true(driven, capsys):
    path, truth = driven
    status = selfcal('calibrate', path, *SIZE, '--json', 'result.json', '--report', 'r.html',
                     '--camera-name', 'front')
    said = capsys.readouterr().out
    assert status == 0, said
    camera, name = read_camera_yaml('camera.yaml')
    content = json.loads(Path('result.json').read_text(encoding='utf-8'))
    assert name == 'front' and content['status'] == 'calibrated'
    for key, estimate, true in zip(('fx', 'fy', 'cx', 'cy'), camera.parameters, truth.parameters):
        assert abs(estimate - true) < 4 * content['sigma'][key]
        assert content['camera'][key] == estimate
    assert content['parameters']['skew'] == 'held'
    assert 'aspect ratio 1 (held), skew 0 px (held)' in said
    assert 'fx' in said and '±' in said and 'Written: camera.yaml, result.json, r.html.' in said
    assert '<html' in Path('r.html').read_text(encoding='utf-8')
    assert sorted(p.name for p in Path().iterdir()) == ['camera.yaml', 'r.html', 'result.json']


@pytest.mark.parametrize('arguments, words', [
    (['calibrate'], 'selfcal calibrate: the following arguments are required: INPUT; '),
    (['calib'], 'did you mean calibrate? selfcal --help tells more.'),
    (['frobnicate'], "invalid choice: 'frobnicate'"),
    (['calibrate', 'x.csv', '--reprot=r.html'], 'unrecognized arguments: --reprot=r.html; did '
     'you mean --report?'),
    (['calibrate', 'x.csv', '--motion', 'plana'], 'did you mean planar?'),
    (['calibrate', 'x.csv', '--jobs', 'many'], "invalid int value: 'many'"),
    (['demo', '--recording', 'moon'], "invalid choice: 'moon'"),
    (['calibrate', ''], 'selfcal calibrate: An INPUT is empty'),
    (['calibrate', 'x.csv', ''], 'selfcal calibrate: An INPUT is empty')])
def test_a_slip_of_the_finger_costs_one_line(capsys, arguments, words):
    assert selfcal(*arguments) == 2
    heard = capsys.readouterr()
    assert words in heard.err and heard.err.count('\n') == 1 and not heard.out


def test_quiet_says_nothing(driven, capsys):
    assert selfcal('calibrate', driven[0], *SIZE, '--quiet') == 0
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err == ''


def test_what_cannot_be_calibrated_is_status_1_with_a_reason(capsys):
    pure_translation(np.random.default_rng(1)).tracks.to_csv('tracks.csv')
    assert selfcal('calibrate', 'tracks.csv', *SIZE, '--json', 'result.json') == 1
    said = capsys.readouterr().out
    assert said.startswith('Not calibrated: ')
    assert not Path('camera.yaml').exists()
    content = json.loads(Path('result.json').read_text(encoding='utf-8'))
    assert content['status'] == 'not_calibrated' and content['reason'] in said


@pytest.mark.parametrize('arguments, words', [
    (['nowhere.mcap'], 'nowhere.mcap does not exist'),
    (['hollow'], 'hollow is empty'),
    (['empty.csv'], 'empty.csv'),
    (['nan.csv'], 'line 2'),
    (['good.csv', '--output', 'no/such/folder/camera.yaml'], 'does not exist'),
    (['good.csv', '--json', 'camera.yaml'], 'same name'),
    (['good.csv', '--aspect-ratio', '-3'], 'aspect ratio'),
    (['good.csv', '--aspect-ratio-sigma', '-1'], 'sigma'),
    (['good.csv', '--topic', '/image'], 'topic'),
    (['good.csv', '--motion', 'known-object'], 'needs --object'),
    (['good.csv', '--ply', 'camera.yaml'], 'same name'),
    (['good.csv', '--max-keyframes', '1'], 'at least 3'),
    (['good.csv', '--image-size', '0', '480'], 'image size'),
])
def test_a_wrong_input_is_status_2_in_one_sentence(capsys, arguments, words):
    Path('empty.csv').touch()
    Path('hollow').mkdir()
    Path('nan.csv').write_text('frame,track,x,y\n0,1,nan,2\n', encoding='utf-8')
    Path('good.csv').write_text('frame,track,x,y\n0,1,3,2\n', encoding='utf-8')
    before = sorted(Path().iterdir())
    assert selfcal('calibrate', *arguments, *([] if '--image-size' in arguments else SIZE)) == 2
    heard = capsys.readouterr()
    assert heard.out == ''
    assert heard.err.startswith('selfcal calibrate: ') and heard.err.count('\n') == 1
    assert words in heard.err
    assert sorted(Path().iterdir()) == before, 'nothing half-written'


@pytest.fixture
def bad_inputs():
    """Make inputs that go wrong in the middle, or hold nothing."""
    rng = np.random.default_rng(0)

    def frames(sizes):
        return [Frame(k, 10 ** 18 + k * 10 ** 8, rng.integers(0, 256, size, np.uint8))
                for k, size in enumerate(sizes)]

    write_image_bag('good', frames([(96, 128)] * 8))
    write_image_bag('mixed', frames([(96, 128)] * 4 + [(64, 64)] * 4))
    recording = next(Path('good').glob('*.mcap'))
    content = recording.read_bytes()
    Path('truncated.mcap').write_bytes(content[:len(content) // 2])
    Path('folder').mkdir()


@pytest.mark.parametrize('arguments, words', [
    (['truncated.mcap'], 'truncated'), (['mixed'], 'change size'), (['folder'], 'folder'),
    (['good', '--topic', '/nothing'], '/camera/image_raw')])
def test_a_broken_recording_is_status_2_in_one_sentence(bad_inputs, capsys, arguments, words):
    before = sorted(Path().rglob('*'))
    assert selfcal('calibrate', *arguments, '--json', 'result.json') == 2
    heard = capsys.readouterr()
    assert heard.err.startswith('selfcal calibrate: ') and heard.err.count('\n') == 1
    assert words in heard.err
    assert sorted(Path().rglob('*')) == before, 'nothing half-written'


def test_an_option_that_does_not_exist_is_status_2(capsys):
    assert selfcal('calibrate', 'x', '--mood', 'good') == 2
    assert selfcal('calibrate', 'x', '--skew', 'some') == 2
    assert selfcal('sing') == 2
    assert selfcal() == 2
    capsys.readouterr()


def test_a_fault_of_the_program_is_not_mistaken_for_data_that_do_not_suffice(monkeypatch, capsys):
    def broken(*_, **__):
        raise ZeroDivisionError('a fault')

    monkeypatch.setattr('selfcal_ros.cli.facts.facts_from', broken)
    monkeypatch.setattr('selfcal_ros.cli.calibrate.facts_from', broken)
    assert selfcal('calibrate', 'x.csv') == 70
    assert 'please report' in capsys.readouterr().err


def test_help_comes_at_once_and_loads_nothing_heavy():
    code = ('import sys; from selfcal_ros.cli.main import main\n'
            'try: main(["calibrate", "--help"])\n'
            'except SystemExit: pass\n'
            'heavy = {"cv2", "matplotlib", "rosbags", "rclpy", "tqdm"} & set(sys.modules)\n'
            'sys.exit(str(heavy) if heavy else 0)')
    began = time.monotonic()
    done = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True,
                          timeout=60)
    assert done.returncode == 0, done.stderr
    assert '--aspect-ratio' in done.stdout
    # 0.3 s on a quiet machine
    assert time.monotonic() - began < 5


def test_version(capsys):
    assert selfcal('--version') == 0
    assert capsys.readouterr().out.startswith('selfcal_ros 0.')


@pytest.mark.parametrize('arguments, expected', [
    ([], CameraFacts(aspect_ratio=1.0, skew=0.0)),
    (['--aspect-ratio', 'free'], CameraFacts(skew=0.0)),
    (['--skew', 'free', '--aspect-ratio', '1.1', '--aspect-ratio-sigma', '0.01'],
     CameraFacts(aspect_ratio=1.1, aspect_ratio_sigma=0.01)),
    (['--principal-point', '320', '240', '--distortion', 'plumb_bob'],
     CameraFacts(aspect_ratio=1.0, skew=0.0, principal_point=(320, 240),
                 distortion='plumb_bob')),
])
def test_options_become_facts(arguments, expected):
    import argparse
    parser = argparse.ArgumentParser()
    add_fact_arguments(parser)
    assert facts_from(parser.parse_args(arguments)) == expected


def test_many_recordings_have_a_line_and_a_file_each_and_one_joint_result(capsys, driven):
    Path('drives').mkdir()
    for number in range(3):
        drive(np.random.default_rng(number), 0.2, 12, 250, 12).tracks.to_csv(
            f'drives/d{number}.csv')
    Path('drives/broken.csv').write_text('frame,track,x,y\n0,1,nan,2\n', encoding='utf-8')
    pure_translation(np.random.default_rng(1)).tracks.to_csv('drives/straight.csv')
    assert selfcal('calibrate', 'drives', *SIZE, '--output-dir', 'out') == 0
    said = capsys.readouterr().out
    for words in ('d0.csv', 'straight.csv', 'not calibrated: ', 'broken.csv, line 2',
                  '3 of 4 recordings calibrate', 'The recordings agree'):
        assert words in said
    joint = json.loads(Path('out/camera.json').read_text(encoding='utf-8'))
    assert abs(joint['camera']['fx'] - 520) < 4 * joint['sigma']['fx']
    assert read_camera_yaml('out/camera.yaml')[0].K[0, 0] == joint['camera']['fx']
    assert sorted(p.name for p in Path('out/recordings').iterdir()) == [
        'd0.json', 'd0.yaml', 'd1.json', 'd1.yaml', 'd2.json', 'd2.yaml', 'straight.json']
    page = Path('out/summary.html').read_text(encoding='utf-8')
    assert 'data:image/svg+xml' in page and 'http://' not in page and 'straight.csv' in page
    assert Path('out/summary.png').read_bytes().startswith(b'\x89PNG')
    content = json.loads(Path('out/summary.json').read_text(encoding='utf-8'))
    assert len(content['cameras'][0]['recordings']) == 4 and len(content['failures']) == 1
    assert content['cameras'][0]['joint'] == joint


def test_many_recordings_none_of_which_can_be_used(capsys):
    for name in ('a', 'b'):
        Path(f'{name}.csv').write_text('frame,track,x,y\n0,1,nan,2\n', encoding='utf-8')
    assert selfcal('calibrate', 'a.csv', 'b.csv', '--quiet') == 2
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err.count('\n') == 2
    for options, words in ((['--output', 'c.yaml'], '--output is for a single'),
                           (['--track', '--model', 'm.cao'], '--track takes a single'),
                           (['--jobs', '0'], 'positive'), (['--scheduler', 'x'], 'dask')):
        assert selfcal('calibrate', 'a.csv', 'b.csv', *options) == 2
        assert words in capsys.readouterr().err
    assert selfcal('calibrate', 'a.csv', '--output-dir', 'x') == 2
    assert '--output-dir is for many' in capsys.readouterr().err


@pytest.mark.parametrize('verb', ['one', 'many', 'refused'])
def test_json_on_standard_output_is_all_that_is_there(driven, capsys, verb):
    pure_translation(np.random.default_rng(1)).tracks.to_csv('straight.csv')
    inputs = {'one': [driven[0]], 'many': [driven[0], 'straight.csv'],
              'refused': ['straight.csv']}[verb]
    assert selfcal('calibrate', *inputs, *SIZE, '--json', '-') == (verb == 'refused')
    heard = capsys.readouterr()
    content = json.loads(heard.out)
    if verb == 'many':
        assert len(content['cameras'][0]['recordings']) == 2
    else:
        assert content['status'] == ('calibrated' if verb == 'one' else 'not_calibrated')
    assert heard.err.startswith('Not calibrated') == (verb == 'refused')
    assert not Path('-').exists() and '\x1b' not in heard.out + heard.err


def test_colours_are_for_terminals_only(monkeypatch):
    class Terminal(io.StringIO):

        def isatty(self):
            return True

    text = 'Calibrated.\n  fx 520 ± 1   estimated\n  skew 0 ± -   held by skew = 0\nfacts'
    monkeypatch.setenv('TERM', 'xterm')
    monkeypatch.delenv('NO_COLOR', raising=False)
    assert coloured(text, io.StringIO()) == text
    shown = coloured(text, Terminal())
    assert re.sub(r'\x1b\[[0-9]+m', '', shown) == text and shown.count('\x1b[0m') == 3
    assert '\x1b[31m' in coloured('a\nd1.csv not calibrated: no parallax', Terminal())
    monkeypatch.setenv('NO_COLOR', '1')
    assert coloured(text, Terminal()) == text
    monkeypatch.delenv('NO_COLOR')
    monkeypatch.setenv('TERM', 'dumb')
    assert coloured(text, Terminal()) == text


def test_the_report_names_the_camera_and_shows_what_the_reading_noted(driven, monkeypatch):
    from selfcal_ros.pipeline import calibrate_input
    plain = calibrate_input.calibrate_input

    def noted(*args):
        result, reading = plain(*args)
        return result, replace(reading, notes=('Eleven of twelve images were used.',))

    monkeypatch.setattr(calibrate_input, 'calibrate_input', noted)
    assert selfcal('calibrate', driven[0], *SIZE, '--report', 'r.html', '--camera-name',
                   'front_left', '--quiet') == 0
    page = Path('r.html').read_text(encoding='utf-8')
    notes = page[page.index('>Notes</h'):]
    assert 'Eleven of twelve images were used.' in notes[:notes.index('</section>')]
    assert 'Motion: planar, found from the images' in notes
    assert 'camera_name: front_left' in page


def test_compare_says_in_pixels_and_words_how_far_apart(capsys):
    a = Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], [-0.1, 0.02, 0, 0], 640, 480)
    b = Camera([[505, 0, 322], [0, 505, 241], [0, 0, 1]], [-0.1, 0.02, 0, 0], 640, 480)
    write_camera_yaml('a.yaml', a, 'a')
    write_camera_yaml('b.yaml', b, 'b')
    assert selfcal('compare', 'a.yaml', 'a.yaml') == 0
    assert 'practically the same' in capsys.readouterr().out
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


def test_compare_finds_the_covariance_beside_a_camera_file(driven, capsys):
    path, truth = driven
    assert selfcal('calibrate', path, *SIZE, '--json', 'camera.json', '--quiet') == 0
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
        assert selfcal('convert', path, 'back.yaml', '--force', '--camera-name', 'front') == 0
        back, name = read_camera_yaml('back.yaml')
        assert np.array_equal(back.parameters, camera.parameters) and name == 'front'


@pytest.mark.parametrize('arguments, words', [
    (['a.yaml', 'b.yaml'], 'say with --to'), (['a.yaml', 'b.dat'], 'does not tell'),
    (['a.yaml', 'taken.txt'], '--force'), (['a.yaml', 'b.xml', '--camera', 'cam1'], 'cam1'),
    (['a.yaml', 'b.xml', '--fisheye'], '--fisheye'), (['none.yaml', 'b.xml'], 'none.yaml'),
    (['a.yaml', 'b.xml', '--image-size', '0', '4'], 'image size'),
    (['a.yaml', 'no/folder/b.xml'], 'does not exist'),
    (['k3.yaml', 'camchain.yaml'], 'Kalibr has no model for the plumb_bob')])
def test_what_cannot_be_converted_is_status_2_in_one_sentence(capsys, arguments, words):
    K = [[505, 0, 322], [0, 505, 241], [0, 0, 1]]
    write_camera_yaml('a.yaml', Camera(K, [], 640, 480), 'a')
    write_camera_yaml('k3.yaml', Camera(K, [0, 0, 0, 0, 0.1], 640, 480), 'a')
    Path('taken.txt').touch()
    before = sorted(Path().iterdir())
    assert selfcal('convert', *arguments) == 2
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err.count('\n') == 1 and words in heard.err
    assert sorted(Path().iterdir()) == before


def test_shared_files_are_found_and_a_missing_one_is_a_sentence():
    assert shared_file('config/fastdds.xml').is_file()
    with pytest.raises(InputError, match='not installed'):
        shared_file('config/no_such_file')


def test_demo_without_nodes_prints_the_truth_beside_the_estimate(capsys):
    assert selfcal('demo', '--no-ros', '--output-dir', 'out') == 0
    said = capsys.readouterr().out
    assert 'truth' in said and 'sigmas' in said and '520.000' in said
    content = json.loads(Path('out/result.json').read_text(encoding='utf-8'))
    assert abs(content['camera']['fx'] - 520) < 0.002 * 520
    assert abs(content['camera']['cx'] - 328) < 1 and abs(content['camera']['cy'] - 235) < 1
    assert Path('out/camera.yaml').is_file() and Path('out/report.html').is_file()


def test_tracks_without_an_image_size_are_either_used_or_refused_in_a_sentence(driven, capsys):
    status = selfcal('calibrate', driven[0], '--distortion', 'none')
    heard = capsys.readouterr()
    assert status in (0, 2)
    if status == 2:
        assert '--image-size' in heard.err or 'image size' in heard.err
