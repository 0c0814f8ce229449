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
How far a camera that seems to turn about its centre may be from the centre of rotation.

A lever ℓ from the point that rests moves the image of a point at depth d by what ℓ / d does. What
it does at the points' usual depth is nearly what another focal length and principal point do. Only
the differences of depth tell it from none. With a depth for every point the cost would fall by

    e / 2,  e = P + κ |ℓ|² ± sqrt(2 P + 4 κ |ℓ|²)

for P points, with κ the information of the images about single depths, and their usual spread. One
step tells e, for the direction of ℓ that has the largest. So levers are weighed by how probable
they make e, and by what they do at one common depth. What the lever may do is added to the
covariance of the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.information import HUBER_SIGMAS
from selfcal_ros.calibration.bundle.lens import Projection
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.uncertainty.suppositions import (added_covariance,
                                                              joint_information, likely_size,
                                                              Supposition)
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.robust_loss import huber_weights

#: Levers over the usual depth of points: each is as likely beforehand.
LEVERS = np.geomspace(3e-4, 3e-2, 13)
#: Inverse depths scatter by such a share of their mean: what of it is no smooth function of the
#: direction, which turns and lens would take for their own.
SPREAD = 0.15
#: Directions of a lever that are tried.
DIRECTIONS = 200
_LEVER = 'no lever'


@dataclass(frozen=True)
class HiddenLever:
    """
    What a lever that the images do not exclude may do to a camera that turns.

    Attributes
    ----------
    size : float
        Standard deviation of the lever's coordinates over the usual depth of points.
    covariance : ndarray, shape (k, k)
        To add to that of the unknowns of the lens.

    """

    size: float
    covariance: np.ndarray

    def findings(self, other: np.ndarray) -> tuple[Finding, ...]:
        """Report it where it adds more variance to the focal length than all else, (k, k)."""
        return ((Finding('lever_not_excluded', share=self.size),)
                if self.covariance[0, 0] > other[0, 0] else ())


def hidden_lever(fit: RobustFit, variance_inflation: float) -> HiddenLever:
    """
    Ask the images of an optimum for a lever between the camera and the point that rests.

    Parameters
    ----------
    fit : RobustFit
        By rotations alone, at its optimum.
    variance_inflation : float
        Variance of the estimate over that with independent errors.

    Returns
    -------
    HiddenLever

    """
    columns = _by_lever(fit)
    tested = joint_information(fit, [Supposition(_LEVER, ('x', 'y', 'z'), columns)],
                               variance_inflation).test(_LEVER)
    gain, points, told = _by_depths(fit, columns, variance_inflation)
    shown = SPREAD**2 * told * LEVERS**2
    variance = 2 * points + 4 * shown
    size = likely_size(tested.value, tested.information, LEVERS,
                       -0.5 * ((gain - points - shown)**2 / variance + np.log(variance)))
    return HiddenLever(size, added_covariance(fit, tested, size**2))


def _by_lever(fit: RobustFit) -> np.ndarray:
    """Differentiate the residuals by a lever before points at depth one, shape (N, 2, 3)."""
    blocks, state = fit.bundle.blocks, fit.state
    ray = state.points[:, :3] / np.linalg.norm(state.points[:, :3], axis=1, keepdims=True)
    turned = state.path.cam_from_world()[blocks.view, :, :3]
    seen = np.einsum('nij,nj->ni', turned, ray[blocks.point])
    return Projection(state.lens, seen).by_points()


def _by_depths(fit: RobustFit, columns: np.ndarray, variance_inflation: float,
               ) -> tuple[float, int, float]:
    """
    Let every point have a depth, its direction eliminated.

    Returns
    -------
    gain : float
        Twice what the cost falls by, for the lever of the likeliest direction.
    points : int
        Points of which the images could tell a depth.
    told : float
        Information about the single inverse depths for a lever of length one, summed; its mean
        over directions.

    """
    linearisation, blocks = fit.linearisation, fit.bundle.blocks
    distance = np.linalg.norm(linearisation.residual, axis=1) / fit.bundle.sigma_px
    weight = huber_weights(distance, HUBER_SIGMAS) * linearisation.ahead
    weight = weight / (variance_inflation * fit.bundle.sigma_px**2)
    H, b = blocks.point_equations(np.concatenate([linearisation.eliminated, columns], axis=2),
                                  linearisation.residual, weight)
    through = np.swapaxes(H[:, :3, 3:], 1, 2) @ np.linalg.pinv(H[:, :3, :3], hermitian=True,
                                                               rcond=1e-9)
    information = H[:, 3:, 3:] - through @ H[:, :3, 3:]
    slope = b[:, 3:] - np.einsum('pij,pj->pi', through, b[:, :3])
    along = _half_sphere(DIRECTIONS)
    told = np.einsum('di,pij,dj->dp', along, information, along)
    enough = told > 1e-6 * np.trace(H[:, 3:, 3:], axis1=1, axis2=2)
    gain = np.where(enough, (along @ slope.T)**2 / np.where(enough, told, 1.0), 0.0).sum(axis=1)
    best = int(np.argmax(gain))
    return (float(gain[best]), int(enough[best].sum()),
            float(np.trace(information, axis1=1, axis2=2).sum()) / 3)


def _half_sphere(count: int) -> np.ndarray:
    """Unit vectors (count, 3) that are spread evenly, of every two opposite ones one."""
    z = (np.arange(count) + 0.5) / count
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    across = np.sqrt(1 - z**2)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
