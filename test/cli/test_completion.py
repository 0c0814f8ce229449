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
"""The TAB key: real shells, and every option that the parsers know."""

import argparse
import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest
from selfcal_ros.cli import main as command
from selfcal_ros.cli.completion import SHELLS

#: What bash does when TAB is pressed at the end of a line.
PRESS_TAB = """
COMP_LINE="$1"; COMP_POINT=${#1}; COMP_TYPE=9
read -ra COMP_WORDS <<< "$1"; case "$1" in *" ") COMP_WORDS+=("");; esac
COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
_python_argcomplete selfcal
printf "%s\\n" "${COMPREPLY[@]}"
"""


def environment(**more):
    """Let shells find the installed command, and nobody's settings."""
    return {**os.environ, 'PATH': os.pathsep.join([str(Path(sys.executable).parent),
                                                   os.environ['PATH']]), **more}


def script(shell, capsys):
    """Return the script for a shell."""
    assert command.main(['completion', shell]) == 0
    return capsys.readouterr().out


def ask_bash(text, line, folder):
    """Return what bash offers at the end of a line."""
    if not shutil.which('bash'):
        pytest.skip('bash is not installed')
    if not (Path(sys.executable).parent / 'selfcal').exists():
        pytest.skip('selfcal is not installed in this environment')
    done = subprocess.run(['bash', '--norc', '-c', text + PRESS_TAB, 'bash', line], cwd=folder,
                          capture_output=True, text=True, timeout=60, env=environment())
    assert done.stderr == '' and done.returncode == 0
    return done.stdout.split()


@pytest.mark.parametrize('line, expected', [
    ('selfcal c', ['calibrate', 'compare', 'convert', 'completion']),
    ('selfcal calibrate --motion p', ['planar']),
    ('selfcal calibrate x.mcap --cam', ['--camera', '--cameras', '--camera-name',
                                        '--camera-frame']),
    ('selfcal convert --to ', ['ros', 'opencv', 'kalibr', 'colmap', 'mrcal', 'urdf', 'tf',
                               'moveit', 'easy_handeye2', 'easy_handeye']),
    ('selfcal convert d', ['drive.mcap', 'drives/']),
    ('selfcal calibrate --report dr', ['drive.mcap', 'drives/']),
    ('selfcal calibrate --skew ', []),
    ('selfcal completion z', ['zsh']),
])
def test_bash_offers_what_fits(tmp_path, capsys, line, expected):
    (tmp_path / 'drive.mcap').touch()
    (tmp_path / 'drives').mkdir()
    assert sorted(ask_bash(script('bash', capsys), line, tmp_path)) == sorted(expected)


@pytest.mark.parametrize('verb', command.VERBS)
def test_every_option_is_offered_and_no_hidden_one(verb, tmp_path, capsys):
    offered = ask_bash(script('bash', capsys), f'selfcal {verb} --', tmp_path)
    parser = command.build_parser(verb)
    chosen, = (action.choices[verb] for action in parser._actions
               if isinstance(action, argparse._SubParsersAction))
    shown = {name for action in chosen._actions if action.help != argparse.SUPPRESS
             for name in action.option_strings if name.startswith('--')}
    assert set(offered) == shown


@pytest.mark.parametrize('shell', SHELLS)
def test_every_shell_has_a_script(shell, capsys):
    assert 'selfcal' in script(shell, capsys)


@pytest.mark.parametrize('shell', ['zsh', 'fish'])
def test_the_other_shells_can_parse_their_scripts(shell, tmp_path, capsys):
    if not shutil.which(shell):
        pytest.skip(f'{shell} is not installed')
    path = tmp_path / f'selfcal.{shell}'
    path.write_text(script(shell, capsys), encoding='utf-8')
    done = subprocess.run([shell, '-n', str(path)], capture_output=True, text=True, timeout=30)
    assert done.returncode == 0 and done.stderr == ''


def test_fish_offers_what_fits(tmp_path, capsys):
    if not shutil.which('fish'):
        pytest.skip('fish is not installed')
    path = tmp_path / 'selfcal.fish'
    path.write_text(script('fish', capsys), encoding='utf-8')
    for line, expected in (('selfcal calibrate --motion p', 'planar'), ('selfcal tr', 'track')):
        ask = f'source {path}; complete -C "{line}"'
        done = subprocess.run(['fish', '--no-config', '-c', ask], capture_output=True,
                              text=True, timeout=30, env=environment(HOME=str(tmp_path)))
        assert done.stdout.split()[0] == expected
