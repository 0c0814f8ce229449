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
The pencil of conics through the fixed points, and the fact that picks the camera (thesis 5.2).

omega(mu) = C + mu l l^T contains the circular points i, j and has v as the pole of l; one more
fact gives mu. All work is done in a frame in which i lies near (0, 0) at unit distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.calibration.planar.conic_covariance import (calibration_covariance, EXACT_SIGMAS,
                                                             Pencil)
from selfcal_ros.calibration.result import FixedPoints
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import iac_from_calibration

#: Largest change of the camera per unit change of a fact with which a fact may pick the camera.
#: Both are without dimension: focal lengths by their logarithm, aspect ratio as it is, skew and
#: principal point in focal lengths.
LEVERAGE_LIMIT = 20.0
#: Steps of an iteration along the pencil at most, and halvings of each. They converge in a few.
_ROUNDS = 20


@dataclass(frozen=True)
class PencilCalibration:
    """
    A camera out of the pencil.

    Attributes
    ----------
    K : ndarray, shape (3, 3)
        Pixels.
    omega : ndarray, shape (3, 3)
        Image of the absolute conic, pixels, omega = (K K^T)^-1.
    fact : str
        Which fact picked it: 'aspect_ratio', 'skew', 'principal_point', or several joined
        by '+'.
    covariance : ndarray, shape (5, 5), optional
        Of fx, fy, cx, cy, skew in pixels; first order, from that of the fixed points and from
        the sigmas of the facts. None where the former is not known.

    """

    K: np.ndarray
    omega: np.ndarray
    fact: str
    covariance: np.ndarray | None = None


def conic_pencil(fixed: FixedPoints) -> tuple[np.ndarray, np.ndarray]:
    """
    Return C and l l^T of the pencil omega(mu) = C + mu l l^T (5.3), each of unit norm.

    Parameters
    ----------
    fixed : FixedPoints

    Returns
    -------
    C, ll : ndarray, shape (3, 3)

    """
    side = np.cross(fixed.vanishing_point, fixed.circular_point)
    C = 2 * (side[:, None] * side.conj()[None, :]).real
    ll = np.outer(fixed.horizon, fixed.horizon)
    return C / np.linalg.norm(C), ll / np.linalg.norm(ll)


def _working_frame(fixed: FixedPoints) -> tuple[np.ndarray, FixedPoints]:
    """Similarity T to the working frame, and the fixed points in it."""
    i = fixed.circular_point / fixed.circular_point[2]
    scale = 1 / max(float(np.linalg.norm(i.imag)), 1e-300)
    T = np.array([[scale, 0, -scale * i[0].real], [0, scale, -scale * i[1].real], [0, 0, 1]])
    circular = T @ i
    # l is again made from i, so that it holds both exactly
    line = np.cross(circular.real, circular.imag)
    return T, FixedPoints(line / np.linalg.norm(line), T @ fixed.vanishing_point, circular)


def _values(K: np.ndarray) -> dict[str, np.ndarray]:
    """What the facts speak of, without dimension."""
    return {'aspect_ratio': np.array([K[1, 1] / K[0, 0]]), 'skew': np.array([K[0, 1] / K[0, 0]]),
            'principal_point': K[:2, 2] / K[0, 0]}


def mu_from_skew(C: np.ndarray, ll: np.ndarray, shear: float = 0.0) -> list[float]:
    """
    Member with the skew shear * fy; without it (5.7). None if the horizon is exactly level.

    omega12 + shear omega11 = 0.
    """
    below = ll[0, 1] + shear * ll[0, 0]
    return [-(C[0, 1] + shear * C[0, 0]) / below] if below != 0 else []


