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

The closed forms of `diac` start the least squares of `rotation_constraints` in K alone. Directions
of K with a large covariance name the parameters that the views do not determine (thesis 4.1.3).
`other_cameras` tells where the curvature at the optimum understates it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.affine.diac import (camera_from_dual_conic, InfiniteHomographies,
                                                 linear_conic)
from selfcal_ros.calibration.affine.other_cameras import (covariance_of_other_optima,
                                                          covariance_of_valley, skew_cost)
from selfcal_ros.calibration.affine.rotation_constraints import (CX, CY, inverse_of, LOG_ASPECT,
                                                                 LOG_F, RotationConstraints, SKEW,
                                                                 solve, square)
from selfcal_ros.calibration.observability import FOCAL_FRACTION, parameter_status
from selfcal_ros.geometry.camera import Camera, MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.distributions import chi2_isf
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.parameter_status import Status, unobservable_among

#: Rotations that leave this axis by less (degrees) are called rotations about it.
_NEAR_AXIS_DEG = 15.0
#: Rotations must exceed their noise by so much (in variance) to tell anything.
_IDENTITY_SLACK = 1.5
#: Rotations below this are too small to tell their axis.
_MIN_TURN_DEG = 1.0
#: Optima whose costs differ by less are one.
_EQUAL_COST = 1e-3
#: Largest log f (image sides) and log ζ of a start: no lens is longer, and no pixel narrower.
_LARGEST_START = 4.0
#: Focal lengths from which the least squares start, too (image sizes).
_SUPPOSED = (0.7, 1.3, 2.6)


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
    constraints = RotationConstraints.carried(homographies, T)
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
        supposed[LOG_F] = np.log(focal)
        starts.append(('search', supposed))
    solved = [(name, *solve(constraints, theta, free, terms)) for name, theta in starts
              if np.abs(theta[:2]).max() < _LARGEST_START]
    # of equals the closed form
    costs = [cost + skew_cost(theta, facts) for _, theta, cost, _, _ in solved]
    chosen = next(k for k, cost in enumerate(costs) if cost <= min(costs) + _EQUAL_COST)
    name, theta, _, misfit, information = solved[chosen]
    K = inverse @ constraints.K(theta)
    freedom = max(5 * len(constraints.H) - int(free.sum()), 1)
    inflation = max(misfit / freedom, 1.0)
    small = inverse_of(information, free) * inflation
    small += covariance_of_valley(constraints, theta, small, free, terms, misfit, inflation)
    small += covariance_of_other_optima(theta, [other for _, other, *_ in solved],
                                        np.array(costs) - costs[chosen])
    covariance, log_aspect_sigma, open_directions = _judge(small, free, K, scale)
    camera = Camera(np.triu(K), width=size[0], height=size[1])
    status = _status(camera, covariance, facts)
    status['aspect_ratio'] = ('held' if not free[LOG_ASPECT] else 'estimated'
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
    statistic = square(offset, np.linalg.pinv(covariance, rcond=1e-9, hermitian=True))
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
        known.append((LOG_ASPECT, np.log(facts.aspect_ratio),
                      facts.aspect_ratio_sigma / facts.aspect_ratio))
    if facts.skew is not None:
        known.append((SKEW, facts.skew, facts.skew_sigma_px))
    if facts.principal_point is not None:
        known += [(CX + k, facts.principal_point[k], facts.principal_point_sigma_px)
                  for k in (0, 1)]
    for k, value, sigma in known:
        start[k] = targets[k] = value
        if sigma > 0:
            sigmas[k] = sigma
        else:
            free[k] = False
    return free, start, (targets, sigmas)


def _judge(small: np.ndarray, free: np.ndarray, K: np.ndarray, scale: float,
           ) -> tuple[np.ndarray, float, tuple[str, ...]]:
    """Covariance of fx, fy, cx, cy, skew (px), sigma of log ζ, names of open directions."""
    index = np.flatnonzero(free)
    values, vectors = np.linalg.eigh(small[np.ix_(index, index)])
    names = np.array(['focal length', 'aspect ratio', 'cx', 'cy', 'skew'])[index]
    directions = []
    for value, vector in zip(values[::-1], vectors.T[::-1]):
        if np.sqrt(max(value, 0.0)) > FOCAL_FRACTION:
            share = np.abs(vector) / np.abs(vector).max()
            directions.append(' with '.join(names[np.argsort(-share)][np.sort(-share) < -0.2]))
    J = np.zeros((5, 5))
    J[0, LOG_F], J[1, LOG_F], J[1, LOG_ASPECT] = K[0, 0], K[1, 1], K[1, 1]
    J[2, CX] = J[3, CY] = J[4, SKEW] = scale
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
    # about x or y the skew takes no part; elsewhere an aspect ratio alone leaves two cameras
    if facts.aspect_ratio is not None and facts.skew is None and not near:
        known['helps'] = ('skew',)
    if facts.aspect_ratio is None and not (near and nearest == 2):
        known['helps'] = (('aspect ratio',) if near or facts.skew is not None
                          else ('skew', 'aspect ratio'))
    if not near:
        return NoEstimate('rotations_about_one_axis', **known)
    return NoEstimate('rotations_about_camera_axis', axis='xyz'[nearest],
                      wanted=(('y',), ('x',), ('x', 'y'))[nearest], **known)
