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
"""How the poses before a known object move with the lens, and what they have of their own."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.object_poses import VIEW_NAMES
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.calibration.reconstruction import PosePrecision
from selfcal_ros.geometry.projective import cross_matrix


def pose_precision(bundle: Bundle[ObjectState], state: ObjectState, extent: float,
                   ) -> PosePrecision:
    """
    Take from an optimum what the covariance of the poses needs.

    The adjustment eliminates the poses, so that they follow the lens and have a covariance of
    their own beside it.

    Parameters
    ----------
    bundle : Bundle
        Of points or edges of a known object.
    state : ObjectState
    extent : float
        Length in the unit of the object that is one in the adjustment.

    Returns
    -------
    PosePrecision
        In the frame of the object; lengths in its own unit.

    """
    linearisation = bundle.linearise(state)
    information = bundle.information(state, linearisation)
    unknowns = bundle.unknowns
    elimination = information.system.elimination(unknowns.selection)
    factor, _ = bundle.loss_factors(linearisation)
    slopes = _by_steps(state.path.cam_from_object, extent)
    views, steps = len(slopes), len(VIEW_NAMES)
    by_lens = np.zeros((views, steps, elimination.size))
    for view in range(views):
        for step in range(steps):
            form = np.zeros((views, steps))
            form[view] = slopes[view, step]
            by_lens[view, step], _ = elimination.point_form(form)
    half = elimination.inverse_root @ np.swapaxes(slopes, 1, 2)
    return PosePrecision(
        state.camera(), unknowns.free_lens_names,
        csr_array(by_lens.reshape(views * steps, -1)),
        information.covariance[np.ix_(unknowns.members, unknowns.members)],
        factor * np.swapaxes(half, 1, 2) @ half)


def _by_steps(poses: np.ndarray, extent: float) -> np.ndarray:
    """Differentiate centre and turn of cameras by the steps of `VIEW_NAMES`, (V, 6, 6)."""
    R_back = np.swapaxes(poses[:, :, :3], 1, 2)
    slopes = np.zeros((len(poses), 6, 6))
    slopes[:, :3, :3] = -extent * R_back @ cross_matrix(poses[:, :, 3])
    slopes[:, :3, 3:] = -extent * R_back
    slopes[:, 3:, :3] = -R_back
    return slopes
