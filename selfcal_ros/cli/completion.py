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
`selfcal completion`: what makes the TAB key of bash, zsh and fish complete our words.

argcomplete asks the parser itself, so that no option can be missing. Here stands what it cannot
know: which values are names of files, and which are numbers, for which there is nothing to offer.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
import os
from pathlib import Path

from selfcal_ros.cli.parsing import output_path
from selfcal_ros.cli.status import EXIT_DONE

SHELLS = ('bash', 'zsh', 'fish')
#: How to switch it on, a line a shell.
HOW = {'bash': 'eval "$(selfcal completion bash)"      in ~/.bashrc',
       'zsh': 'eval "$(selfcal completion zsh)"       in ~/.zshrc, after compinit',
       'fish': 'selfcal completion fish | source       in ~/.config/fish/config.fish'}
#: Set by the script of a shell when it asks for words.
ASKED = '_ARGCOMPLETE'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `selfcal completion`."""
    parser.add_argument('shell', choices=SHELLS, metavar=f'{{{",".join(SHELLS)}}}',
                        help='whose TAB key')
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = 'Switch it on with\n  ' + '\n  '.join(HOW.values())


def run(args: argparse.Namespace) -> int:
    """Print the script; returns the exit status."""
    from argcomplete import shellcode
    # without its defaults: after a number no names of files are offered
    print(shellcode(['selfcal'], use_defaults=False, shell=args.shell))
    return EXIT_DONE


def verb_asked_for(verbs: Iterable[str]) -> str | None:
    """Return the verb on the line that a shell completes; None before there is one."""
    line = os.environ.get('COMP_LINE', '')[:int(os.environ.get('COMP_POINT') or 0) or None]
    # the last word is the one that is being typed
    return next((word for word in line.split()[1:] if word in verbs), None)


def answer(parser: argparse.ArgumentParser) -> None:
    """Tell the shell which words fit, and end the process."""
    from argcomplete import autocomplete
    from argcomplete.completers import FilesCompleter, SuppressCompleter
    for action in _actions(parser):
        if action.nargs == 0 or action.choices is not None:
            continue
        is_file = action.type in (Path, output_path) or not action.option_strings
        action.completer = FilesCompleter() if is_file else _nothing  # type: ignore[attr-defined]
    autocomplete(parser, always_complete_options=False, default_completer=SuppressCompleter())


def _actions(parser: argparse.ArgumentParser) -> Iterable[argparse.Action]:
    """Yield the actions of a parser and of the verbs in it."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in set(action.choices.values()):
                yield from _actions(verb)
        else:
            yield action


def _nothing(**_: object) -> tuple[str, ...]:
    """Offer nothing."""
    return ()
