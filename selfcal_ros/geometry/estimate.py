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

from dataclasses import dataclass


@dataclass(frozen=True)
class NoEstimate:
    """
    Why there is no estimate; false in a condition.

    Attributes
    ----------
    reason : str
        One sentence, with the number that decided.
    kind : str
        For programs: 'too_few', 'no_rotation', 'no_parallax', 'not_planar', 'circular',
        'no_triplet', 'ill_conditioned', 'indefinite' or 'no_fact'.

    """

    reason: str
    kind: str = ''

    def __bool__(self) -> bool:
        """Be false: there is no estimate."""
        return False

    def __str__(self) -> str:
        """Say why."""
        return self.reason
