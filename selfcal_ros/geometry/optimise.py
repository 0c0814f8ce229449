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
Least squares over many points: Schur complement, Levenberg-Marquardt, robust loss.

The unknowns are a few that every observation shares (g: calibration, axis), a few for each
view (v), and three for each point (p). Points are eliminated first; the system that remains has
the size of g + views · v.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, LinAlgError

#: Points are reduced in groups that share a window of views, so that the cost grows with the
#: length of the tracks and not with that of the sequence.
GROUP_POINTS = 192


class PointBlocks:
    """
    Bookkeeping of one set of observations, made once and used in every iteration.

    Parameters
    ----------
    point, view : ndarray of int, shape (N,)
        Indices from zero, sorted by point, then view; every point occurs.

    """

    def __init__(self, point: np.ndarray, view: np.ndarray):
        self.point, self.view = point, view
        self.point_count = int(point[-1]) + 1
        self.view_count = int(view.max()) + 1
        self.first = np.flatnonzero(np.r_[True, np.diff(point) > 0])
        self.length = np.diff(np.r_[self.first, len(point)])
        by_view = np.argsort(view, kind='stable')
        self._by_view = by_view
        self._view_first = np.searchsorted(view[by_view], np.arange(self.view_count + 1))
        last = np.maximum.reduceat(view, self.first)
        begin = np.minimum.reduceat(view, self.first)
        order = np.lexsort((last, begin))
        self._groups = []
        for start in range(0, self.point_count, GROUP_POINTS):
            members = order[start:start + GROUP_POINTS]
            low, high = int(begin[members].min()), int(last[members].max()) + 1
            lengths = self.length[members]
            rows = np.repeat(self.first[members], lengths) + (
                np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths))
            slot = np.repeat(np.arange(len(members)), lengths)
            self._groups.append((members, rows, slot, view[rows] - low, low, high))

    def sum_over_points(self, values: np.ndarray) -> np.ndarray:
        """Add rows (N, ...) of each point: (P, ...)."""
        return np.add.reduceat(values, self.first, axis=0)

    def reduce(self, jac_shared, jac_view, jac_point, residual, damping=0.0) -> ReducedSystem:
        """
        Eliminate the points from the normal equations.

        Parameters
        ----------
        jac_shared : ndarray, shape (N, m, g)
        jac_view : ndarray, shape (N, m, v)
        jac_point : ndarray, shape (N, m, 3)
        residual : ndarray, shape (N, m)
        damping : float
            Levenberg-Marquardt factor on the diagonal of the point blocks. The diagonal of the
            rest is left to the caller.

        Returns
        -------
        ReducedSystem

        """
        g, v = jac_shared.shape[2], jac_view.shape[2]
        size = g + self.view_count * v
        full = np.concatenate([jac_shared, jac_view], axis=2)
        matrix = np.zeros((size, size))
        gradient = np.zeros(size)
        for k in range(self.view_count):
            rows = self._by_view[self._view_first[k]:self._view_first[k + 1]]
            if not len(rows):
                continue
            J = full[rows].reshape(-1, g + v)
            gram = J.T @ J
            part = J.T @ residual[rows].ravel()
            own = slice(g + k * v, g + (k + 1) * v)
            matrix[:g, :g] += gram[:g, :g]
            matrix[:g, own] = gram[:g, g:]
            matrix[own, :g] = gram[g:, :g]
            matrix[own, own] = gram[g:, g:]
            gradient[:g] += part[:g]
            gradient[own] = part[g:]
        diagonal = np.diag(matrix).copy()

        jpt = np.swapaxes(jac_point, 1, 2)
        H = self.sum_over_points(jpt @ jac_point)
        b = self.sum_over_points((jpt @ residual[:, :, None])[..., 0])
        scale = np.einsum('pii->pi', H)
        # a floor keeps points without parallax invertible
        H = H + np.einsum('pi,ij->pij', scale * damping + 1e-12 * scale.sum(1, keepdims=True)
                          + 1e-300, np.eye(3))
        inverse_root = np.linalg.inv(np.linalg.cholesky(H))   # L⁻¹, H⁻¹ = L⁻ᵀ L⁻¹
        cross = jpt @ full                                    # (N, 3, g + v)
        shared = self.sum_over_points(cross[..., :g])
        half_b = (inverse_root @ b[..., None])[..., 0]
        factors = []
        for members, rows, slot, column, low, high in self._groups:
            W = np.zeros((len(members), 3, g + (high - low) * v))
            W[..., :g] = shared[members]
            window = W[..., g:].reshape(len(members), 3, high - low, v)
            window[slot, :, column] = cross[rows][..., g:]
            M = (inverse_root[members] @ W).reshape(-1, W.shape[2])
            gram = M.T @ M
            part = M.T @ half_b[members].ravel()
            own = slice(g + low * v, g + high * v)
            matrix[:g, :g] -= gram[:g, :g]
            matrix[:g, own] -= gram[:g, g:]
            matrix[own, :g] -= gram[g:, :g]
            matrix[own, own] -= gram[g:, g:]
            gradient[:g] -= part[:g]
            gradient[own] -= part[g:]
            factors.append((members, M, own))
        return ReducedSystem(matrix, gradient, diagonal, inverse_root, half_b, factors, g)


@dataclass
class ReducedSystem:
    """
    Normal equations after the points are eliminated: matrix · step = -gradient.

    Attributes
    ----------
    matrix : ndarray, shape (n, n)
    gradient : ndarray, shape (n,)
    diagonal : ndarray, shape (n,)
        Diagonal before the elimination, which scales the damping.

    """

    matrix: np.ndarray
    gradient: np.ndarray
    diagonal: np.ndarray
    _inverse_root: np.ndarray
    _half_b: np.ndarray
    _factors: list
    _shared: int

    def point_steps(self, step: np.ndarray) -> np.ndarray:
        """Back-substitute: steps (P, 3) of the points for a step (n,) of the rest."""
        half = np.array(self._half_b)
        for members, M, own in self._factors:
            local = np.concatenate([step[:self._shared], step[own]])
            half[members] += (M @ local).reshape(-1, 3)
        return -(np.swapaxes(self._inverse_root, 1, 2) @ half[..., None])[..., 0]


def huber_weights(distance: np.ndarray, threshold: float) -> np.ndarray:
    """Weights ψ(d) / d of Huber's loss for distances in units of sigma."""
    return np.minimum(1.0, threshold / np.maximum(distance, 1e-300))


def huber_cost(distance: np.ndarray, threshold: float) -> float:
    """Sum of Huber's loss, d² / 2 near zero, for distances in units of sigma."""
    return float(np.where(distance <= threshold, 0.5 * distance**2,
                          threshold * (distance - 0.5 * threshold)).sum())


def solve_damped(matrix, gradient, diagonal, damping, free) -> np.ndarray | None:
    """
    Solve one Levenberg-Marquardt step for the free unknowns.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
    gradient, diagonal : ndarray, shape (n,)
    damping : float
    free : ndarray of bool, shape (n,)

    Returns
    -------
    ndarray, shape (n,), or None where the damped matrix is not positive definite

    """
    index = np.flatnonzero(free)
    H = matrix[np.ix_(index, index)]
    root = np.sqrt(np.maximum(diagonal[index], 1e-30))
    # scaled to a unit diagonal: pixels, radians and lengths in one matrix
    H = H / np.outer(root, root)
    H[np.diag_indices_from(H)] += damping
    try:
        solution = cho_solve(cho_factor(H, check_finite=True), -gradient[index] / root)
    except (LinAlgError, ValueError):
        return None
    step = np.zeros(len(gradient))
    step[index] = solution / root
    return step
