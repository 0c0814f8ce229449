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
"""What a pose from lines read one after the other owes to a velocity that is not known well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.rorapid.estimation.edge_fit import EdgeFit
from selfcal_ros.rorapid.projection.row_motion import RowMotion

#: What tells nothing of a correction tells nothing of when it was seen; share of its information.
_NOTHING = 1e-9


@dataclass(frozen=True)
class RowDoubt:
    """
    When the lines were read that tell a pose.

    Attributes
    ----------
    late : ndarray, shape (m, m)
        Seconds after the stamp: the image tells the correction p + late v, v the error of the
        velocity. A multiple of the identity where all of the object is in one line.
    velocity : ndarray, shape (m, m)
        Covariance of v.

    """

    late: np.ndarray
    velocity: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (m, m) of the pose at the stamp that the doubt of the velocity adds."""
        doubt: np.ndarray = self.late @ self.velocity @ self.late.T
        return doubt


def row_doubt(fit: EdgeFit, row_motion: RowMotion, basis: np.ndarray) -> RowDoubt:
    """
    Tell when the lines were read in which a pose was found.

    Parameters
    ----------
    fit : EdgeFit
    row_motion : RowMotion
    basis : ndarray, shape (size, m)
        Corrections p of the pose, q = basis p.

    Returns
    -------
    RowDoubt

    """
    tau = row_motion.seconds(fit.view.projected.pixels[fit.at])
    late = (fit.rows * (fit.weight * tau)[:, None]).T @ fit.rows
    total = float(fit.weight.sum())
    if total > 0:
        # corners of the texture lie where the edges are
        late += float(fit.weight @ tau) / total * (fit.measured - fit.edges)
    floor = _NOTHING * (np.diag(np.diag(fit.measured)) + np.eye(len(late)))
    return RowDoubt(np.linalg.solve(fit.measured + floor, late),
                    basis.T @ row_motion.covariance @ basis)
