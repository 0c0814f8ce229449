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
How the camera is turned against a gyro, from the turns that both saw.

The turn between two views is the same turn for camera and body, about other axes:

    Rᵀ_v R_v+1 = Xᵀ ΔG_v X,    X = R_body_camera,

where ΔG is what the gyro measured between the instants of the views, by its own clock, less its
bias. The images enter by the Gaussian of their adjustment, together with the camera's
parameters; the gyro by white noise, whose density the misfit tells. So one estimate holds X, the
offset of the clocks, the bias and the camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize_scalar

from selfcal_ros.calibration.mount import Mount, NAMES
from selfcal_ros.calibration.mounting.camera_poses import camera_poses, CameraPoses, with_lens
from selfcal_ros.calibration.mounting.integrated_rates import RateSteps
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import (left_jacobian, nearest_rotation, rotation_matrix,
                                           rotation_vector)
from selfcal_ros.geometry.scaled_inverse import unit_diagonal
from selfcal_ros.values.angular_rates import AngularRates
from selfcal_ros.values.parameter_status import Status

#: Offsets of the clocks that are tried, seconds.
OFFSETS_S = np.arange(-0.5, 0.501, 0.01)
#: So many intervals between views, at least, inside the time that the gyro covers.
LEAST_INTERVALS = 4
#: A turn that is known no better than this is not known, radians; and an offset, seconds.
OPEN_RAD, OPEN_S = 0.1, 0.05
#: An interval that misses by more is set aside: so many medians at the start, then sigmas.
START_SIGMAS, OUTLIER_SIGMAS = 4.0, 4.0
#: What says more often than this that the gyro is wrong, or misses by more (rad/√s), is refused.
LARGEST_SHARE, LARGEST_DENSITY = 1 / 3, 0.02
ITERATIONS, ROUNDS, START_ROUNDS = 30, 5, 6


@dataclass(frozen=True)
class _Views:
    """Turns between successive views, and how they follow unknowns of unit variance."""

    instants: np.ndarray
    later: np.ndarray
    turned: np.ndarray
    by_unknowns: np.ndarray

    def of(self, chosen: np.ndarray) -> _Views:
        """Return some of them."""
        return _Views(self.instants[chosen], self.later[chosen], self.turned[chosen],
                      self.by_unknowns[chosen])

    @property
    def lasting_s(self) -> np.ndarray:
        """How long each took, (M,)."""
        lasting: np.ndarray = self.later - self.instants
        return lasting


def mount_by_gyro(calibration: Calibration, rates: AngularRates, stamps_ns: Mapping[int, int],
                  ) -> Calibration:
    """
    Estimate how the camera is turned against a gyro, and the offset of their clocks.

    Parameters
    ----------
    calibration : Calibration
        With its reconstruction.
    rates : AngularRates
    stamps_ns : mapping of int to int
        When each frame was taken, by the camera's clock.

    Returns
    -------
    Calibration
        With its mount; the camera, its covariance included, is what images and gyro say
        together. A gyro tells no place and no scale. Where the turns leave an axis open there is
        a `NoEstimate`, and the camera is that of the images.

    """
    precision, frames = calibration.reconstructed.pose_precision, calibration.reconstructed.frames
    if precision is None or precision.own is not None or any(
            int(frame) not in stamps_ns for frame in frames):
        return replace(calibration, mount=NoEstimate('gyro_without_poses'))
    poses = camera_poses(calibration)
    found = _estimate(RateSteps.of(rates), _views(poses, stamps_ns, int(rates.stamps_ns[0])))
    if isinstance(found, NoEstimate):
        return replace(calibration, mount=found)
    return _with_gyro(calibration, poses, rates.frame, found)


def _views(poses: CameraPoses, stamps_ns: Mapping[int, int], begin_ns: int) -> _Views:
    """Collect the turns of the camera."""
    instants = np.array([stamps_ns[int(frame)] - begin_ns for frame in poses.frames]) * 1e-9
    order = np.argsort(instants, kind='stable')
    R, turns = poses.rotation[order], poses.roots[order, 3:]
    back = np.swapaxes(R, 1, 2)
    return _Views(instants[order][:-1], instants[order][1:], back[:-1] @ R[1:],
                  back[1:] @ (turns[1:] - turns[:-1]))


@dataclass(frozen=True)
class _Fit:
    """
    What images and gyro say together.

    `covariance` (7, 7) is that of X (a turn about the body's axes), bias and offset. `unknowns`
    (k,) is by how much those of the images move, `spread` (k, k) their covariance then. Of
    `views` intervals `doubtful` contradict the others.
    """

    R: np.ndarray
    bias: np.ndarray
    offset_s: float
    density: float
    covariance: np.ndarray
    unknowns: np.ndarray
    spread: np.ndarray
    views: int
    doubtful: int


