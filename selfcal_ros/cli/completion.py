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
"""
`selfcal completion`: words for the TAB key of bash, zsh and fish.

The script is made from the options as the verbs declare them, and then stands alone: a shell that
completes does not start Python.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
import re
import shlex

from selfcal_ros.cli.status import EXIT_DONE

SHELLS = ('bash', 'zsh', 'fish')
#: How to switch it on, a line a shell.
HOW = {'bash': 'eval "$(selfcal completion bash)"      in ~/.bashrc',
       'zsh': 'eval "$(selfcal completion zsh)"       in ~/.zshrc, after compinit',
       'fish': 'selfcal completion fish | source       in ~/.config/fish/config.fish'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `selfcal completion`."""
    parser.add_argument('shell', choices=SHELLS, help='whose TAB key')
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = 'Switch it on with\n  ' + '\n  '.join(HOW.values())


def run(args: argparse.Namespace) -> int:
    """Print the script; returns the exit status."""
    print({'bash': bash_script, 'zsh': zsh_script, 'fish': fish_script}[args.shell]())
    return EXIT_DONE


@dataclass(frozen=True)
class Option:
    """
    An option or a positional argument, as completion needs it.

    Attributes
    ----------
    names : tuple of str
        The spellings of an option; for a positional argument its only name.
    summary : str
        Its help as one line.
    choices : tuple of str
    values : int
        How many values follow; 0 for a switch, 1 for one or more.
    is_file : bool
        Whether a value names a file.
    repeats : bool
        Whether any number of values may follow.

    """

    names: tuple[str, ...]
    summary: str
    choices: tuple[str, ...] = ()
    values: int = 1
    is_file: bool = False
    repeats: bool = False

    @property
    def positional(self) -> bool:
        """Tell a positional argument."""
        return not self.names[0].startswith('-')


class _Recorder:
    """Stands in for a parser, and keeps what is declared."""

    def __init__(self):
        self.options = [Option(('-h', '--help'), 'show the help and exit', values=0)]

    def add_argument(self, *names, **declared) -> None:
        """Keep an argument, unless it is hidden."""
        text = declared.get('help') or ''
        if text == argparse.SUPPRESS:
            return
        nargs = declared.get('nargs', 1)
        switch = declared.get('action') in ('store_true', 'store_false')
        choices = tuple(map(str, declared.get('choices') or ()))
        positional = not names[0].startswith('-')
        self.options.append(Option(
            names, ' '.join(text.split()), choices,
            0 if switch else nargs if isinstance(nargs, int) else 1,
            not choices and (positional or declared.get('type') is Path), nargs in ('+', '*')))

    def add_argument_group(self, *_, **__) -> _Recorder:
        """Take groups for what they hold."""
        return self

    def add_mutually_exclusive_group(self, *_, **__) -> _Recorder:
        """Take groups for what they hold."""
        return self


def options_of(verb: str) -> list[Option]:
    """Return the arguments that a verb declares."""
    recorder = _Recorder()
    import_module(f'selfcal_ros.cli.{verb}').add_arguments(recorder)
    return recorder.options


def _verbs() -> dict[str, str]:
    from selfcal_ros.cli.main import VERBS
    return VERBS


