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
Trifocal tensors, and the reduced one of planar motion with its circular points (thesis B, 5.4).

T[i, j, k] is T_i^{jk}: i of the first image (covariant), j of the second, k of the third.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.estimate import NoEstimate
from selfcal_ros.geometry.projective import (homogeneous, normalising_transform, unit)

#: Elements (i, j, k) of the tensor that planar motion leaves in the canonical frame, from 0.
PLANAR_ELEMENTS = np.array([(i, j, k) for i in (0, 2) for j in (0, 2) for k in (0, 2)]
                           + [(1, 0, 1), (1, 1, 0), (1, 1, 2), (1, 2, 1)])


@dataclass(frozen=True)
class CircularEstimate:
    """
    The circular points of one triplet on the horizon of the canonical frame.

    Attributes
    ----------
    kappa : complex
        Root with positive imaginary part; the circular points are (-kappa, 0, 1) and its
        conjugate.
    covariance : ndarray, shape (2, 2)
        Of the real and imaginary part, to first order from the spread of the linear solution.
    fourth : float
        The real root, peculiar to the triplet.
    tensor : ndarray, shape (3, 3, 3)
        Reduced tensor in the canonical frame.

    """

    kappa: complex
    covariance: np.ndarray
    fourth: float
    tensor: np.ndarray


def tensor_from_cameras(second, third) -> np.ndarray:
    """Tensor (3, 3, 3) of [I | 0] and two more cameras (3, 4) (5.19)."""
    a, b = np.asarray(second, float), np.asarray(third, float)
    return (np.einsum('ji,k->ijk', a[:, :3], b[:, 3]) - np.einsum('j,ki->ijk', a[:, 3], b[:, :3]))


def transform_tensor(T, H) -> np.ndarray:
    """Tensor after x -> H x in all three images (B.3)."""
    return np.einsum('jl,km,ni,nlm->ijk', H, H, np.linalg.inv(H), T, optimize=True)


def point_equations(first, second, third) -> np.ndarray:
    """
    Four linear equations of each point triplet (5.17).

    Parameters
    ----------
    first, second, third : array_like, shape (m, 2)

    Returns
    -------
    ndarray, shape (m, 4, 3, 3, 3)
        Coefficients of T_i^{jk}.

    """
    x = homogeneous(np.asarray(first, float))
    lines = []
    for xy in (np.asarray(second, float), np.asarray(third, float)):
        pair = np.zeros((len(xy), 2, 3))
        pair[:, 0, 0] = pair[:, 1, 1] = 1
        pair[:, :, 2] = -xy
        lines.append(pair)
    left = lines[0][:, :, None, :, None] * lines[1][:, None, :, None, :]
    return (x[:, None, :, None, None] * left.reshape(len(x), 4, 1, 3, 3))


def linear_tensor(first, second, third):
    """
    General tensor of a point triplet by linear least squares.

    Parameters
    ----------
    first, second, third : array_like, shape (m, 2)
        Pixels, m at least 7.

    Returns
    -------
    ndarray, shape (3, 3, 3), or NoEstimate
        In pixels, unit norm.

    """
    views = [np.asarray(xy, float) for xy in (first, second, third)]
    if len(views[0]) < 7:
        return NoEstimate('A trifocal tensor needs at least 7 point triplets; there are '
                          f'{len(views[0])}.', 'too_few')
    H = normalising_transform(np.vstack(views))
    views = [xy * H[0, 0] + H[:2, 2] for xy in views]
    rows = point_equations(*views).reshape(-1, 27)
    _, s, Vt = np.linalg.svd(rows, full_matrices=False)
    if s[-2] < 1e-12 * s[0]:
        return NoEstimate('The point triplets leave more than one trifocal tensor: points in '
                          'one plane, or equal views.', 'ill_conditioned')
    T = transform_tensor(Vt[-1].reshape(3, 3, 3), np.linalg.inv(H))
    return T / np.linalg.norm(T)


def transfer_point(T, first, second) -> np.ndarray:
    """
    Predict points of the third image from the first two.

    Parameters
    ----------
    T : array_like, shape (3, 3, 3)
    first, second : array_like, shape (m, 2)

    Returns
    -------
    ndarray, shape (m, 2)
        The line through each second point is the one across its epipolar line.

    """
    T = np.asarray(T, float)
    x, y = homogeneous(np.asarray(first, float)), homogeneous(np.asarray(second, float))
    # x^i T_i^{jk} = (point j) (epipole k) - (epipole j) (point k): its columns span, in the
    # second image, the epipolar line
    slices = np.einsum('mi,ijk->mjk', x, T)
    U = np.linalg.svd(slices)[0]
    epipolar = U[:, :, 2]
    across = np.stack([epipolar[:, 1], -epipolar[:, 0],
                       y[:, 1] * epipolar[:, 0] - y[:, 0] * epipolar[:, 1]], axis=-1)
    z = np.einsum('mj,mjk->mk', across, slices)
    return z[:, :2] / z[:, 2:]


def circular_cubic(T) -> np.ndarray:
    """Coefficients (..., 4) of the cubic in kappa, highest power first (5.32)."""
    a, b, c = (T[..., :, 0, 0], T[..., :, 0, 2] + T[..., :, 2, 0], T[..., :, 2, 2])
    return np.stack([c[..., 0], b[..., 0] - c[..., 2], a[..., 0] - b[..., 2], -a[..., 2]], axis=-1)


