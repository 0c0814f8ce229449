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
"""Corrections of a pose that a shape does not show, and what is left without them."""

from __future__ import annotations

import numpy as np

from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection


def free_at(turns: np.ndarray, state: ObjectPose, projection: Projection) -> np.ndarray:
    """
    Corrections that leave a shape where it is.

    Parameters
    ----------
    turns : ndarray, shape (k, 6)
        `free_turns` of the model, object frame, about its middle.
    state : ObjectPose
        Of the middle.
    projection : Projection

    Returns
    -------
    ndarray, shape (size, k)
        No columns for the affine camera.

    """
    size = projection.size
    if not len(turns):
        return np.zeros((size, 0))
    turns = turns if size < 8 else turns[:0]
    out = np.zeros((size, len(turns)))
    out[:3] = state.rotation @ turns[:, :3].T
    out[3:6] = state.rotation @ turns[:, 3:].T
    return out


def apart_from(directions: np.ndarray) -> np.ndarray:
    """Return what projects onto all that is across directions (n, k); shape (n, n)."""
    across: np.ndarray = np.eye(len(directions)) - directions @ np.linalg.pinv(directions)
    return across
