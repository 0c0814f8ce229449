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
"""Exit statuses of the command line."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

EXIT_DONE = 0
EXIT_NOT_CALIBRATED = 1
#: Calibrations differ by more than was allowed for.
EXIT_DIFFER = 1
EXIT_INPUT = 2
#: A fault of the program, as in sysexits.h.
EXIT_FAULT = 70


class LeftOut(NamedTuple):
    """Why an output that was asked for was not written, and the exit status that tells of it."""

    sentence: str
    status: int = EXIT_NOT_CALIBRATED


def status_of(done: bool, left_out: Iterable[LeftOut]) -> int:
    """Return the exit status of a run that is done or not, and has left outputs out."""
    return max([EXIT_DONE if done else EXIT_NOT_CALIBRATED, *(one.status for one in left_out)])
