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
"""Rotations: angle-axis vectors and matrices, with derivatives; all stack over leading axes."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.projective import about_axis


def _sine_terms(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return sin a / a and (1 - cos a) / a², with their limits at zero."""
    # at such angles the limits are exact to the last digit
    safe = np.maximum(angle, 1e-9)
    half = np.sin(safe / 2) / safe
    return np.sin(safe) / safe, 2 * half * half


def _third_term(angle: np.ndarray) -> np.ndarray:
    """Return (a - sin a) / a³, with its limit at zero."""
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    term: np.ndarray = np.where(small, 1 / 6 - angle * angle / 120,
                                (safe - np.sin(safe)) / safe**3)
    return term


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """
    Rotation matrix of an angle-axis vector (Rodrigues).

    Parameters
    ----------
    vector : array_like, shape (..., 3)
        Axis times angle in radians.

    Returns
    -------
    ndarray, shape (..., 3, 3)

    """
    vector = np.asarray(vector, float)
    angle = np.sqrt(np.einsum('...i,...i->...', vector, vector))
    sine, cosine = _sine_terms(angle)
    return about_axis(vector, 1 - cosine * angle * angle, sine, cosine)


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """
    Return the rotation (3, 3) nearest to a matrix (3, 3).

    Of targetᵀ source, both (m, 3), it is the turn that takes the source nearest to the target
    (Kabsch 1976).
    """
    U, _, Vt = np.linalg.svd(matrix)
    rotation: np.ndarray = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return rotation


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """
    Angle-axis vector of a rotation matrix, angle in [0, pi].

    Goes through the unit quaternion with the largest component first, which is accurate at
    every angle.

    Parameters
    ----------
    matrix : array_like, shape (..., 3, 3)

    Returns
    -------
    ndarray, shape (..., 3)

    """
    R = np.asarray(matrix, float)
    trace = np.trace(R, axis1=-2, axis2=-1)
    # 4 q qᵀ of the quaternion q = (w, x, y, z); its row of the largest diagonal is 4 q_k q
    outer = np.empty(R.shape[:-2] + (4, 4))
    outer[..., 0, 0] = 1 + trace
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        outer[..., 0, k + 1] = outer[..., k + 1, 0] = R[..., j, i] - R[..., i, j]
        outer[..., k + 1, k + 1] = 1 + 2 * R[..., k, k] - trace
        outer[..., i + 1, j + 1] = outer[..., j + 1, i + 1] = R[..., i, j] + R[..., j, i]
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(q[..., :1] < 0, -q, q)
    length = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(length, q[..., :1])
    factor = np.where(length > 1e-12, angle / np.maximum(length, 1e-300), 2.0)
    vector: np.ndarray = factor * q[..., 1:]
    return vector


def left_jacobian(vector: np.ndarray) -> np.ndarray:
    """
    Left Jacobian of the exponential map: R(v + dv) ≈ R(J dv) R(v).

    Parameters
    ----------
    vector : array_like, shape (..., 3)

    Returns
    -------
    ndarray, shape (..., 3, 3)

    """
    vector = np.asarray(vector, float)
    angle = np.sqrt(np.einsum('...i,...i->...', vector, vector))
    cosine, cubic = _sine_terms(angle)[1], _third_term(angle)
    return about_axis(vector, 1 - cubic * angle * angle, cosine, cubic)


def roll_pitch_yaw(matrix: np.ndarray) -> np.ndarray:
    """
    Take rotations apart: Rz(yaw) Ry(pitch) Rx(roll), turns about fixed x, y, z (REP 103).

    Parameters
    ----------
    matrix : ndarray, shape (..., 3, 3)

    Returns
    -------
    ndarray, shape (..., 3)
        Radians; NaN where a matrix has them.

    """
    angles: np.ndarray = np.stack([
        np.arctan2(matrix[..., 2, 1], matrix[..., 2, 2]),
        np.arctan2(-matrix[..., 2, 0], np.hypot(matrix[..., 0, 0], matrix[..., 1, 0])),
        np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0])], axis=-1)
    return angles


def angle_sigmas(pitch: float, yaw: float, covariance: np.ndarray) -> np.ndarray:
    """
    Return the standard deviations of roll, pitch and yaw of a rotation Rz(yaw) Ry(pitch) Rx(roll).

    Parameters
    ----------
    pitch, yaw : float
        Radians.
    covariance : ndarray, shape (3, 3)
        Of a small turn about the fixed axes x, y, z, which comes after the rotation (rad²).

    Returns
    -------
    ndarray, shape (3,)
        Radians; roll and yaw grow without bound as the pitch nears a right angle.

    """
    c, s = np.cos(yaw), np.sin(yaw)
    J = np.array([[c / np.cos(pitch), s / np.cos(pitch), 0.0], [-s, c, 0.0],
                  [c * np.tan(pitch), s * np.tan(pitch), 1.0]])
    sigmas: np.ndarray = np.sqrt(np.einsum('ij,jk,ik->i', J, covariance, J))
    return sigmas


def swing_twist(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Split rotations into a swing about an axis in the x-y plane after a twist about z.

    R = R(swing_x, swing_y, 0) R_z(twist); for planar motion the swing is zero.

    Parameters
    ----------
    matrix : array_like, shape (..., 3, 3)

    Returns
    -------
    twist : ndarray, shape (...,)
        Radians, in (-pi, pi].
    swing : ndarray, shape (..., 2)
        Radians.

    """
    R = np.asarray(matrix, float)
    # the swing takes e3 to R e3 along the shortest way
    z = R[..., 2]
    horizontal = np.linalg.norm(z[..., :2], axis=-1)
    angle = np.arctan2(horizontal, z[..., 2])
    factor = np.where(horizontal > 1e-12, angle / np.maximum(horizontal, 1e-300), 1.0)
    swing = np.stack([-z[..., 1], z[..., 0]], axis=-1) * factor[..., None]
    twisted = np.swapaxes(rotation_matrix(pad(swing)), -1, -2) @ R
    return np.arctan2(twisted[..., 1, 0] - twisted[..., 0, 1],
                      twisted[..., 0, 0] + twisted[..., 1, 1]), swing


def pad(swing: np.ndarray) -> np.ndarray:
    """Append a zero third component to vectors (..., 2)."""
    swing = np.asarray(swing, float)
    return np.concatenate([swing, np.zeros(swing.shape[:-1] + (1,))], axis=-1)


def twist_matrix(angle: np.ndarray) -> np.ndarray:
    """Return rotations about z by angles (...,) in radians, shape (..., 3, 3)."""
    angle = np.asarray(angle, float)
    matrix = np.zeros(angle.shape + (3, 3))
    matrix[..., 0, 0] = matrix[..., 1, 1] = np.cos(angle)
    matrix[..., 1, 0] = np.sin(angle)
    matrix[..., 0, 1] = -matrix[..., 1, 0]
    matrix[..., 2, 2] = 1
    return matrix


def align_z(direction: np.ndarray) -> np.ndarray:
    """Return a rotation whose third column is the unit vector along direction (3,)."""
    z = np.asarray(direction, float) / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
