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
What the tracker asks of a method that estimates poses, and of one that searches besides.

`RapidTracker` is the thesis's: it corrects a prediction, once an image. `RobustTracker` is ours:
it also tests starts and seeks what is lost, where the options ask for that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from selfcal_ros.rorapid.edges.control_points import ControlModel
from selfcal_ros.rorapid.estimation.joint_search import Measuring
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.estimation.pose_search import PoseSearch
from selfcal_ros.rorapid.estimation.start_check import StartCheck
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose


class PoseMeter(Protocol):
    """Measures a pose in an image."""

    def measure(self, image: np.ndarray, predicted: ObjectPose,
                covariance: np.ndarray) -> PoseMeasurement:
        """Find the object near a prediction of covariance (m, m), in an image (H, W) of uint8."""


class PoseEstimator(PoseMeter, Protocol):
    """One measurement an image, and what is remembered from image to image."""

    @property
    def placed(self) -> bool:
        """Whether there ever was a place to search around."""

    @property
    def verifier(self) -> SearchingEstimator | None:
        """What tests starts and poses that were found again; None where nothing does."""

    @property
    def seeker(self) -> SearchingEstimator | None:
        """What seeks an object that is lost; None where nothing does."""

    def measuring(self, image: np.ndarray, predicted: ObjectPose,
                  covariance: np.ndarray) -> Measuring:
        """Do the same beside others, whose edges are searched at once."""

    def initialise(self, image: np.ndarray, guess: ObjectPose,
                   covariance: np.ndarray) -> PoseMeasurement:
        """Find the object from a guess of covariance (m, m)."""

    def remember(self, measured: PoseMeasurement, confirmed: bool) -> None:
        """Learn the appearance of the object from a measurement that was accepted."""

    def seek(self) -> None:
        """Begin without any place to search around; ArgumentError if the method cannot."""

    def reset(self) -> None:
        """Forget what the object looks like."""

    def switch(self, basis: np.ndarray, camera_model: str) -> None:
        """Go on with another basis (size, m) of corrections, or another camera model."""

    def adopt(self, options: TrackerOptions, control: ControlModel) -> None:
        """Go on by other settings, and with control points that may lie elsewhere."""


class SearchingEstimator(PoseMeter, Protocol):
    """Tests poses by what their estimates never looked at, and proposes others."""

    check: StartCheck
    search: PoseSearch

    @property
    def placed(self) -> bool:
        """Whether there ever was a place to search around."""

    def measured_anew(self, image: np.ndarray, state: ObjectPose,
                      covariance: np.ndarray) -> PoseMeasurement:
        """Measure without regard to what edges looked like."""

    def measured_by_edges(self, image: np.ndarray, predicted: ObjectPose, covariance: np.ndarray,
                          near: bool = False) -> PoseMeasurement:
        """Measure without corners of the texture; edges may be nearer than the covariance says."""

    def proposals(self, image: np.ndarray, state: ObjectPose, everywhere: bool,
                  covariance: np.ndarray, is_other: Callable[[ObjectPose], bool],
                  ) -> Iterator[ObjectPose]:
        """Propose other poses, one at a time, the cheapest first; not those of another thing."""

    def glance(self, image: np.ndarray, measured: PoseMeasurement) -> None:
        """Learn anew what object and background look like, from a pose that is not confirmed."""

    def disown(self) -> None:
        """Forget what was learned of the object at poses that were not confirmed."""
