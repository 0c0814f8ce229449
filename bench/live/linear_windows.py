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
Windows of the monitor to first order: hundreds of hours of drives, point by point.

A drive there and back shows a few windows again and again. The adjustment of each is linearised
once, at the true camera, poses and points; then every window of an endless drive is one solution
of its normal equations, for the errors that its points have there. Gross ones are left out, as the
adjustment does. Errors are drawn as for the whole adjustment, so that windows share drifting
tracks and keyframes as they do there.
"""

from __future__ import annotations

from bench.live.monitored_drive import (ideal_places, MeasuredDrive, measurement_errors,
                                        recalibrated, window_of)
import numpy as np
from scipy.stats import chi2
from selfcal_ros.calibration.bundle.information import huber_factors, HUBER_SIGMAS, Information
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.robust_fit import OUTLIER_SIGMAS
from selfcal_ros.calibration.monitoring.camera_change import CHANGES
from selfcal_ros.calibration.monitoring.change_detector import ChangeMonitor
from selfcal_ros.calibration.monitoring.window_score import (adjusted, shared_within_tracks,
                                                             WindowScore, without_camera)
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.robust_loss import huber_weights

#: Noise with which the linearised windows are set up, pixels: none to speak of.
_FAINT_PX = 1e-3
#: Gross errors beyond this are found by the epipolar geometry, pixels.
_FOUND_PX = 1.0


class LinearWindow:
    """
    One window, linearised.

    Parameters
    ----------
    drive : MeasuredDrive
    frames : list of tuple
        Of every keyframe: index, points seen, identities of their tracks, view.
    free : tuple of str
        Of the monitor.

    """

    def __init__(self, drive: MeasuredDrive, frames, free: tuple[str, ...]):
        rng = np.random.default_rng(0)
        places = ideal_places(drive)
        faint = [(index, identity, drive.camera.pixels(places[view, at])
                  + _FAINT_PX * rng.standard_normal((len(at), 2)))
                 for index, at, identity, view in frames]
        found = adjusted(window_of([_sorted(*frame) for frame in faint],
                                   (drive.camera.width, drive.camera.height)), drive.camera, rng)
        if isinstance(found, NoEstimate):
            raise ValueError(found.reason)
        graph, fit = found[0], found[1].fit
        bundle, state, observations = fit.bundle, fit.state, fit.observations
        if len(graph.frames) != len(frames):
            raise ValueError('Keyframes of the window are not connected: what is seen in one '
                             'would be taken for what is seen in the next.')
        row = {}
        for _, at, identity, _ in frames:
            row.update(zip(identity.tolist(), at.tolist()))
        self.free, self.view, self.track = free, observations.view, observations.point
        self.row = np.array([row[int(one)] for one in observations.track])[observations.point]
        held = bundle.with_sigma(1.0)
        self._held = held.normal_equations(state, robust=False)
        self._inverse = held.inverse(self._held)
        self._freedom = held.degrees_of_freedom
        self._measured = 2 * len(self.view) - 3 * len(state.points)
        camera_free = without_camera(held, free)
        self._system = camera_free.normal_equations(state, robust=False)
        inverse, places = camera_free.inverse(self._system), state.lens.places(free)
        self._rows = inverse[places]
        self._covariance = inverse[np.ix_(places, places)]

    def score(self, error: np.ndarray, lost: np.ndarray):
        """
        Tell what the window shows of the camera.

        Parameters
        ----------
        error : ndarray, shape (N, 2)
            Of its observations, pixels.
        lost : ndarray of bool, shape (N,)
            Those that are known not to fit.

        Returns
        -------
        error : ndarray, shape (k,)
            Of the camera.
        information : ndarray, shape (k, k)
        variance_inflation : float

        """
        residual, length = self._adjusted(error, lost)
        for _ in range(2):
            lost = lost | (length > OUTLIER_SIGMAS * self._robust_sigma(length[~lost]))
            residual, length = self._adjusted(error, lost)
        distance = length / self._sigma(residual)
        share = self._freedom / (2 * len(distance))
        factor, _ = huber_factors(distance[~lost], share)
        weight = huber_weights(distance, HUBER_SIGMAS)
        # the normal equations here carry no weights
        mean = np.mean(weight[~lost])
        slope = mean / huber_factors(distance[~lost], share)[1]
        self._system.residual = residual * weight[:, None]
        influence = self._system.influence(self._rows) / slope
        sigma = self._sigma(residual)
        times = sigma**2 * factor / mean
        covariance = self._covariance * times
        information = np.linalg.inv(covariance)
        every = np.arange(len(self.free))
        told = Information(covariance, influence, share, self._freedom / self._measured,
                           self._system, slice(0, len(self.free)), times)
        return influence.sum(axis=0), information, shared_within_tracks(
            told, self.track, every, information)

    def _sigma(self, residual) -> float:
        return float(np.sqrt(np.sum(residual**2) / self._freedom))

    def _adjusted(self, error, lost):
        """Residuals (N, 2) after poses and points have followed, and their lengths (N,)."""
        residual = np.where(lost[:, None], 0, -error)
        gradient, half = self._held.right_hand_side(residual)
        step = -self._inverse @ gradient
        residual = residual + self._held.predict(step, self._held.point_steps(step, half))
        residual[lost] = 0
        return residual, np.linalg.norm(residual, axis=1)

    def _robust_sigma(self, length) -> float:
        """As `Bundle.noise_sigma`."""
        share = self._freedom / (2 * len(self.view))
        sigma = float(np.sqrt(np.mean(length**2) / (2 * share)))
        expected = 2 * (1 - np.exp(-HUBER_SIGMAS**2 / 2))
        for _ in range(15):
            limit = HUBER_SIGMAS * sigma * np.sqrt(share)
            sigma = float(np.sqrt(np.mean(np.minimum(length, limit)**2) / (expected * share)))
        return sigma


def _sorted(index, identity, xy):
    order = np.argsort(identity)
    return index, identity[order], xy[order]


class EndlessDrive:
    """
    The windows of an endless drive.

    Parameters
    ----------
    drive : MeasuredDrive
    keyframes : int
        In a window; successive ones share one.
    free : tuple of str
        Of the monitor.

    """

    def __init__(self, drive: MeasuredDrive, keyframes: int, free: tuple[str, ...]):
        self.drive, self.keyframes, self.free = drive, keyframes, free
        self._period = 2 * len(drive.poses) - 2
        self._windows: dict[int, LinearWindow] = {}

    def scores(self, rng: np.random.Generator, count: int):
        """Yield the index of the last keyframe and the score of so many windows."""
        frames, at_hand = [], []
        shape = (*self.drive.seen.shape[1:], 2)
        for index, place, at, identity, error, gross in measurement_errors(self.drive, rng):
            everywhere, wrong = np.zeros(shape), np.zeros(shape[0], bool)
            everywhere[at], wrong[at] = error, gross & (np.abs(error).max(axis=1) > _FOUND_PX)
            frames.append((index, at, identity.copy(), place))
            at_hand.append((everywhere, wrong))
            if len(frames) < self.keyframes:
                continue
            window = self._window(frames)
            errors, lost = (np.array(part) for part in zip(*at_hand))
            yield index, window.score(errors[window.view, window.row],
                                      lost[window.view, window.row])
            frames, at_hand, count = frames[-1:], at_hand[-1:], count - 1
            if not count:
                return

    def _window(self, frames) -> LinearWindow:
        phase = frames[0][0] % self._period
        if phase not in self._windows:
            self._windows[phase] = LinearWindow(self.drive, frames, self.free)
        return self._windows[phase]


def linear_hours(drive: MeasuredDrive, hours: float, period_s: float, seed: int):
    """
    Drive for hours with the camera as it is, scores to first order.

    Returns
    -------
    alarms : int
    chances : ndarray
        Of every test; see `corrected_chance`.
    errors : ndarray, shape (n, k)
        Of the windows.

    """
    rng = np.random.default_rng([seed, 97])
    monitor = ChangeMonitor(recalibrated(drive, rng))
    true, at = Lens.of(drive.camera).take(monitor.free), monitor.in_force
    step = monitor.settings.keyframes - 1
    endless = EndlessDrive(drive, monitor.settings.keyframes, monitor.free)
    chances, errors = [], []
    for index, (error, information, variance_inflation) in endless.scores(
            rng, max(1, int(hours * 3600 / period_s / step))):
        monitor.add(WindowScore((index - step, index), at, true + error - at, information,
                                variance_inflation, 0.0, 1.0))
        errors.append(error)
        chances.append(corrected_chance(monitor))
    return int(monitor.change is not None), np.array(chances), np.array(errors)


def corrected_chance(monitor: ChangeMonitor) -> float:
    """Chance of the newest statistic with an unchanged camera, all moments together."""
    moments = chi2.sf(monitor.threshold, len(CHANGES))
    step = (monitor.settings.keyframes - 1) / monitor.settings.false_alarm_keyframes
    return float(chi2.sf(monitor.statistic, len(CHANGES)) * step / moments)
