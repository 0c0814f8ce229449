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
"""What is known of the order in which the rows of an image are read."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from selfcal_ros.findings.finding import Finding


@dataclass(frozen=True)
class RowReadout:
    """
    Rolling shutter: the rows of an image are read one after the other, or its columns.

    Attributes
    ----------
    line_delay_s, sigma_s : float or None
        Seconds from one line to the next, negative from the lowest row up, or from the right;
        None where the frames have no stamps.
    status : {'estimated', 'held'}
    intervals, intervals_sigma : float
        The time in which the whole image is read, in intervals between frames.
    rows : int
        How many lines there are: the height of the image, of columns its width.
    lines : {'rows', 'columns'}
        What is read one after the other. Columns where the image was turned upright since.

    """

    line_delay_s: float | None
    sigma_s: float | None
    status: str
    intervals: float
    intervals_sigma: float
    rows: int
    lines: str = 'rows'

    @classmethod
    def in_time(cls, line_delay_s: float, sigma_s: float, status: str, interval_s: float,
                size: tuple[int, int], lines: str) -> RowReadout:
        """Tell of a line delay with what is known of images: their interval and size in pixels."""
        count = size[1] if lines == 'rows' else size[0]
        intervals = count / interval_s
        return cls(line_delay_s, sigma_s, status, line_delay_s * intervals, sigma_s * intervals,
                   count, lines)

    @property
    def readout_s(self) -> float | None:
        """The time in which the whole image is read, seconds."""
        return None if self.line_delay_s is None else self.line_delay_s * self.rows

    def finding(self) -> Finding:
        """Say that rows are read one after the other, and how fast."""
        if self.status == 'held':
            return Finding('rolling_shutter_stated', lines=self.lines,
                           line_delay_us=1e6 * (self.line_delay_s or 0))
        if self.line_delay_s is None or self.sigma_s is None:
            return Finding('rolling_shutter_unstamped', lines=self.lines, readout={
                'value': self.intervals, 'sigma': self.intervals_sigma})
        return Finding('rolling_shutter', lines=self.lines, readout_ms={
            'value': 1e3 * self.line_delay_s * self.rows, 'sigma': 1e3 * self.sigma_s * self.rows})

    def as_dict(self) -> dict[str, Any]:
        """Return what a file holds."""
        return asdict(self)
