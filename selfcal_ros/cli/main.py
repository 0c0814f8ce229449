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
"""`selfcal`: one verb, one file; a verb is imported only when it is used."""

from __future__ import annotations

import argparse
from contextlib import suppress
from importlib import import_module
import os
import sys
import traceback

from selfcal_ros.cli import completion
from selfcal_ros.cli.own_process import end_if_told_to, own_process, silence
from selfcal_ros.cli.parsing import SentenceParser
from selfcal_ros.cli.status import EXIT_DONE, EXIT_FAULT, EXIT_INPUT
from selfcal_ros.cli.verbosity import add_verbose_argument, library_messages

#: Verb and what it does; each is a module of this package with `add_arguments` and `run`.
VERBS = {
    'calibrate': 'calibrate a camera from a recording of its own motion',
    'compare': 'compare two calibration files, in pixels over the image',
    'convert': 'turn images into a bag, or a camera file into that of another program',
    'track': 'follow a known object through a recording',
    'model': 'make a wireframe model of an object from two images',
    'watch': 'show the running nodes on a live page',
    'completion': 'print the words for the TAB key of a shell',
    'demo': 'replay the recorded drive of this package and calibrate it',
}


def build_parser(verb: str | None = None) -> argparse.ArgumentParser:
    """Build the parser; only the chosen verb gets its arguments."""
    parser = SentenceParser(
        prog='selfcal', description='Calibrate a camera from what it sees while it moves.',
        epilog='Exit status: 0 done, 1 could not calibrate, or not write a file that was asked '
               'for (and says why), 2 the input or the arguments are wrong.')
    parser.add_argument('--version', action='store_true', help='print the version and exit')
    commands = parser.add_subparsers(dest='verb', metavar='COMMAND')
    for name, summary in VERBS.items():
        command = commands.add_parser(name, help=summary, description=summary.capitalize() + '.')
        if name == verb:
            import_module(f'selfcal_ros.cli.{name}').add_arguments(command)
            add_verbose_argument(command)
    return parser


def main(argv: list[str] | None = None) -> int:
    """
    Run the command line.

    Returns
    -------
    int
        Exit status: 0 done, 1 could not calibrate or write what was asked for, 2 wrong input or
        arguments.

    """
    if completion.ASKED in os.environ:
        completion.answer(build_parser(completion.verb_asked_for(VERBS)))
    if argv is not None:
        return _run(list(argv))
    # the demo shows what its nodes log, and whoever wants to hear more gets everything
    loud = any(word == 'demo' or word.startswith(('-v', '--verb')) for word in sys.argv[1:])
    verb = _verb_of(sys.argv[1:])
    # a page is watched until it is closed
    unfinished = '' if verb == 'watch' else (
        f'{_name_of(verb)}: interrupted; each file that it wrote by then is whole.')
    with own_process(library_noise=loud, unfinished=unfinished):
        return _run(sys.argv[1:])
    return EXIT_FAULT


def _verb_of(argv: list[str]) -> str | None:
    """Return the first word that is no option."""
    return next((word for word in argv if not word.startswith('-')), None)


def _name_of(verb: str | None) -> str:
    """Return what a verb is called in messages."""
    return f'selfcal {verb}' if verb in VERBS else 'selfcal'


def _run(argv: list[str]) -> int:
    """Run a verb; what goes wrong is a sentence."""
    from selfcal_ros.errors import SelfcalError
    verb = _verb_of(argv)
    name = _name_of(verb)
    try:
        parser = build_parser(verb)
        args = parser.parse_args(argv)
        args.command_line = ('selfcal', *argv)    # for the report
        if args.version:
            from selfcal_ros.version import SOFTWARE
            print(SOFTWARE, flush=True)
            return EXIT_DONE
        if args.verb is None:
            parser.print_help()
            return EXIT_INPUT
        with library_messages(args):
            status: int = import_module(f'selfcal_ros.cli.{args.verb}').run(args)
        sys.stdout.flush()
        return status
    except SelfcalError as error:
        sentence = str(error)
    except BrokenPipeError:
        # the reader of our output went away: nothing is left to say, not even at exit
        silence(sys.stdout)
        return EXIT_DONE
    except OSError as error:
        what = f' {error.filename}' if error.filename else ' standard output'
        sentence = f'Cannot use{what}: {error.strerror or error}.'
        if not error.filename:
            silence(sys.stdout)
    except MemoryError:
        sentence = ('There is not enough memory for this input; use smaller images, or fewer of '
                    'them.')
    except Exception:
        end_if_told_to()
        # not 1, which says that the data did not suffice
        traceback.print_exc()
        print(f'{name}: this is a fault of selfcal_ros; please report the lines '
              'above.', file=sys.stderr)
        return EXIT_FAULT
    from selfcal_ros.cli.colours import complaint
    with suppress(OSError):
        print(complaint(name, sentence), file=sys.stderr)
    return EXIT_INPUT


if __name__ == '__main__':
    sys.exit(main())