def canonical_scaling(xy) -> np.ndarray:
    """
    Affine map of the canonical frame that conditions points without leaving that frame.

    Parameters
    ----------
    xy : array_like, shape (m, 2)
        Points in the canonical frame.

    Returns
    -------
    ndarray, shape (3, 3)
        It keeps the line y = 0 and the point (0, 1, 0).

    """
    xy = np.asarray(xy, float)
    centre = xy[:, 0].mean()
    spread = np.abs(xy[:, 0] - centre).mean() or 1.0
    height = np.abs(xy[:, 1]).mean() or 1.0
    return np.array([[1 / spread, 0, -centre / spread], [0, 1 / height, 0], [0, 0, 1]])


def _reduced(rows):
    """Least singular vector of (m, 12) rows, its covariance, and the ratio of singular values."""
    _, s, Vt = np.linalg.svd(rows, full_matrices=False)
    variance = s[-1] ** 2 / max(len(rows) // 4 * 3 - 11, 1)
    spread = (Vt[:-1].T / np.maximum(s[:-1], 1e-300) ** 2) @ Vt[:-1] * variance
    return Vt[-1], spread, s


def reduced_tensor(first, second, third):
    """
    Tensor of planar motion in the canonical frame: twelve elements, linearly (B.4).

    Parameters
    ----------
    first, second, third : array_like, shape (m, 2)
        In the canonical frame; well conditioned, see `canonical_scaling`.

    Returns
    -------
    T : ndarray, shape (3, 3, 3), or NoEstimate
    covariance : ndarray, shape (12, 12)
        Of the elements of `PLANAR_ELEMENTS`, to first order; None with a NoEstimate.

    """
    if len(first) < 4:
        return NoEstimate('The reduced trifocal tensor needs at least 4 point triplets, 3 and '
                          f'one to spare; there are {len(first)}.', 'too_few'), None
    equations = point_equations(first, second, third).reshape(-1, 3, 3, 3)
    i, j, k = PLANAR_ELEMENTS.T
    values, covariance, s = _reduced(equations[:, i, j, k])
    if not s[-2] > 1e-11 * s[0]:
        return NoEstimate('The point triplets leave more than one reduced tensor: equal views '
                          'or no rotation.', 'ill_conditioned'), None
    T = np.zeros((3, 3, 3))
    T[i, j, k] = values
    return T, covariance


def circular_points(first, second, third):
    """
    Circular points of one triplet of planar motion (5.25-5.33).

    Parameters
    ----------
    first, second, third : array_like, shape (m, 2)
        In the canonical frame.

    Returns
    -------
    CircularEstimate or NoEstimate
        Three real roots make the triplet unusable.

    """
    scaling = canonical_scaling(np.vstack([first, second, third]))
    scale, shift = np.diag(scaling)[:2], scaling[:2, 2]
    T, covariance = reduced_tensor(*(np.asarray(xy) * scale + shift
                                     for xy in (first, second, third)))
    if not isinstance(T, np.ndarray):
        return T
    cubic = circular_cubic(T)
    if not abs(cubic[0]) > 1e-14:
        return NoEstimate('The cubic of the fixed lines degenerates.', 'no_triplet')
    roots = np.roots(cubic)
    top = int(np.argmax(roots.imag))
    kappa = roots[top]
    if not kappa.imag > 1e-9 * (1 + abs(kappa)):
        return NoEstimate('All three fixed lines of the triplet are real; it says nothing of '
                          'the circular points.', 'no_triplet')
    fourth = float(roots[np.argmin(np.abs(roots.imag))].real)
    # d kappa = -dP / P'(kappa), P linear in the twelve elements
    basis = np.zeros((12, 3, 3, 3))
    basis[(np.arange(12), *PLANAR_ELEMENTS.T)] = 1
    slope = -circular_cubic(basis) @ kappa ** np.arange(3, -1, -1) / np.polyval(
        np.polyder(cubic), kappa)
    slope = np.stack([slope.real, slope.imag])
    # the canonical frame's own coordinate: -kappa there is (-kappa - shift) / scale here
    stretch = 1 / scale[0]
    own = -(-kappa - shift[0]) * stretch
    back = np.linalg.inv(scaling)
    return CircularEstimate(complex(own), slope @ covariance @ slope.T * stretch ** 2,
                            float((fourth + shift[0]) * stretch), transform_tensor(T, back))


def planar_cameras(T) -> tuple[np.ndarray, np.ndarray]:
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


def cameras_in_pixels(cameras, H) -> list[np.ndarray]:
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
    back = np.linalg.inv(H)
    out = []
    for P in cameras:
        pixels = back @ np.asarray(P, float)
        pixels[:, :3] = pixels[:, :3] @ H
        out.append(pixels / np.linalg.norm(pixels))
    return out


def circular_image(kappa, H) -> np.ndarray:
    """Circular point i = H^-1 (-kappa, 0, 1) in pixels, complex, shape (3,), unit norm."""
    return unit(np.linalg.solve(np.asarray(H, complex), np.array([-kappa, 0, 1])))
