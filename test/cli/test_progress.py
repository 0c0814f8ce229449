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
"""How far the work has come: lines in a log, a bar on a terminal, nothing with -q."""

import io
import re

import pytest
from selfcal_ros.cli import progress as module
from selfcal_ros.cli.progress import Progress
from selfcal_ros.cli.time_left import rig_courses, TimeLeft
from test_support.command_line import selfcal, SIZE


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self):
        return True


@pytest.fixture
def work(monkeypatch):
    """Return what an hour of work leaves in a stream; a stage a minute, a step a second."""
    def run(stream, seconds, **how):
        monkeypatch.setattr(module, 'PATIENCE_S', 10.0)
        now = [0.0]
        with Progress(stream=stream, clock=lambda: now[0], **how) as progress:
            for second in range(seconds):
                now[0] = float(second)
                progress('tracking', second + 1, 4 * seconds)
            progress('estimating')
            now[0] += 7
        return stream.getvalue()
    return run


def test_a_log_has_lines_with_stages_their_times_and_what_is_left(work):
    said = work(io.StringIO(), 60)
    assert '\r' not in said and '\x1b' not in said
    lines = said.splitlines()
    assert all(re.match(r'\[ *\d+\.\d s\] \S', line) for line in lines)
    # a line every ten seconds, after the first ten; the stages at their ends
    stages = [line[11:].split()[0].strip(':') for line in lines]
    assert stages == ['tracking'] * 6 + ['estimating'] * 2
    assert lines[0] == '[  10.0 s] tracking: 11 of 240 (5 %), about 3 min left'
    assert lines[4] == '[  50.0 s] tracking: 51 of 240 (21 %), about 3 min left'
    assert lines[5] == '[  59.0 s] tracking: done in 59 s'
    assert lines[-1].endswith('estimating: done in 7.0 s')


def test_what_is_left_counts_the_stages_to_come(work):
    course = ((('tracking', None), ('estimating', 60), ('writing', 60)),)
    lines = work(io.StringIO(), 60, courses=course).splitlines()
    # 11 of 240 images in 10 s; 229 more, and what is worth 120
    assert lines[0] == '[  10.0 s] tracking: 11 of 240 (5 %), about 5 min left in all'
    left = TimeLeft(course)
    left.seconds('tracking', 0, 100, 0.0)
    assert left.seconds('tracking', 100, 100, 50.0) == pytest.approx(60.0)
    # 20 s into a stage that should take 30, before one that should, too
    left.seconds('estimating', 0, None, 50.0)
    assert left.seconds('estimating', 0, None, 70.0) == pytest.approx(40.0)
    # nobody knows of other stages
    assert left.seconds('waiting', 1, 10, 80.0) is None


def test_a_stage_begins_with_what_is_left_where_its_course_tells(work):
    course = ((('tracking', None), ('estimating', 60), ('writing', 60)),)
    lines = work(io.StringIO(), 60, courses=course).splitlines()
    # 240 images of 1 s, of which 60 were followed; then what is worth 120
    assert re.search(r'estimating \.\.\. \(about \d+ (s|min) left in all\)$', lines[-2])


def test_what_is_left_of_a_rig_counts_all_cameras():
    left = TimeLeft(rig_courses(['left', 'right']))
    left.seconds('tracking of left', 0, 100, 0.0)
    # 100 images in 10 s: 1240 more in what the other stages are worth
    assert left.seconds('tracking of left', 100, 100, 10.0) == pytest.approx(124.0)
    # few images are not followed first
    left = TimeLeft(rig_courses(['left', 'right']))
    left.seconds('reading right', 0, None, 0.0)
    left.seconds('features of left', 0, 20, 2.0)
    assert left.seconds('features of left', 20, 20, 12.0) == pytest.approx(112.0)


def test_short_work_is_silent_unless_v_asks_for_its_stages(work):
    assert work(io.StringIO(), 3) == ''
    said = work(io.StringIO(), 3, stages=True)
    assert 'tracking: done in 2.0 s' in said and 'estimating: done in 7.0 s' in said
    assert 'estimating: done' in work(Terminal(), 3, stages=True)
    assert work(io.StringIO(), 3000, wanted=False) == work(Terminal(), 30, wanted=False) == ''


def test_what_takes_no_time_is_done_without_a_figure():
    stream = io.StringIO()
    with Progress(stream=stream, stages=True, clock=lambda: 12.0) as progress:
        progress('writing')
    assert stream.getvalue() == '[   0.0 s] writing ...\n[   0.0 s] writing: done\n'


def test_a_terminal_has_a_bar_with_the_time_that_is_left(work):
    said = work(Terminal(), 30)
    assert '\r' in said and re.search(r'tracking: .*\|.*\[\d\d:\d\d<', said)
    assert 'estimating' in said and said.endswith(' \r')


def test_the_command_tells_its_stages_where_there_is_no_terminal(driven, capsys, monkeypatch):
    monkeypatch.setattr(module, 'PATIENCE_S', 0.0)
    assert selfcal('calibrate', driven[0], *SIZE) == 0
    heard = capsys.readouterr()
    told = [re.sub(r'^\[.*?\] ', '', line) for line in heard.err.splitlines()]
    assert [re.sub(r' in [\d.]+ \w+$', '', line) for line in told] == [
        'starting ...', 'starting: done', 'estimating ...', 'estimating: done',
        'writing ...', 'writing: done']
    assert selfcal('calibrate', driven[0], *SIZE, '-q', '--force') == 0
    assert capsys.readouterr() == ('', '')