def _misfit(gyro: RateSteps, views: _Views, R: np.ndarray, bias: np.ndarray, offset_s: float,
            ) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals (M, 3) and their derivatives by turn, bias and offset (M, 3, 7)."""
    turned, by_bias, by_offset = gyro.less(bias).between(views.instants - offset_s,
                                                         views.later - offset_s)
    ours = R.T @ turned @ R
    residual = rotation_vector(np.swapaxes(views.turned, 1, 2) @ ours)
    # a small turn after ours, in terms of the residual vector
    carry = np.linalg.inv(left_jacobian(-residual)) @ R.T
    by_turn = np.eye(3) - np.swapaxes(turned, 1, 2)
    slopes = np.concatenate([by_turn, by_bias, by_offset[..., None]], axis=2)
    return residual, carry @ slopes


def _start(gyro: RateSteps, views: _Views,
           ) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """
    Find X, bias and offset in closed form: turns as vectors, the offset by trial.

    For every offset the lengths of the vectors agree or not, whatever X; X is the rotation
    between the two sets (Kabsch), and the bias a linear correction. Returns by how much every
    interval misses (M,), too.
    """
    seen, unbiased = rotation_vector(views.turned), gyro.less(np.zeros(3))
    root = 1 / np.sqrt(np.maximum(views.lasting_s, 1e-3))
    best: tuple[float, np.ndarray, np.ndarray, float, np.ndarray] | None = None
    for offset_s in OFFSETS_S:
        bias, R, weight = np.zeros(3), np.eye(3), np.ones(len(seen))
        turned, by_bias, _ = unbiased.between(views.instants - offset_s, views.later - offset_s)
        measured = rotation_vector(turned)
        for _ in range(START_ROUNDS):
            there = measured + np.einsum('mij,j->mi', by_bias, bias)
            R = nearest_rotation((there * (weight * root**2)[:, None]).T @ seen)
            rest = seen @ R.T - measured
            scaled = (np.sqrt(weight) * root)[:, None, None]
            bias = np.linalg.lstsq((by_bias * scaled).reshape(-1, 3),
                                   (rest * scaled[..., 0]).ravel(), rcond=None)[0]
            missed = root * np.linalg.norm(rest - np.einsum('mij,j->mi', by_bias, bias), axis=1)
            # views that are wrong shall not lead
            weight = np.minimum(1, 2 * np.median(missed) / np.maximum(missed, 1e-300))
        cost = float(np.median(missed))
        if best is None or cost < best[0]:
            best = cost, R, bias, float(offset_s), missed
    assert best is not None
    return best[1:]


def _estimate(gyro: RateSteps, views: _Views) -> _Fit | NoEstimate:
    """Estimate X, bias, offset and the density of the noise."""
    offset_s, used = 0.0, np.zeros(len(views.instants), bool)
    for _ in range(START_ROUNDS):
        covered = (views.lasting_s > 0) & gyro.covers(
            np.append(views.instants, views.later[-1:]) - offset_s)
        if covered.sum() < LEAST_INTERVALS:
            return NoEstimate('gyro_covers_too_little', intervals=int(covered.sum()),
                              least=LEAST_INTERVALS)
        # with another offset of the clocks the gyro covers others
        if np.array_equal(covered, used):
            break
        used = covered
        R, bias, offset_s, missed = _start(gyro, views.of(used))
    views = views.of(used)
    kept = missed < START_SIGMAS * np.median(missed)
    for _ in range(ROUNDS):
        fit = _adjusted(gyro, views.of(kept), R, bias, offset_s)
        R, bias, offset_s = fit.R, fit.bias, fit.offset_s
        residual, _ = _misfit(gyro, views, R, bias, offset_s)
        expected = 3 * fit.density**2 * views.lasting_s + np.einsum(
            'mij,mij->m', views.by_unknowns, views.by_unknowns)
        near = np.einsum('mi,mi->m', residual, residual) < OUTLIER_SIGMAS**2 * expected
        if np.array_equal(near, kept):
            break
        kept = near
    dropped = int((~kept).sum())
    if fit.density > LARGEST_DENSITY or dropped > LARGEST_SHARE * len(kept):
        return NoEstimate('gyro_contradicts', intervals=len(kept), dropped=dropped,
                          density_deg=float(np.degrees(fit.density)))
    return replace(fit, doubtful=dropped)


def _adjusted(gyro: RateSteps, views: _Views, R: np.ndarray, bias: np.ndarray, offset_s: float,
              ) -> _Fit:
    """Adjust all from a start, by Gauss-Newton steps."""
    for _ in range(ITERATIONS):
        residual, slopes = _misfit(gyro, views, R, bias, offset_s)
        density = _density(views, residual, slopes)
        step, covariance, unknowns, spread = _solved(views, residual, slopes, density)
        R, bias = rotation_matrix(step[:3]) @ R, bias + step[3:6]
        offset_s += float(step[6])
        if step @ np.linalg.pinv(covariance) @ step < 1e-6:
            break
    return _Fit(R, bias, offset_s, density, covariance, unknowns, spread, len(views.instants), 0)


def _spread(views: _Views, density: float) -> np.ndarray:
    """Return the covariance of the residuals (3 M, 3 M): the gyro's noise and the images'."""
    J = views.by_unknowns.reshape(-1, views.by_unknowns.shape[2])
    S = J @ J.T
    S[np.diag_indices_from(S)] += np.repeat(density**2 * views.lasting_s, 3)
    spread: np.ndarray = S
    return spread


def _density(views: _Views, residual: np.ndarray, slopes: np.ndarray) -> float:
    """Estimate the density of the gyro's noise, rad/√s, by restricted likelihood."""
    J, r = slopes.reshape(-1, slopes.shape[2]), residual.ravel()

    def cost(log_density: float) -> float:
        factor = cho_factor(_spread(views, np.exp(log_density)))
        Wr, WJ = cho_solve(factor, r), cho_solve(factor, J)
        scaled, scale = unit_diagonal(J.T @ WJ)
        values, vectors = np.linalg.eigh(scaled)
        known = values > 1e-9
        g = (vectors.T @ ((J.T @ Wr) / scale))[known]
        return float(2 * np.log(np.diag(factor[0])).sum() + np.log(values[known]).sum()
                     + r @ Wr - np.sum(g * g / values[known]))

    return float(np.exp(minimize_scalar(cost, bounds=(np.log(1e-6), np.log(0.3)),
                                        method='bounded', options={'xatol': 0.02}).x))


