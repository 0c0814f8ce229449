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
"""No camera file and no model is replaced without --force; and it is said at once."""

from pathlib import Path

import pytest
from selfcal_ros import Camera
from selfcal_ros.cli.demo import log_folder, logs_in
from selfcal_ros.cli.force import check_outputs
from selfcal_ros.pipeline import calibrate_input, tracking_run
from selfcal_ros.report.camera_yaml import write_camera_yaml
from test_support.command_line import selfcal, SIZE

MINE = 'mine: is what a driver serves\n'


def refused(capsys, *arguments):
    """Return the sentence of a refusal."""
    assert selfcal(*arguments) == 2
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err.count('\n') == 1 and '--force' in heard.err
    return heard.err


def test_a_camera_file_that_exists_is_kept_and_no_work_is_begun(driven, capsys, monkeypatch):
    Path('camera.yaml').write_text(MINE, encoding='utf-8')
    with monkeypatch.context() as patch:
        patch.setattr(calibrate_input, 'calibrate_input', None)
        assert 'camera.yaml exists already' in refused(capsys, 'calibrate', driven[0], *SIZE)
    assert Path('camera.yaml').read_text(encoding='utf-8') == MINE
    # devices and standard output have nothing to lose
    check_outputs(('-', '/dev/null', None), (driven[0],), False)
    assert selfcal('calibrate', driven[0], *SIZE, '--force', '-q') == 0
    assert 'image_width: 640' in Path('camera.yaml').read_text(encoding='utf-8')


@pytest.mark.long
def test_a_camera_file_of_an_earlier_run_is_replaced_where_nobody_has_named_it(driven, capsys):
    assert selfcal('calibrate', driven[0], *SIZE) == 0
    assert 'Written: camera.yaml.' in capsys.readouterr().out
    assert selfcal('calibrate', driven[0], *SIZE) == 0
    assert 'Written: camera.yaml (replaced).' in capsys.readouterr().out
    assert 'exists already' in refused(capsys, 'calibrate', driven[0], *SIZE, '--output',
                                       'camera.yaml')


def test_missing_folders_of_outputs_are_made_but_for_what_is_refused(driven, capsys,
                                                                     without_figures):
    assert selfcal('calibrate', driven[0], *SIZE, '-q', '--output', 'a/b/c.yaml', '--json',
                   'r/result.json', '--report', 'p/q/report.html', '--colmap', 'm/n') == 0
    for name in ('a/b/c.yaml', 'r/result.json', 'p/q/report.html', 'm/n/cameras.txt'):
        assert Path(name).is_file(), name
    assert selfcal('convert', 'a/b/c.yaml', 'sparse/0/cameras.bin') == 0
    capsys.readouterr()
    assert selfcal('calibrate', driven[0], *SIZE, '--output', 'x/y/c.yaml', '--json',
                   'a/b/c.yaml/z/result.json') == 2
    assert 'is not a folder' in capsys.readouterr().err
    assert not Path('x').exists()


def test_a_camera_file_that_another_run_makes_meanwhile_is_kept_and_told(driven, capsys,
                                                                         monkeypatch):
    work = calibrate_input.calibrate_input

    def slow(*arguments):
        Path('camera.yaml').write_text(MINE, encoding='utf-8')
        return work(*arguments)

    monkeypatch.setattr(calibrate_input, 'calibrate_input', slow)
    assert selfcal('calibrate', driven[0], *SIZE, '--json', 'result.json') == 2
    heard = capsys.readouterr()
    assert heard.err.count('\n') == 1 and 'camera.yaml has been made meanwhile' in heard.err
    # the result is not lost: it is printed, and what was asked for beside is written
    assert 'fx ' in heard.out and 'Written: result.json.' in heard.out
    assert Path('camera.yaml').read_text(encoding='utf-8') == MINE
    assert Path('result.json').exists()


@pytest.mark.parametrize('arguments', [
    ['calibrate', 'in.csv', '--output', 'mine'],
    ['calibrate', 'in.csv', 'in.csv', '--output-dir', 'earlier'],
    ['model', 'in', '--camera', 'c.yaml', '--output', 'mine.cao'],
    ['convert', 'c.yaml', 'mine', '--to', 'opencv'],
    ['demo', '--no-ros', '--output-dir', 'earlier']])
