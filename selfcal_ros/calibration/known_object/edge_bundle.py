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
Adjustment of a camera and its poses before the edges of a known object.

An edgel lies somewhere on the image of its edge: one equation, its distance from the projected
edge (thesis 7.2, equation 7.12, with the calibration among the unknowns; 8.2 asks for it).
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.information import Evidence, HUBER_SIGMAS
from selfcal_ros.calibration.bundle.pixel_model import PixelModel
from selfcal_ros.calibration.bundle.reprojection import MINIMUM_DEPTH
from selfcal_ros.calibration.known_object.object_bundle import (INTERNAL, ObjectBundle,
                                                                ObjectState, POSE)
from selfcal_ros.geometry.optimise import huber_loss, huber_weights


class EdgeBundle(ObjectBundle):
    """
    Least squares over edgels of known edges.

    Parameters
    ----------
    view : ndarray of int, shape (N,)
        Indices from zero, ascending; every view occurs.
    points, tangents : ndarray, shape (N, 3)
        A point of each edgel's edge, near where it was seen, and the edge's direction there,
        object coordinates.
    xy : ndarray, shape (N, 2)
        The edgels, pixels.
    priors, sigma_px
        As in `ObjectBundle`; sigma_px is that of the distance from an edge.

    """

    def __init__(self, view, points, tangents, xy, *, priors, sigma_px: float):
        super().__init__(view, points, xy, priors=priors, sigma_px=sigma_px)
        self.tangents = tangents

    @property
    def degrees_of_freedom(self) -> int:
        """Observations and soft facts less unknowns."""
        soft = sum(0 < prior.sigma < np.inf for prior in self.priors.values())
        return len(self.view) + soft - int(self.free.sum()) - POSE * self.views

    def _feet(self, state: ObjectState):
        """
        Project the point of each edge that lies nearest to its edgel.

        Returns the turned points, depth, which are ahead, the pixel model and the normals (N, 2).
        """
        R, t = state.cam_from_object[:, :, :3], state.cam_from_object[:, :, 3]
        turned, along = np.empty_like(self.points), np.empty_like(self.points)
        for v in range(self.views):
            rows = slice(self.first[v], self.first[v + 1])
            np.matmul(self.points[rows], R[v].T, out=turned[rows])
            np.matmul(self.tangents[rows], R[v].T, out=along[rows])
        move = t[self.view]

        def project():
            X = turned + move
            ahead = X[:, 2] > MINIMUM_DEPTH
            depth = np.where(ahead, X[:, 2], MINIMUM_DEPTH)
            model = PixelModel(state.intrinsics, X[:, 0] / depth, X[:, 1] / depth)
            run = np.einsum('nij,nj->ni', model.by_points(depth), along)
            length = np.maximum(np.linalg.norm(run, axis=1), 1e-12)
            return depth, ahead, model, run / length[:, None], length

        depth, ahead, model, run, length = project()
        # slide along the edge; beyond a tenth of the depth the first order means nothing
        slide = np.einsum('ni,ni->n', self.xy - model.uv, run) / length
        turned = turned + np.clip(slide, -0.1 * depth, 0.1 * depth)[:, None] * along
        depth, ahead, model, run, _ = project()
        return turned, depth, ahead, model, np.column_stack([-run[:, 1], run[:, 0]])

    def residuals(self, state: ObjectState) -> np.ndarray:
        """Signed distances from the edges in pixels, (N, 1); NaN behind the camera."""
        _, _, ahead, model, normal = self._feet(state)
        distance = np.einsum('ni,ni->n', model.uv - self.xy, normal)
        return np.where(ahead, distance, np.nan)[:, None]

    def offsets(self, state: ObjectState) -> np.ndarray:
        """Residuals as vectors from the edgel to its edge, (N, 2) pixels."""
        _, _, ahead, model, normal = self._feet(state)
        distance = np.einsum('ni,ni->n', model.uv - self.xy, normal)
        return np.where(ahead[:, None], distance[:, None] * normal, np.nan)

    def noise_sigma(self, state: ObjectState) -> float:
        """Estimate the standard deviation of a distance while there may be outliers."""
        distance = np.abs(self.residuals(state)).ravel()
        distance = distance[np.isfinite(distance)]
        freedom = self.degrees_of_freedom
        if freedom <= 0 or not len(distance):
            return np.nan
        share = freedom / len(distance)
        sigma = float(np.sqrt(np.mean(distance**2) / share))
        for _ in range(30):
            limit = HUBER_SIGMAS * sigma * np.sqrt(share)
            sigma = float(np.sqrt(np.mean(np.minimum(distance, limit)**2)
                                  / (_WINSORISED * share)))
        return max(sigma, 1e-9)

    def cost(self, state: ObjectState) -> float:
        """Robust cost in units of sigma²; infinite where the state is impossible."""
        if not (np.isfinite(state.intrinsics).all() and (state.intrinsics[:2] > 0).all()):
            return np.inf
        _, _, ahead, model, normal = self._feet(state)
        distance = np.abs(np.einsum('ni,ni->n', model.uv - self.xy, normal)) / self.sigma_px
        if not np.isfinite(distance).all():
            return np.inf
        distance = np.where(ahead, distance, np.maximum(distance, 100.0))
        return float(huber_loss(distance, HUBER_SIGMAS).sum()) + self._prior_terms(state)[0]

    def _rows(self, state: ObjectState):
        """Return weighted derivatives and residual side by side, (N, 1, 16)."""
        turned, depth, ahead, model, normal = self._feet(state)
        residual = np.einsum('ni,ni->n', model.uv - self.xy, normal)
        weight = huber_weights(np.abs(residual) / self.sigma_px, HUBER_SIGMAS) * ahead
        J_X = np.einsum('nij,ni->nj', model.by_points(depth), normal)
        rows = np.empty((len(depth), 1, INTERNAL + POSE + 1))
        rows[:, 0, :INTERNAL] = np.einsum('nij,ni->nj', model.by_intrinsics(self.free), normal)
        rows[:, 0, :INTERNAL][:, ~self.free] = 0
        rows[:, 0, INTERNAL:INTERNAL + 3] = np.cross(turned, J_X)
        rows[:, 0, INTERNAL + 3:-1] = J_X
        rows[:, 0, -1] = residual
        rows *= (np.sqrt(weight) / self.sigma_px)[:, None, None]
        return rows

    def evidence(self, state: ObjectState) -> Evidence:
        """Covariance at the optimum and every edgel's influence; see `ObjectBundle.evidence`."""
        rows = self._rows(state)
        equations = self.equations(state, rows)
        matrix, _, _, carry = equations.eliminate()
        distance = np.abs(self.residuals(state)).ravel() / self.sigma_px
        distance = distance[np.isfinite(distance)]
        share = max(self.degrees_of_freedom, 1) / len(distance)
        psi_square = np.mean(np.minimum(distance, HUBER_SIGMAS)**2) / share
        slope = np.mean(distance <= HUBER_SIGMAS)
        weight = np.mean(huber_weights(distance, HUBER_SIGMAS))
        inverse = self._inverse(matrix, equations.shared)
        single = rows[:, 0, :-1] * rows[:, 0, -1:]
        own = single[:, :INTERNAL] - np.einsum('nik,nk->ni', carry[self.view],
                                               single[:, INTERNAL:])
        influence = -own @ inverse * weight / slope
        return Evidence(inverse * psi_square * weight / slope**2, influence, share, share)


def _winsorised_variance(limit: float) -> float:
    """E[min(z, c)²] of a Gaussian z."""
    from scipy.special import erf
    inside = erf(limit / np.sqrt(2))
    density = np.exp(-limit**2 / 2) / np.sqrt(2 * np.pi)
    return float(inside - 2 * limit * density + limit**2 * (1 - inside))


_WINSORISED = _winsorised_variance(HUBER_SIGMAS)
