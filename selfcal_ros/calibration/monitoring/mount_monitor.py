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
Was the camera knocked? The sequential test of the monitor, of how the camera is mounted.

What may change is the turn of the camera on its body. Its place and the offset of the clocks are
common to all windows, and known as well as the mount in force says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.monitoring.camera_change import MonitorSettings, what_changed
from selfcal_ros.calibration.monitoring.mount_score import (FARTHEST_RAD, MountScore, VAGUE_M,
                                                            VAGUE_S)
from selfcal_ros.calibration.monitoring.sequential_monitor import SequentialMonitor
from selfcal_ros.calibration.mount import Mount, NAMES, TURN
from selfcal_ros.findings.finding import Finding

#: Of the mount's covariance, in the order of a score.
_COLUMNS = [NAMES.index(name) for name in (*TURN, 'x', 'y', 'z', 'time_offset')]
#: No fact is known better: metres, seconds.
_LEAST_M, _LEAST_S = 1e-4, 1e-4


@dataclass(frozen=True)
class MountChange:
    """
    A turn of the camera against its mount.

    Attributes
    ----------
    turn : ndarray, shape (3,)
        About the body's axes: x forward, y left, z up; radians.
    covariance : ndarray, shape (3, 3)
    since_frame, clear_from_frame, until_frame : int
        See `Departure`.
    statistic, threshold : float
        Twice the logarithm of the likelihood ratio, and what it had to exceed.

    """

    turn: np.ndarray
    covariance: np.ndarray
    since_frame: int
    clear_from_frame: int
    until_frame: int
    statistic: float
    threshold: float

    @property
    def degrees(self) -> np.ndarray:
        """The turn in degrees, shape (3,)."""
        turn_deg: np.ndarray = np.degrees(self.turn)
        return turn_deg

    @property
    def sigma_degrees(self) -> np.ndarray:
        """Standard deviations of the turn in degrees, shape (3,)."""
        return np.degrees(np.sqrt(np.diag(self.covariance)))

    def finding(self) -> Finding:
        """Tell about which axes the camera is turned, and by how much."""
        return Finding('mount_changed', changes=what_changed(
            TURN, self.degrees, self.sigma_degrees, ('degrees',) * 3))

    def __str__(self) -> str:
        """Tell about which axes the camera is turned, and by how much."""
        return self.finding().clause


class MountMonitor(SequentialMonitor):
    """
    Compares windows with a mount, and with one another.

    Parameters
    ----------
    mount : Mount
        In force; all of its turns are known.
    settings : MonitorSettings, optional

    Attributes
    ----------
    mount : Mount
    change : MountChange or None
        The alarm.

    """

    change: MountChange | None

    def __init__(self, mount: Mount, settings: MonitorSettings = MonitorSettings()):
        self.mount = mount
        super().__init__(_prior(mount), [0, 1, 2],
                         np.full(3, np.radians(settings.tolerance_deg)**2), settings.chance,
                         first_alone=False)
        vague = self._stated.copy()
        vague[:3], vague[:, :3] = 0, 0
        vague[:3, :3] = FARTHEST_RAD**2 * np.eye(3)
        self._others = np.linalg.inv(vague)

    def add(self, score: MountScore) -> MountChange | None:
        """
        Take the score of the next window.

        Returns
        -------
        MountChange or None
            The alarm, as long as it stands.

        """
        found = self._ask(score, score.information, score.shift, self._of_windows)
        if found is not None:
            self.change = MountChange(found.change, found.covariance, found.since_frame,
                                      found.clear_from_frame, found.until_frame, self.statistic,
                                      self.threshold)
        self._retire()
        return self.change

    def _seen(self, score: MountScore) -> tuple[np.ndarray, np.ndarray]:
        covariance = np.linalg.inv(score.information + self._others)
        return (covariance @ score.shift)[:3], covariance[:3, :3]


def _prior(mount: Mount) -> np.ndarray:
    """Covariance of the parameters of a score by the mount, (7, 7); what is open is vague."""
    covariance = mount.covariance[np.ix_(_COLUMNS, _COLUMNS)].copy()
    vague = np.array([FARTHEST_RAD] * 3 + [VAGUE_M] * 3 + [VAGUE_S])**2
    least = np.array([0.0] * 3 + [_LEAST_M] * 3 + [_LEAST_S])**2
    for k, (most, floor) in enumerate(zip(vague, least)):
        if not covariance[k, k] < most:
            covariance[k], covariance[:, k] = 0, 0
            covariance[k, k] = most
        covariance[k, k] += floor
    return covariance
