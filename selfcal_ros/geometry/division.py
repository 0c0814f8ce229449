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
Epipolar geometry through a distorting lens that nobody has calibrated: the division model.

A pixel is lifted to (x, y, w) with w = 1 + lambda r^2 (+ kappa r^4), r its distance from the
image centre. With the right lambda matches obey x_b' F x_a = 0 (Fitzgibbon, CVPR 2001, eq. 6).
Lifted points stay homogeneous: a ray beyond 90 degrees has w <= 0, where dividing would fail.
Epipolar lines become curves in the image; distances to them are in its pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.fundamental import general_model, general_state, general_step

#: Halvings of the step of a refinement that does not gain before it ends.
_MOST_FAILURES = 5


@dataclass(frozen=True)
class DivisionModel:
    """
    Radial lens about the image centre.

    Parameters
    ----------
    coefficients : tuple of float
        lambda, or lambda and kappa, for radii in half image diagonals. Negative for barrel
        distortion: an equidistant lens has lambda = -(0.33 to 0.40) (R / f)^2, a stereographic
        one -0.25 (R / f)^2, with R the half diagonal and f the focal length in pixels.
    image_size : (int, int)
        Width and height in pixels.

    """

    coefficients: tuple[float, ...]
    image_size: tuple[int, int]

    @property
    def straight(self) -> bool:
        """Whether straight lines stay straight."""
        return not any(self.coefficients)

    @property
    def centre(self) -> np.ndarray:
        """Middle of the image in pixels, shape (2,)."""
        middle: np.ndarray = (np.array(self.image_size, float) - 1) / 2
        return middle

    @property
    def half_diagonal_px(self) -> float:
        """Distance of a corner from the centre."""
        return float(np.hypot(*self.centre))

    @property
    def to_units(self) -> np.ndarray:
        """Similarity (3, 3) from pixels to half diagonals about the centre."""
        size, (x, y) = self.half_diagonal_px, self.centre
        return np.array([[1, 0, -x], [0, 1, -y], [0, 0, size]]) / size

    def units(self, xy: np.ndarray) -> np.ndarray:
        """Turn pixels (..., 2) into half diagonals about the centre."""
        moved: np.ndarray = (np.asarray(xy, float) - self.centre) / self.half_diagonal_px
        return moved

    def lifted(self, xy: np.ndarray) -> np.ndarray:
        """
        Lift pixels (..., 2) to straightened homogeneous points (..., 3).

        In half diagonals about the centre; any positive multiple is the same point.
        """
        return lifted(self.units(xy), np.array(self.coefficients))

    def straightened(self, xy: np.ndarray) -> np.ndarray:
        """Return where a perspective camera would see pixels (..., 2); NaN beyond 90 degrees."""
        raised = self.lifted(xy)
        ahead = np.where(raised[..., 2:] > 0, raised[..., 2:], np.nan)
        straight: np.ndarray = raised[..., :2] / ahead * self.half_diagonal_px + self.centre
        return straight

    def lifted_slope(self, xy: np.ndarray) -> np.ndarray:
        """Derivative (..., 3, 2) of lifted pixels (..., 2) by their place in half diagonals."""
        place = self.units(xy)
        slope = np.zeros((*place.shape[:-1], 3, 2))
        slope[..., 0, 0] = slope[..., 1, 1] = 1
        slope[..., 2, :] = bend(place, np.array(self.coefficients))
        return slope

    def sampson_distance(self, F: np.ndarray, xy_a: np.ndarray, xy_b: np.ndarray) -> np.ndarray:
        """
        Signed first-order distance of matches to their epipolar curves.

        Parameters
        ----------
        F : ndarray, shape (3, 3)
            For lifted points: x_b' F x_a = 0.
        xy_a, xy_b : ndarray, shape (m, 2)
            Pixels.

        Returns
        -------
        ndarray, shape (m,)
            Pixels of the image, not of a straightened one.

        """
        distance, *_ = residuals(self.units(xy_a)[None], self.units(xy_b)[None], F[None],
                                 np.array(self.coefficients))
        in_pixels: np.ndarray = distance[0] * self.half_diagonal_px
        return in_pixels

    def raised(self, xy: np.ndarray) -> np.ndarray:
        """Return lifted pixels (..., 2) and the slopes of their last coordinate, (5, ...)."""
        place, coefficients = self.units(xy), np.array(self.coefficients)
        both = np.concatenate([lifted(place, coefficients), bend(place, coefficients)], axis=-1)
        return np.ascontiguousarray(np.moveaxis(both, -1, 0))

    def curve_distance(self, line: np.ndarray, raised: np.ndarray) -> np.ndarray:
        """
        Signed first-order distance of pixels to epipolar curves, pixels (m,).

        Parameters
        ----------
        line : ndarray, shape (m, 3)
            Of lifted points: F x of the partners.
        raised : ndarray, shape (5, m)
            The pixels, as `raised` returns them.

        """
        l0, l1, l2 = np.moveaxis(line, -1, 0)
        product = l0 * raised[0] + l1 * raised[1] + l2 * raised[2]
        with np.errstate(divide='ignore', invalid='ignore'):
            distance = product / np.sqrt((l0 + l2 * raised[3])**2 + (l1 + l2 * raised[4])**2)
        in_pixels: np.ndarray = distance * self.half_diagonal_px
        return in_pixels

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """
        Find the pixels (..., 2) that are lifted to points (..., 3), NaN where there is none.

        With r / w(r) = rho / W a quadratic for lambda alone; kappa follows by Newton steps.
        """
        points = np.asarray(points, float)
        rho, w = np.hypot(points[..., 0], points[..., 1]), points[..., 2]
        division = self.coefficients[0] if self.coefficients else 0.0
        with np.errstate(divide='ignore', invalid='ignore'):
            radius = 2 * rho / (w + np.sqrt(w ** 2 - 4 * division * rho ** 2))
            if len(self.coefficients) > 1:
                kappa = self.coefficients[1]
                for _ in range(8):
                    s = radius ** 2
                    miss = radius * w - rho * (1 + s * (division + s * kappa))
                    slope = w - 2 * rho * radius * (division + 2 * s * kappa)
                    change = miss / slope
                    radius = radius - change
                    # NaN, where there is no pixel, stays NaN
                    if not np.any(np.abs(change) > 1e-15 * radius):
                        break
            radius = np.where(radius >= 0, radius, np.nan)
            scale = np.where(rho > 0, radius / rho, np.where(w > 0, 1.0, np.nan))
        place = points[..., :2] * scale[..., None]
        pixels: np.ndarray = self.centre + self.half_diagonal_px * place
        return pixels


