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
"""What a monitored camera may change in, what counts as a change, and how one is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding

#: What may change suddenly. The aspect ratio belongs to the sensor; a change of the distortion
#: shows as one of these.
CHANGES = ('f', 'cx', 'cy')
CHANGE_NAMES = ('focal length', 'cx', 'cy')
#: A parameter counts as changed when its change exceeds so many sigmas.
SAID_SIGMAS = 3.0


@dataclass(frozen=True)
class MonitorSettings:
    """
    What counts as a change, and how rarely one may be reported where there is none.

    Parameters
    ----------
    keyframes : int
        In a window; successive windows share one.
    false_alarm_keyframes : float
        Mean number of keyframes between false alarms, at least.
    tolerance_px : float
        Standard deviation of the displacement, half an image diagonal from the middle, that is
        no change: no two scenes show a camera exactly alike.
    tolerance_deg : float
        Standard deviation of a turn of the camera on its robot that is no change.

    Raises
    ------
    ArgumentError
        If a value is impossible.

    """

    keyframes: int = 9
    false_alarm_keyframes: float = 3.6e6
    tolerance_px: float = 0.25
    tolerance_deg: float = 0.03

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        if not 4 <= self.keyframes <= 100:
            raise ArgumentError('A window of the monitor has 4 to 100 keyframes, '
                                f'not {self.keyframes!r}.')
        if not self.false_alarm_keyframes >= 100:
            raise ArgumentError('The monitor needs at least 100 keyframes between false alarms, '
                                f'not {self.false_alarm_keyframes!r}.')
        if not 0 < self.tolerance_px < 100:
            raise ArgumentError('The tolerance of the monitor lies between 0 and 100 px, '
                                f'not {self.tolerance_px!r}.')
        if not 0 < self.tolerance_deg < 10:
            raise ArgumentError('The tolerance of the monitor lies between 0 and 10 degrees, '
                                f'not {self.tolerance_deg!r}.')

    @property
    def chance(self) -> float:
        """Of an alarm in the test of one window, where nothing changed."""
        return (self.keyframes - 1) / self.false_alarm_keyframes


def what_changed(names: Sequence[str], values: np.ndarray, sigmas: np.ndarray,
                 units: Sequence[str]) -> tuple[dict[str, Any], ...]:
    """Return those parts of a change that are clear; all where none is."""
    told = [{'name': name, 'value': value, 'sigma': sigma, 'unit': unit}
            for name, value, sigma, unit in zip(names, values.tolist(), sigmas.tolist(), units)]
    # significant together need not be significant one by one
    clear = [part for part in told if abs(part['value']) > SAID_SIGMAS * part['sigma']]
    return tuple(clear or told)


@dataclass(frozen=True)
class CameraChange:
    """
    A change of the camera; first order, so that a large one is stated roughly.

    Attributes
    ----------
    change_px : ndarray, shape (3,)
        Of focal length (fx), cx and cy, pixels.
    covariance : ndarray, shape (3, 3)
    focal_px : float
        fx in force.
    since_frame, clear_from_frame, until_frame : int
        First keyframe of the windows that differ; last keyframe of the first of them, from which
        on the camera is the changed one; last keyframe of the newest.
    statistic, threshold : float
        Twice the logarithm of the likelihood ratio, and what it had to exceed.

    """

    change_px: np.ndarray
    covariance: np.ndarray
    focal_px: float
    since_frame: int
    clear_from_frame: int
    until_frame: int
    statistic: float
    threshold: float

    @property
    def sigma_px(self) -> np.ndarray:
        """Standard deviations of the change, shape (3,)."""
        return np.sqrt(np.diag(self.covariance))

    def finding(self) -> Finding:
        """Tell what changed and by how much."""
        scale = np.array([100 / self.focal_px, 1, 1])
        return Finding('camera_changed', changes=what_changed(
            CHANGE_NAMES, self.change_px * scale, self.sigma_px * scale, ('%', 'px', 'px')))

    def __str__(self) -> str:
        """Say what changed and by how much."""
        return self.finding().clause
