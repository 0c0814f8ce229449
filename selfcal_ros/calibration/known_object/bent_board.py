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
Is the board flat, and printed to scale? Its shape is estimated with the camera, and told.

A board that bends by a fifth of a percent of its length moves the focal length by as much. So does
a print that is longer one way than the other. No residual tells: the lens takes up what it can.
Tilted views from several sides do tell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, chdtri

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.object_bend import Bend, BEND_NAMES, bend_modes, SHAPE_NAMES
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.calibration.known_object.object_views import ObjectViews
from selfcal_ros.calibration.uncertainty.cluster_covariance import ClusterCovariance
from selfcal_ros.findings.finding import Finding

#: What is supposed of a board whose flatness nobody stated, as a share of its extent.
USUAL_FLATNESS = 0.03
#: What is supposed of a print: the share by which it is longer one way, and the angle by which it
#: leans, radians.
USUAL_PRINT = 0.005
#: A bend, or a print that is off, is told where chance would show one in fewer boards than this.
CHANCE = 1e-4
#: Millimetres in a metre: objects are in metres.
_MM = 1e3
#: Where the unknowns of the bend stand, and those of the print.
_BEND, _PRINT = slice(0, len(BEND_NAMES)), slice(len(BEND_NAMES), len(SHAPE_NAMES))


@dataclass(frozen=True)
class BoardShape:
    """
    How a board bends and is printed, with the covariance of that.

    Attributes
    ----------
    shape : ndarray, shape (5,)
        By `SHAPE_NAMES`, lengths in the unit of the object.
    covariance : ndarray, shape (5, 5)
    modes : ndarray, shape (P, 5, 3)
        How the object's points move by the unknowns.
    normal : ndarray, shape (3,)

    """

    shape: np.ndarray
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
        found, place = bend_modes(points), bundle.unknowns.places(SHAPE_NAMES)
        assert found is not None     # it has been free to bend
        modes, normal = found
        unit = np.ones(len(SHAPE_NAMES))
        unit[_BEND] = extent
        modes[:, _PRINT] *= extent
        return cls(unit * state.bend, np.outer(unit, unit) * clusters.covariance[
            np.ix_(place, place)], modes, normal)

    @property
    def off(self) -> np.ndarray:
        """How far the object's points are from where they were stated, (P, 3)."""
        away: np.ndarray = np.einsum('pki,k->pi', self.modes, self.shape)
        return away

    def _shows(self, which: slice) -> bool:
        """Tell whether chance hardly shows what some of the unknowns are."""
        found = self.shape[which]
        square = found @ np.linalg.solve(self.covariance[which, which], found)
        return bool(chdtrc(len(found), square) < CHANCE)

    def findings(self) -> tuple[Finding, ...]:
        """Tell how much the board bends, or how flat it is, and a print that is not to scale."""
        heights, bend = self.modes[:, _BEND] @ self.normal, self.shape[_BEND]
        covariance, is_bent = self.covariance[_BEND, _BEND], self._shows(_BEND)
        height = heights @ bend
        slope = heights[np.argmax(height)] - heights[np.argmin(height)]
        sigma = float(np.sqrt(slope @ covariance @ slope))
        told = {'bend_mm': {'value': _MM * float(np.ptp(height)), 'sigma': _MM * sigma}}
        if not is_bent:
            told['limit_mm'] = _MM * sigma * np.sqrt(chdtri(len(bend), CHANCE))
        bent = Finding('board_bent' if is_bent else 'board_flat', **told, unknowns_m=bend.tolist(),
                       sigmas_m=np.sqrt(np.diag(covariance)).tolist())
        if not self._shows(_PRINT):
            return (bent,)
        stretch, lean = (
            {'value': float(value), 'sigma': float(spread)} for value, spread in zip(
                self.shape[_PRINT], np.sqrt(np.diag(self.covariance)[_PRINT])))
        return bent, Finding('board_print_off', stretch_percent={
            name: 100 * value for name, value in stretch.items()}, lean_deg={
                name: float(np.degrees(value)) for name, value in lean.items()})


def may_bend(views: ObjectViews, points: np.ndarray, sigma: float) -> ObjectViews | None:
    """
    Let the board of some views bend, and be printed not quite to scale.

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
    supposed = np.full(len(SHAPE_NAMES), USUAL_PRINT)
    supposed[_BEND] = sigma
    return replace(views, bend=Bend(found[0][views.point], supposed))
