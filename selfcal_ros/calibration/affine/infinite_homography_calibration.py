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
Infinite homographies → K, with its covariance, or what the rotations leave open.

The closed forms of `diac` start a small least-squares problem in K alone that asks
R = K^-1 H K of all views to be rotations; the null space of its normal matrix names the
parameters that the views do not determine (thesis 4.1.3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.affine.diac import (camera_from_dual_conic, InfiniteHomographies,
                                                 linear_conic, ROUNDING)
from selfcal_ros.calibration.observability import FOCAL_FRACTION, parameter_status
from selfcal_ros.geometry.camera import Camera, MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.distributions import chi2_isf
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.values.parameter_status import Status, unobservable_among

#: Rotations that leave this axis by less (degrees) are called rotations about it.
_NEAR_AXIS_DEG = 15.0
#: Rotations must exceed their noise by so much (in variance) to tell anything.
_IDENTITY_SLACK = 1.5
#: Rotations below this are too small to tell their axis.
_MIN_TURN_DEG = 1.0
#: Sigmas of a very wide prior on (log f, log ζ, cx, cy, skew), in image sides where they have a
#: length: it holds what nothing else does.
_WIDE = np.array([3.0, 1.0, 1.0, 1.0, 1.0])
#: Largest log f (image sides) and log ζ of a start, and of what is tried: no lens is longer, and
#: no pixel narrower. Largest step of both, over which the linear model may hold.
_LARGEST_START, _LARGEST_LOG, _LARGEST_STEP = 4.0, 4.5, 0.7
#: Largest principal point and skew that is tried, in image sides.
_LARGEST_OFFSET = 50.0
#: Optima whose costs differ by less are one.
_EQUAL_COST = 1e-3
#: Focal lengths from which the least squares start, too (image sizes).
_SUPPOSED = (0.7, 1.3, 2.6)
_LOG_F, _LOG_ASPECT, _CX, _CY, _SKEW = range(5)


@dataclass(frozen=True)
class ConicCalibration:
    """
    A camera from infinite homographies.

    Attributes
    ----------
    K : ndarray, shape (3, 3)
        Pixels, after the least squares over all views.
    covariance : ndarray, shape (5, 5)
        Of fx, fy, cx, cy, skew, pixels.
    linear_K : ndarray, shape (3, 3), or None
        The closed form alone; None where its conic is not definite.
    closed_form : str
        'linear', or the fact that picked the member of the family: 'zero skew' (4.9),
        'aspect ratio', 'principal point'; 'search' where no closed form gave a camera.
    rotations : ndarray, shape (n, 3)
        Rotation vector of each view against the reference, radians.
    misfit : float
        Root mean square of the constraints in sigmas of the homographies.

    """

    K: np.ndarray
    covariance: np.ndarray
    linear_K: np.ndarray | None
    closed_form: str
    rotations: np.ndarray
    misfit: float


class _Constraints:
    """R = K^-1 H K be rotations: residuals, weights and derivatives in (log f, log ζ, ...)."""

    def __init__(self, H: np.ndarray, covariance: np.ndarray) -> None:
        self.H = H
        self.covariance = covariance + ROUNDING**2 * np.eye(covariance.shape[1])

    @classmethod
    def carried(cls, homographies: InfiniteHomographies, T: np.ndarray) -> _Constraints:
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
        f = np.exp(theta[_LOG_F])
        return np.array([[f, theta[_SKEW], theta[_CX]],
                         [0, f * np.exp(theta[_LOG_ASPECT]), theta[_CY]], [0, 0, 1]])

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
        dK[_LOG_F, 0, 0], dK[_LOG_F, 1, 1] = K[0, 0], K[1, 1]
        dK[_LOG_ASPECT, 1, 1] = K[1, 1]
        dK[_CX, 0, 2] = dK[_CY, 1, 2] = dK[_SKEW, 0, 1] = 1
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


def _solve(constraints: _Constraints, theta: np.ndarray, free: np.ndarray,
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
        return float(_square(r, W) + np.sum(fact[np.isfinite(sigmas)]**2)
                     + np.sum((t / _WIDE)[free]**2))

    damping = 1e-3
    for _ in range(iterations):
        r, J, W = constraints.evaluate(theta)
        cost = total(theta, W)
        H, g = _normal(r, J, W)
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
    misfit = float(_square(r, W) + fact @ fact)
    # small residuals with a wide covariance come from K that blow the weights up, too
    log_weight = float(np.linalg.slogdet(W)[1].sum())
    information, _ = _normal(r, J, W)
    information[np.diag_indices(5)] += np.where(np.isfinite(sigmas), 1 / sigmas**2, 0)
    return theta, misfit - log_weight, misfit, information


def _square(r: np.ndarray, W: np.ndarray) -> float:
    """Sum r W r over independent groups."""
    return float(np.sum((r[:, None] @ W)[:, 0] * r))


def _normal(r: np.ndarray, J: np.ndarray, W: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum the normal equations of independent groups: J^T W J, J^T W r."""
    JW = np.swapaxes(J, 1, 2) @ W
    return (JW @ J).sum(axis=0), (JW @ r[:, :, None])[:, :, 0].sum(axis=0)


def _theta(K: np.ndarray) -> np.ndarray:
    return np.array([np.log(K[0, 0]), np.log(K[1, 1] / K[0, 0]), K[0, 2], K[1, 2], K[0, 1]])


def camera_from_homographies(homographies: InfiniteHomographies, size: tuple[int, int],
                             facts: CameraFacts | None = None) -> ConicCalibration | NoEstimate:
    """
    Calibrate a fixed camera from infinite homographies (algorithm 4.2, last steps).

    Parameters
    ----------
    homographies : InfiniteHomographies
        Of undistorted pixels.
    size : (int, int)
        Width and height of the image, pixels.
    facts : CameraFacts, optional
        Aspect ratio, skew, principal point; those with sigma 0 are held.

    Returns
    -------
    ConicCalibration or NoEstimate
        The failure names what the rotations leave open, and which rotation would help. Its value
        `status` holds, for fx, fy, cx, cy, skew and aspect_ratio: 'estimated' (the views do
        determine it), 'held' or 'unobservable'. `open_directions` names the combinations of
        parameters that the views do not determine. There is no number with it.

    """
    facts = CameraFacts() if facts is None else facts
    facts = replace(facts, distortion='none')
    if not len(homographies.H):
        return _nothing(facts, 'views_not_rotated')
    scale, middle = float(max(size)), (np.array(size, float) - 1) / 2
    T = np.array([[1 / scale, 0, -middle[0] / scale], [0, 1 / scale, -middle[1] / scale],
                  [0, 0, 1]])
    inverse = np.linalg.inv(T)
    constraints = _Constraints.carried(homographies, T)
    if _is_identity(constraints.H, constraints.covariance):
        return _nothing(facts, 'views_rotated_within_noise')
    scaled = _scaled_facts(facts, scale, middle)
    candidates, family = linear_conic(constraints.H, constraints.noise, scaled)
    closed = [(name, K) for name, conic in candidates
              if not isinstance(K := camera_from_dual_conic(conic), NoEstimate)]
    free, start, terms = _fact_terms(scaled)
    starts = [(name, np.where(free, _theta(K), start)) for name, K in closed]
    for focal in _SUPPOSED:
        supposed = start.copy()
        supposed[_LOG_F] = np.log(focal)
        starts.append(('search', supposed))
    solved = [(name, *_solve(constraints, theta, free, terms)) for name, theta in starts
              if np.abs(theta[:2]).max() < _LARGEST_START]
    # of equals the closed form
    best = min(cost for _, _, cost, _, _ in solved)
    name, theta, _, misfit, information = next(s for s in solved if s[2] <= best + _EQUAL_COST)
    K = inverse @ constraints.K(theta)
    freedom = max(5 * len(constraints.H) - int(free.sum()), 1)
    covariance, log_aspect_sigma, open_directions = _judge(
        information, free, K, scale, max(misfit / freedom, 1.0))
    camera = Camera(np.triu(K), width=size[0], height=size[1])
    status = _status(camera, covariance, facts)
    status['aspect_ratio'] = ('held' if not free[_LOG_ASPECT] else 'estimated'
                              if log_aspect_sigma < FOCAL_FRACTION else 'unobservable')
    rotations = constraints.rotations(theta)
    if 'unobservable' in status.values():
        return _explain(status, rotations, family, facts, open_directions)
    linear_K = np.triu(inverse @ closed[0][1]) if closed else None
    return ConicCalibration(camera.K, covariance, linear_K, name, rotations,
                            float(np.sqrt(misfit / freedom)))


def _status(camera: Camera, covariance: np.ndarray, facts: CameraFacts) -> dict[str, Status]:
    """Tell the status of fx, fy, cx, cy, skew, of covariance (5, 5)."""
    count = len(MATRIX_PARAMETERS)
    whole = np.zeros((len(camera.parameters),) * 2)
    whole[:count, :count] = covariance
    return {k: v for k, v in parameter_status(camera, whole, facts).items()
            if k in MATRIX_PARAMETERS}


def _is_identity(H: np.ndarray, covariance: np.ndarray) -> bool:
    """Tell whether homographies differ from no rotation by no more than their noise."""
    offset = (H - np.eye(3)).reshape(len(covariance), -1)
    statistic = _square(offset, np.linalg.pinv(covariance, rcond=1e-9, hermitian=True))
    # eight degrees of freedom each; the noise level itself is known to some 10 percent only
    return bool(statistic < _IDENTITY_SLACK * chi2_isf(0.001, 8 * len(H)))


def _nothing(facts: CameraFacts, kind: str) -> NoEstimate:
    camera = Camera(np.eye(3), width=1, height=1)
    status = parameter_status(camera, np.diag(np.full(9, 1e12)), facts)
    status = {k: status[k] for k in ('fx', 'fy', 'cx', 'cy', 'skew')}
    held = facts.aspect_ratio is not None and facts.aspect_ratio_sigma == 0
    status['aspect_ratio'] = 'held' if held else 'unobservable'
    return NoEstimate(kind, status=status, open_directions=('everything',))


def _scaled_facts(facts: CameraFacts, scale: float, middle: np.ndarray) -> CameraFacts:
    point = facts.principal_point
    return replace(
        facts, skew=None if facts.skew is None else facts.skew / scale,
        skew_sigma_px=facts.skew_sigma_px / scale,
        principal_point=None if point is None else tuple((np.array(point) - middle) / scale),
        principal_point_sigma_px=facts.principal_point_sigma_px / scale)


def _fact_terms(facts: CameraFacts,
                ) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Free parameters, where the held ones stand, and facts with a spread as measurements."""
    free, start = np.ones(5, bool), np.zeros(5)
    targets, sigmas = np.zeros(5), np.full(5, np.inf)
    known = []
    if facts.aspect_ratio is not None:
        known.append((_LOG_ASPECT, np.log(facts.aspect_ratio),
                      facts.aspect_ratio_sigma / facts.aspect_ratio))
    if facts.skew is not None:
        known.append((_SKEW, facts.skew, facts.skew_sigma_px))
    if facts.principal_point is not None:
        known += [(_CX + k, facts.principal_point[k], facts.principal_point_sigma_px)
                  for k in (0, 1)]
    for k, value, sigma in known:
        start[k] = targets[k] = value
        if sigma > 0:
            sigmas[k] = sigma
        else:
            free[k] = False
    return free, start, (targets, sigmas)


def _judge(information: np.ndarray, free: np.ndarray, K: np.ndarray, scale: float,
           inflation: float) -> tuple[np.ndarray, float, tuple[str, ...]]:
    """Covariance of fx, fy, cx, cy, skew (px), sigma of log ζ, names of open directions."""
    index = np.flatnonzero(free)
    values, vectors = np.linalg.eigh(information[np.ix_(index, index)])
    values = np.maximum(values, 1e-16 * max(values[-1], 1e-300))
    small = np.zeros((5, 5))
    small[np.ix_(index, index)] = inflation * (vectors / values) @ vectors.T
    names = np.array(['focal length', 'aspect ratio', 'cx', 'cy', 'skew'])[index]
    directions = []
    for value, vector in zip(values, vectors.T):
        if np.sqrt(inflation / value) > FOCAL_FRACTION:
            share = np.abs(vector) / np.abs(vector).max()
            directions.append(' with '.join(names[np.argsort(-share)][np.sort(-share) < -0.2]))
    J = np.zeros((5, 5))
    J[0, _LOG_F], J[1, _LOG_F], J[1, _LOG_ASPECT] = K[0, 0], K[1, 1], K[1, 1]
    J[2, _CX] = J[3, _CY] = J[4, _SKEW] = scale
    return J @ small @ J.T, float(np.sqrt(small[1, 1])), tuple(directions)


def _explain(status: dict[str, Status], rotations: np.ndarray, family: bool, facts: CameraFacts,
             open_directions: tuple[str, ...]) -> NoEstimate:
    """Tell what is open and which rotation would help."""
    missing = unobservable_among(status, status)
    _, spread, axes = np.linalg.svd(rotations, full_matrices=True)
    largest = float(np.degrees(np.linalg.norm(rotations, axis=1).max()))
    along = np.degrees(np.arccos(np.clip(np.abs(axes[0]), 0, 1)))
    nearest = int(np.argmin(along))
    near = along[nearest] < _NEAR_AXIS_DEG
    known = {'missing': missing, 'largest_deg': largest, 'status': status,
             'open_directions': open_directions}
    if not (largest > _MIN_TURN_DEG
            and (family or len(spread) < 2 or spread[1] < 0.2 * spread[0])):
        return NoEstimate('rotations_small', **known)
    known['helps'] = ()
    # about x or y the skew takes no part
    if facts.aspect_ratio is None and not (near and nearest == 2):
        known['helps'] = (('aspect ratio',) if near or facts.skew is not None
                          else ('skew', 'aspect ratio'))
    if not near:
        return NoEstimate('rotations_about_one_axis', **known)
    return NoEstimate('rotations_about_camera_axis', axis='xyz'[nearest],
                      wanted=(('y',), ('x',), ('x', 'y'))[nearest], **known)
