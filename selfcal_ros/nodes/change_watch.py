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
"""The monitor of a calibrator: its keyframes, its windows, and what it says."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from msg_adapters.diagnostics import WARN

from selfcal_ros.calibration.monitoring.camera_change import CHANGE_NAMES, MonitorSettings
from selfcal_ros.calibration.monitoring.mount_monitor import MountChange
from selfcal_ros.calibration.mount import TURN
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.nodes.estimation_job import Job, JobKind, JobResult
from selfcal_ros.pipeline.calibration_session import CalibrationSession
from selfcal_ros.pipeline.estimate_request import EstimateRequest
from selfcal_ros.pipeline.monitoring import AskRobot, Monitoring, MonitoringSnapshot, ScoreRequest
from selfcal_ros.values.tracks import Tracks

if TYPE_CHECKING:
    from rclpy.impl.rcutils_logger import RcutilsLogger

ADVICE = 'call ~/calibrate to calibrate from what came since, ~/reset to start anew'


class ChangeWatch:
    """
    Watches the calibration of a session.

    After an alarm the session is held: it neither starts nor takes an estimate by itself.

    Parameters
    ----------
    session : CalibrationSession
    logger : object
        rclpy's, for the alarm.
    settings : MonitorSettings, optional
        None: watch nothing.
    ask_robot : callable, optional
        Returns what the robot has told so far, for watching the mount.

    """

    def __init__(self, session: CalibrationSession, logger: RcutilsLogger,
                 settings: MonitorSettings | None, ask_robot: AskRobot | None = None) -> None:
        self._session, self._logger, self._ask_robot = session, logger, ask_robot
        self._monitoring = Monitoring()
        self._settings: MonitorSettings | None = None
        self._scoring = False
        self._watched: tuple[Calibration, Tracks] | None = None
        self.change(settings)

    def change(self, settings: MonitorSettings | None) -> None:
        """
        Watch by other settings from now on, or not at all.

        An alarm that stands remains; without a monitor there is none, and the session goes on.
        """
        if settings == self._settings:
            return
        self._settings = settings
        if settings is None:
            if self._monitoring.change is not None:
                self._logger.warning('the monitor is off and its alarm with it: estimates go on, '
                                     'from the views since the change, and replace the '
                                     'calibration')
            self.release()
            self._monitoring.forget()
            return
        self._monitoring.settings = settings
        if self._watched and self._monitoring.change is None:
            self._monitoring.watch(*self._watched)

    def offer(self, image_size: tuple[int, int]) -> None:
        """Look whether the session has a new keyframe, of images of that size."""
        if self._settings and self._session.keyframes:
            self._monitoring.add_keyframe(self._session.keyframes[-1], image_size)

    def next_job(self) -> Job[ScoreRequest] | None:
        """Return a window to score; None while there is none, or one is being scored."""
        if self._settings is None or self._scoring:
            return None
        request = self._monitoring.next_request(self._ask_robot)
        self._scoring = request is not None
        return None if request is None else Job(JobKind.WINDOW_SCORE, request)

    def take(self, done: JobResult[ScoreRequest]) -> None:
        """Take the score of a window; an alarm holds the session."""
        self._scoring = False
        alarm = self._monitoring.accept(done.job.request, done.value)
        if alarm is not None:
            self._session.hold()
            self._logger.warning(f'{alarm}; {ADVICE}')

    def watch(self, calibration: Calibration, request: EstimateRequest) -> None:
        """Watch this calibration from here on."""
        self._watched = calibration, request.tracks
        if self._settings:
            self._monitoring.watch(*self._watched)

    def forget(self) -> None:
        """Watch nothing until there is another calibration."""
        self._watched = None
        self._monitoring.forget()

    def interrupt(self) -> None:
        """Go on with tracks that have nothing in common with those before."""
        self._monitoring.interrupt()

    def release(self) -> None:
        """Let the session go on after an alarm, with views of the changed camera only."""
        if self._monitoring.change is not None:
            self._session.keep_since(self._monitoring.change.clear_from_frame)

    def judge(self, level: int, text: str,
              values: dict[str, Any]) -> tuple[int, str, dict[str, Any]]:
        """Add the verdict to what `calibration_status` has said."""
        if self._settings is None:
            return level, text, values
        state = self._monitoring.snapshot()
        values.update({'monitor windows': state.windows, 'monitor skipped': state.skipped,
                       'monitor unexplained in a row': state.unexplained,
                       'monitor statistic': state.statistic,
                       'monitor threshold': state.threshold})
        if state.why_skipped:
            values['monitor last skipped'] = state.why_skipped
        if state.mount is not None:
            values.update({'mount monitor windows': state.mount.windows,
                           'mount monitor skipped': state.mount.skipped,
                           'mount monitor statistic': state.mount.statistic,
                           'mount monitor threshold': state.mount.threshold})
            if state.mount.why_skipped:
                values['mount monitor last skipped'] = state.mount.why_skipped
        if state.change is None:
            return level, text, values
        values.update(_stated(state))
        return WARN, f'{state.change}; {ADVICE}', values


def _stated(state: MonitoringSnapshot) -> dict[str, float]:
    """Return what an alarm states, with sigmas."""
    change = state.change
    if isinstance(change, MountChange):
        told = zip(TURN, 'deg deg deg'.split(), change.degrees.tolist(),
                   change.sigma_degrees.tolist())
    elif change is not None:
        told = zip(CHANGE_NAMES, 'px px px'.split(), change.change_px.tolist(),
                   change.sigma_px.tolist())
    else:
        return {}
    values: dict[str, float] = {}
    for name, unit, value, sigma in told:
        values[f'change of {name} {unit}'] = value
        values[f'change of {name} {unit} sigma'] = sigma
    return values