def mu_from_aspect(C: np.ndarray, ll: np.ndarray, aspect_ratio: float) -> list[float]:
    """
    Members with the aspect ratio, for any skew: omega11^2 = ratio^2 det2(omega).

    (5.8) is the same with the skew neglected. The determinant of the upper left block is
    linear in mu, so that this is a quadratic.
    """
    z2 = aspect_ratio ** 2
    determinant = C[0, 0] * C[1, 1] - C[0, 1] ** 2
    slope = C[0, 0] * ll[1, 1] + C[1, 1] * ll[0, 0] - 2 * C[0, 1] * ll[0, 1]
    quadratic = [ll[0, 0] ** 2, 2 * C[0, 0] * ll[0, 0] - z2 * slope,
                 C[0, 0] ** 2 - z2 * determinant]
    # a level horizon leaves a linear equation; its lost root has gone to infinity
    if abs(quadratic[0]) < 1e-13 * abs(quadratic[1]):
        return [-quadratic[2] / quadratic[1]] if quadratic[1] else []
    roots = np.roots(quadratic)
    found: list[float] = roots[np.abs(roots.imag) < 1e-9 * (1 + np.abs(roots))].real.tolist()
    return found


def mu_from_principal_point(C: np.ndarray, ll: np.ndarray, point: np.ndarray) -> list[float]:
    """Member with the principal point: two linear equations, least squares (5.9)."""
    x = np.array([*point, 1.0])
    a, b = (C @ x)[:2], (ll @ x)[:2]
    below = b @ b
    return [-(a @ b) / below] if below else []


def _slopes(pencil: Pencil, mu: float) -> dict[str, np.ndarray]:
    """Derivative of the facts' values along the pencil, per unit change of the camera."""
    step = _step(mu)
    one, other = (pencil.camera(mu + s) for s in (step, -step))
    if isinstance(one, NoEstimate) or isinstance(other, NoEstimate):
        return {name: np.zeros(1) for name in EXACT_SIGMAS}
    first, second = _values(one), _values(other)
    change = {name: first[name] - second[name] for name in first}
    focal = np.log(np.diag(one)[:2] / np.diag(other)[:2])
    size = np.linalg.norm([*focal, *change['skew'], *change['principal_point']])
    return {name: value / max(size, 1e-300) for name, value in change.items()}


def _step(mu: float) -> float:
    """Return a step of mu for differences: large beside rounding, small beside curvature."""
    return 1e-6 * max(abs(mu), 1e-3)


def _leverage(slope: np.ndarray) -> float:
    size = float(np.linalg.norm(slope))
    return 1 / size if size > 1e-9 else float('inf')


def calibrate_from_fixed_points(fixed: FixedPoints, facts: CameraFacts,
                                covariance: ArrayLike | None = None,
                                ) -> PencilCalibration | NoEstimate:
    """
    Pick the camera of the pencil that agrees with what is known (5.7-5.9).

    Parameters
    ----------
    fixed : FixedPoints
        With v the pole of l; for circular motion see `circular.calibrate_circular`.
    facts : CameraFacts
        Aspect ratio, skew, principal point; several are weighed by their sigmas.
    covariance : array_like, shape (9, 9), optional
        Of v, the real and the imaginary part of i, in pixels.

    Returns
    -------
    PencilCalibration or NoEstimate
        No camera where no fact is known, or where the conic is not definite. None, too, where the
        facts have no hold on the focal length; the reason gives the number.

    """
    known = [name for name in ('aspect_ratio', 'principal_point', 'skew')
             if getattr(facts, name) is not None]
    if not known:
        return NoEstimate('no_fact')
    T, working = _working_frame(fixed)
    if not (np.isfinite(T).all() and np.isfinite(working.vanishing_point).all()):
        return NoEstimate('circular_points_at_infinity')
    C, ll = conic_pencil(working)
    pencil = Pencil(fixed, working, T, C, ll, known, facts)
    candidates = []
    failure = NoEstimate('fact_meets_no_member')
    for name in known:
        for mu in _closed_form(name, pencil):
            K = pencil.camera(mu)
            if isinstance(K, NoEstimate):
                failure = K
                continue
            slopes = _slopes(pencil, mu)
            candidates.append((_misfit(K, pencil), _leverage(slopes[name]), mu, slopes))
    if not candidates:
        ratio = abs(ll[0, 1]) / (ll[0, 0] + ll[1, 1])
        if known == ['skew'] and ratio < 1 / LEVERAGE_LIMIT:
            return NoEstimate('skew_without_hold', tilt_deg=float(np.degrees(ratio)))
        return failure
    _, _, mu, slopes = min(candidates, key=lambda c: (c[0], c[1]) if len(known) > 1 else c[1])
    joint = _leverage(np.concatenate([slopes[name] for name in known]))
    if joint > LEVERAGE_LIMIT:
        tilt = np.degrees(np.arctan2(abs(working.horizon[0]), abs(working.horizon[1])))
        return NoEstimate('fact_without_hold', known=tuple(known), factor=float(joint),
                          limit=LEVERAGE_LIMIT, tilt_deg=float(tilt))
    if len(known) > 1:
        mu = _weighed(pencil, mu)
    K = pencil.camera(mu)
    if isinstance(K, NoEstimate):
        return K
    K = np.linalg.solve(T, K)
    K = np.triu(K / K[2, 2])
    if abs(K[0, 1]) > K[0, 0]:
        return NoEstimate('skew_too_large', skew_px=float(K[0, 1]), focal_px=float(K[0, 0]))
    if covariance is not None:
        covariance = calibration_covariance(K, pencil, mu, covariance)
    return PencilCalibration(K, iac_from_calibration(K), '+'.join(known), covariance)


