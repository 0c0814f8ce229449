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
Is the board flat? Its bend is estimated with the camera, and told where the images show one.

A board that bends by a fifth of a percent of its length moves the focal length by as much. No
residual tells: the lens takes up what it can. Tilted views from several sides do tell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, chdtri

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.object_bend import Bend, bend_modes, BEND_NAMES
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.calibration.known_object.object_views import ObjectViews
from selfcal_ros.calibration.uncertainty.cluster_covariance import ClusterCovariance
from selfcal_ros.findings.finding import Finding

#: What is supposed of a board whose flatness nobody stated, as a share of its extent.
USUAL_FLATNESS = 0.03
#: A bend is told where chance would show one in fewer boards than this.
CHANCE = 1e-4
#: Millimetres in a metre: objects are in metres.
_MM = 1e3


@dataclass(frozen=True)
class BoardShape:
    """
    How a board bends, with the covariance of that.

    Attributes
    ----------
    bend : ndarray, shape (3,)
        By `BEND_NAMES`, in the unit of the object.
    covariance : ndarray, shape (3, 3)
    modes : ndarray, shape (P, 3)
        Heights of the object's points by the unknowns.
    normal : ndarray, shape (3,)

    """

    bend: np.ndarray
    covariance: np.ndarray
    modes: np.ndarray
    normal: np.ndarray

    @classmethod
    def of(cls, bundle: Bundle[ObjectState], state: ObjectState, clusters: ClusterCovariance,
           points: np.ndarray, extent: float) -> BoardShape:
        """
        Take the shape out of an adjustment.

        Parameters
        ----------
        bundle : Bundle
        state : ObjectState
        clusters : ClusterCovariance
            Of all that observations share, the shape included.
        points : ndarray, shape (P, 3)
            Of the object, in units of `extent`.
        extent : float
            In the unit of the object.

        Returns
        -------
        BoardShape

        """
        found, place = bend_modes(points), bundle.unknowns.places(BEND_NAMES)
        assert found is not None     # it has been free to bend
        return cls(extent * state.bend, extent**2 * clusters.covariance[np.ix_(place, place)],
                   *found)

    @property
    def off(self) -> np.ndarray:
        """How far the object's points stand off the plane, (P, 3)."""
        away: np.ndarray = (self.modes @ self.bend)[:, None] * self.normal
        return away

    @property
    def is_bent(self) -> bool:
        """Tell whether chance hardly shows such a bend."""
        square = self.bend @ np.linalg.solve(self.covariance, self.bend)
        return bool(chdtrc(len(self.bend), square) < CHANCE)

    def finding(self) -> Finding:
        """Tell how much the board bends, or how flat it is."""
        height = self.modes @ self.bend
        slope = self.modes[np.argmax(height)] - self.modes[np.argmin(height)]
        sigma = float(np.sqrt(slope @ self.covariance @ slope))
        told = {'bend_mm': {'value': _MM * float(np.ptp(height)), 'sigma': _MM * sigma}}
        if not self.is_bent:
            told['limit_mm'] = _MM * sigma * np.sqrt(chdtri(len(self.bend), CHANCE))
        return Finding('board_bent' if self.is_bent else 'board_flat', **told,
                       unknowns_m=self.bend.tolist(),
                       sigmas_m=np.sqrt(np.diag(self.covariance)).tolist())


def may_bend(views: ObjectViews, points: np.ndarray, sigma: float) -> ObjectViews | None:
    """
    Let the board of some views bend.

    Parameters
    ----------
    views : ObjectViews
    points : ndarray, shape (P, 3)
        Of the object, in the frame and unit of the views.
    sigma : float
        What is supposed of the bend, in this unit.

    Returns
    -------
    ObjectViews or None
        None where the object is no board, or one view cannot show its shape.

    """
    found = bend_modes(points)
    if found is None or len(views.frames) < 2:
        return None
    modes, normal = found
    return replace(views, bend=Bend(modes[views.point], normal, sigma))
