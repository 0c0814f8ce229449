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
"""Wrong words and broken inputs: status 2, one sentence, and nothing half-written."""

from pathlib import Path

import numpy as np
import pytest
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.frame_source import Frame
from test_support.command_line import selfcal, SIZE

BAGS = Path(__file__).resolve().parents[2] / 'bags'


@pytest.mark.parametrize('arguments, words', [
    (['calibrate'], 'selfcal calibrate: the following arguments are required: INPUT; '),
    (['calib'], 'did you mean calibrate? selfcal --help tells more.'),
    (['frobnicate'], "invalid choice: 'frobnicate'"),
    (['calibrate', 'x.csv', '--reprot=r.html'], 'unrecognized arguments: --reprot=r.html; did '
     'you mean --report?'),
    (['calibrate', 'x.csv', '--motion', 'plana'], 'did you mean planar?'),
    (['calibrate', 'x.csv', '--motion', 'pivot'], 'leave --motion out, or say auto'),
    (['calibrate', 'x.csv', '--lens', 'fisheye'], 'fisheye is called equidistant here; selfcal'),
    (['calibrate', 'x.csv', '--output', 'c.json'], 'c.json is YAML, and must be named .yaml.'),
    (['calibrate', 'x.csv', '--ply', 'c.obj'], 'c.obj is PLY, and must be named .ply.'),
    (['calibrate', 'x.csv', '--motion', 'general', '--views', '3'], 'at least 4 of them; or'),
    (['track', 'x', '--model', 'm', '--init', '0.1', '0', '0.4', '2', '1', '0'], 'selfcal track: '
     'argument --init: the six numbers go in quotes: --init "0.1 0 0.4 2.1 0.8 0.1"'),
    (['calibrate', '--init', '-0.1', '0', '0.4', '2', '1', '0', 'x'], 'go in quotes'),
    *([[verb, *words, '--xyzzy'], f'arguments: --xyzzy; selfcal {verb} --help tells more.']
      for verb, words in (('calibrate', ['x']), ('compare', ['x', 'y']), ('convert', ['x', 'y']),
                          ('track', ['x', '--model', 'm', '--camera', 'c']), ('watch', []),
                          ('model', ['x', '--camera', 'c']), ('completion', ['bash']),
                          ('demo', []))),
    *((['calibrate', 'x.csv', word], 'selfcal calibrate: --out may be --output CAMERA.YAML or '
       '--output-dir FOLDER; write the one that you mean in full; selfcal calibrate --help')
      for word in ('--out', '--out=a could match b.yaml')),
    (['--versoin'], 'did you mean --version? selfcal --help tells more.'),
    (['calibrate', 'x.csv', '--motion', ''], "invalid choice: ''"),
    (['calibrate', 'x.csv', '--jobs', 'many'], "'many' is no number of processes"),
    (['calibrate', 'x.csv', '--jobs', '0'], 'give 1 or more'),
    (['calibrate', 'x.csv', '--output', ''], "--output: '' is no name of a file or folder"),
    (['calibrate', 'x.csv', 'y.csv', '--output-dir', ''], 'is no name of a file or folder'),
    (['calibrate', 'x.csv', '--max-keyframes', '1e9'], "'1e9' is no whole number; selfcal"),
    (['calibrate', 'x.csv', '--start', 'abc'], "argument --start: 'abc' is no number; selfcal"),
    (['calibrate', 'x.csv', '--report', 'r.pdf'], 'r.pdf is one page, and must be named .html.'),
    (['demo', '--recording', 'moon'], "invalid choice: 'moon'"),
    (['demo', '--rate', '0'], "'0' is no number from 0.01 to 100"),
    (['demo', '--rate', 'nan'], 'from 0.01 to 100'),
    (['demo', '--bag', 'nope'], 'selfcal demo: nope does not exist'),
    (['demo', '--recording', 'object', '--bag', 'nope'], 'selfcal demo: nope does not exist'),
    (['demo', '--recording', 'object', '--no-ros', '--bag', BAGS / 'agv_drive'],
     'agv_drive.model.yaml is not there; the recording of an object needs'),
    (['convert', 'x', 'out_bag', '--frame-id', '\udcff\udcfe'], 'is not plain text'),
    (['convert', 'x', 'out_bag', '--topic', 'two words'], 'is no name of a topic'),
    (['calibrate', 'x.csv', '--robot-frame', 'base\nlink'], 'is not plain text'),
    (['calibrate', ''], 'selfcal calibrate: An INPUT is empty'),
    (['calibrate', 'x.csv', ''], 'selfcal calibrate: An INPUT is empty')])
