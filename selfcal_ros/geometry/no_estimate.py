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
"""What an estimator returns when the data do not determine what was asked."""

from __future__ import annotations

from typing import Any, Literal

from selfcal_ros.findings.finding import Finding


class NoEstimate(Finding):
    """
    Why there is no estimate; false in a condition.

    The one shape of a failure of the data: a kind with the numbers that decided. Its words come
    from the tables in `selfcal_ros.findings`.

    Parameters
    ----------
    kind : str
        One of `selfcal_ros.findings.finding.KINDS`.
    **values
        What the words of this kind name, and more that callers can use.

    """

    @property
    def reason(self) -> str:
        """Why, in a sentence or two."""
        return self.sentence

    def __bool__(self) -> Literal[False]:
        """Be false: there is no estimate."""
        return False

    def saying(self, **values: Any) -> NoEstimate:
        """Return the same failure with more values."""
        return NoEstimate(self.kind, **{**self.values, **values})
