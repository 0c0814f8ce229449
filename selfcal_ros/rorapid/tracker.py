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
"""RAPiD, RoRAPiD and what came after: the pose of a known object from frame to frame."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState

__all__ = ['RorapidTracker', 'TrackedFrame', 'TrackerOptions', 'TrackerState']


class RorapidTracker:
    """
    Follow a known object through images.

    Parameters
    ----------
    model : WireframeModel
    camera : Camera
    options : TrackerOptions, optional
    rng : numpy.random.Generator, optional
        For the samples of RANSAC; None: a generator of fixed seed.

    """

    def __init__(self, model, camera: Camera, options: TrackerOptions | None = None, rng=None):
        """Prepare the model for this camera."""
        raise NotImplementedError

    def start(self, rotation, translation, covariance=None) -> None:
        """Take a guess of the pose; the state becomes INITIALISING."""
        raise NotImplementedError

    def track(self, image: np.ndarray, stamp_ns: int | None = None) -> TrackedFrame:
        """Find the object in the next image, (H, W) or (H, W, 3) uint8."""
        raise NotImplementedError

    def reset(self) -> None:
        """Forget pose and texture; a new start is needed."""
        raise NotImplementedError

    @property
    def state(self) -> TrackerState:
        """State after the last image."""
        raise NotImplementedError