def _closed_form(name: str, pencil: Pencil) -> list[float]:
    """Return the members that agree with one fact (5.7-5.9)."""
    C, ll, T, facts = pencil.C, pencil.ll, pencil.T, pencil.facts
    if name == 'skew':
        shear, found = 0.0, []
        # the skew is known in pixels but enters in focal lengths: a few rounds settle it
        for _ in range(_ROUNDS if facts.skew else 1):
            found = mu_from_skew(C, ll, shear)
            K = pencil.camera(found[0]) if found else None
            if not isinstance(K, np.ndarray):
                break
            new = facts.skew * T[0, 0] / K[1, 1]
            if abs(new - shear) < 1e-15:
                break
            shear = new
        return found
    if name == 'aspect_ratio':
        assert facts.aspect_ratio is not None
        return mu_from_aspect(C, ll, facts.aspect_ratio)
    assert facts.principal_point is not None
    return mu_from_principal_point(C, ll, (T @ [*facts.principal_point, 1.0])[:2])


def _residuals(K: np.ndarray, pencil: Pencil) -> np.ndarray:
    """Deviations of K, in the working frame, from the facts in sigmas."""
    facts, T = pencil.facts, pencil.T
    values, focal_px = _values(K), K[0, 0] / T[0, 0]
    out = []
    for name in pencil.known:
        if name == 'principal_point':
            assert facts.principal_point is not None
            target = (T @ [*facts.principal_point, 1.0])[:2] / K[0, 0]
            sigma = facts.principal_point_sigma_px / focal_px
        elif name == 'skew':
            target, sigma = facts.skew / focal_px, facts.skew_sigma_px / focal_px
        else:
            target, sigma = facts.aspect_ratio, facts.aspect_ratio_sigma
        out.append((values[name] - target) / (sigma or EXACT_SIGMAS[name]))
    return np.concatenate(out)


def _misfit(K: np.ndarray, pencil: Pencil) -> float:
    return float((_residuals(K, pencil) ** 2).sum())


def _weighed(pencil: Pencil, mu: float) -> float:
    """Least squares over the facts along the pencil, by Gauss-Newton on one parameter."""
    for _ in range(_ROUNDS):
        step = _step(mu)
        sides = [K for m in (mu, mu + step, mu - step)
                 if not isinstance(K := pencil.camera(m), NoEstimate)]
        if len(sides) < 3:
            break
        r, above, below = (_residuals(K, pencil) for K in sides)
        slope = (above - below) / (2 * step)
        change = -(slope @ r) / max(slope @ slope, 1e-300)
        for _ in range(_ROUNDS):
            K = pencil.camera(mu + change)
            if not isinstance(K, NoEstimate) and _misfit(K, pencil) <= r @ r:
                break
            change /= 2
        else:
            break
        mu += change
        if abs(change) < 1e-10 * abs(mu):
            break
    return mu
