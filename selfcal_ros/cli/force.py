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
--force: no verb replaces a file that exists without it.

A calibration file may be what a driver serves, and a model or a table what somebody has worked on.
So all outputs of all verbs follow one rule, and it is looked after before the work.
"""

from __future__ import annotations

from collections.abc import Iterable
import os

from selfcal_ros.cli.machine_output import STANDARD_OUTPUT
from selfcal_ros.errors import InputError


def add_force_argument(parser, what: str = 'replace output files that exist already') -> None:
    """Add the option --force to a verb, or to a group of its arguments."""
    parser.add_argument('--force', action='store_true', help=what)


def check_outputs(outputs: Iterable[str | os.PathLike | None],
                  inputs: Iterable[str | os.PathLike | None], force: bool) -> None:
    """
    Make sure before the work that outputs can be written, and replace nothing without a word.

    Parameters
    ----------
    outputs : iterable of path or None
        None and '-' are passed over, and devices such as /dev/null have nothing to lose.
    inputs : iterable of path or None
    force : bool
        Whether --force was given.

    Raises
    ------
    InputError, ArgumentError
        If a file exists already; see also `selfcal_ros.report.files.check_outputs`.

    """
    from selfcal_ros.report import files
    named = [path for path in outputs if path is not None and str(path) != STANDARD_OUTPUT]
    files.check_outputs(named, inputs)
    taken = [] if force else [str(path) for path in named if os.path.isfile(path)]
    if len(taken) == 1:
        raise InputError(f'{taken[0]} exists already; choose another name, or replace it with '
                         '--force.')
    if taken:
        raise InputError(f'{", ".join(taken[:-1])} and {taken[-1]} exist already; choose other '
                         'names, or replace them with --force.')
