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
"""What goes into one round of the search for edges, what is found, and what comes out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.small_system import inverted
from selfcal_ros.rorapid.edges.control_points import ControlView
from selfcal_ros.rorapid.projection.camera_models import ObjectPose

#: Where an edge is put that is not there, pixels: beyond every limit.
NOWHERE_PX = 1e6


@dataclass(frozen=True)
class PosePrior:
    """
    What is known of the pose before an image.

    Attributes
    ----------
    state : ObjectPose
        Predicted.
    covariance, information : ndarray, shape (m, m)
        Of its correction; one is the inverse of the other.

    """

    state: ObjectPose
    covariance: np.ndarray
    information: np.ndarray

    @classmethod
    def of(cls, state: ObjectPose, covariance: np.ndarray) -> PosePrior:
        """Return the prior of a state with a covariance (m, m)."""
        return cls(state, covariance, inverted(covariance))


@dataclass(frozen=True)
class SearchRound:
    """
    Where the edges are searched in one round, and how far.

    Attributes
    ----------
    state : ObjectPose
    view : ControlView
        At `state`.
    reach : int
        Search range to each side, pixels.
    limits : sequence of float
        Of Tukey's biweight, one for each step, pixels.
    weights : ndarray, shape (V,)
        Weights of the control points of the view.

    """

    state: ObjectPose
    view: ControlView
    reach: int
    limits: Sequence[float]
    weights: np.ndarray


@dataclass(frozen=True)
class EdgeCandidates:
    """
    Edges along the normals of the C control points searched, up to K for each.

    Attributes
    ----------
    offset, contrast : ndarray, shape (C, K)
        Pixels from the control point, `NOWHERE_PX` where there is no edge; grey levels.
    penalty : ndarray, shape (C, K)
        Pixels by which an edge counts as further away, as it looks otherwise than remembered.
    worse : ndarray, shape (C, K)
        Factor by which an edge is located worse than that of a line.
    weight : ndarray, shape (C,)
        Weight of the control points.
    profiles : ndarray, shape (C, S)
        Grey levels along the normals.

    """

    offset: np.ndarray
    contrast: np.ndarray
    penalty: np.ndarray
    worse: np.ndarray
    weight: np.ndarray
    profiles: np.ndarray


@dataclass(frozen=True)
class EdgeChoice:
    """
    One edge for each of the C control points searched.

    Attributes
    ----------
    offset, contrast : ndarray, shape (C,)
        Pixels from the control point; grey levels.
    near : ndarray of bool, shape (C,)
        Whether there is one within the limit.
    weight, off : ndarray, shape (C,)
        Tukey's weight over the variance; and the distance over Tukey's limit.

    """

    offset: np.ndarray
    contrast: np.ndarray
    near: np.ndarray
    weight: np.ndarray
    off: np.ndarray


@dataclass(frozen=True)
class EdgeFit:
    """
    Attributes of one round of search and solution; rows of the C control points searched.

    Attributes
    ----------
    state : ObjectPose
    edges, measured, solved : ndarray, shape (m, m)
        Information of the edges, edgels taken as independent; the same with the corners; with
        the prior as well, the matrix of the last solution.
    pull : ndarray, shape (m,)
        measured (z - state), z being what the image says without the prior.
    view : ControlView
    at : ndarray of int, shape (C,)
        Which control points of the view.
    clutter_weight : ndarray, shape (C,)
        Weight by what runs alongside.
    rows : ndarray, shape (C, m)
    residual, contrast, weight, off : ndarray, shape (C,)
        Pixels, NaN without an edge; grey levels; Tukey's weight over the variance; and the
        squared distance over Tukey's squared limit.
    profiles : ndarray, shape (C, S)
        Grey levels along the normals, from before the last correction.

    """

    state: ObjectPose
    edges: np.ndarray
    measured: np.ndarray
    solved: np.ndarray
    pull: np.ndarray
    view: ControlView
    at: np.ndarray
    clutter_weight: np.ndarray
    rows: np.ndarray
    residual: np.ndarray
    contrast: np.ndarray
    weight: np.ndarray
    off: np.ndarray
    profiles: np.ndarray