def lifted(xy: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Lift places (..., 2), in units of the radii of the coefficients (p,), to (..., 3)."""
    square = _dot(xy, xy)
    points = np.empty((*xy.shape[:-1], 3))
    points[..., :2] = xy
    w = np.zeros_like(square)
    for value in coefficients[::-1]:
        w = (w + value) * square
    points[..., 2] = 1 + w
    return points


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of (..., k) with (..., k), summed: several times faster than by sum()."""
    product: np.ndarray = np.einsum('...i,...i->...', a, b)
    return product


def bend(xy: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Derivative (..., 2) of w by the place."""
    square = _dot(xy, xy)
    slope = np.zeros_like(square)
    for power in range(len(coefficients), 0, -1):
        slope = slope * square + 2 * power * coefficients[power - 1]
    bend: np.ndarray = slope[..., None] * xy
    return bend


def residuals(xy_a: np.ndarray, xy_b: np.ndarray, F: np.ndarray, coefficients: np.ndarray,
              derivative: bool = False) -> tuple[np.ndarray, ...]:
    """
    Sampson distances to epipolar curves of n pairs, and if asked their derivatives.

    Parameters
    ----------
    xy_a, xy_b : ndarray, shape (n, m, 2)
        In units of the radii of the coefficients.
    F : ndarray, shape (n, 3, 3)
    coefficients : ndarray, shape (p,)
    derivative : bool

    Returns
    -------
    distance : ndarray, shape (n, m)
    by_F : ndarray, shape (n, m, 9)
        Only with `derivative`, like the next.
    by_coefficient : ndarray, shape (n, m, p)

    """
    a, b = lifted(xy_a, coefficients), lifted(xy_b, coefficients)
    bend_a, bend_b = bend(xy_a, coefficients), bend(xy_b, coefficients)
    line_b, line_a = a @ np.swapaxes(F, 1, 2), b @ F
    slope_a = line_a[..., :2] + line_a[..., 2:] * bend_a
    slope_b = line_b[..., :2] + line_b[..., 2:] * bend_b
    product = _dot(line_b, b)
    norm = np.sqrt(_dot(slope_a, slope_a) + _dot(slope_b, slope_b)) + 1e-300
    distance = product / norm
    if not derivative:
        return (distance,)
    # gradient of half the squared norm by the line of either side
    share_a = np.concatenate([slope_a, _dot(slope_a, bend_a)[..., None]], axis=-1)
    share_b = np.concatenate([slope_b, _dot(slope_b, bend_b)[..., None]], axis=-1)
    shrink = distance / norm ** 2
    by_F = np.einsum('...i,...j->...ij', b, a / norm[..., None] - shrink[..., None] * share_a)
    by_F -= np.einsum('...i,...j->...ij', shrink[..., None] * share_b, a)
    square_a, square_b = _dot(xy_a, xy_a), _dot(xy_b, xy_b)
    by_coefficient = np.empty((*distance.shape, len(coefficients)))
    for k in range(len(coefficients)):
        w_a, w_b = square_a ** (k + 1), square_b ** (k + 1)
        turn_a = 2 * (k + 1) * square_a ** k * line_a[..., 2] * _dot(slope_a, xy_a)
        turn_b = 2 * (k + 1) * square_b ** k * line_b[..., 2] * _dot(slope_b, xy_b)
        turn_a += w_b * _dot(share_a, F[:, None, 2, :])
        turn_b += w_a * _dot(share_b, F[:, None, :, 2])
        by_coefficient[..., k] = ((line_a[..., 2] * w_a + line_b[..., 2] * w_b) / norm
                                  - shrink * (turn_a + turn_b))
    return distance, by_F.reshape(*distance.shape, 9), by_coefficient


def weighted_eight_point(xy_a: np.ndarray, xy_b: np.ndarray, weight: np.ndarray,
                         coefficients: np.ndarray, F: np.ndarray | None = None,
                         iterations: int = 3) -> np.ndarray:
    """
    Linear F of every pair, rows divided by the slope that makes them distances in the image.

    Parameters
    ----------
    xy_a, xy_b : ndarray, shape (n, m, 2)
    weight : ndarray, shape (n, m)
        Zero leaves a match out; at least eight others are needed.
    coefficients : ndarray, shape (p,)
    F : ndarray, shape (n, 3, 3), optional
        Where to begin.
    iterations : int
        Times that the slopes are taken anew.

    Returns
    -------
    ndarray, shape (n, 3, 3)
        Of rank 2 and unit norm.

    """
    a, b = lifted(xy_a, coefficients), lifted(xy_b, coefficients)
    bend_a, bend_b = bend(xy_a, coefficients), bend(xy_b, coefficients)
    rows = (b[..., :, None] * a[..., None, :]).reshape(*weight.shape, 9)
    scale = weight
    for turn in range(iterations):
        if F is not None:
            line_b, line_a = a @ np.swapaxes(F, 1, 2), b @ F
            slope_a = line_a[..., :2] + line_a[..., 2:] * bend_a
            slope_b = line_b[..., :2] + line_b[..., 2:] * bend_b
            norm = np.sqrt(_dot(slope_a, slope_a) + _dot(slope_b, slope_b))
            # next to an epipole the slope vanishes
            usual = np.median(norm, axis=1, keepdims=True)
            scale = weight / np.maximum(norm, 0.05 * usual + 1e-300)
        scaled = rows * scale[..., None]
        moment = np.swapaxes(scaled, 1, 2) @ scaled
        full = np.linalg.eigh(moment)[1][..., 0].reshape(-1, 3, 3)
        U, s, Vt = np.linalg.svd(full)
        s[:, 2] = 0
        F = (U * s[:, None, :]) @ Vt
        F = F / np.linalg.norm(F, axis=(1, 2), keepdims=True)
    assert F is not None
    return F


@dataclass(frozen=True)
class DivisionFit:
    """
    Least squares over all pairs.

    Attributes
    ----------
    F : ndarray, shape (n, 3, 3)
        For lifted points.
    coefficients : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
        Of the coefficients, for matches of unit variance; infinite where they are not
        determined.
    cost : float
        Weighted sum of squared distances, units of the radii.

    """

    F: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    cost: float


def refine_division(xy_a: np.ndarray, xy_b: np.ndarray, weight: np.ndarray, F: np.ndarray,
                    coefficients: np.ndarray, held: bool = False, iterations: int = 12,
                    tolerance: float = 1e-6) -> DivisionFit:
    """
    Refine all F and the coefficients that they share (Levenberg-Marquardt).

    Each F is eliminated: the equations of the coefficients are its Schur complement.

    Parameters
    ----------
    xy_a, xy_b : ndarray, shape (n, m, 2)
        In units of the radii of the coefficients.
    weight : ndarray, shape (n, m)
        Zero leaves a match out.
    F : ndarray, shape (n, 3, 3)
    coefficients : ndarray, shape (p,)
    held : bool
        Keep the coefficients.
    iterations : int
    tolerance : float
        Ends when a step lowers the cost by a smaller share.

    Returns
    -------
    DivisionFit

    """
    state: tuple[np.ndarray, ...] = general_state(F)
    shared, root = np.array(coefficients, float), np.sqrt(weight)
    here = _equations(xy_a, xy_b, root, state, shared)
    damping, failures = 1e-7, 0
    for _ in range(iterations):
        step, move = here.step(damping, held)
        trial = general_step(state, step)
        new = _equations(xy_a, xy_b, root, trial, shared + move)
        if new.cost < here.cost:
            gain, failures = here.cost - new.cost, 0
            state, shared, damping, here = trial, shared + move, 0.1 * damping, new
            if gain <= tolerance * here.cost:
                break
        else:
            failures, damping = failures + 1, max(10 * damping, 1e-3)
            if failures > _MOST_FAILURES:
                break
    return DivisionFit(general_model(state)[0], shared, here.covariance(), here.cost)


@dataclass(frozen=True)
class _Equations:
    """Normal equations: A, g of each F; C, h of what they share; B between them."""

    cost: float
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    g: np.ndarray
    h: np.ndarray

    def _solved(self, right: np.ndarray, damping: float) -> np.ndarray:
        size = np.einsum('npp->np', self.A)
        size = np.maximum(size, 1e-12 * size.max(axis=1, keepdims=True) + 1e-300)
        solved: np.ndarray = np.linalg.solve(
            self.A + (damping * size)[..., None] * np.eye(7), right)
        return solved

    def step(self, damping: float, held: bool) -> tuple[np.ndarray, np.ndarray]:
        """Changes of every F (n, 7) and of the coefficients (p,)."""
        solved = self._solved(np.concatenate([self.B, self.g[..., None]], axis=2), damping)
        X, y = solved[..., :-1], solved[..., -1]
        move = np.zeros(len(self.C))
        if not held:
            S = self.C - np.einsum('npi,npj->ij', self.B, X)
            S += damping * np.diag(np.diag(S)) + 1e-300 * np.eye(len(S))
            move = -np.linalg.solve(S, self.h - np.einsum('npi,np->i', self.B, y))
        return -(y + X @ move), move

    def covariance(self) -> np.ndarray:
        """Inverse (p, p) of the Schur complement; infinite where it is singular."""
        S = self.C - np.einsum('npi,npj->ij', self.B, self._solved(self.B, 1e-12))
        value, vector = np.linalg.eigh(S)
        if (value <= 1e-10 * np.trace(self.C)).any():
            return np.diag(np.full(len(S), np.inf))
        covariance: np.ndarray = (vector / value) @ vector.T
        return covariance


def _equations(xy_a: np.ndarray, xy_b: np.ndarray, root: np.ndarray,
               state: tuple[np.ndarray, ...], shared: np.ndarray) -> _Equations:
    """Linearise all pairs; root (n, m) is the square root of the weight."""
    F, dF = general_model(state)
    r, by_F, by_shared = residuals(xy_a, xy_b, F, shared, derivative=True)
    r, J, K = r * root, (by_F * root[..., None]) @ dF, by_shared * root[..., None]
    Jt = np.swapaxes(J, 1, 2)
    return _Equations(float((r * r).sum()), Jt @ J, Jt @ K, np.einsum('nmp,nmq->pq', K, K),
                      (Jt @ r[..., None])[..., 0], np.einsum('nmp,nm->p', K, r))
