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
Motion of a rigid body between two views of a calibrated camera, from rays.

Samples of five matches are solved by Gauss-Newton steps from a small turn and a step in a random
direction, all samples at once. Few matches in a small part of the image, as of a vehicle that
crosses, leave eight-point solutions to the noise; five unknowns they determine.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.rotation import rotation_matrix

#: Matches of a sample, samples that are drawn, steps for each at most, and steps (radians) after
#: which nothing moves any more.
SAMPLE, SAMPLES, STEPS, STANDS_STILL = 5, 60, 7, 1e-10
#: A sample may not turn further than this from one view to the next (radians): a body that is
#: followed does not.
MAX_TURN = 0.8


def epipolar_angles(R: np.ndarray, t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """
    Signed angles by which matches miss the epipolar geometry of motions, first order.

    Parameters
    ----------
    R : ndarray, shape (S, 3, 3)
        Turn of the body from the first view to the second.
    t : ndarray, shape (S, 3)
        Direction of its step, unit.
    a, b : ndarray, shape (M, 3)
        Unit rays of the matches.

    Returns
    -------
    ndarray, shape (S, M)
        Radians; Sampson's distance (Hartley and Zisserman 2004, 11.9) for rays.

    """
    E = _cross(t) @ R
    Ea, Eb = E @ a.T, np.swapaxes(E, 1, 2) @ b.T
    value = (Ea * b.T).sum(axis=1)
    square = (Ea * Ea).sum(axis=1) + (Eb * Eb).sum(axis=1) - 2 * value**2
    angles: np.ndarray = value / np.sqrt(np.maximum(square, 1e-18))
    return angles


def relative_motion(a: np.ndarray, b: np.ndarray, limit: float, rng: np.random.Generator,
                    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """
    Motion of the largest part of matches that move as one rigid body.

    Parameters
    ----------
    a, b : ndarray, shape (M, 3)
        Unit rays in the first view and in the second.
    limit : float
        Largest angle of a match that agrees, radians.
    rng : numpy.random.Generator

    Returns
    -------
    R : ndarray, shape (3, 3)
    t : ndarray, shape (3,)
        Unit, x_second ~ R x_first + depth⁻¹ t.
    agree : ndarray of bool, shape (M,)
        None for fewer than six matches, or where no sample has a solution.

    """
    count = len(a)
    if count <= SAMPLE:
        return None
    chosen = np.argsort(rng.random((SAMPLES, count)), axis=1)[:, :SAMPLE]
    t = rng.standard_normal((SAMPLES, 3))
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    R, t = _steps(np.tile(np.eye(3), (SAMPLES, 1, 1)), t, a[chosen], b[chosen],
                  np.ones((SAMPLES, SAMPLE)))
    small = np.einsum('sii->s', R) > 1 + 2 * np.cos(MAX_TURN)
    angles = np.abs(epipolar_angles(R, t, a, b))
    score = np.minimum(angles / limit, 1).sum(axis=1)
    best = int(np.argmin(np.where(small & np.isfinite(score), score, np.inf)))
    if not small[best]:
        return None
    R, t, agree = R[best:best + 1], t[best:best + 1], angles[best] < limit
    for _ in range(3):
        if agree.sum() < SAMPLE:
            return None
        weight = 1 / np.sqrt(np.maximum(_spread(R, t, a, b), 1e-18)) * agree
        R, t = _steps(R, t, a[None], b[None], weight)
        agree = np.abs(epipolar_angles(R, t, a, b))[0] < limit
    return R[0], t[0], agree


def _steps(R: np.ndarray, t: np.ndarray, a: np.ndarray, b: np.ndarray, weight: np.ndarray,
           ) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Newton on turns (S, 3, 3) and directions (S, 3) for rays (S, M, 3)."""
    # each component of all rays in a row: (S, 3, M)
    a, b = (np.ascontiguousarray(np.swapaxes(rays, 1, 2)) for rays in (a, b))
    J, normal = np.empty((len(a), 5, a.shape[2])), np.empty(a.shape)
    for _ in range(STEPS):
        p = R @ a
        along, inner = (t[:, None] @ p)[:, 0], (b * p).sum(axis=1)
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            J[:, k] = b[:, k] * along - inner * t[:, k, None]
            normal[:, k] = p[:, i] * b[:, j] - p[:, j] * b[:, i]
        # two directions across t
        turn, other = _cross(t), np.eye(3)[np.argmin(np.abs(t), axis=1)]
        u = turn @ other[:, :, None]
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        basis = np.concatenate([u, turn @ u], axis=2)
        J[:, 3:] = np.swapaxes(basis, 1, 2) @ normal
        J *= weight[:, None]
        r = (t[:, None] @ normal)[:, 0] * weight
        H = J @ np.swapaxes(J, 1, 2)
        H += (1e-6 * np.einsum('sii->s', H)[:, None, None] / 5 + 1e-18) * np.eye(5)
        step = -np.linalg.solve(H, J @ r[:, :, None])[..., 0]
        # no leaps: the start is a guess
        length = np.linalg.norm(step, axis=1, keepdims=True)
        step *= np.minimum(1, 0.5 / np.maximum(length, 1e-12))
        R = rotation_matrix(step[:, :3]) @ R
        t = t + np.einsum('sij,sj->si', basis, step[:, 3:])
        t /= np.linalg.norm(t, axis=1, keepdims=True)
        if (length < STANDS_STILL).all():
            break
    return R, t


def _spread(R: np.ndarray, t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Variance of the triple product over that of a ray's angle, shape (S, M)."""
    E = _cross(t) @ R
    Ea, Eb = E @ a.T, np.swapaxes(E, 1, 2) @ b.T
    spread: np.ndarray = (Ea * Ea).sum(axis=1) + (Eb * Eb).sum(axis=1)
    return spread


def _cross(t: np.ndarray) -> np.ndarray:
    """Return the matrices [t]x (S, 3, 3) of vectors (S, 3)."""
    x, y, z = t.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
