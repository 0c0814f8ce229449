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
"""What is to be explained: observations, the pairs that start it, facts, and a kind of motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.motion import MotionModel, NEARLY_PLANAR
from selfcal_ros.calibration.bundle.priors import Prior, Priors, start_lens
from selfcal_ros.calibration.bundle.robust_fit import Observations
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.initialisation.initial_structure import (PairGeometry, planar_start,
                                                                      relative_rotations,
                                                                      spanning_order)
from selfcal_ros.calibration.initialisation.pivot_start import PivotPath
from selfcal_ros.calibration.initialisation.planar_scene import FlatScene
from selfcal_ros.calibration.initialisation.supposed_lens import (Bend, likely_focal_lengths,
                                                                  supposed_camera)
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.values.tracks import Tracks

#: While starts are compared, soft facts keep them from wandering: principal point within so
#: much of the middle (share of the longer side), distortion that of ordinary lenses.
START_PRINCIPAL_POINT_FRACTION = 0.06
#: Longer sequences are started, and their models chosen, on the stretch of so many successive
#: views that turns most: the time for that does not grow with the sequence.
WINDOW_VIEWS = 48
#: Views that turn so far by a usual lens may close a loop: twice as far by a wide one. They are
#: started on so many of them first.
ROUND_RAD, ROUND_WINDOWS = np.radians(180.0), (12, 24)
#: Tracks per view that the estimate uses; more add time and little accuracy.
TRACKS_PER_VIEW = 400


@dataclass(frozen=True)
class SelfCalibrationProblem:
    """
    What every start is judged on.

    `flat` where the scene may be one plane, `pivot` where the camera turns about a fixed point;
    `bend` is that of the lens which the pairs show, for radii in half image diagonals; `instants`
    tell when each view was taken, in any unit; `is_weak` where the translations are small beside
    the rotations; `supposes_plane` where nobody said that the motion is planar; `of_still` where
    the tracks are those that a first estimate found to stand still; `first_fitted` is the first
    view of the stretch on which the models were chosen.
    """

    observations: Observations
    pairs: list[PairGeometry]
    size: tuple[int, int]
    facts: CameraFacts
    noise_px: float
    motion: MotionModel = NEARLY_PLANAR
    flat: FlatScene | None = None
    pivot: PivotPath | None = None
    bend: Bend = ()
    instants: tuple[float, ...] = ()
    is_weak: bool = False
    supposes_plane: bool = False
    of_still: bool = False
    first_fitted: int = 0

    @property
    def views(self) -> int:
        """Count the views."""
        return int(self.observations.view.max()) + 1

    def starts(self, blocks: PointBlocks, xy: np.ndarray, camera: Camera) -> list[SceneState]:
        """Start under a supposed calibration, in all ways that stand; see `planar_start`."""
        ways = (True, False) if self.motion.keeps_plane else (False,)
        if self.pivot is not None:
            found = [self.pivot.start(blocks, xy, camera) for _ in ways]
        elif self.flat is not None:
            found = [self.flat.start(blocks, xy, camera, exact) for exact in ways]
        else:
            relative = relative_rotations(self.pairs, camera)
            found = [planar_start(self.pairs, blocks, xy, camera, exact, relative)
                     for exact in ways]
        return [state for state in found if state is not None]

    def turns_round(self) -> bool:
        """Tell whether the camera turns so far between any two views that a loop may close."""
        if self.views <= ROUND_WINDOWS[0]:
            return False
        turned = np.cumsum(self._turns(), axis=0)
        apart = np.linalg.norm(turned[:, None] - turned, axis=2)
        return bool(apart.max() > ROUND_RAD)

    def _turns(self) -> np.ndarray:
        """Rotation vectors (V - 1, 3) from view to view, if the camera is a usual one."""
        camera = supposed_camera(
            likely_focal_lengths(self.size, self.bend, (1.0,))[0], self.size, self.facts,
            self.bend)
        near = [pair for pair in self.pairs if pair.second - pair.first == 1]
        turns = np.zeros((self.views - 1, 3))
        turns[[pair.first for pair in near]] = rotation_vector(relative_rotations(near, camera))
        return turns

    def window(self, most: int = WINDOW_VIEWS) -> SelfCalibrationProblem:
        """Return the stretch of so many views that turns most, this problem if it is short."""
        if self.views <= most:
            return self
        first = self.first_of_window(most)
        last = first + most
        pairs = [replace(pair, first=pair.first - first, second=pair.second - first)
                 for pair in self.pairs if first <= pair.first and pair.second < last]
        if len(spanning_order(pairs, most)) < most - 1:
            return self
        observations = self.observations
        inside = (observations.view >= first) & (observations.view < last)
        within, _ = observations.select(inside)
        flat = self.flat and self.flat.of_views(first, last)
        pivot = self.pivot and self.pivot.of_views(first, last)
        views = np.arange(first, last)
        return replace(self, pairs=pairs, flat=flat, pivot=pivot,
                       instants=self.instants[first:last], motion=self.motion.of_views(views),
                       observations=replace(within, view=within.view - first,
                                            clock=within.clock and within.clock.of_views(views)))

    def first_of_window(self, most: int) -> int:
        """Return the first view of the stretch of so many that turns most."""
        if self.views <= most:
            return 0
        turn = np.linalg.norm(self._turns(), axis=1)
        return int(np.argmax(np.convolve(turn, np.ones(most - 1), 'valid')))


def start_priors(problem: SelfCalibrationProblem, camera: Camera) -> Priors:
    """Facts, and for the starts alone what most cameras with such a lens have."""
    return start_lens(problem.facts, camera.lens).under(usual_matrix(problem))


def usual_matrix(problem: SelfCalibrationProblem) -> dict[str, Prior]:
    """What most cameras have, but for the focal length, as soft measurements."""
    longer = max(problem.size)
    return {'cx': Prior((problem.size[0] - 1) / 2, START_PRINCIPAL_POINT_FRACTION * longer),
            'cy': Prior((problem.size[1] - 1) / 2, START_PRINCIPAL_POINT_FRACTION * longer),
            'aspect': Prior(1.0, 0.1), 'skew': Prior(0.0, 0.02 * longer)}


def observations_of(tracks: Tracks, frames: np.ndarray) -> Observations:
    """Index the observations of tracks, no more than `TRACKS_PER_VIEW` of the longest a view."""
    return Observations.of(tracks, frames).longest(TRACKS_PER_VIEW)
