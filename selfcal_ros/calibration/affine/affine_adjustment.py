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
"""Bundle adjustment without calibration: affine cameras and points, translated views [I | e]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.geometry.levenberg_marquardt import curved_step, DampedFactor
from selfcal_ros.geometry.projective import tangent_basis
from selfcal_ros.geometry.reduced_system import ReducedSystem
from selfcal_ros.geometry.resection import projection_jacobian
from selfcal_ros.geometry.robust_loss import huber_loss, huber_weights
from selfcal_ros.geometry.robust_scale import robust_sigma_of_lengths
from selfcal_ros.geometry.scaled_inverse import unit_diagonal
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.geometry.selection_matrix import selection_matrix

#: Residuals beyond so many sigmas weigh less.
_HUBER_SIGMAS = 2.5
#: An iteration that lowers the cost by less than this share is the last one: what the pixels'
#: distortion leaves makes the cost fall slowly for long.
_LAST_FRACTION = 2e-3


@dataclass(frozen=True)
class AffineViews:
    """
    Cameras, points and observations to adjust.

    Attributes
    ----------
    cameras : ndarray, shape (V, 3, 4)
        The first is [I | 0], the translated ones [I | e]; pixels.
    points : ndarray, shape (P, 4)
    translated : ndarray of bool, shape (V,)
    view, point : ndarray of int, shape (N,)
        Sorted by point.
    xy : ndarray, shape (N, 2)
        Pixels.

    """

    cameras: np.ndarray
    points: np.ndarray
    translated: np.ndarray
    view: np.ndarray
    point: np.ndarray
    xy: np.ndarray


@dataclass(frozen=True)
class Adjusted:
    """
    The optimum.

    Attributes
    ----------
    cameras : ndarray, shape (V, 3, 4)
    points : ndarray, shape (P, 4)
        Unit norm.
    covariance : ndarray, shape (9 n, 9 n)
        Of the left halves of the n cameras that are not translated, row-wise.
    sigma_px : float
        Robust standard deviation of an image coordinate.

    """

    cameras: np.ndarray
    points: np.ndarray
    covariance: np.ndarray
    sigma_px: float


def adjust(views: AffineViews, iterations: int = 25, plane_sigma: float | None = None) -> Adjusted:
    """
    Minimise the reprojection error over cameras and points, with Huber's loss.

    Parameters
    ----------
    views : AffineViews
    iterations : int
        0: leave them as they are, and find the covariance only.
    plane_sigma : float, optional
        Of projective views, whose plane at infinity nothing holds: how far it may move all
        cameras together, these of unit norm.

    Returns
    -------
    Adjusted

    """
    # pixels of the order of one, and the affine frame with them
    centre, scale = views.xy.mean(axis=0), float(np.abs(views.xy - views.xy.mean(axis=0)).max())
    T = np.array([[1 / scale, 0, -centre[0] / scale], [0, 1 / scale, -centre[1] / scale],
                  [0, 0, 1]])
    inverse = np.linalg.inv(T)
    frame = np.eye(4)
    frame[:3, :3] = T
    cameras = T @ views.cameras @ np.linalg.inv(frame)
    norm = np.linalg.norm(cameras, axis=(1, 2))[:, None, None]
    cameras = np.where(views.translated[:, None, None], cameras, cameras / norm)
    points = views.points @ frame.T
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    problem = _Adjustment(replace(views, xy=(views.xy - centre) / scale))
    cameras, points, covariance, sigma = problem.optimise(cameras, points, iterations, plane_sigma)
    carry = np.kron(np.eye(int((~views.translated).sum())), np.kron(inverse, T.T))
    points = points @ np.linalg.inv(frame).T
    return Adjusted(inverse @ cameras @ frame, points / np.linalg.norm(points, axis=1)[:, None],
                    carry @ covariance @ carry.T, sigma * scale)


class _Adjustment:
    """Levenberg-Marquardt on twelve unknowns a view, in normalised pixels."""

    def __init__(self, views: AffineViews):
        self.views = views
        self.blocks = PointBlocks(views.point, views.view)
        count = len(views.cameras)
        free = np.ones((count, 3, 4), bool)
        free[views.translated, :, :3] = False
        free[0] = False
        self.free = free.ravel()
        # each free camera's scale, and one for the inverse depths
        self.gauges = int((~views.translated).sum()) + 1
        self.freedom = (2 * len(views.xy) - int(self.free.sum()) + self.gauges
                        - 3 * self.blocks.point_count)

    def apply(self, cameras: np.ndarray, points: np.ndarray, step: np.ndarray,
              point_steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Move cameras and points; all but the translated cameras are of unit norm."""
        cameras = cameras + step.reshape(-1, 3, 4)
        norm = np.linalg.norm(cameras, axis=(1, 2))[:, None, None]
        points = points + np.einsum('pij,pj->pi', tangent_basis(points), point_steps)
        return (np.where(self.views.translated[:, None, None], cameras, cameras / norm),
                points / np.linalg.norm(points, axis=1, keepdims=True))

    def residuals(self, cameras: np.ndarray, points: np.ndarray) -> np.ndarray:
        x = np.einsum('nij,nj->ni', cameras[self.views.view], points[self.views.point])
        with np.errstate(divide='ignore', invalid='ignore'):
            residual: np.ndarray = x[:, :2] / x[:, 2:] - self.views.xy
        return residual

    def sigma(self, residual: np.ndarray) -> float:
        """Robust estimate of the noise of a coordinate."""
        distance = np.linalg.norm(residual, axis=1)
        share = max(self.freedom, 1) / (2 * len(distance))
        return float(max(robust_sigma_of_lengths(distance) / np.sqrt(share), 1e-12))

    def system(self, cameras: np.ndarray, points: np.ndarray, sigma: float, damping: float,
               ) -> tuple[ReducedSystem, np.ndarray]:
        view, point = self.views.view, self.views.point
        jac_view = np.empty((len(view), 2, 12))
        for k, camera in enumerate(cameras):
            rows = view == k
            jac_view[rows] = projection_jacobian(camera, points[point[rows]])[1]
        x = np.einsum('nij,nj->ni', cameras[view], points[point])
        image = x[:, :2] / x[:, 2:]
        slope = cameras[view][:, :2] - image[:, :, None] * cameras[view][:, None, 2]
        jac_point = slope / x[:, 2, None, None] @ tangent_basis(points)[point]
        residual = image - self.views.xy
        weight = np.sqrt(huber_weights(np.linalg.norm(residual, axis=1) / sigma, _HUBER_SIGMAS))
        root = (weight / sigma)[:, None]
        jac_view[:, :, :] *= self.free.reshape(-1, 12)[view][:, None]
        unreduced = self.blocks.unreduced(
            np.zeros((len(view), 2, 0)), jac_view * root[..., None], jac_point * root[..., None],
            residual * root)
        return unreduced.reduced(damping), root

    def optimise(self, cameras: np.ndarray, points: np.ndarray, iterations: int,
                 plane_sigma: float | None = None,
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """
        Minimise Huber's loss; cameras, points, covariance of the cameras, and noise.

        Levenberg-Marquardt in a loop of its own: the noise, and with it the cost, is estimated
        anew in each step, which `levenberg_marquardt.minimise` does not allow for.
        """
        residual = self.residuals(cameras, points)
        sigma = self.sigma(residual)
        damping = 1e-4
        unknowns = selection_matrix(self.free)
        for _ in range(iterations):
            sigma = self.sigma(residual)
            cost = self._cost(residual, sigma)
            system, root = self.system(cameras, points, sigma, damping)
            factor = DampedFactor(system.matrix, system.diagonal, damping, unknowns)
            if not factor.usable:
                damping *= 10
                continue
            steps = curved_step(system, factor, lambda *ahead: root * self.residuals(
                *self.apply(cameras, points, *ahead)))
            moved, new_points = self.apply(cameras, points, *steps)
            new_residual = self.residuals(moved, new_points)
            new = self._cost(new_residual, sigma)
            if new < cost:
                cameras, points, residual = moved, new_points, new_residual
                damping = max(0.1 * damping, 1e-10)
                if cost - new < _LAST_FRACTION * new:
                    break
            else:
                damping *= 10
                if damping > 1e6:
                    break
        sigma = self.sigma(residual)
        return cameras, points, self._covariance(cameras, points, sigma, plane_sigma), sigma

    @staticmethod
    def _cost(residual: np.ndarray, sigma: float) -> float:
        distance = np.linalg.norm(residual, axis=1) / sigma
        return float(huber_loss(np.where(np.isfinite(distance), distance, 1e6),
                                _HUBER_SIGMAS).sum())

    def _covariance(self, cameras: np.ndarray, points: np.ndarray, sigma: float,
                    plane_sigma: float | None = None) -> np.ndarray:
        """Covariance of the free cameras' left halves, scales and depth unit held."""
        system, _ = self.system(cameras, points, sigma, 0.0)
        matrix = system.matrix
        weight = float(np.median(system.diagonal[self.free]))
        flat = np.zeros((len(cameras), 12))
        for k in np.flatnonzero(~self.views.translated):
            gauge = flat.copy()
            gauge[k] = cameras[k].ravel() / np.linalg.norm(cameras[k])
            matrix = matrix + weight * np.outer(gauge, gauge)
        depth = np.zeros_like(cameras)
        depth[:, :, 3] = cameras[:, :, 3]
        gauge = depth.ravel() / np.linalg.norm(depth)
        matrix = matrix + weight * np.outer(gauge, gauge)
        if plane_sigma is not None:
            for axis in range(3):
                # [M + m b^T | m]: the same images of points (X, w - b X)
                plane = np.zeros_like(cameras)
                plane[:, :, axis] = cameras[:, :, 3]
                plane[0] = 0
                gauge = plane.ravel() / np.linalg.norm(plane)
                matrix = matrix + np.outer(gauge, gauge) / plane_sigma**2
        index = np.flatnonzero(self.free)
        scaled, root = unit_diagonal(matrix[np.ix_(index, index)])
        values, vectors = np.linalg.eigh(scaled)
        values = np.maximum(values, 1e-14 * values[-1])
        covariance = np.zeros(matrix.shape)
        covariance[np.ix_(index, index)] = (vectors / values) @ vectors.T / np.outer(root, root)
        left = np.zeros(cameras.shape, bool)
        left[~self.views.translated, :, :3] = True
        chosen = np.flatnonzero(left.ravel())
        return covariance[np.ix_(chosen, chosen)]
