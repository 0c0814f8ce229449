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
The fixed point of a turning camera: where on the axis of rotation it lies.

Any point of the axis explains the images nearly as well. An adjustment that began with one far
along the axis ends in false optima: from there the smallest turns about other axes move the
camera far.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.state import SceneState

#: Turns about one axis: those about others are less than this share of them.
ONE_AXIS = 0.05


def axis_of_all(rotations: np.ndarray) -> np.ndarray | None:
    """
    Return the axis that all views turn about.

    Parameters
    ----------
    rotations : ndarray, shape (V, 3, 3)
        Of views from the first view.

    Returns
    -------
    ndarray, shape (3,), or None
        Unit, in the frame of every view; None where the views turn about several.

    """
    # what an axis loses by the turns: |(R - 1) a|^2 = a^T (2 - R - R^T) a
    lost = np.sum(2 * np.eye(3) - rotations - np.swapaxes(rotations, 1, 2), axis=0)
    values, vectors = np.linalg.eigh(lost)
    axis: np.ndarray = vectors[:, 0]
    return axis if values[0] < ONE_AXIS**2 * values[1] else None


def resting_near(state: SceneState) -> SceneState | None:
    """
    Let the point of a common axis rest that is the nearest to the camera.

    Parameters
    ----------
    state : SceneState
        Of views that turn about the world's origin.

    Returns
    -------
    SceneState or None
        None where they turn about several axes, as then the point is determined.

    """
    path, points = state.path, state.points
    R = path.rotations()
    axis = axis_of_all(R @ R[0].T)
    if axis is None:
        return None
    along = float(axis @ path.translation[0])
    places = points[:, :3] + along * points[:, 3:] * (R[0].T @ axis)
    points = np.column_stack([places, points[:, 3]])
    return replace(state, path=replace(path, translation=path.translation - along * axis),
                   points=points / np.linalg.norm(points, axis=1, keepdims=True))
