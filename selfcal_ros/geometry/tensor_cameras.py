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
"""Cameras that agree with a reduced trifocal tensor, and how they move with it (thesis B.4)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.trifocal import PLANAR_ELEMENTS


def planar_cameras(T: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """
    Cameras that agree with a reduced tensor (B.4); the first is [I | 0].

    Parameters
    ----------
    T : array_like, shape (3, 3, 3)
        In the canonical frame.

    Returns
    -------
    second, third : ndarray, shape (3, 4)
        In the canonical frame. The harmless two-parameter family - the plane at infinity
        along the planes of motion - is settled by the least norm.

    """
    T = np.asarray(T, float)
    second, third = np.zeros((3, 4)), np.zeros((3, 4))
    second[1, 1] = third[1, 1] = 1
    third[[0, 2], 3] = T[1, 1, [0, 2]]
    second[[0, 2], 3] = -T[1, [0, 2], 1]
    a4, b4 = second[[0, 2], 3], third[[0, 2], 3]
    # unknown (a^1, a^3, b^1, b^3) of one column: a^j b4^k - a4^j b^k = T^{jk}
    A = np.concatenate([np.kron(np.eye(2), b4[:, None]), -np.kron(a4[:, None], np.eye(2))],
                       axis=1)
    for i in (0, 2):
        column = np.linalg.lstsq(A, T[i][np.ix_([0, 2], [0, 2])].ravel(), rcond=1e-10)[0]
        second[[0, 2], i], third[[0, 2], i] = column[:2], column[2:]
    return second, third


def planar_camera_slopes(T: ArrayLike) -> np.ndarray:
    """
    Derivative of `planar_cameras` by the elements of the tensor.

    Parameters
    ----------
    T : array_like, shape (3, 3, 3)
        In the canonical frame.

    Returns
    -------
    ndarray, shape (2, 3, 4, 12)
        Second and third camera by `PLANAR_ELEMENTS`; their covariance is the slopes times that
        of the tensor times the slopes.

    """
    T = np.asarray(T, float)
    element = {tuple(e): n for n, e in enumerate(PLANAR_ELEMENTS.tolist())}
    slopes = np.zeros((2, 3, 4, 12))
    A = np.zeros((4, 4))
    dA = np.zeros((12, 4, 4))
    for n, row in enumerate((0, 2)):
        on_third, on_second = element[1, 1, row], element[1, row, 1]
        slopes[1, row, 3, on_third], slopes[0, row, 3, on_second] = 1, -1
        # rows (j, k) of `planar_cameras`: a^j b4^k - a4^j b^k
        for j in range(2):
            dA[on_third, 2 * j + n, j] = 1
            dA[on_second, 2 * n + j, 2 + j] = 1
    A = np.einsum('nij,n->ij', dA, T[tuple(PLANAR_ELEMENTS.T)])
    inverse = np.linalg.pinv(A, rcond=1e-10)
    null = np.eye(4) - inverse @ A
    for i in (0, 2):
        right = T[i][np.ix_([0, 2], [0, 2])].ravel()
        column = inverse @ right
        # derivative of a pseudo-inverse of constant rank (Golub and Pereyra 1973)
        change = -inverse @ (dA @ column).T
        change += null @ (np.swapaxes(dA, 1, 2) @ (inverse.T @ column)).T
        change += inverse @ inverse.T @ (np.swapaxes(dA, 1, 2) @ (right - A @ column)).T
        for n, (j, k) in enumerate(((0, 0), (0, 2), (2, 0), (2, 2))):
            change[:, element[i, j, k]] += inverse[:, n]
        slopes[0, [0, 2], i], slopes[1, [0, 2], i] = change[:2], change[2:]
    return slopes


def cameras_in_pixels(cameras: Iterable[ArrayLike], H: ArrayLike) -> list[np.ndarray]:
    """
    Carry canonical cameras back to pixels: P = H^-1 P^, in the frame in which view 1 is [I | 0].

    Parameters
    ----------
    cameras : iterable of array_like, shape (3, 4)
    H : array_like, shape (3, 3)
        Canonical transform.

    Returns
    -------
    list of ndarray, shape (3, 4)

    """
    H = np.asarray(H)
    back = np.linalg.inv(H)
    out = []
    for P in cameras:
        pixels = back @ np.asarray(P, float)
        pixels[:, :3] = pixels[:, :3] @ H
        out.append(pixels / np.linalg.norm(pixels))
    return out
