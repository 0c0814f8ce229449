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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import (homogeneous, normalising_transform,
                                             unit_covariance)
from selfcal_ros.geometry.propagation import null_influence

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
        Of the real and imaginary part, l and v held; first order.
    fourth : float
        The real root, peculiar to the triplet.
    tensor : ndarray, shape (3, 3, 3)
        Reduced tensor in the canonical frame.
    influence : ndarray, shape (3, m, 2, 2)
        Change of (real, imaginary) part, the last axis, with the canonical coordinates of
        every point in every view.
    noise_px : float
        Standard deviation of an image coordinate as estimated from this triplet.

    """

    kappa: complex
    covariance: np.ndarray
    fourth: float
    tensor: np.ndarray
    influence: np.ndarray
    noise_px: float


@dataclass(frozen=True)
class ReducedTensor:
    """
    The twelve elements that planar motion leaves in the canonical frame.

    Attributes
    ----------
    T : ndarray, shape (3, 3, 3)
        |T| = 1 over `PLANAR_ELEMENTS`.
    influence : ndarray, shape (3, m, 2, 12)
        Change of `PLANAR_ELEMENTS` with the coordinates of every point in every view.
    noise : float
        Estimated standard deviation of the coordinates, in units of `spreads`.
    covariance : ndarray, shape (12, 12)

    """

    T: np.ndarray
    influence: np.ndarray
    noise: float
    covariance: np.ndarray


def transform_tensor(T: np.ndarray, H: np.ndarray) -> np.ndarray:
    """Tensor after x -> H x in all three images (B.3)."""
    moved: np.ndarray = np.einsum('jl,km,ni,nlm->ijk', H, H, np.linalg.inv(H), T, optimize=True)
    return moved


def point_equations(first: ArrayLike, second: ArrayLike, third: ArrayLike) -> np.ndarray:
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
    equations: np.ndarray = x[:, None, :, None, None] * left.reshape(len(x), 4, 1, 3, 3)
    return equations


def equation_slopes(T: np.ndarray, first: ArrayLike, second: ArrayLike, third: ArrayLike,
                    ) -> np.ndarray:
    """
    Derivative of the point equations times a tensor by the points.

    Parameters
    ----------
    T : ndarray, shape (3, 3, 3)
    first, second, third : array_like, shape (m, 2)

    Returns
    -------
    ndarray, shape (m, 4, 3, 2)
        Equations by view and coordinate.

    """
    x, y, z = (homogeneous(np.asarray(xy, float)) for xy in (first, second, third))
    slices = np.einsum('mi,ijk->mjk', x, T)
    # equation (a, b): l' = e_a - y_a e_3, l'' = e_b - z_b e_3
    left = T[:, None, :2] - y[:, :2, None] * T[:, None, 2:]          # (3, m, 2, 3)
    both = left[..., :2] - left[..., 2:] * z[:, None, :2]            # (3, m, 2, 2)
    slopes = np.zeros((len(x), 2, 2, 3, 2))
    slopes[:, :, :, 0, :] = np.moveaxis(both[:2], 0, -1)
    at_second = -(slices[:, 2, :2] - slices[:, 2, 2:] * z[:, :2])     # (m, b)
    at_third = -(slices[:, :2, 2] - y[:, :2] * slices[:, 2:, 2])     # (m, a)
    for a in range(2):
        slopes[:, a, :, 1, a] = at_second
        slopes[:, :, a, 2, a] = at_third
    return slopes.reshape(len(x), 4, 3, 2)


def _propagated(rows: np.ndarray, values: np.ndarray, T: np.ndarray, views: Sequence[ArrayLike],
                spreads: np.ndarray | None) -> tuple[np.ndarray, float, np.ndarray]:
    """Influence (3, m, 2, k) of a least squares tensor, its noise, and its covariance."""
    by_point = equation_slopes(T, *views)
    if spreads is not None:
        by_point = np.einsum('mevc,vmcd->mevd', by_point, spreads, optimize=True)
    count = len(by_point)
    influence, expected = null_influence(rows, by_point.reshape(count, 4, 6))
    square = float(((rows @ values) ** 2).sum())
    noise = np.sqrt(square / expected) if expected > 0 else 0.0
    flat = influence.reshape(-1, influence.shape[-1])
    covariance = noise ** 2 * flat.T @ flat
    influence = np.moveaxis(influence.reshape(count, 3, 2, -1), 0, 1)
    if spreads is not None:
        influence = np.linalg.solve(np.swapaxes(spreads, 2, 3), influence)
    return influence, float(noise), covariance


def linear_tensor_estimate(first: ArrayLike, second: ArrayLike, third: ArrayLike,
                           ) -> tuple[np.ndarray, np.ndarray, float] | NoEstimate:
    """
    General tensor of point triplets, by linear least squares, and its covariance (5.17).

    Parameters
    ----------
    first, second, third : array_like, shape (m, 2)
        Pixels, m at least 7.

    Returns
    -------
    T : ndarray, shape (3, 3, 3)
        In pixels, unit norm.
    covariance : ndarray, shape (27, 27)
        Of its elements in C order, first order.
    noise_px : float
        Standard deviation of an image coordinate; 0 where no equation is to spare.

    """
    views = [np.asarray(xy, float) for xy in (first, second, third)]
    if len(views[0]) < 7:
        return NoEstimate('too_few', what='trifocal tensor', needed=7, items='point triplets',
                          found=len(views[0]))
    H = normalising_transform(np.vstack(views))
    views = [xy * H[0, 0] + H[:2, 2] for xy in views]
    rows = point_equations(*views).reshape(-1, 4, 27)
    _, s, Vt = np.linalg.svd(rows.reshape(-1, 27), full_matrices=False)
    if s[-2] < 1e-12 * s[0]:
        return NoEstimate('tensor_open')
    own = Vt[-1].reshape(3, 3, 3)
    _, noise, covariance = _propagated(rows, Vt[-1], own, views, None)
    back = np.linalg.inv(H)
    # the transform of a tensor is linear in it
    carry = np.einsum('jl,km,ni->ijknlm', back, back, H).reshape(27, 27)
    T, covariance = unit_covariance(carry @ Vt[-1], carry @ covariance @ carry.T)
    return T.reshape(3, 3, 3), covariance, noise / H[0, 0]


def circular_cubic(T: np.ndarray) -> np.ndarray:
    """Coefficients (..., 4) of the cubic in kappa, highest power first (5.32)."""
    a, b, c = (T[..., :, 0, 0], T[..., :, 0, 2] + T[..., :, 2, 0], T[..., :, 2, 2])
    return np.stack([c[..., 0], b[..., 0] - c[..., 2], a[..., 0] - b[..., 2], -a[..., 2]], axis=-1)


def canonical_scaling(xy: ArrayLike) -> np.ndarray:
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


def reduced_tensor(first: ArrayLike, second: ArrayLike, third: ArrayLike,
                   spreads: np.ndarray | None = None) -> ReducedTensor | NoEstimate:
    """
    Tensor of planar motion in the canonical frame: twelve elements, linearly (B.4).

    Parameters
    ----------
    first, second, third : array_like, shape (m, 2)
        In the canonical frame; well conditioned, see `canonical_scaling`.
    spreads : ndarray, shape (3, m, 2, 2), optional
        Derivative of these coordinates by the noisy ones, as by pixels: noise that is equal
        there is neither equal nor isotropic here (thesis 6.3.1). Without it the noise counts
        as equal here.

    Returns
    -------
    ReducedTensor or NoEstimate

    """
    count = len(np.asarray(first))
    if count < 4:
        return NoEstimate('too_few', what='reduced trifocal tensor', needed=4,
                          items='point triplets, one to spare', found=count)
    equations = point_equations(first, second, third)
    i, j, k = PLANAR_ELEMENTS.T
    rows = equations[..., i, j, k]
    _, s, Vt = np.linalg.svd(rows.reshape(-1, 12), full_matrices=False)
    if not s[-2] > 1e-11 * s[0]:
        return NoEstimate('reduced_tensor_open')
    T = np.zeros((3, 3, 3))
    T[i, j, k] = Vt[-1]
    return ReducedTensor(T, *_propagated(rows, Vt[-1], T, (first, second, third), spreads))


def circular_points(first: ArrayLike, second: ArrayLike, third: ArrayLike,
                    spreads: np.ndarray | None = None) -> CircularEstimate | NoEstimate:
    """
    Circular points of one triplet of planar motion (5.25-5.33).

    Parameters
    ----------
    first, second, third : array_like, shape (m, 2)
        In the canonical frame.
    spreads : ndarray, shape (3, m, 2, 2), optional
        Derivative of these coordinates by pixels; without it the noise counts as equal in the
        canonical frame.

    Returns
    -------
    CircularEstimate or NoEstimate
        Three real roots make the triplet unusable.

    """
    scaling = canonical_scaling(np.vstack([first, second, third]))
    scale, shift = np.diag(scaling)[:2], scaling[:2, 2]
    if spreads is not None:
        spreads = scale[:, None] * spreads
    a, b, c = (np.asarray(xy) * scale + shift for xy in (first, second, third))
    reduced = reduced_tensor(a, b, c, spreads)
    if isinstance(reduced, NoEstimate):
        return reduced
    cubic = circular_cubic(reduced.T)
    if not abs(cubic[0]) > 1e-14:
        return NoEstimate('cubic_degenerate')
    roots = np.roots(cubic)
    top = int(np.argmax(roots.imag))
    kappa = roots[top]
    if not kappa.imag > 1e-9 * (1 + abs(kappa)):
        return NoEstimate('fixed_lines_real')
    fourth = float(roots[np.argmin(np.abs(roots.imag))].real)
    # d kappa = -dP / P'(kappa), P linear in the twelve elements
    basis = np.zeros((12, 3, 3, 3))
    basis[(np.arange(12), *PLANAR_ELEMENTS.T)] = 1
    slope = -circular_cubic(basis) @ kappa ** np.arange(3, -1, -1) / np.polyval(
        np.polyder(cubic), kappa)
    # the canonical frame's own coordinate: -kappa there is (-kappa - shift) / scale here
    slope = np.stack([slope.real, slope.imag]) / scale[0]
    own = -(-kappa - shift[0]) / scale[0]
    influence = (reduced.influence * scale[:, None]) @ slope.T
    return CircularEstimate(complex(own), slope @ reduced.covariance @ slope.T,
                            float((fourth + shift[0]) / scale[0]),
                            transform_tensor(reduced.T, np.linalg.inv(scaling)), influence,
                            reduced.noise)