def test_every_verb_keeps_a_camera_or_a_model(arguments, capsys, monkeypatch):
    write_camera_yaml('c.yaml', Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], [], 640, 480),
                      'c')
    Path('in.csv').write_text('frame,track,x,y\n0,0,1,1\n', encoding='utf-8')
    Path('earlier/recordings').mkdir(parents=True)
    mine = [Path(name) for name in ('mine', 'mine.cao', 'mine.png', 'earlier/camera.yaml',
                                    'earlier/poses.csv', 'earlier/recordings/d0.yaml')]
    for path in mine:
        path.write_text(MINE, encoding='utf-8')
    monkeypatch.setattr(tracking_run, 'track_objects', None)
    assert 'exists already' in refused(capsys, *arguments)
    assert all(path.read_text(encoding='utf-8') == MINE for path in mine)


def test_what_is_derived_is_replaced_and_an_empty_file_is_no_camera(driven, capsys,
                                                                    without_figures):
    for name in ('old.json', 'old.html', 'old.ply'):
        Path(name).write_text(MINE, encoding='utf-8')
    Path('empty.yaml').touch()
    assert selfcal('calibrate', driven[0], *SIZE, '--output', 'empty.yaml', '--json', 'old.json',
                   '--report', 'old.html', '--ply', 'old.ply', '-q') == 0
    for name in ('old.json', 'old.html', 'old.ply', 'empty.yaml'):
        assert Path(name).read_text(encoding='utf-8', errors='replace') not in ('', MINE)


def test_the_demo_replaces_its_own_folder(capsys, monkeypatch):
    monkeypatch.setattr('selfcal_ros.cli.demo._from_bag', _stop)
    Path('selfcal_demo').mkdir()
    Path('selfcal_demo/camera.yaml').write_text(MINE, encoding='utf-8')
    for more in ([], ['--output-dir', 'selfcal_demo', '--force']):
        with pytest.raises(EOFError):
            _demo(*more)


@pytest.mark.parametrize('recording', ['agv', 'object'])
def test_an_interrupted_demo_leaves_no_folder_of_logs(recording, monkeypatch):
    def interrupted(module, arguments, environment):
        list(arguments)
        Path(environment['ROS_LOG_DIR']).mkdir(exist_ok=True)
        Path(environment['ROS_LOG_DIR'], 'python.log').touch()
        raise KeyboardInterrupt

    monkeypatch.delenv('ROS_LOG_DIR', raising=False)
    monkeypatch.setattr('selfcal_ros.cli.demo.without_nodes', lambda *_: False)
    monkeypatch.setattr('selfcal_ros.pipeline.child_process.run_module', interrupted)
    with pytest.raises(KeyboardInterrupt):
        selfcal('demo', '--recording', recording)
    assert not Path('selfcal_demo').exists()
    # the logs of an earlier demo stay
    Path('selfcal_demo/log').mkdir(parents=True)
    with pytest.raises(KeyboardInterrupt):
        selfcal('demo', '--recording', recording)
    assert Path('selfcal_demo/log').is_dir()


@pytest.mark.parametrize('words', [
    ('calibrate', 'drive.csv', '--output', '-'), ('calibrate', 'drive.csv', '--report', '-'),
    ('calibrate', 'drive.csv', '--ply', '-'), ('track', 'bag', '--output', '-'),
    ('convert', 'camera.yaml', '-')])
def test_no_file_is_called_as_the_standard_output(capsys, words):
    assert selfcal(*words) == 2
    assert "'-' is for --json alone" in capsys.readouterr().err


def test_the_logs_of_the_last_demo_replace_those_of_earlier_ones():
    log = Path('folder/log')
    log.mkdir(parents=True)
    for name in ('python_12_3400.log', 'notes.log'):
        (log / name).touch()
    with pytest.raises(KeyboardInterrupt), log_folder(log.parent):
        raise KeyboardInterrupt
    with log_folder(log.parent):
        # a user may send logs elsewhere
        pass
    assert logs_in(log.parent) == {log / 'python_12_3400.log'}
    with log_folder(log.parent):
        (log / 'python_13_3500.log').touch()
    assert sorted(one.name for one in log.iterdir()) == ['notes.log', 'python_13_3500.log']


def _stop(_):
    raise EOFError


def _demo(*more):
    from selfcal_ros.cli.demo import run
    from selfcal_ros.cli.main import build_parser
    run(build_parser('demo').parse_args(['demo', '--no-ros', *more]))
