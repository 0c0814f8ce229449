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
"""`selfcal calibrate` on one recording, and what holds for every verb: status, help, facts."""

from dataclasses import replace
import json
from pathlib import Path
import subprocess
import sys
import time

import numpy as np
import pytest
from selfcal_ros import CameraFacts
from selfcal_ros.cli.facts import add_fact_arguments, facts_from
from selfcal_ros.cli.shared_files import shared_file
from selfcal_ros.errors import InputError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.report.camera_yaml import read_camera_yaml
from selfcal_ros.synthetic.hard_scenes import one_curve, vehicle
from selfcal_ros.synthetic.special_scenes import pure_translation
from test_support.command_line import selfcal, SIZE

ROOT = Path(__file__).resolve().parents[2]


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
            'heavy = {"cv2", "matplotlib", "numpy", "rosbags", "rclpy", '
            '"scipy", "tqdm"} & set(sys.modules)\n'
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


def test_the_report_names_the_camera_and_shows_what_the_reading_noted(driven, monkeypatch,
                                                                      without_figures):
    from selfcal_ros.pipeline import calibrate_input
    plain = calibrate_input.calibrate_input

    def noted(*args):
        result, reading = plain(*args)
        return result, replace(reading, findings=(
            Finding('note', text='Eleven of twelve images were used.'),))

    monkeypatch.setattr(calibrate_input, 'calibrate_input', noted)
    assert selfcal('calibrate', driven[0], *SIZE, '--report', 'r.html', '--camera-name',
                   'front_left', '--quiet') == 0
    page = Path('r.html').read_text(encoding='utf-8')
    notes = page[page.index('id="notes"'):page.index('<section')]
    assert 'Eleven of twelve images were used.' in notes
    assert 'Motion: planar, found from the images' in notes
    assert 'camera_name: front_left' in page
    made = page[page.index('id="made"'):]
    assert f'selfcal calibrate {driven[0]}' in made and '--camera-name front_left' in made


def test_a_hint_is_status_1_in_words_and_leaves_no_camera_file(capsys):
    curve = vehicle(np.random.default_rng(1), one_curve(6, 6), count=60)
    curve.tracks.to_csv('tracks.csv')
    command = ['calibrate', 'tracks.csv', '--image-size', *curve.tracks.image_size, '--lens',
               'radial2', '--json', 'r.json']
    assert selfcal(*command) == 1
    said = capsys.readouterr().out
    assert said.startswith('A hint, no calibration: The camera turned by 5.')
    assert 'which suggests a focal length of' in said and 'Turn the camera by 20 degrees' in said
    assert 'Written: r.json.' in said and not Path('camera.yaml').exists()
    content = json.loads(Path('r.json').read_text(encoding='utf-8'))
    truth = curve.camera.K[0, 0]
    assert content['status'] == 'hint' and content['camera'] is None
    assert abs(content['hint']['camera']['fx'] - truth) < 4 * content['hint']['sigma']['fx']
    # a hint is no camera to compare with or to convert either
    assert selfcal('convert', 'r.json', 'camera.yaml') == 2
    assert 'holds no camera' in capsys.readouterr().err and not Path('camera.yaml').exists()


def test_shared_files_are_found_and_a_missing_one_is_a_sentence():
    assert shared_file('config/fastdds.xml').is_file()
    with pytest.raises(InputError, match='not installed'):
        shared_file('config/no_such_file')


def test_demo_without_nodes_prints_the_truth_beside_the_estimate(capsys, without_figures):
    assert selfcal('demo', '--no-ros', '--output-dir', 'out') == 0
    said = capsys.readouterr().out
    assert 'truth' in said and 'sigmas' in said and '520.000' in said
    content = json.loads(Path('out/result.json').read_text(encoding='utf-8'))
    assert abs(content['camera']['fx'] - 520) < 0.002 * 520
    assert abs(content['camera']['cx'] - 328) < 1 and abs(content['camera']['cy'] - 235) < 1
    assert Path('out/camera.yaml').is_file() and Path('out/report.html').is_file()


@pytest.mark.long
def test_tracks_without_an_image_size_are_used_and_the_size_is_asked_for(driven, capsys):
    path, camera = driven
    assert selfcal('calibrate', path, '--distortion', 'none', '--json', 'result.json') == 0
    assert 'state it with --image-size' in capsys.readouterr().out
    content = json.loads(Path('result.json').read_text(encoding='utf-8'))
    assert abs(content['camera']['fx'] - camera.K[0, 0]) < 4 * content['sigma']['fx']
    assert selfcal('calibrate', path, *SIZE, '--force') == 0
    assert '--image-size' not in capsys.readouterr().out
