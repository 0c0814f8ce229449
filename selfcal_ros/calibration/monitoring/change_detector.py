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
Has the camera changed? A sequential test of new evidence against the calibration in force.

Model: the camera in force errs by what its covariance says; window after window of keyframes tells
it again, each with its own error (`window_score`). Against that stands, for every moment at which
it might have happened, a change of focal length and principal point, or of the focal length
alone. Twice the logarithm of the generalised likelihood ratio is a chi-square with three degrees
of freedom, or one; the less probable of both counts, as one of three. Over the moments it is
maximised, and the threshold bounds the rate at which an unchanged camera exceeds it
(docs/monitoring.md).
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens, to_intrinsics
from selfcal_ros.calibration.monitoring.camera_change import CameraChange, CHANGES, MonitorSettings
from selfcal_ros.calibration.monitoring.sequential_test import SequentialTest
from selfcal_ros.calibration.monitoring.window_scatter import WindowScatter
from selfcal_ros.calibration.monitoring.window_score import WindowScore
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.camera import Camera

#: Share of the windows' scatter, as a variance, that a change has to exceed.
SHARED_SCATTER = 0.25
#: A window does not fit where noise that the epipolar geometry lacks exceeds the usual by this
#: factor, or where tracks agree with themselves alone, by the factors of misfit and dependence.
UNUSUAL_NOISE, UNUSUAL_MISFIT, UNUSUAL_DEPENDENCE = 1.3, 1.2, 1.5
#: The same where less than this share of the tracks stands still.
MOSTLY_STILL = 0.9
#: A score is exact to first order: so much of the step that it tells is its own uncertainty.
CURVATURE = 0.1