def test_a_slip_of_the_finger_costs_one_line(capsys, arguments, words):
    assert selfcal(*arguments) == 2
    heard = capsys.readouterr()
    assert words in heard.err and heard.err.count('\n') == 1 and not heard.out


@pytest.mark.parametrize('arguments, words', [
    (['nowhere.mcap'], 'nowhere.mcap does not exist'),
    (['hollow'], 'hollow is empty; give one that holds images or a bag.'),
    (['empty.mcap'], 'empty.mcap is empty (0 bytes); give another file.'),
    (['camera.yaml'], 'camera.yaml is of no known kind; expected a rosbag2 folder'),
    (['good.csv', '--robot', 'nan.txt'], "--robot takes poses.csv, a topic of the bag such as"),
    (['empty.csv'], 'empty.csv'),
    (['nan.csv'], 'line 2'),
    (['good.csv', '--output', 'good.csv/such/camera.yaml'], 'is not a folder'),
    (['good.csv', '--json', 'camera.yaml'],
     '--output and --json have the same name, camera.yaml; give each its own file.'),
    (['good.csv', '--json', 'hollow/../good.csv'], 'is the input good.csv'),
    (['good.csv', '--json', 'good.csv'], 'is the input good.csv'),
    (['good.csv', '--aspect-ratio', '-3'], 'aspect ratio'),
    (['good.csv', '--aspect-ratio-sigma', '-1'], 'sigma'),
    (['good.csv', '--skew-sigma', '1e200'], 'a number from 1e-15 to 1e+15, not 1e+200'),
    (['good.csv', '--principal-point', '1e9', '5'], 'The principal point (1e+09, 5) is far '
     'outside of images of 640x480 pixels; state it in their pixels, or leave it open.'),
    (['good.csv', '--skew', '5000'], 'A skew of 5000 px is impossible in images of 640x480'),
    (['good.csv', '--line-delay', '0.009'], 'from one row to the next, about 7e-05, or leave'),
    (['good.csv', '--line-delay', '-9e-3'], 'from one row to the next, about 7e-05, or leave'),
    (['good.csv', '--line-delay', '20'], '480 rows that are read in 20 ms have 4.2e-05'),
    (['good.csv', '--line-delay', '2e-5', '--shutter', 'global'], 'leave one of them out'),
    (['good.csv', '--topic', '/image'], 'topic'),
    (['good.csv', '--motion', 'known-object'], 'needs --object'),
    (['good.csv', '--motion', 'repeated', '--focal', 'varying'], 'leave it out'),
    (['good.csv', '--ply', 'a.ply', '--json', 'a.ply'], 'same name'),
    (['good.csv', '--max-keyframes', '1'], 'at least 3'),
    (['good.csv', '--image-size', '0', '480'], 'image size'),
])
def test_a_wrong_input_is_status_2_in_one_sentence(capsys, arguments, words):
    for name in ('empty.csv', 'empty.mcap', 'camera.yaml', 'nan.txt'):
        Path(name).touch()
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
    (['good', '--output-dir', 'x'], 'many recordings'),
    (['truncated.mcap'], 'truncated'), (['truncated.mcap'], 'try `mcap recover` on it'),
    (['mixed'], 'change size'), (['folder'], 'folder'),
    (['good', '--motion', 'translation', '--translation-frames', '0', '99'],
     'good has no image 99: its 8 images are counted from 0.'),
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
