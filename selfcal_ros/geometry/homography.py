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
"""Homography of an image pair: linear, then least squares of the transfer error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import homogeneous, normalising_transform
from selfcal_ros.geometry.robust_loss import huber_weights
from selfcal_ros.geometry.robust_scale import robust_sigma_of_lengths


@dataclass(frozen=True)
class Homography:
    """
    A homography with its covariance.

    Attributes
    ----------
    H : ndarray, shape (3, 3)
        From the first image to the second, pixels, unit norm.
    covariance : ndarray, shape (9, 9)
        Of its row-wise entries, of rank 8.
    sigma_px : float
        Robust standard deviation of an image coordinate, both images measured alike.

    """

    H: np.ndarray
    covariance: np.ndarray
    sigma_px: float


def homography(xy_a: ArrayLike, xy_b: ArrayLike, iterations: int = 8,
               huber_sigmas: float = 2.5) -> Homography | NoEstimate:
    """
    Homography between two images, gross errors weighed down.

    Parameters
    ----------
    xy_a, xy_b : array_like, shape (m, 2)
        Matches in pixels.
    iterations : int
        Gauss-Newton steps on the distance in the second image, weighed by what noise in the
        first one adds.
    huber_sigmas : float

    Returns
    -------
    Homography or NoEstimate

    """
    a, b = np.asarray(xy_a, float), np.asarray(xy_b, float)
    if len(a) < 5:
        return NoEstimate('too_few', what='homography', needed=5, items='matches', found=len(a))
    T = normalising_transform(np.vstack([a, b]))
    x, uv = homogeneous(a) @ T.T, b * T[0, 0] + T[:2, 2]
    zero = np.zeros_like(x)
    rows = np.concatenate([np.concatenate([x, zero, -uv[:, :1] * x], axis=1),
                           np.concatenate([zero, x, -uv[:, 1:] * x], axis=1)])
    _, singular, Vt = np.linalg.svd(rows, full_matrices=False)
    if not singular[7] > 1e-9 * singular[0]:
        return NoEstimate('matches_on_line')
    h = Vt[-1]
    spare = max(1 - 4 / len(x), 0.1)
    for _ in range(iterations + 1):
        residual, J, noise = _transfer(h, x, uv)
        distance = np.linalg.norm(residual / noise, axis=1)
        sigma = max(robust_sigma_of_lengths(distance) / np.sqrt(spare), 1e-12)
        weight = huber_weights(distance, huber_sigmas * sigma)
        root = np.sqrt(weight)[:, None] / noise / sigma
        basis = np.linalg.svd(h[None])[2][1:].T
        A = (J * root[..., None]).reshape(-1, 9) @ basis
        information = A.T @ A
        step = basis @ np.linalg.solve(information + 1e-14 * np.trace(information) * np.eye(8),
                                       A.T @ (residual * root).ravel())
        if not np.isfinite(step).all():
            return NoEstimate('point_at_infinity')
        h = h - step
        h /= np.linalg.norm(h)
        if np.linalg.norm(step) < 1e-10:
            break
    covariance = basis @ np.linalg.inv(information) @ basis.T
    carry = np.kron(np.linalg.inv(T), T.T)
    H = carry @ h
    norm = np.linalg.norm(H)
    H = H / norm
    carry = (np.eye(9) - np.outer(H, H)) @ carry / norm
    return Homography(H.reshape(3, 3), carry @ covariance @ carry.T, float(sigma / T[0, 0]))


def _transfer(h: np.ndarray, x: np.ndarray, uv: np.ndarray,
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Transfer error, its slopes by the entries, and its spread for unit noise (m, 1)."""
    H = h.reshape(3, 3)
    y = x @ H.T
    with np.errstate(divide='ignore', invalid='ignore'):
        image = y[:, :2] / y[:, 2:]
        by_y = np.zeros((len(x), 2, 3))
        by_y[:, 0, 0] = by_y[:, 1, 1] = 1
        by_y[:, :, 2] = -image
        by_y /= y[:, 2, None, None]
    J = (by_y[..., None] * x[:, None, None]).reshape(len(x), 2, 9)
    local = by_y @ H[:, :2]
    # noise of both images, taken as isotropic in the second
    noise = np.sqrt(1 + 0.5 * np.sum(local**2, axis=(1, 2)))
    return image - uv, J, noise[:, None]
