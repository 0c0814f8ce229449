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
"""How large the errors of the body's poses are, by kinds that add up."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from selfcal_ros.calibration.mounting.body_track import BodyTrack
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.values.body_poses import BodyPoses

#: No pose is better than this, metres and radians: what is smaller is rounding, or what a linear
#: law leaves. No floor is flatter, either.
LEAST_M, LEAST_RAD = 1e-5, 1e-5
FLATTEST_M, FLATTEST_RAD = 3e-4, 1e-4
#: Correlations of successive errors count from so many of their sigmas on, up to the largest.
SHOWS, MOST_SHARED = 2.5, 0.95
#: Fewer poses than this have errors of two kinds, those of place and of turn.
FEW = 12
#: A camera that only turns has no place; errors of this size let it be anywhere.
ANYWHERE_M = 1e4
#: Even a robot that stands has a way, as noise: metres and radians.
_STANDING = 1e-3

_Kinds = tuple[tuple[int, ...], ...]
#: Kinds of errors of absolute poses, of those in a plane, and of odometry: components of a
#: misfit (x, y, z, roll, pitch, yaw) that share a variance.
_WHOLE: _Kinds = ((0, 1, 2), (3, 4, 5))
_IN_A_PLANE: _Kinds = ((0, 1), (2,), (3, 4), (5,))
_ALONG: _Kinds = ((0,), (1,), (2,), (3, 4), (5,))


@dataclass(frozen=True)
class PoseErrors:
    """
    Covariances of misfits, sums of kinds with a variance each.

    Attributes
    ----------
    axes : tuple of tuple of int
        Per kind, the components whose errors it is of; none where it is of the camera's poses.
    shapes : ndarray, shape (K, m, 6, 6)
        Covariances for unit variances.
    variances : ndarray, shape (K,)
    stated : ndarray of bool, shape (K,)
        Which are not to be estimated.
    floors : ndarray, shape (K,)
        Smallest variances.
    shared : ndarray, shape (6,)
        Correlation of each component's error with that of the pose before.

    """

    axes: tuple[tuple[int, ...], ...]
    shapes: np.ndarray
    variances: np.ndarray
    stated: np.ndarray
    floors: np.ndarray
    shared: np.ndarray

    @classmethod
    def of(cls, poses: BodyPoses, track: BodyTrack, offset: float, rows: np.ndarray,
           has_path: bool) -> PoseErrors:
        """Choose the kinds of errors; variances are those stated, or the smallest."""
        single = _single(track, offset, rows)
        if track.odometry:
            axes = _ALONG if single.shape[1] >= FEW else _WHOLE
        else:
            axes = _IN_A_PLANE if track.flat else _WHOLE
        shapes = np.array([single[list(kind)].sum(axis=0) for kind in axes])
        sigmas = [poses.sigma_position_m, poses.sigma_rotation_rad]
        # a plane is not measured: neither is how well it holds
        known = [sigmas[kind[0] // 3] if not (track.flat and set(kind) & {2, 3, 4}
                                              and len(axes) > 2) else None for kind in axes]
        upright = np.array([track.flat and set(kind) <= {2, 3, 4} for kind in axes])
        places = np.array([kind[0] < 3 for kind in axes])
        floors = np.where(upright, np.where(places, FLATTEST_M, FLATTEST_RAD),
                          np.where(places, LEAST_M, LEAST_RAD))**2
        variances = np.maximum([(one or 0.0)**2 for one in known], floors)
        stated = np.array([one is not None for one in known])
        if not has_path:
            variances, stated = np.where(places, ANYWHERE_M**2, variances), stated | places
        return cls(axes, shapes, variances, stated, floors, np.zeros(6))

    @classmethod
    def known(cls, sigmas: np.ndarray, track: BodyTrack, offset: float,
              rows: np.ndarray) -> PoseErrors:
        """Take errors of known size, (6,): see `Mount.pose_sigmas`."""
        single = _single(track, offset, rows)
        return cls(tuple((k,) for k in range(6)), single, sigmas**2, np.ones(6, bool),
                   np.zeros(6), np.zeros(6))

    @property
    def by_component(self) -> tuple[float, ...]:
        """Standard deviations of x, y, z, roll, pitch and yaw, those of a kind alike."""
        found = np.zeros(6)
        for kind, variance in zip(self.axes, self.variances):
            found[list(kind)] = np.sqrt(variance)
        return tuple(found.tolist())

    # a descent asks for these at every step, and the errors stay

    @cached_property
    def covariances(self) -> np.ndarray:
        """The covariance of every misfit, shape (m, 6, 6)."""
        total: np.ndarray = np.einsum('k,kmij->mij', self.variances, self.shapes)
        return total

    @cached_property
    def precisions(self) -> np.ndarray:
        """Inverses of the covariances, shape (m, 6, 6)."""
        inverses: np.ndarray = np.linalg.inv(self.covariances)
        return inverses

    @cached_property
    def whitening(self) -> np.ndarray:
        """What makes the components of a misfit independent and of unit variance, (m, 6, 6)."""
        turned: np.ndarray = np.swapaxes(np.linalg.cholesky(self.precisions), 1, 2)
        return turned

    def independent(self, rows: np.ndarray) -> np.ndarray:
        """Free whitened rows (m, 6, n) of successive misfits of what they share, (m, 6, n)."""
        if not self.shared.any():
            return rows
        along = self.shared[:, None]
        later = (rows[1:] - along * rows[:-1]) / np.sqrt(1 - along**2)
        return np.concatenate([rows[:1], later])

    def in_a_row(self, residual: np.ndarray, keep: np.ndarray) -> PoseErrors:
        """
        Estimate what errors of successive poses share, where it shows.

        The poses of a filter, or of an arm that bends, do not err each by itself (an
        autoregressive law of the first order).

        Parameters
        ----------
        residual : ndarray, shape (m, 6)
        keep : ndarray of bool, shape (m,)

        Returns
        -------
        PoseErrors

        """
        z = (self.whitening @ residual[:, :, None])[keep, :, 0]
        shared = np.zeros(6)
        for kind in filter(len, self.axes):
            own = z[:, list(kind)]
            found = float(np.sum(own[1:] * own[:-1]) / max(np.sum(own**2), 1e-300))
            if found > SHOWS / np.sqrt(own.size):
                shared[list(kind)] = min(found, MOST_SHARED)
        return replace(self, shared=shared)

    def from_medians(self, residual: np.ndarray, keep: np.ndarray) -> PoseErrors:
        """Estimate variances from misfits (m, 6) of which a minority may be wrong."""
        found = self.variances.copy()
        for k, (kind, shape) in enumerate(zip(self.axes, self.shapes)):
            if not kind:
                continue
            own = list(kind)
            spread = np.sqrt(np.diagonal(shape[keep], axis1=1, axis2=2)[:, own])
            found[k] = robust_sigma(residual[keep][:, own] / spread)**2
        return self._with(found)

    def refined(self, residual: np.ndarray, spread: np.ndarray, keep: np.ndarray,
                weights: np.ndarray | None = None) -> tuple[PoseErrors, np.ndarray]:
        """
        Estimate variances from the misfits of an optimum, and the degrees of freedom of each.

        Those that the unknowns take up are regarded (variance components, Förstner 1979).

        Parameters
        ----------
        residual : ndarray, shape (m, 6)
        spread : ndarray, shape (m, 6, 6)
            Covariance of what is predicted.
        keep : ndarray of bool, shape (m,)
        weights : ndarray, shape (m,), optional
            Of the squares, under a law with wide tails.

        Returns
        -------
        errors : PoseErrors
        freedom : ndarray, shape (K,)

        """
        W = np.linalg.inv(self.covariances[keep])
        weighted = np.einsum('mij,mj->mi', W, residual[keep])
        shapes = self.shapes[:, keep]
        counted = weighted if weights is None else weights[keep, None] * weighted
        squares = np.einsum('mi,kmij,mj->k', counted, shapes, weighted)
        whole = np.einsum('mij,kmji->k', W, shapes)
        taken = np.einsum('kmij,mji->k', shapes, W @ spread[keep] @ W)
        left = np.maximum(whole - taken, 1e-3 * whole)
        freedom: np.ndarray = self.variances * left
        return self._with(self.variances * squares / left), freedom

    def cautious(self, spread: np.ndarray, keep: np.ndarray) -> PoseErrors:
        """
        Enlarge variances by what the misfits leave open of them.

        With n degrees of freedom the ratio of an error to its sigma is Student's, whose variance
        is n / (n - 2). A variance that came out near zero may be as large as its own sigma.

        Parameters
        ----------
        spread : ndarray, shape (m, 6, 6)
            Covariance of what is predicted.
        keep : ndarray of bool, shape (m,)

        Returns
        -------
        PoseErrors

        """
        W = np.linalg.inv(self.covariances[keep])
        shown = (W - W @ spread[keep] @ W) @ self.shapes[:, keep]
        known = np.einsum('kmij,kmji->k', shown, shown) / 2
        off = 1 / np.maximum(known, 1e-300)
        return self._with(self.variances + off / np.maximum(self.variances, np.sqrt(off)))

    def _with(self, variances: np.ndarray) -> PoseErrors:
        """Replace variances that are not stated."""
        return replace(self, variances=np.where(
            self.stated, self.variances, np.maximum(variances, self.floors)))

    def at_most(self, other: PoseErrors) -> PoseErrors:
        """Return the smaller of two estimates of each variance."""
        return self._with(np.minimum(self.variances, other.variances))

    def scaled(self, factors: np.ndarray) -> PoseErrors:
        """Multiply all variances."""
        return replace(self, variances=self.variances * factors)

    def sigma(self, component: int) -> float:
        """Return the root mean square of the standard deviations of place (0) or turn (3)."""
        among = [(len(kind), variance) for kind, variance in zip(self.axes, self.variances)
                 if kind and kind[0] // 3 == component // 3]
        return float(np.sqrt(sum(n * v for n, v in among) / sum(n for n, _ in among)))


def _single(track: BodyTrack, offset: float, rows: np.ndarray) -> np.ndarray:
    """Return covariances of misfits for unit variances, component by component, (6, m, 6, 6)."""
    units = np.array([np.diag(one) for one in np.eye(6)])[:, None]
    if track.odometry:
        return track.way_errors(offset, rows) + _STANDING * units
    return np.broadcast_to(units, (6, len(rows), 6, 6))
