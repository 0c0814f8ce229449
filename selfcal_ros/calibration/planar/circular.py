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
Calibration from circular motion - turntable, fixation - with known aspect ratio and skew.

All screw axes coincide then, and v is undetermined along their image m (thesis 5.3). With square
pixels v also lies on the line n across the horizon through the midpoint of i and j, as the
principal point does; v is where m meets n. A camera that looks straight at the axis has its
principal point on m, so that m is n: then the principal point must be known as well.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.calibration.planar.conic_covariance import K_ENTRIES
from selfcal_ros.calibration.planar.conic_pencil import PencilCalibration
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import iac_from_calibration

#: Least distance of m from the midpoint of i and j, in units of their half distance.
OFFSET_LIMIT = 0.02


def calibrate_circular(circular_point: ArrayLike, screw_axis: ArrayLike, facts: CameraFacts,
                       covariance: ArrayLike | None = None) -> PencilCalibration | NoEstimate:
    """
    Find the camera of known pixel shape in which the pole of the horizon lies on m.

    Parameters
    ----------
    circular_point : array_like of complex, shape (3,)
        i, in pixels; the horizon is i x conj(i).
    screw_axis : array_like, shape (3,)
        m, in pixels.
    facts : CameraFacts
        With aspect ratio and skew; a principal point is used in place of m.
    covariance : array_like, shape (9, 9), optional
        Of the real and the imaginary part of i, and of m.

    Returns
    -------
    PencilCalibration or NoEstimate
        No camera without these facts, where m hardly differs from n (the reason gives the
        number), or where no real focal length fits.

    """
    if facts.aspect_ratio is None or facts.skew is None:
        return NoEstimate('circular_motion_needs_facts')
    i = np.asarray(circular_point, complex)
    if not abs(i[2]) > 1e-12 * np.abs(i).max():
        return NoEstimate('circular_points_at_infinity')
    scale, stated = i[2], i
    axis = np.asarray(screw_axis, float)
    i = i[:2] / scale
    shear = 0.0
    # the skew is known in pixels but enters in focal lengths: a few rounds settle it
    for _ in range(20):
        square = np.array([[facts.aspect_ratio, -shear, 0], [0, 1, 0], [0, 0, 1]])
        found = _square_pixels(square[:2, :2] @ i, np.linalg.solve(square.T, axis),
                               None if facts.principal_point is None else
                               square[:2, :2] @ facts.principal_point)
        if isinstance(found, NoEstimate):
            return found
        K = np.linalg.solve(square, found)
        new = facts.skew / K[0, 0]
        if abs(new - shear) < 1e-14:
            break
        shear = new
    fact = 'aspect_ratio+skew' + ('+principal_point' if facts.principal_point else '')
    spread = None
    if covariance is not None:
        spread = _covariance(K, stated, axis, square, facts, np.asarray(covariance, float))
    return PencilCalibration(K, iac_from_calibration(K), fact, spread)


def _covariance(K: np.ndarray, i: np.ndarray, axis: np.ndarray, square: np.ndarray,
                facts: CameraFacts, covariance: np.ndarray) -> np.ndarray:
    """
    Covariance (5, 5) of fx, fy, cx, cy, skew; see `conic_covariance`.

    The square frame, in which the pixels are square, moves with the facts, but not with the
    data: what the focal length does to a skew that is stated in pixels is neglected.
    """
    # thirteen inputs: Re i, Im i, m, aspect ratio, skew, u0, v0
    d_square = np.zeros((3, 3, 13))
    d_square[0, 0, 9], d_square[0, 1, 10] = 1, -1 / K[0, 0]
    di = np.zeros((3, 13), complex)
    di[:, :3], di[:, 3:6] = np.eye(3), 1j * np.eye(3)
    point = i[:2] / i[2]
    di = (di[:2] - point[:, None] * di[2]) / i[2]
    di = square[:2, :2] @ di + np.einsum('ijk,j->ik', d_square[:2, :2], point)
    p, q = (square[:2, :2] @ point).real, (square[:2, :2] @ point).imag
    dp, dq = di.real, di.imag
    reach = np.linalg.norm(q)
    d_reach = q @ dq / reach
    n = np.array([-q[1], q[0]]) / reach
    dn = np.stack([-dq[1], dq[0]]) / reach - np.outer(n, d_reach / reach)
    if facts.principal_point is not None:
        centre = np.asarray(facts.principal_point, float)
        moved = np.einsum('ijk,j->ik', d_square[:2, :2], centre)
        moved[:, 11:] += square[:2, :2]
        away = square[:2, :2] @ centre - p
        offset = away @ n
        d_offset = n @ (moved - dp) + away @ dn
    else:
        back = np.linalg.inv(square).T
        m = back @ axis
        dm = -back @ np.einsum('jik,j->ik', d_square, m)
        dm[:, 6:9] += back
        distance, slant = m[:2] @ p + m[2], m[:2] @ n
        d_distance = p @ dm[:2] + m[:2] @ dp + dm[2]
        d_slant = n @ dm[:2] + m[:2] @ dn
        offset = -reach ** 2 * slant / distance
        d_offset = offset * (2 * d_reach / reach - d_distance / distance) \
            - reach ** 2 / distance * d_slant
    found = square @ K
    dK = np.zeros((3, 3, 13))
    dK[0, 0] = dK[1, 1] = (reach * d_reach - offset * d_offset) / found[0, 0]
    dK[:2, 2] = dp + np.outer(n, d_offset) + offset * dn
    dK -= np.einsum('ijk,jl->ilk', d_square, K)
    slopes = (np.linalg.inv(square) @ np.moveaxis(dK, 2, 0))[(slice(None), *K_ENTRIES)].T
    sigmas = np.r_[facts.aspect_ratio_sigma, facts.skew_sigma_px,
                   facts.principal_point_sigma_px, facts.principal_point_sigma_px]
    by_facts = slopes[:, 9:] * sigmas
    spread: np.ndarray = slopes[:, :9] @ covariance @ slopes[:, :9].T + by_facts @ by_facts.T
    return spread


def _square_pixels(i: np.ndarray, axis: np.ndarray, principal_point: np.ndarray | None,
                   ) -> np.ndarray | NoEstimate:
    """K in a frame with square pixels, from i as (2,) complex, m, and maybe (u0, v0)."""
    middle, reach = i.real, np.linalg.norm(i.imag)
    across = np.array([-i.imag[1], i.imag[0]]) / max(reach, 1e-300)
    if principal_point is not None:
        offset = (principal_point - middle) @ across
    else:
        axis = axis / np.linalg.norm(axis[:2])
        distance, slant = axis[:2] @ middle + axis[2], axis[:2] @ across
        if abs(distance) < OFFSET_LIMIT * reach:
            return NoEstimate('axis_in_view', distance_px=float(abs(distance)),
                              limit_px=float(OFFSET_LIMIT * reach))
        # v = middle + tau across on m; the principal point divides that by Thales
        offset = -reach ** 2 * slant / distance
    if not abs(offset) < reach:
        return NoEstimate('no_real_focal_length')
    focal = np.sqrt(reach ** 2 - offset ** 2)
    u, v = middle + offset * across
    return np.array([[focal, 0, u], [0, focal, v], [0, 0, 1]])
