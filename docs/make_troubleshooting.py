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
Write the page of refusals and remarks from the tables of words.

`python docs/make_troubleshooting.py` writes docs/troubleshooting.md. A test holds that the page is
the one that this makes, so that each kind is on it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import re
import sys

from selfcal_ros.findings.closed_forms import CLOSED_FORMS
from selfcal_ros.findings.mounting import MOUNTING
from selfcal_ros.findings.phrase import MOTIONS, Phrase
from selfcal_ros.findings.refusals import REFUSALS
from selfcal_ros.findings.remarks import REMARKS
from selfcal_ros.values.output_files import atomic_write

HERE = Path(__file__).resolve().parent
_START = """# Troubleshooting

Made from the tables of words by `python docs/make_troubleshooting.py`; do not edit.

Each message has a kind. A program reads the kind in `result.json`: `kind` says why there is no
calibration, and `findings` lists everything that was found, with its numbers
([result-json.md](result-json.md)). In Python, `NotCalibrated.kind` and `Calibration.findings` say
the same. A name in braces stands for a number or a name that the message fills in.

Errors in the arguments and inputs have no kind. They are one sentence that says what to do, and
the exit status is 2.

- [Refusals](#refusals): why there is no calibration. The exit status is 1.
- [Mounts](#mounts): why it is not known where the camera sits on the robot.
- [Remarks](#remarks): what to know of a result, or of the tracks behind it.
- [Steps that give no estimate](#steps-that-give-no-estimate): mostly for programs that call them.
- [Motions that are suggested](#motions-that-are-suggested).
"""
_SECTIONS = (
    ('Refusals', 'Why there is no calibration. The command line and the nodes say what to do, '
     'too.', REFUSALS),
    ('Mounts', 'Why it is not known where the camera sits on the robot. The calibration itself '
     'stands.', MOUNTING),
    ('Remarks', 'They come with a result. The command line, the report and `notes` in the JSON '
     'show them.', REMARKS),
    ('Steps that give no estimate', 'Functions of one step return these. Where a calibration '
     'rests on one step alone, they are its refusal.', CLOSED_FORMS))
_ENDING = re.compile(r'\{\w+:(?:plural|[^|}]*\|([^}]*))\}')
_VALUE = re.compile(r'\{(\w+)(?::[^}]*)?\}')


def page() -> str:
    """Return the page as Markdown."""
    parts = [_START]
    for title, about, table in _SECTIONS:
        parts.append(f'## {title}\n\n{about}\n')
        parts += [_entry(kind, phrase) for kind, phrase in table.items()]
    parts.append('## Motions that are suggested\n\nThe remark `motion_suggestion` names one of '
                 'these in `motion`:\n')
    parts += [f'- `{name}`: {words}' for name, words in MOTIONS.items()]
    return '\n'.join(parts) + '\n'


def _entry(kind: str, phrase: Phrase) -> str:
    """Describe one kind."""
    # words that depend on a number are those of several
    said = _ENDING.sub(lambda found: found[1] or 's', phrase.sentence)
    said = _VALUE.sub(r'{\1}', said)
    return (f'### `{kind}`\n\n> {said}\n\n**What it means.** {phrase.means}\n\n'
            f'**What to do.** {phrase.advice}\n')


def main(argv=None) -> int:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--output', type=Path, default=HERE / 'troubleshooting.md')
    atomic_write(parser.parse_args(argv).output, page())
    return 0


if __name__ == '__main__':
    sys.exit(main())
