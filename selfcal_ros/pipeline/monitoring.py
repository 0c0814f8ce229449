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
"""Keyframes in, a verdict on the calibration in force out; what the calibrator node drives."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.monitoring.camera_change import CameraChange, MonitorSettings
from selfcal_ros.calibration.monitoring.change_detector import ChangeMonitor
from selfcal_ros.calibration.monitoring.mount_monitor import MountChange, MountMonitor
from selfcal_ros.calibration.monitoring.mount_score import is_watchable, mount_score, MountScore
from selfcal_ros.calibration.monitoring.window_score import adjusted, score_of, WindowScore
from selfcal_ros.calibration.mount import Mount
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.errors import InputError
from selfcal_ros.features.selection import drop_static
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.distributions import chi2_isf
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.pipeline.estimate_request import Keyframe
from selfcal_ros.pipeline.robot.live_robot import RobotSnapshot
from selfcal_ros.values.tracks import Tracks

#: Windows that wait for their turn; where the machine is slower than the camera, the rest go.
MAX_WAITING = 40
#: A window says nothing of the mount while that of the lens has less than this chance: a zoom
#: would pass for a knock.
LENS_IN_DOUBT = float(chi2_isf(1e-3, 3))

#: What tells the poses of the robot so far, if anything does.
AskRobot = Callable[[], RobotSnapshot | None]


@dataclass(frozen=True)
class WindowVerdict:
    """What a window says of the camera, and of its mount where that is watched."""

    camera: WindowScore
    mount: MountScore | NoEstimate | None = None


@dataclass(frozen=True)
class ScoreRequest:
    """A window to score, independent of what the monitoring does meanwhile."""

    tracks: Tracks
    camera: Camera
    free: tuple[str, ...]
    shift_px: float
    generation: int
    reference: bool
    mount: Mount | None = None
    robot: RobotSnapshot | None = None

    def run(self) -> WindowVerdict | NoEstimate:
        """Score it; takes tenths of a second, for a worker thread."""
        tracks, _ = drop_static(self.tracks)
        found = adjusted(tracks, self.camera, np.random.default_rng(0), self.shift_px)
        if isinstance(found, NoEstimate):
            return found
        score = score_of(*found, self.camera, self.free)
        if isinstance(score, NoEstimate):
            return score
        if self.mount is None or self.robot is None:
            return WindowVerdict(score)
        try:
            return WindowVerdict(score, mount_score(
                *found, self.camera, self.mount, self.robot.poses(), self.robot.facts,
                max(1.0, score.variance_inflation)))
        except (InputError, np.linalg.LinAlgError) as error:
            return WindowVerdict(score, NoEstimate('body_poses_unusable', why=str(error)))


@dataclass(frozen=True)
class MountSnapshot:
    """The same of the mount: windows, those that said nothing, and the newest test."""

    windows: int
    skipped: int
    why_skipped: str
    statistic: float
    threshold: float


@dataclass(frozen=True)
class MonitoringSnapshot:
    """
    State of the monitoring, for diagnostics.

    Attributes
    ----------
    windows, skipped : int
        Windows that were judged, and that said nothing.
    why_skipped : str
        Of the last such window.
    unexplained : int
        Windows, up to the newest, that no camera before a still scene explains.
    statistic, threshold : float
        Of the newest test; 0 before the first.
    change : CameraChange or MountChange or None
    mount : MountSnapshot or None
        None where no mount is watched.

    """

    windows: int = 0
    skipped: int = 0
    why_skipped: str = ''
    unexplained: int = 0
    statistic: float = 0.0
    threshold: float = 0.0
    change: CameraChange | MountChange | None = None
    mount: MountSnapshot | None = None


class Monitoring:
    """
    Gathers keyframes to windows, and holds the verdict of a `ChangeMonitor` on them.

    It does no work of its own: `next_request` hands out what is to be computed, in whatever
    thread the caller likes, and `accept` takes the result. Windows that were asked for under
    another calibration are dropped.

    Parameters
    ----------
    settings : MonitorSettings, optional

    """

    def __init__(self, settings: MonitorSettings = MonitorSettings()) -> None:
        self.settings = settings
        self._generation = 0
        self.forget()

    def forget(self) -> None:
        """Stop monitoring, and forget what was seen so far."""
        self._generation += 1
        self._monitor: ChangeMonitor | None = None
        self._keyframes: list[Keyframe] = []
        self._image_size = (0, 0)
        self._waiting: deque[tuple[Tracks, bool]] = deque()
        self._skipped, self._why = 0, ''
        self._of_mount: MountMonitor | None = None
        self._mount_skipped, self._mount_why = 0, ''

    def watch(self, calibration: Calibration, tracks: Tracks) -> None:
        """
        Watch a calibration from here on, and its mount where that is known.

        Parameters
        ----------
        calibration : Calibration
        tracks : Tracks
            That it was made from: they tell how well windows agree with it.

        """
        self.forget()
        self._monitor = ChangeMonitor(calibration, self.settings)
        if isinstance(calibration.mount, Mount) and is_watchable(calibration.mount):
            self._of_mount = MountMonitor(calibration.mount, self.settings)
        frames = [frame for frame in tracks.frames if frame in set(calibration.frames)]
        count = self.settings.keyframes
        for first in range(0, len(frames) - count + 1, count // 2):
            self._waiting.append((tracks.in_frames(frames[first:first + count]), True))

    def interrupt(self) -> None:
        """Leave out the keyframes of a window that is not complete: their tracks end here."""
        self._complete()
        self._keyframes = []

    @property
    def change(self) -> CameraChange | MountChange | None:
        """The alarm, if there is one; that of the camera before that of its mount."""
        return (self._monitor.change if self._monitor else None) or (
            self._of_mount.change if self._of_mount else None)

    def add_keyframe(self, keyframe: Keyframe, image_size: tuple[int, int]) -> None:
        """
        Take a keyframe, unless it is the newest one; after every so many a window is ready.

        In a video a window waits for the image after its last keyframe. So offer the newest
        keyframe again with that image.

        Parameters
        ----------
        keyframe : Keyframe
        image_size : (int, int)
            Width and height, pixels.

        """
        if self._monitor is None:
            return
        if not self._keyframes or self._keyframes[-1].index < keyframe.index:
            self._complete()
            self._keyframes.append(keyframe)
            self._image_size = image_size
        newest = self._keyframes[-1].filmed
        if newest is None or newest.after is not None:
            self._complete()

    def _complete(self) -> None:
        """Make a window of the keyframes, where they are so many; it ends where another begins."""
        frames = self._keyframes
        if len(frames) < self.settings.keyframes:
            return
        # windows of the calibration have the images beside, too: both are to leave like noise
        filmed = all(f.filmed is not None for f in frames)
        tracks = Tracks(np.repeat([f.index for f in frames], [len(f.ids) for f in frames]),
                        np.concatenate([f.ids for f in frames]),
                        np.concatenate([f.xy for f in frames]), self._image_size,
                        {f.index: f.stamp_ns for f in frames},
                        np.concatenate([f.neighbours for f in frames]) if filmed else None)
        self._keyframes = frames[-1:]
        if len(self._waiting) < MAX_WAITING:
            self._waiting.append((tracks, False))
        else:
            self._skip('the machine does not keep up')

    def next_request(self, ask_robot: AskRobot | None = None) -> ScoreRequest | None:
        """Return the next window to score, with poses of the robot; None if there is none."""
        if self._monitor is None or not self._waiting:
            return None
        tracks, reference = self._waiting.popleft()
        request = ScoreRequest(tracks, self._monitor.camera, self._monitor.free,
                               self._monitor.shift_px, self._generation, reference)
        robot = ask_robot() if ask_robot and self._of_mount is not None else None
        if self._of_mount is None or robot is None or not tracks.stamps_ns:
            return request
        stamps = tracks.stamps_ns.values()
        return replace(request, mount=self._of_mount.mount,
                       robot=robot.between(min(stamps), max(stamps)))

    def accept(self, request: ScoreRequest, score: object) -> CameraChange | MountChange | None:
        """
        Take the result of a request.

        Parameters
        ----------
        request : ScoreRequest
        score : WindowVerdict or object
            Anything else is the reason why there is no score.

        Returns
        -------
        CameraChange or MountChange or None
            The alarm, if it is new.

        """
        if self._monitor is None or request.generation != self._generation:
            return None
        if not isinstance(score, WindowVerdict):
            self._skip(score.clause if isinstance(score, NoEstimate) else str(score))
            return None
        known = self.change
        try:
            self._take(request, score)
        except np.linalg.LinAlgError:
            # absurd tracks can make absurd scores; the node must go on
            self._skip('its score is singular')
        return self.change if known is None else None

    def _take(self, request: ScoreRequest, verdict: WindowVerdict) -> None:
        """Give a verdict to the monitors: to that of the mount where the lens is not in doubt."""
        monitor, camera = self._monitor, verdict.camera
        if monitor is None:
            return
        if request.reference:
            monitor.learn(camera)
            if self._of_mount is not None and isinstance(verdict.mount, MountScore):
                self._of_mount.learn(verdict.mount)
            return
        explained = monitor.explains(camera)
        if not explained:
            self._skip(NoEstimate('window_unexplained', left_px=camera.noise_px,
                                  still=camera.still).clause)
        monitor.add(camera)
        if self._of_mount is None or verdict.mount is None:
            return
        if not explained or monitor.change or monitor.statistic > LENS_IN_DOUBT:
            self._mount_skipped += 1
            self._mount_why = 'the camera itself may have changed, or the window does not fit'
        elif isinstance(verdict.mount, NoEstimate):
            self._mount_skipped += 1
            self._mount_why = verdict.mount.clause
        else:
            self._of_mount.add(verdict.mount)

    def work_off(self) -> None:
        """Score all waiting windows in this thread, at once."""
        while (request := self.next_request()) is not None:
            self.accept(request, request.run())

    def snapshot(self) -> MonitoringSnapshot:
        """Return the state for diagnostics."""
        if self._monitor is None:
            return MonitoringSnapshot()
        return MonitoringSnapshot(self._monitor.windows, self._skipped, self._why,
                                  self._monitor.unexplained, self._monitor.statistic,
                                  self._monitor.threshold, self.change, self._mount_snapshot())

    def _mount_snapshot(self) -> MountSnapshot | None:
        one = self._of_mount
        return None if one is None else MountSnapshot(
            one.windows, self._mount_skipped, self._mount_why, one.statistic, one.threshold)

    def _skip(self, why: str) -> None:
        self._skipped += 1
        self._why = why
