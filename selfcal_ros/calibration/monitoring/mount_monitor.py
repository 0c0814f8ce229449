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

from selfcal_ros.calibration.monitoring.camera_change import MonitorSettings, SAID_SIGMAS
from selfcal_ros.calibration.monitoring.mount_score import (FARTHEST_RAD, MountScore, VAGUE_M,
                                                            VAGUE_S)
from selfcal_ros.calibration.monitoring.sequential_test import SequentialTest
from selfcal_ros.calibration.monitoring.window_scatter import WindowScatter
from selfcal_ros.calibration.mount import Mount, NAMES, TURN
from selfcal_ros.findings.finding import Finding

#: Of the mount's covariance, in the order of a score.
_COLUMNS = [NAMES.index(name) for name in (*TURN, 'x', 'y', 'z', 'time_offset')]
#: No fact is known better: metres, seconds.
_LEAST_M, _LEAST_S = 1e-4, 1e-4
#: Share of the windows' scatter, as a variance, that a change has to exceed.
SHARED_SCATTER = 0.25


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
        return np.degrees(self.turn)

    @property
    def sigma_degrees(self) -> np.ndarray:
        """Standard deviations of the turn in degrees, shape (3,)."""
        return np.degrees(np.sqrt(np.diag(self.covariance)))

    def finding(self) -> Finding:
        """Tell about which axes the camera is turned, and by how much."""
        told = [{'name': name, 'value': value, 'sigma': sigma, 'unit': 'degrees'}
                for name, value, sigma in zip(TURN, self.degrees.tolist(),
                                              self.sigma_degrees.tolist())]
        clear = [part for part in told if abs(part['value']) > SAID_SIGMAS * part['sigma']]
        return Finding('mount_changed', changes=tuple(clear or told))

    def __str__(self) -> str:
        """Tell about which axes the camera is turned, and by how much."""
        return self.finding().clause


class MountMonitor:
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
        The alarm. It stays once it is raised, and what it states improves with every window.
    windows : int
        Windows that were taken.

    """

    def __init__(self, mount: Mount, settings: MonitorSettings = MonitorSettings()):
        self.mount = mount
        self._least = np.full(3, np.radians(settings.tolerance_deg)**2)
        self._stated = _prior(mount)
        self._stated[:3, :3] += np.diag(0.01 * self._least)
        vague = self._stated.copy()
        vague[:3], vague[:, :3] = 0, 0
        vague[:3, :3] = FARTHEST_RAD**2 * np.eye(3)
        self._others = np.linalg.inv(vague)
        self._test = SequentialTest(self._stated, [0, 1, 2], self._least, settings.chance,
                                    first_alone=False)
        self._scatter = WindowScatter(self._least)
        self._of_windows = self._least
        self.change: MountChange | None = None
        self.windows = 0

    @property
    def statistic(self) -> float:
        """Of the newest test."""
        return self._test.statistic

    @property
    def threshold(self) -> float:
        """Of the newest test."""
        return self._test.threshold

    @property
    def discarded(self) -> int:
        """Windows that agreed with nothing before or after."""
        return self._test.discarded

    def learn(self, score: MountScore) -> None:
        """
        Take the score of a window of those keyframes that the mount was estimated from.

        It is no evidence, but tells how well windows agree with this mount.
        """
        mean = np.zeros(len(self._stated))
        mean[:3] = self._remember(score)
        # by so much all windows may disagree with the mount
        self._test.prior = self._stated + np.outer(mean, mean)

    def add(self, score: MountScore) -> MountChange | None:
        """
        Take the score of the next window.

        Returns
        -------
        MountChange or None
            The alarm, as long as it stands.

        """
        self.windows += 1
        own = np.zeros(len(self._stated))
        own[:3] = self._of_windows
        weight = np.linalg.inv(np.eye(len(own)) + score.information * own)
        found = self._test.add(weight @ score.information, weight @ score.shift, score.frames,
                               score, self.change is not None)
        if found is not None:
            self.change = MountChange(found.change, found.covariance, found.since_frame,
                                      found.clear_from_frame, found.until_frame, self.statistic,
                                      self.threshold)
        if self._test.oldest is not None:
            # not after a change: windows then scatter about another mount
            if self.change is None:
                self._remember(self._test.oldest)
            self._test.retire()
        return self.change

    def _remember(self, score: MountScore) -> np.ndarray:
        """Learn how large the errors of windows are; returns their mean, shape (3,)."""
        covariance = np.linalg.inv(score.information + self._others)
        step = covariance @ score.shift
        self._scatter.remember(None, step[:3], covariance[:3, :3])
        self._of_windows, mean = self._scatter.tolerance()
        # neighbouring windows share a scene, so that their mean scatters, too
        self._test.tolerance = np.maximum(self._least, SHARED_SCATTER * self._of_windows)
        return mean


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
