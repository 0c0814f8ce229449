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
R = K^-1 H K of infinite homographies must be rotations: the least squares in K alone.

Unknowns are theta = (log f, log ζ, cx, cy, skew), the last three in units of the longer image
side.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.affine.diac import InfiniteHomographies, ROUNDING
from selfcal_ros.geometry.rotation import rotation_vector

#: Sigmas of a very wide prior on (log f, log ζ, cx, cy, skew), in image sides where they have a
#: length: it holds what nothing else does.
_WIDE = np.array([3.0, 1.0, 1.0, 1.0, 1.0])
#: Largest log f (image sides) and log ζ that is tried: no lens is longer, and no pixel narrower.
#: Largest step of both, over which the linear model may hold.
_LARGEST_LOG, _LARGEST_STEP = 4.5, 0.7
#: Largest principal point and skew that is tried, in image sides.
_LARGEST_OFFSET = 50.0
#: Places in theta.
LOG_F, LOG_ASPECT, CX, CY, SKEW = range(5)


class RotationConstraints:
    """R = K^-1 H K be rotations: residuals, weights and derivatives in (log f, log ζ, ...)."""

    def __init__(self, H: np.ndarray, covariance: np.ndarray) -> None:
        self.H = H
        self.covariance = covariance + ROUNDING**2 * np.eye(covariance.shape[1])

    @classmethod
    def carried(cls, homographies: InfiniteHomographies, T: np.ndarray) -> RotationConstraints:
        """Carry homographies of pixels to coordinates T x, in which f is of the order of one."""
        inverse = np.linalg.inv(T)
        entries = homographies.covariance.shape[1]
        carry = np.kron(np.eye(entries // 9), np.kron(T, inverse.T))
        return cls(T @ homographies.H @ inverse, carry @ homographies.covariance @ carry.T)

    @property
    def noise(self) -> float:
        """Standard deviation of an entry of H, root mean square."""
        groups, entries, _ = self.covariance.shape
        return float(np.sqrt(np.einsum('gii->', self.covariance) / (groups * entries)))

    def rotations(self, theta: np.ndarray) -> np.ndarray:
        """Return the rotation vectors (n, 3) nearest to K^-1 H K, radians."""
        K = self.K(theta)
        U, _, Vt = np.linalg.svd(np.linalg.inv(K) @ self.H @ K)
        return rotation_vector(U @ Vt)

    @staticmethod
    def K(theta: np.ndarray) -> np.ndarray:
        f = np.exp(theta[LOG_F])
        return np.array([[f, theta[SKEW], theta[CX]],
                         [0, f * np.exp(theta[LOG_ASPECT]), theta[CY]], [0, 0, 1]])

    @staticmethod
    def select(S: np.ndarray) -> np.ndarray:
        """Five numbers of R R^T - I: its trace is zero to first order, as det R = 1."""
        return np.stack([S[..., 0, 0] - S[..., 1, 1],
                         (S[..., 0, 0] + S[..., 1, 1] - 2 * S[..., 2, 2]) / np.sqrt(3),
                         2 * S[..., 0, 1], 2 * S[..., 0, 2], 2 * S[..., 1, 2]], axis=-1)

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        """R R^T - I of all views, by independent groups, shape (n / m, 5 m)."""
        K = self.K(theta)
        R = np.linalg.inv(K) @ self.H @ K
        return self.select(R @ np.swapaxes(R, 1, 2)).reshape(len(self.covariance), -1)

    def evaluate(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return residuals, slopes and the inverse covariance of residuals, by independent groups.

        Shapes (n / m, 5 m), (n / m, 5 m, 5) and (n / m, 5 m, 5 m).
        """
        K = self.K(theta)
        inverse = np.linalg.inv(K)
        R = inverse @ self.H @ K
        Rt = np.swapaxes(R, 1, 2)
        r = self.select(R @ Rt)
        dK = np.zeros((5, 3, 3))
        dK[LOG_F, 0, 0], dK[LOG_F, 1, 1] = K[0, 0], K[1, 1]
        dK[LOG_ASPECT, 1, 1] = K[1, 1]
        dK[CX, 0, 2] = dK[CY, 1, 2] = dK[SKEW, 0, 1] = 1
        E = inverse @ dK
        half = (R[:, None] @ E - E @ R[:, None]) @ Rt[:, None]
        slope = self.select(half + np.swapaxes(half, 2, 3))
        unit = np.einsum('ia,bj->abij', inverse, K).reshape(9, 3, 3)
        half = unit @ Rt[:, None]
        by_entry = self.select(half + np.swapaxes(half, 2, 3))          # (n, 9, 5)
        groups, m = len(self.covariance), self.covariance.shape[1] // 9
        by_entry = by_entry.reshape(groups, m, 9, 5)
        spread = np.einsum('giac,giajb,gjbd->gicjd', by_entry,
                           self.covariance.reshape(groups, m, 9, m, 9), by_entry, optimize=True)
        spread = spread.reshape(groups, 5 * m, 5 * m)
        # scaled to a unit diagonal; what is known least must not make it singular
        root = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
        scale = root[:, :, None] * root[:, None]
        weight = np.linalg.inv(spread / scale + 1e-12 * np.eye(5 * m)) / scale
        return (r.reshape(groups, -1), np.swapaxes(slope, 1, 2).reshape(groups, -1, 5), weight)


def solve(constraints: RotationConstraints, theta: np.ndarray, free: np.ndarray,
          facts_terms: tuple[np.ndarray, np.ndarray], iterations: int = 30,
          ) -> tuple[np.ndarray, float, float, np.ndarray]:
    """
    Gauss-Newton with damping, weights renewed in each step; theta, cost, misfit, information.

    A loop of its own: the weights W are those of each step, so that costs of two steps do not
    compare as `levenberg_marquardt.minimise` compares them.
    """
    targets, sigmas = facts_terms
    index = np.flatnonzero(free)

    def total(t: np.ndarray, W: np.ndarray) -> float:
        r = constraints.residuals(t)
        fact = (t - targets) / sigmas
        return float(square(r, W) + np.sum(fact[np.isfinite(sigmas)]**2)
                     + np.sum((t / _WIDE)[free]**2))

    damping = 1e-3
    for _ in range(iterations):
        r, J, W = constraints.evaluate(theta)
        cost = total(theta, W)
        H, g = normal_equations(r, J, W)
        H[np.diag_indices(5)] += np.where(np.isfinite(sigmas), 1 / sigmas**2, 0) + 1 / _WIDE**2
        g += np.where(np.isfinite(sigmas), (theta - targets) / sigmas**2, 0)
        g += theta / _WIDE**2
        A, b = H[np.ix_(index, index)], g[index]
        moved = False
        while damping < 1e8:
            step = np.zeros(5)
            step[index] = -np.linalg.solve(A + damping * np.diag(np.diag(A)), b)
            step *= min(1.0, _LARGEST_STEP / max(np.abs(step[:2]).max(), 1e-300))
            trial = theta + step
            if (np.abs(trial[:2]).max() < _LARGEST_LOG
                    and np.abs(trial[2:]).max() < _LARGEST_OFFSET):
                new = total(trial, W)
                if new < cost:
                    theta, moved, damping = trial, True, max(0.1 * damping, 1e-12)
                    break
            damping *= 10
        if not moved or cost - new < 1e-9 * (1 + cost):
            break
    r, J, W = constraints.evaluate(theta)
    fact = ((theta - targets) / sigmas)[np.isfinite(sigmas)]
    misfit = float(square(r, W) + fact @ fact)
    # small residuals with a wide covariance come from K that blow the weights up, too
    log_weight = float(np.linalg.slogdet(W)[1].sum())
    information, _ = normal_equations(r, J, W)
    information[np.diag_indices(5)] += np.where(np.isfinite(sigmas), 1 / sigmas**2, 0)
    return theta, misfit - log_weight, misfit, information


def square(r: np.ndarray, W: np.ndarray) -> float:
    """Sum r W r over independent groups."""
    return float(np.sum((r[:, None] @ W)[:, 0] * r))


def normal_equations(r: np.ndarray, J: np.ndarray, W: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum the normal equations of independent groups: J^T W J, J^T W r."""
    JW = np.swapaxes(J, 1, 2) @ W
    return (JW @ J).sum(axis=0), (JW @ r[:, :, None])[:, :, 0].sum(axis=0)


def inverse_of(information: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Covariance (5, 5) of theta; what nothing determines has a large one, what is held none."""
    index = np.flatnonzero(free)
    values, vectors = np.linalg.eigh(information[np.ix_(index, index)])
    values = np.maximum(values, 1e-16 * max(values[-1], 1e-300))
    small = np.zeros((5, 5))
    small[np.ix_(index, index)] = (vectors / values) @ vectors.T
    return small
