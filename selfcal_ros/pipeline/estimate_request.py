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
"""What a calibration session keeps, by which settings, and what it hands out to be estimated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import ArgumentError
from selfcal_ros.features.selection import drop_static, verify
from selfcal_ros.features.still_features import without_still
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.pipeline.robot.live_robot import RobotSnapshot
from selfcal_ros.values.neighbours import Filmed
from selfcal_ros.values.tracks import Tracks


@dataclass(frozen=True)
class SessionSettings:
    """
    When a frame is kept, and when an estimate is worth its time.

    Parameters
    ----------
    motion : str
        As in `selfcal_ros.calibrate`.
    facts : CameraFacts
    parallax : float
        A frame becomes a keyframe when the median point has moved by this share of the image
        diagonal since the last one.
    max_keyframes : int
        Bound on memory and on the time of an estimate; beyond it the views that tell least go.
    first_estimate : int
        Keyframes before the first estimate.
    growth : float
        New keyframes, as a share of all, that make another estimate worthwhile.
    min_common : int
        Thinning leaves neighbours that share at least so many points.

    Raises
    ------
    ArgumentError
        If a value is impossible.

    """

    motion: str = 'auto'
    facts: CameraFacts = CameraFacts()
    parallax: float = 0.03
    max_keyframes: int = 40
    first_estimate: int = 8
    growth: float = 0.2
    min_common: int = 60

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        if not 0 < self.parallax < 1:
            raise ArgumentError('The keyframe parallax is a share of the image diagonal between '
                                f'0 and 1, not {self.parallax!r}.')
        if not 3 <= self.first_estimate <= self.max_keyframes:
            raise ArgumentError(f'The first estimate needs 3 to {self.max_keyframes} keyframes '
                                f'(max_keyframes), not {self.first_estimate}.')


@dataclass(frozen=True)
class Keyframe:
    """
    Points of one kept frame.

    Attributes
    ----------
    index : int
        Counts the frames of the session.
    stamp_ns : int
    ids : ndarray of int, shape (M,)
        Ascending.
    xy : ndarray, shape (M, 2)
        Pixels.
    filmed : Filmed
        The points in the frames just before and after.
    of_part : bool
        Kept for what moves before a camera that stands.

    """

    index: int
    stamp_ns: int
    ids: np.ndarray
    xy: np.ndarray
    filmed: Filmed | None = None
    of_part: bool = False

    @property
    def neighbours(self) -> np.ndarray:
        """Pixels and seconds of the points just before and after, (M, 2, 3); NaN: not seen."""
        return (np.full((len(self.ids), 2, 3), np.nan) if self.filmed is None
                else self.filmed.neighbours)


@dataclass(frozen=True)
class EstimateRequest:
    """
    All that one estimate needs, independent of what the session does meanwhile.

    Attributes
    ----------
    tracks : Tracks
    settings : SessionSettings
    start : Calibration or None
    generation, section : int
        Resets of the session before, and steps of the clock since the last of them.
    keyframes : int
    robot : RobotSnapshot or None
        What its robot has told: the mount of the camera is estimated, too.

    """

    tracks: Tracks
    settings: SessionSettings
    start: Calibration | None
    generation: int
    keyframes: int
    section: int = 0
    robot: RobotSnapshot | None = None

    def with_robot(self, robot: RobotSnapshot | None) -> EstimateRequest:
        """Return the request with poses of the robot."""
        return replace(self, robot=robot)

    def run(self, calibrate: Callable[..., Calibration | NotCalibrated] | None = None,
            ) -> Calibration | NotCalibrated:
        """
        Estimate; takes up to seconds, for a worker thread.

        Parameters
        ----------
        calibrate : callable, optional
            `selfcal_ros.calibrate` by default.

        """
        if calibrate is None:
            import selfcal_ros
            calibrate = selfcal_ros.calibrate
        tracks, told = without_still(self.tracks)
        tracks, _ = drop_static(tracks)
        tracks = verify(tracks).tracks
        result = calibrate(tracks, motion=self.settings.motion, facts=self.settings.facts,
                           start=self.start.camera if self.start else None)
        if told:
            result = replace(result, findings=(*told, *result.findings))
        if self.robot is not None and isinstance(result, Calibration):
            return self.robot.mounted(result, self.tracks)
        return result
