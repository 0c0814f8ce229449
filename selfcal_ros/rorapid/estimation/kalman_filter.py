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
"""Constant-velocity Kalman filter over the states of any camera and motion model."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.small_system import solved
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.projection.free_directions import apart_from

#: Share of the velocity that is lost with each image in which nothing is seen.
DAMPING = 0.3
#: What was computed from the prediction may be so much wider, as a share.
_ROUNDING = 1e-2
#: Longest time that a prediction reaches over, seconds.
_LONGEST_S = 0.5


class ConstantVelocityFilter:
    """
    Mean, velocity and covariance of an object's state (algorithm 7.1, 12 values for a pose).

    The covariance is that of a small correction p of the mean, q = basis p, and of the velocity
    dp/dt; the rotation turns on the camera's side.

    Parameters
    ----------
    projection : Projection
    basis : ndarray, shape (size, m)
        Corrections that the motion model allows.
    state : ObjectPose
    covariance : ndarray, shape (m, m)
        Of the first state.
    velocity_sigma, acceleration_sigma : ndarray, shape (m,)
        Standard deviations of the unknown first velocity, per second, and of the white
        acceleration, per second squared.
    random_walk : ndarray, shape (m,), optional
        Standard deviations of a random walk of the state itself, per square root of a second.
        A direction with a random walk and no velocity nor acceleration is one in which the object
        does not move: it is estimated from all images together.

    """

    def __init__(self, projection: Projection, basis: ArrayLike, state: ObjectPose,
                 covariance: np.ndarray, velocity_sigma: ArrayLike, acceleration_sigma: ArrayLike,
                 random_walk: ArrayLike = 0.0) -> None:
        """Start at rest, with a velocity as uncertain as stated."""
        self.projection, self.basis = projection, np.asarray(basis, float)
        self.state = state
        m = self.basis.shape[1]
        self.velocity = np.zeros(m)
        self.covariance = np.zeros((2 * m, 2 * m))
        self.covariance[:m, :m] = covariance
        self._velocity = np.square(np.asarray(velocity_sigma, float))
        self.covariance[m:, m:] = np.diag(self._velocity)
        self._acceleration = np.square(np.asarray(acceleration_sigma, float))
        self._random_walk = np.square(np.broadcast_to(np.asarray(random_walk, float), (m,)))
        #: Time that the last prediction reached over, seconds.
        self._reach_s = 0.0
        self._noise_s, self._noise = 0.0, np.zeros((2 * m, 2 * m))

    def restart(self, state: ObjectPose, covariance: np.ndarray,
                velocity: np.ndarray | None = None) -> None:
        """Begin again at a state with covariance (m, m), at rest or with a first velocity (m,)."""
        m = self.basis.shape[1]
        self.state = state
        self.velocity = np.zeros(m) if velocity is None else velocity
        self.covariance = np.zeros((2 * m, 2 * m))
        self.covariance[:m, :m] = covariance
        self.covariance[m:, m:] = np.diag(self._velocity)

    def take_over(self, state: ObjectPose, velocity: np.ndarray, covariance: np.ndarray) -> None:
        """Go on from another filter's state, velocity (m,) and covariance (2 m, 2 m)."""
        self.state, self.velocity, self.covariance = state, velocity, covariance

    @property
    def pose_covariance(self) -> np.ndarray:
        """Covariance of the mean, shape (m, m)."""
        m = self.basis.shape[1]
        return self.covariance[:m, :m]

    def predict(self, seconds: float, damping: float = 0.0) -> ObjectPose:
        """
        Move the state on by so many seconds.

        Parameters
        ----------
        seconds : float
        damping : float
            Share of the velocity that is lost; for the time when nothing is seen.

        Returns
        -------
        ObjectPose

        """
        m = self.basis.shape[1]
        self._reach_s = seconds
        P, dt = self.covariance, seconds
        cross = P[:m, m:] + dt * P[m:, m:]
        P[:m, :m] += dt * (P[:m, m:].T + cross)
        P[:m, m:] = cross
        P[m:, :m] = cross.T
        P += self._noise_after(dt)
        self.state = self.projection.renewed(
            self.projection.moved(self.state, self.basis @ (self.velocity * dt)))
        self.velocity *= 1 - damping
        return self.state

    def _noise_after(self, seconds: float) -> np.ndarray:
        """Covariance (2 m, 2 m) that so many seconds add; images mostly come at one rate."""
        if seconds != self._noise_s:
            m, dt = self.basis.shape[1], seconds
            at, self._noise_s = np.arange(m), seconds
            self._noise = np.zeros((2 * m, 2 * m))
            self._noise[at, at] = self._acceleration * dt**4 / 4 + self._random_walk * dt
            self._noise[at, m + at] = self._noise[m + at, at] = self._acceleration * dt**3 / 2
            self._noise[m + at, m + at] = self._acceleration * dt**2
        return self._noise

    def update(self, measured: ObjectPose, noise: np.ndarray) -> None:
        """Take in a measured state with its covariance (m, m)."""
        m = self.basis.shape[1]
        innovation = self.basis.T @ self.projection.difference(measured, self.state)
        gain = solved(self.pose_covariance + noise, self.covariance[:m]).T
        step = gain @ innovation
        self.state = self.projection.moved(self.state, self.basis @ step[:m])
        self.velocity = self.velocity + step[m:]
        self.covariance = self.covariance - gain @ self.covariance[:m]
        self.covariance = 0.5 * (self.covariance + self.covariance.T)

    def absorb(self, state: ObjectPose, covariance: np.ndarray,
               late: np.ndarray | None = None) -> None:
        """
        Take over the posterior of a measurement that already contained the prediction.

        Parameters
        ----------
        state : ObjectPose
            Maximum of the posterior.
        covariance : ndarray, shape (m, m)
            Of the posterior.
        late : ndarray, shape (m, m), optional
            How long after the stamp the image tells each correction, seconds; the posterior is
            that for the velocity as predicted. None: it tells all of them at the stamp.

        """
        m = self.basis.shape[1]
        step = self.basis.T @ self.projection.difference(state, self.state)
        if late is not None:
            if self._is_narrower(covariance):
                self._absorb_late(step, covariance, late)
                return
            # no posterior, but a pose that is only proposed
            covariance = covariance + late @ self.covariance[m:, m:] @ late.T
        carry = solved(self.pose_covariance, self.covariance[:m, m:]).T
        self.velocity = self.velocity + carry @ step
        cross = carry @ covariance
        new = np.empty_like(self.covariance)
        new[:m, :m] = covariance
        new[m:, :m], new[:m, m:] = cross, cross.T
        velocity = (self.covariance[m:, m:]
                    - carry @ (self.covariance[:m, :m] - covariance) @ carry.T)
        new[m:, m:] = 0.5 * (velocity + velocity.T)
        self.covariance, self.state = new, state

    def _is_narrower(self, covariance: np.ndarray) -> bool:
        """Whether a covariance (m, m) is nowhere wider than that of the prediction."""
        shares = np.linalg.eigvals(np.linalg.solve(covariance, self.pose_covariance)).real
        return bool(shares.min() > 1 - _ROUNDING)

    def _absorb_late(self, step: np.ndarray, covariance: np.ndarray, late: np.ndarray) -> None:
        """
        Take over a posterior of p + late v, whose prior was that of p alone.

        With L the image's information, P the covariance of (p, v), H = [I late] and S = H P H':
        P - P H' (I + L S)^-1 L H P, and a step of P H' (I + L S)^-1 b, where b = L z.
        """
        P, m = self.covariance, self.basis.shape[1]
        pull = np.linalg.solve(covariance, step)
        seen = np.linalg.inv(covariance) - np.linalg.inv(self.pose_covariance)
        PH = P[:, :m] + P[:, m:] @ late.T
        gain = np.linalg.solve((np.eye(m) + seen @ (PH[:m] + late @ PH[m:])).T, PH.T).T
        moved = gain @ pull
        self.state = self.projection.moved(self.state, self.basis @ moved[:m])
        self.velocity = self.velocity + moved[m:]
        P = P - gain @ seen @ PH.T
        self.covariance = 0.5 * (P + P.T)

    def doubt_motion(self) -> None:
        """Take note that it may have moved in any way since the last image, and may go on so."""
        m = self.basis.shape[1]
        at = np.arange(m)
        self.covariance[at, at] += self._velocity * self._reach_s**2
        self.covariance[m + at, m + at] += self._velocity

    def forget_motion(self) -> None:
        """Take note that since the last image it did not move as before; what follows is open."""
        self.doubt_motion()
        self.restart(self.state, self.pose_covariance)

    def hold(self, directions: np.ndarray, sigma: float) -> None:
        """
        Hold the state where it is in directions of which images say nothing.

        Parameters
        ----------
        directions : ndarray, shape (size, k)
            Corrections.
        sigma : float
            How firmly, in units of each direction.

        """
        m = self.basis.shape[1]
        along = self.basis.T @ directions
        keep = apart_from(along)
        self.velocity = keep @ self.velocity
        both = np.kron(np.eye(2), keep)
        self.covariance = both @ self.covariance @ both.T
        self.covariance[:m, :m] += sigma**2 * along @ along.T

    def innovation_share(self, state: ObjectPose, noise: np.ndarray | float = 0.0) -> float:
        """Squared Mahalanobis distance of a state from the prediction, per degree of freedom."""
        step = self.basis.T @ self.projection.difference(state, self.state)
        return float(step @ solved(self.pose_covariance + noise, step) / len(step))


def seconds_between(before_ns: int | None, now_ns: int | None, frame_rate_hz: float) -> float:
    """Time between two images, as far as a prediction reaches; by their rate without stamps."""
    if now_ns is None or before_ns is None or now_ns <= before_ns:
        return 1 / frame_rate_hz
    return min((now_ns - before_ns) * 1e-9, _LONGEST_S)