def _solved(views: _Views, residual: np.ndarray, slopes: np.ndarray, density: float,
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a Gauss-Newton step (7,) with its covariance, and what it says of the images."""
    J, r = slopes.reshape(-1, slopes.shape[2]), residual.ravel()
    factor = cho_factor(_spread(views, density))
    WJ, Wr = cho_solve(factor, J), cho_solve(factor, r)
    covariance = np.linalg.pinv(J.T @ WJ, rcond=1e-14, hermitian=True)
    step = -covariance @ (J.T @ Wr)
    rest = r + J @ step
    W_rest = cho_solve(factor, rest)
    # the unknowns of the images move the residual by minus their slopes
    pull = views.by_unknowns.reshape(len(r), -1).T
    unknowns = pull @ W_rest
    gain = pull @ cho_solve(factor, pull.T) - (pull @ WJ) @ covariance @ (pull @ WJ).T
    return step, covariance, unknowns, np.eye(len(pull)) - gain


def _with_gyro(calibration: Calibration, poses: CameraPoses, frame: str,
               fit: _Fit) -> Calibration:
    """Put an estimate into a calibration."""
    largest = float(np.sqrt(np.linalg.eigvalsh(fit.covariance[:3, :3])[-1]))
    if largest > OPEN_RAD:
        return replace(calibration, mount=NoEstimate(
            'gyro_leaves_an_axis_open', sigma_deg=float(np.degrees(largest))))
    T = np.full((4, 4), np.nan)
    T[:3, :3], T[3] = fit.R, [0, 0, 0, 1]
    timed = float(np.sqrt(fit.covariance[6, 6])) < OPEN_S
    covariance = np.zeros((len(NAMES),) * 2)
    at = [NAMES.index(name) for name in ('roll', 'pitch', 'yaw', 'time_offset')]
    covariance[np.ix_(at, at)] = fit.covariance[np.ix_([0, 1, 2, 6], [0, 1, 2, 6])]
    status: dict[str, Status] = {name: 'estimated' if place in at else 'unobservable'
                                 for place, name in enumerate(NAMES)}
    missing = dict.fromkeys(('x', 'y', 'z', 'scale'), Finding('gyro_tells_no_place').advice)
    if not timed:
        status['time_offset'] = 'unobservable'
        missing['time_offset'] = Finding('gyro_turns_evenly').advice
    for place, name in enumerate(NAMES):
        if status[name] == 'unobservable':
            covariance[place], covariance[:, place] = 0, 0
            covariance[place, place] = np.inf
    mount = Mount(frame, T, covariance, status, np.nan, fit.offset_s if timed else np.nan,
                  missing, fit.views, fit.doubtful, np.nan, fit.density)
    return replace(with_lens(calibration, poses, fit.unknowns, fit.spread), mount=mount)
