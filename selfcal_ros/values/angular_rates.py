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
"""What a gyro measures: angular velocities, with their instants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.errors import InputError

#: No robot turns faster, rad/s; beyond it the values are degrees.
FASTEST_RAD_S = 40.0


@dataclass(frozen=True)
class AngularRates:
    """
    Angular velocities of a body, in the order of time.

    Parameters
    ----------
    stamps_ns : ndarray of int, shape (N,)
        Ascending, by the gyro's clock.
    rate_rad_s : ndarray, shape (N, 3)
        About the axes of the body.
    frame : str
        Name of the frame that the axes are those of.

    Raises
    ------
    InputError
        If shapes differ, a value is not finite, instants do not ascend, or the rates are degrees.

    """

    stamps_ns: np.ndarray
    rate_rad_s: np.ndarray
    frame: str = 'imu_link'

    def __post_init__(self) -> None:
        """Check the rates."""
        if self.rate_rad_s.shape != (len(self.stamps_ns), 3) or len(self.stamps_ns) < 2:
            raise InputError('Angular rates need instants (N,) and rates (N, 3), two or more; got '
                             f'{np.shape(self.stamps_ns)} and {self.rate_rad_s.shape}.')
        if not np.isfinite(self.rate_rad_s).all():
            raise InputError('An angular rate is not finite; remove it.')
        if (np.diff(self.stamps_ns) <= 0).any():
            raise InputError('Angular rates must be in the order of time, one at an instant.')
        if np.median(np.linalg.norm(self.rate_rad_s, axis=1)) > FASTEST_RAD_S:
            raise InputError('Angular rates must be in radians a second; these look like degrees, '
                             'so multiply them by 0.01745.')

    def __len__(self) -> int:
        """Count the measurements."""
        return len(self.stamps_ns)
