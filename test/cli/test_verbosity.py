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
"""-v and -q: what is said, and on which stream."""

import logging
import subprocess
import sys

import pytest
from selfcal_ros.cli import main as command

from test_support.command_line import selfcal, SIZE


@pytest.mark.long
def test_v_tells_on_standard_error_what_is_done(driven, capsys):
    assert selfcal('calibrate', driven[0], *SIZE) == 0
    quiet = capsys.readouterr()
    assert quiet.err == ''
    assert selfcal('calibrate', driven[0], *SIZE, '-v', '--force') == 0
    told = capsys.readouterr()
    assert told.out.replace(' (replaced)', '') == quiet.out
    assert 'INFO selfcal_ros.pipeline' in told.err and 'observations' in told.err
    assert 'calibrated by planar motion' in told.err
    # the next call begins anew
    assert selfcal('calibrate', driven[0], *SIZE, '--force') == 0
    assert capsys.readouterr().err == ''


def test_q_is_quiet(driven, capsys):
    assert selfcal('calibrate', driven[0], *SIZE, '-q') == 0
    assert capsys.readouterr() == ('', '')


@pytest.mark.parametrize('verb', command.VERBS)
def test_every_verb_has_v(verb, capsys):
    with pytest.raises(SystemExit):
        command.build_parser(verb).parse_args([verb, '--help'])
    assert '-v, --verbose' in capsys.readouterr().out


def test_the_library_says_nothing_to_a_program_that_has_not_asked():
    code = ('import logging, selfcal_ros; '
            'logging.getLogger("selfcal_ros.pipeline").warning("unwanted")')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, '', '')
    assert any(isinstance(handler, logging.NullHandler)
               for handler in logging.getLogger('selfcal_ros').handlers)
