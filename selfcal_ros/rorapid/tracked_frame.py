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
"""What the tracker says of one image."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np


class TrackerState(Enum):
    """How far a pose can be trusted."""

    #: A pose was guessed; no image has confirmed it yet.
    INITIALISING = 'initialising'
    #: The image confirms the pose.
    TRACKING = 'tracking'
    #: Little of the object is seen: the pose leans on the prediction.
    DEGRADED = 'degraded'
    #: The object is not where it was expected; the pose is only the last prediction.
    LOST = 'lost'


@dataclass(frozen=True)
class TrackedFrame:
    """
    Attributes of one tracked image.

    Attributes
    ----------
    state : TrackerState
    reason : str
        One sentence; empty while TRACKING as asked for.
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,)
        Pose of the object in the camera's optical frame, X = R Xm + T, metres.
    covariance : ndarray, shape (6, 6)
        Of (tx ty tz rx ry rz), metres and radians; the rotation is a small turn on the camera's
        side. Grows with the prediction while nothing is seen.
    focal_px : float
        fx; the camera's own unless the camera model is 'zoom'.
    focal_sigma_px : float
        0 unless the camera model is 'zoom'.
    camera_model : str
        The model in use; 'weak' where zoom had to fall back to weak perspective.
    image_px : ndarray, shape (C, 2)
        Control points at the resulting pose, pixels.
    normal : ndarray, shape (C, 2)
        Unit normal of the projected primitive at each control point.
    edge_px : ndarray, shape (C,)
        Signed distance from the control point along the normal to its edgel; NaN if none.
    found, rejected, hidden : ndarray of bool, shape (C,)
        Found: has an edgel that supports the pose. Rejected: has an edgel that does not.
        Hidden: behind a face of the object itself (or outside the image). None of the three:
        searched, nothing there.
    primitive : ndarray of int, shape (C,)
        Primitive of each control point.
    texture_px : ndarray, shape (T, 2)
        Points of the texture that confirmed the pose.
    rms_px : float
        Root mean square of `edge_px` over the found control points; NaN without any.
    share_found : float
        Share of what should be visible and is confirmed.
    innovation : float
        Normalised innovation (Mahalanobis distance of the prediction per degree of freedom).
    stamp_ns : int or None
    doubt : str
        What seems wrong with the model, the camera or the start, and by how much; one sentence,
        empty where nothing does. The covariance counts it.

    """

    state: TrackerState
    reason: str
    rotation: np.ndarray
    translation: np.ndarray
    covariance: np.ndarray
    focal_px: float
    focal_sigma_px: float
    camera_model: str
    image_px: np.ndarray
    normal: np.ndarray
    edge_px: np.ndarray
    found: np.ndarray
    rejected: np.ndarray
    hidden: np.ndarray
    primitive: np.ndarray
    texture_px: np.ndarray
    rms_px: float
    share_found: float
    innovation: float
    stamp_ns: int | None = None
    doubt: str = ''

    def __bool__(self) -> bool:
        """Whether the pose is confirmed by the image."""
        return self.state in (TrackerState.TRACKING, TrackerState.DEGRADED)
