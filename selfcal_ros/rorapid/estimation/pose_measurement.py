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
"""What one image says of the pose of the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.rorapid.edges.control_points import ControlView
from selfcal_ros.rorapid.estimation.edge_fit import EdgeFit
from selfcal_ros.rorapid.estimation.row_doubt import RowDoubt
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.region.region_of_interest import Region
from selfcal_ros.rorapid.texture.texture_memory import TextureMatches


@dataclass(frozen=True)
class SearchDetails:
    """
    What the robust tracker learns from a measurement, if it is accepted.

    Attributes
    ----------
    region : Region or None
        Part of the image around the object; None outside of the image.
    fit : EdgeFit
        Last round of the search for edges.
    matches : TextureMatches or None
    agree : ndarray of bool, shape (N,)
        Which of the matches agree with the pose.
    scatter : ndarray, shape (4,)
        Sums of `edges.edge_noise.CommonScatter`.
    edge_share : float
        Share of the edges searched that were found.
    misfit : float
        Median distance of those from the pose in their sigmas: 0.67 where it is right. 0 for an
        outline, whose pieces err together, and for cameras that are not quite the real one.

    """

    region: Region | None
    fit: EdgeFit
    matches: TextureMatches | None
    agree: np.ndarray
    scatter: np.ndarray
    edge_share: float
    misfit: float


@dataclass(frozen=True)
class PoseMeasurement:
    """
    One measurement of the pose.

    Attributes
    ----------
    state : ObjectPose
    covariance : ndarray, shape (m, m)
        Of the correction p of that state; of the posterior if `with_prior`, else of the
        measurement alone.
    with_prior : bool
    view : ControlView
        Control points at `state`.
    edge_px : ndarray, shape (C,)
        Distance of each control point to its edgel along the normal, NaN without one.
    found : ndarray of bool, shape (C,)
    texture_px : ndarray, shape (T, 2)
    share : float
        Share of what should be seen and is confirmed.
    determined : bool
        Whether the measurement determines all of the correction.
    recognised : bool
        Whether it would do to recognise an object that was lost.
    by_texture : bool
        Whether the texture recognised it.
    focal_sigma : float
        Relative standard deviation of the focal length from this image alone (zoom).
    reason : str
        Why not, or why the share is low; one sentence.
    details : SearchDetails or None
        Of the robust tracker.
    rows : RowDoubt or None
        When the lines were read that tell the pose; None where all are read at once. The
        covariance is that for the velocity as predicted.

    """

    state: ObjectPose
    covariance: np.ndarray
    with_prior: bool
    view: ControlView
    edge_px: np.ndarray
    found: np.ndarray
    texture_px: np.ndarray
    share: float
    determined: bool
    recognised: bool = False
    by_texture: bool = False
    focal_sigma: float = 0.0
    reason: str = ''
    details: SearchDetails | None = None
    rows: RowDoubt | None = None

    @property
    def whole_covariance(self) -> np.ndarray:
        """Its covariance (m, m) with what the doubt of the velocity adds."""
        return self.covariance if self.rows is None else self.covariance + self.rows.covariance
