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
"""The line delay of a rolling shutter in a camera file: CameraInfo has no field for it."""

from __future__ import annotations

import math
import re

from selfcal_ros.calibration.row_readout import RowReadout

#: What the line begins with; `selfcal track` looks for it.
_MARK = 'rolling shutter: line_delay '
_STORED = re.compile(rf'^# {_MARK}(\S+) s .*\bby (rows|columns)\b', re.MULTILINE)


def shutter_comment(shutter: RowReadout | None) -> list[str]:
    """Return the line for a camera file that tells how its lines are read; none if at once."""
    if shutter is None:
        return []
    if shutter.line_delay_s is None:
        return [f'rolling shutter: all {shutter.lines} in {shutter.intervals:.4g} +- '
                f'{shutter.intervals_sigma:.2g} intervals between frames']
    return [f'{_MARK}{shutter.line_delay_s:.6g} s +- {shutter.sigma_s:.2g} s, by {shutter.lines} '
            f'({shutter.status})']


def stored_line_delay(text: str) -> tuple[float, str] | None:
    """
    Return the line delay that the comments of a camera file tell.

    Parameters
    ----------
    text : str
        Of the whole file.

    Returns
    -------
    (float, {'rows', 'columns'}) or None
        Seconds from one line to the next, and which lines; None where there is no such comment.

    """
    found = _STORED.search(text)
    try:
        seconds = float(found[1]) if found else math.nan
    except ValueError:
        return None
    return (seconds, found[2]) if found and math.isfinite(seconds) else None