def bash_script() -> str:
    """Return the script for bash (3.2 or later)."""
    cases, flags = [], []
    for verb in _verbs():
        options = options_of(verb)
        names = ' '.join(name for option in options if not option.positional
                         for name in option.names)
        words = ' '.join(word for option in options if option.positional
                         for word in option.choices)
        flags.append(f'        {verb}) options={shlex.quote(names)}; words={shlex.quote(words)};;')
        for option in options:
            if option.positional or not option.values:
                continue
            patterns = '|'.join(shlex.quote(f'{verb} {name}') for name in option.names)
            # without words of its own an option falls back to file names, or to nothing
            source = (f'-W {shlex.quote(" ".join(option.choices))}' if option.choices
                      else '-f' if option.is_file else '')
            reply = f'COMPREPLY=($(compgen {source} -- "$word"))' if source else ':'
            cases.append(f'        {patterns}) {reply}; return;;')
    verbs = ' '.join([*_verbs(), '--help', '--version'])
    return '\n'.join([
        '# bash completion of selfcal; made by: selfcal completion bash',
        '_selfcal() {',
        '    local word="${COMP_WORDS[COMP_CWORD]}" previous="${COMP_WORDS[COMP_CWORD-1]}"',
        '    local verb="" options="" words="" each',
        '    COMPREPLY=()',
        '    for each in "${COMP_WORDS[@]:1:COMP_CWORD-1}"; do',
        '        case "$each" in -*) ;; *) verb="$each"; break;; esac',
        '    done',
        '    if [ -z "$verb" ]; then',
        f'        COMPREPLY=($(compgen -W {shlex.quote(verbs)} -- "$word")); return',
        '    fi',
        '    case "$verb $previous" in', *cases, '    esac',
        '    case "$verb" in', *flags, '    esac',
        '    case "$word" in',
        '        -*) COMPREPLY=($(compgen -W "$options" -- "$word"));;',
        '        *) if [ -n "$words" ]; then COMPREPLY=($(compgen -W "$words" -- "$word"))',
        '           else COMPREPLY=($(compgen -f -- "$word")); fi;;',
        '    esac',
        '}',
        # names of files are quoted, and folders get their slash
        'complete -o filenames -F _selfcal selfcal'])


def zsh_script() -> str:
    """Return the script for zsh."""
    lines = ['#compdef selfcal', '# zsh completion of selfcal; made by: selfcal completion zsh',
             '_selfcal() {', '    local -a commands', '    commands=(']
    lines += [f'        {shlex.quote(_zsh(verb) + ":" + _zsh(summary))}'
              for verb, summary in _verbs().items()]
    lines += ['    )', '    if (( CURRENT == 2 )); then', "        _describe 'command' commands",
              '        return', '    fi', '    local verb=$words[2]', '    shift words',
              '    (( CURRENT-- ))', '    case $verb in']
    for verb in _verbs():
        specs = [shlex.quote(spec) for option in options_of(verb) for spec in _zsh_specs(option)]
        lines += [f'        {verb}) _arguments -s -S \\',
                  *(f'            {spec} \\' for spec in specs), '        ;;']
    return '\n'.join([*lines, '    esac', '}',
                      # sourced, or found as a function of its name
                      'if [ "$funcstack[1]" = "_selfcal" ]; then _selfcal "$@"; '
                      'else compdef _selfcal selfcal; fi'])


def _zsh(text: str) -> str:
    """Escape what _arguments and _describe would read as theirs."""
    return re.sub(r'([\[\]:\\])', r'\\\1', text)


def _zsh_specs(option: Option) -> list[str]:
    """Return the specifications of _arguments for an option."""
    action = (f'({" ".join(option.choices)})' if option.choices
              else '_files' if option.is_file else ' ')
    if option.positional:
        return [f'{"*" if option.repeats else ""}:{option.names[0]}:{action}']
    value = f':{_zsh(option.names[-1].lstrip("-"))}:{action}' * option.values
    return [f'{name}[{_zsh(option.summary)}]{value}' for name in option.names]


def fish_script() -> str:
    """Return the script for fish."""
    lines = ['# fish completion of selfcal; made by: selfcal completion fish',
             'complete -c selfcal -n __fish_use_subcommand -f -l help -s h -d '
             "'show the help and exit'",
             "complete -c selfcal -n __fish_use_subcommand -f -l version -d 'print the version'"]
    for verb, summary in _verbs().items():
        lines.append(f'complete -c selfcal -n __fish_use_subcommand -f -a {verb} -d '
                     f'{_fish(summary)}')
        for option in options_of(verb):
            words = ['complete -c selfcal -n', f"'__fish_seen_subcommand_from {verb}'"]
            if option.positional:
                if not option.choices:
                    continue
                words += ['-f -a', _fish(' '.join(option.choices))]
            else:
                words += [f'-l {name[2:]}' if name.startswith('--') else f'-s {name[1:]}'
                          for name in option.names]
                if option.choices:
                    words += ['-x -a', _fish(' '.join(option.choices))]
                elif option.values:
                    words.append('-r -F' if option.is_file else '-x')
            lines.append(' '.join([*words, '-d', _fish(option.summary)]))
    return '\n'.join(lines)


def _fish(text: str) -> str:
    """Quote for fish, in which only backslash and quote are special between quotes."""
    return "'" + text.replace('\\', '\\\\').replace("'", "\\'") + "'"
