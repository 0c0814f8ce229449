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
"""What is printed: JSON for programs, colours for terminals."""

import io
import json
from pathlib import Path
import re

import numpy as np
import pytest
from selfcal_ros.cli.colours import coloured
from selfcal_ros.synthetic.special_scenes import pure_translation
from test_support.command_line import selfcal, SIZE


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
    assert coloured('A hint, no calibration: so.', Terminal()).startswith('\x1b[1m\x1b[33m')
    assert '\x1b[33m' in coloured('a\nd1.csv hint: so', Terminal())
    assert '\x1b[31m' in coloured('a\nd1.csv not calibrated: no parallax', Terminal())
    monkeypatch.setenv('NO_COLOR', '1')
    assert coloured(text, Terminal()) == text
    monkeypatch.delenv('NO_COLOR')
    monkeypatch.setenv('TERM', 'dumb')
    assert coloured(text, Terminal()) == text
