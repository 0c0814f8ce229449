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
"""The man page: every option is in it, groff has no warning, and it is installed."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import re
import shutil
import subprocess

import pytest
from selfcal_ros.cli.main import VERBS

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / 'docs' / 'selfcal.1'


@pytest.fixture(scope='module')
def made():
    """Return the module that makes the page."""
    spec = spec_from_file_location('make_man', ROOT / 'docs' / 'make_man.py')
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_option_of_every_verb_has_its_entry(made):
    text = PAGE.read_text(encoding='utf-8').replace('\\-', '-')
    parts = dict(zip(*[iter(re.split(r'^\.SS selfcal (\w+)$', text, flags=re.M)[1:])] * 2))
    assert parts.keys() == VERBS.keys()
    for verb, part in parts.items():
        for action in made._parser_of(verb)._actions:
            for option in action.option_strings if made._is_shown(action) else ():
                assert f'\\fB{option}\\fR' in part, f'{verb} {option}'


def test_groff_has_no_warning():
    if not shutil.which('groff'):
        pytest.skip('groff is not installed')
    done = subprocess.run(['groff', '-ww', '-man', '-z', str(PAGE)], capture_output=True,
                          text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, '', '')


def test_what_roff_takes_for_its_own_is_escaped(made):
    assert made._plain('.cao, or \\x -- ä') == r'\&.cao, or \ex \-\- \[u00E4]'


def test_it_is_installed_where_man_looks():
    assert "('share/man/man1', ['docs/selfcal.1'])" in (ROOT / 'setup.py').read_text(
        encoding='utf-8')
