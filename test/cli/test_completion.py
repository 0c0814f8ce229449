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

import os
import shutil
import subprocess

import pytest
from selfcal_ros.cli import main as command
from selfcal_ros.cli.completion import options_of, SHELLS


def script(shell, capsys):
    """Return the script for a shell."""
    assert command.main(['completion', shell]) == 0
    return capsys.readouterr().out


def ask_bash(text, words, folder):
    """Return what bash offers for the last of the words."""
    if not shutil.which('bash'):
        pytest.skip('bash is not installed')
    quoted = ' '.join(f"'{word}'" for word in words)
    code = (f'{text}\nCOMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}; _selfcal; '
            'printf "%s\\n" "${COMPREPLY[@]}"')
    done = subprocess.run(['bash', '--norc', '-c', code], cwd=folder, capture_output=True,
                          text=True, timeout=30)
    assert done.stderr == '' and done.returncode == 0
    return done.stdout.split()


@pytest.mark.parametrize('words, expected', [
    (['selfcal', 'c'], ['calibrate', 'compare', 'convert', 'completion']),
    (['selfcal', 'calibrate', '--motion', 'p'], ['planar']),
    (['selfcal', 'calibrate', 'x.mcap', '--cam'], ['--camera', '--camera-name']),
    (['selfcal', 'convert', '--to', ''], ['ros', 'opencv', 'kalibr', 'colmap']),
    (['selfcal', 'convert', 'd'], ['drive.mcap', 'drives']),
    (['selfcal', 'calibrate', '--report', 'dr'], ['drive.mcap', 'drives']),
    (['selfcal', 'calibrate', '--skew', ''], []),
    (['selfcal', 'completion', 'z'], ['zsh']),
])
def test_bash_offers_what_fits(tmp_path, capsys, words, expected):
    (tmp_path / 'drive.mcap').touch()
    (tmp_path / 'drives').mkdir()
    assert sorted(ask_bash(script('bash', capsys), words, tmp_path)) == sorted(expected)


@pytest.mark.parametrize('shell', SHELLS)
def test_every_option_is_offered_and_no_hidden_one(shell, capsys):
    text = script(shell, capsys)
    for verb in command.VERBS:
        parser = command.build_parser(verb)
        with pytest.raises(SystemExit):
            parser.parse_args([verb, '--help'])
        shown = capsys.readouterr().out
        for option in options_of(verb):
            for name in option.names if not option.positional else ():
                assert name in shown, f'{verb} has no {name}'
                assert (name if shell != 'fish' else name.lstrip('-')) in text
    assert '--seed' not in text and '-l seed' not in text


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
                              text=True, timeout=30, env={**os.environ, 'HOME': str(tmp_path)})
        assert done.stdout.split()[0] == expected
