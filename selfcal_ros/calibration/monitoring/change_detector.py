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
it again, each with its own error (`window_score`). Against that stands a change of focal length
and principal point, or of the focal length alone, at every moment that may be its own. Twice the
logarithm of the generalised likelihood ratio is a chi-square with three degrees of freedom, or
one; the less probable of both counts, as one of three. Over the moments it is maximised, and the
threshold bounds the rate at which an unchanged camera exceeds it (docs/monitoring.md).
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens, to_intrinsics
from selfcal_ros.calibration.monitoring.camera_change import CameraChange, CHANGES, MonitorSettings
from selfcal_ros.calibration.monitoring.sequential_monitor import SequentialMonitor
from selfcal_ros.calibration.monitoring.window_scatter import UsualWindows
from selfcal_ros.calibration.monitoring.window_score import WindowScore
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.scaled_inverse import scaled_pseudo_inverse

#: A window does not fit where noise that the epipolar geometry lacks exceeds the usual by this
#: factor, or where tracks agree with themselves alone, by the factors of misfit and dependence.
UNUSUAL_NOISE, UNUSUAL_MISFIT, UNUSUAL_INFLATION = 1.3, 1.2, 1.5
#: The same where less than this share of the tracks stands still.
MOSTLY_STILL = 0.9
#: A score is exact to first order: so much of the step that it tells is its own uncertainty.
CURVATURE = 0.1


class ChangeMonitor(SequentialMonitor):
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
    shift_px : float
        How far each of its images is shifted by itself, standard deviation.
    camera : Camera
        That the next window is to be scored against: the one in force, or after an alarm the one
        that there seems to be, since a score is exact to first order only.
    change : CameraChange or None
        The alarm.
    unexplained : int
        Windows, up to the newest, that no camera explains: they are not taken.

    """

    change: CameraChange | None

    def __init__(self, calibration: Calibration, settings: MonitorSettings = MonitorSettings()):
        self.settings, self.calibration = settings, calibration
        self.camera = calibration.camera
        covariance = _intrinsic_covariance(calibration)
        lens = Lens.of(self.camera)
        self.free = tuple(name for name, variance in zip(lens.names, np.diag(covariance))
                          if variance > 0 or name in CHANGES)
        places = lens.places(self.free)
        self.in_force = lens.take(self.free)
        # of both coordinates together
        self.shift_px = next((float(one.values['shift_px']) / np.sqrt(2)
                              for one in calibration.findings if one.kind == 'images_shifted'),
                             0.0)
        size = np.hypot(self.camera.width, self.camera.height)
        # displacement half a diagonal from the middle: of a focal length, and of the middle
        reach = 2 * self.camera.K[0, 0] / size
        super().__init__(covariance[np.ix_(places, places)],
                         [self.free.index(name) for name in CHANGES],
                         np.square(settings.tolerance_px * np.array([reach, 1, 1])),
                         settings.chance, first_alone=True)
        self._usual = UsualWindows()
        self.unexplained = 0

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
        self.unexplained = 0
        information = score.information / self._usual.inflation_of(score)
        # every scene has its own small error, however much it tells
        found = self._ask(score, information,
                          information @ (score.at + score.step - self.in_force),
                          self._of_windows + np.square(CURVATURE * score.step[self._changes]))
        if found is not None:
            self.change = CameraChange(
                found.change, found.covariance, float(self.in_force[0]), found.since_frame,
                found.clear_from_frame, found.until_frame, self.statistic, self.threshold)
            self.camera = self._changed(found.change)
        self._retire()
        return self.change

    def explains(self, score: WindowScore) -> bool:
        """
        Tell whether some camera before a still scene explains a window.

        What moves by itself, or a shutter that shakes, leaves more than the usual noise. Where
        pairs of images show that noise as well, and tracks are independent, it is noise.
        """
        usual = self._usual.usual(self.calibration.noise_sigma_px)
        return (score.noise_px < UNUSUAL_NOISE * usual.noise_px
                or score.misfit < UNUSUAL_MISFIT * usual.misfit
                and score.variance_inflation < UNUSUAL_INFLATION * usual.variance_inflation
                and score.still > MOSTLY_STILL)

    def _changed(self, change: np.ndarray) -> Camera:
        """Return the camera in force after a change (3,), within reason."""
        camera = self.calibration.camera
        lens, reach = Lens.of(camera), 0.25 * np.hypot(camera.width, camera.height)
        focal, *point = (lens[name] for name in CHANGES)
        point = np.asarray(point) + np.clip(change[1:], -reach, reach)
        focal *= np.clip(1 + change[0] / focal, 0.5, 2.0)
        return lens.with_values(dict(zip(CHANGES, (focal, *point)))).camera(camera.width,
                                                                            camera.height)

    def _seen(self, score: WindowScore) -> tuple[np.ndarray, np.ndarray]:
        spread = scaled_pseudo_inverse(score.information) * self._usual.inflation_of(score)
        step = (score.at + score.step - self.in_force)[self._changes]
        return step, spread[np.ix_(self._changes, self._changes)]

    def _remember(self, score: WindowScore) -> np.ndarray:
        mean = super()._remember(score)
        self._usual.remember(score)
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