class ChangeMonitor:
    """
    Compares windows with a calibration, and with one another.

    Parameters
    ----------
    calibration : Calibration
        In force. Its camera has an image size.
    settings : MonitorSettings, optional

    Attributes
    ----------
    calibration : Calibration
    free : tuple of str
        Those unknowns of the lens that `window_score` has to differentiate by.
    in_force : ndarray, shape (k,)
        These parameters of the camera in force.
    camera : Camera
        That the next window is to be scored against: the one in force, or after an alarm the one
        that there seems to be, since a score is exact to first order only.
    change : CameraChange or None
        The alarm. It stays once it is raised, and what it states improves with every window.
    windows : int
        Windows that were taken.
    unexplained : int
        Windows, up to the newest, that no camera explains: they are not taken.

    """

    def __init__(self, calibration: Calibration, settings: MonitorSettings = MonitorSettings()):
        self.settings, self.calibration = settings, calibration
        self.camera = calibration.camera
        covariance = _intrinsic_covariance(calibration)
        lens = Lens.of(self.camera)
        self.free = tuple(name for name, variance in zip(lens.names, np.diag(covariance))
                          if variance > 0 or name in CHANGES)
        places = lens.places(self.free)
        self.in_force = lens.take(self.free)
        self._changes = [self.free.index(name) for name in CHANGES]
        size = np.hypot(self.camera.width, self.camera.height)
        focal = self.camera.K[0, 0]
        # displacement half a diagonal from the middle: of a focal length, and of the middle
        reach = 2 * focal / size
        self._least = np.square(settings.tolerance_px * np.array([reach, 1, 1]))
        prior = covariance[np.ix_(places, places)]
        self._stated = prior + np.diag(self._along(0.01 * self._least))
        self._test = SequentialTest(self._stated, self._changes, self._least, settings.chance,
                                    first_alone=True)
        self._scatter = WindowScatter(self._least)
        self._of_windows = self._least
        self.change: CameraChange | None = None
        self.windows = self.unexplained = 0

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

    @property
    def remembered(self) -> list:
        """The evidence so far, in blocks."""
        return self._test.blocks

    def _along(self, values) -> np.ndarray:
        """Spread values (3,) of what may change over the free parameters, (k,)."""
        result = np.zeros(len(self.free))
        result[self._changes] = values
        return result

    def learn(self, score: WindowScore) -> None:
        """
        Take the score of a window of those keyframes that the calibration was made from.

        It is no evidence, but tells how well windows agree with this calibration.
        """
        mean = self._along(self._remember(score))
        # by so much all windows may disagree with the calibration
        self._test.prior = self._stated + np.outer(mean, mean)

    def add(self, score: WindowScore) -> CameraChange | None:
        """
        Take the score of the next window.

        Parameters
        ----------
        score : WindowScore
            Of `free`, against `camera` or against the one in force.

        Returns
        -------
        CameraChange or None
            The alarm, as long as it stands.

        """
        if not self.explains(score):
            self.unexplained += 1
            return self.change
        self.windows += 1
        self.unexplained = 0
        step = score.at + score.step - self.in_force
        information = score.information / self._scatter.inflation(score.dependence)
        # every scene has its own small error, however much it tells
        own = np.diag(self._along(self._of_windows
                                  + np.square(CURVATURE * score.step[self._changes])))
        weight = np.linalg.inv(np.eye(len(self.free)) + information @ own)
        found = self._test.add(weight @ information, weight @ information @ step, score.frames,
                               score, self.change is not None)
        if found is not None:
            self.change = CameraChange(
                found.change, found.covariance, float(self.in_force[0]), found.since_frame,
                found.clear_from_frame, found.until_frame, self.statistic, self.threshold)
            self.camera = self._changed(found.change)
        if self._test.oldest is not None:
            # not after a change: windows then scatter about another camera
            if self.change is None:
                self._remember(self._test.oldest)
            self._test.retire()
        return self.change

    def explains(self, score: WindowScore) -> bool:
        """
        Tell whether some camera before a still scene explains a window.

        What moves by itself, or a shutter that shakes, leaves more than the usual noise. Where
        pairs of images show that noise as well, and tracks are independent, it is noise.
        """
        usual = self._scatter.usual(self.calibration.noise_sigma_px)
        return (score.noise_px < UNUSUAL_NOISE * usual.noise_px
                or score.misfit < UNUSUAL_MISFIT * usual.misfit
                and score.dependence < UNUSUAL_DEPENDENCE * usual.dependence
                and score.still > MOSTLY_STILL)

    def _changed(self, change) -> Camera:
        """Return the camera in force after a change (3,), within reason."""
        camera = self.calibration.camera
        lens, reach = Lens.of(camera), 0.25 * np.hypot(camera.width, camera.height)
        focal, *point = (lens[name] for name in CHANGES)
        point = np.asarray(point) + np.clip(change[1:], -reach, reach)
        focal *= np.clip(1 + change[0] / focal, 0.5, 2.0)
        return lens.with_values(dict(zip(CHANGES, (focal, *point)))).camera(camera.width,
                                                                            camera.height)

    def _remember(self, score: WindowScore) -> np.ndarray:
        """Learn how large the errors of windows are; returns their mean, shape (3,)."""
        spread = _inverse(score.information) * self._scatter.inflation(score.dependence)
        step = (score.at + score.step - self.in_force)[self._changes]
        self._scatter.remember(score, step, spread[np.ix_(self._changes, self._changes)])
        self._of_windows, mean = self._scatter.tolerance()
        # neighbouring windows share a scene, so that their mean scatters, too
        self._test.tolerance = np.maximum(self._least, SHARED_SCATTER * self._of_windows)
        return mean


def _intrinsic_covariance(calibration: Calibration) -> np.ndarray:
    """Covariance of the unknowns of the lens from that of the parameters, (k, k)."""
    lens = Lens.of(calibration.camera)
    covariance = to_intrinsics(calibration.covariance, lens)
    # an aspect ratio that a fact fixes has no variance but that of rounding
    aspect = lens.names.index('aspect')
    if covariance[aspect, aspect] < 1e-14:
        covariance[aspect] = covariance[:, aspect] = 0
    return covariance


def _inverse(information: np.ndarray) -> np.ndarray:
    """Invert by way of unit diagonals: parameters differ in scale."""
    scale = np.sqrt(np.diag(information))
    return np.linalg.pinv(information / np.outer(scale, scale),
                          hermitian=True) / np.outer(scale, scale)
