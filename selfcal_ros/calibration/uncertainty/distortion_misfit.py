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
A lens that is not quite what the distortion model says: a smooth field of displacements.

The field is a sum of Legendre polynomials over the image, from degree two (degrees zero and one
are the calibration matrix itself), with independent Gaussian coefficients. Their standard
deviation, and how it falls from degree to degree, are those under which the residuals are most
probable (type-II maximum likelihood; Bishop 2006, 3.5). Where the residuals show no field it
comes out as zero and nothing changes. Where they do, the calibration is the mean over all fields
of the size found, and its covariance theirs. One linear step at the optimum does it. Each camera
of a rig has a field of its own; all have one standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.uncertainty.cluster_covariance import (images_alike,
                                                                    region_excess)
from selfcal_ros.calibration.uncertainty.random_effects import most_probable_size
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.reduced_system import FurtherUnknowns

#: Degrees of the polynomials: the highest have waves of a quarter of the image.
MIN_DEGREE, MAX_DEGREE = 2, 8
#: Long recordings do with lower degrees, down to this: so many derivatives are 64 MB.
LEAST_DEGREE, MOST_DERIVATIVES = 4, 8_000_000
#: From this degree on, coefficients may fall: their standard deviation over that of the degree
#: below, as tried. A lens may lack a term of its model, which has degree two or three, or be
#: uneven everywhere.
LEVEL_DEGREE, FALLS = 3, (1.0, 0.7, 0.4, 0.2, 0.1)
#: Standard deviations of a coefficient that are tried, pixels.
SIZES_PX = 0.003 * 2.0**np.arange(9)
#: Least gain of the log evidence over no field: odds of 150 to 1.
MIN_GAIN = 5.0
#: A step that changes the focal length by more than this fraction is outside the linear range.
MAX_SHIFT = 0.1


@dataclass(frozen=True)
class DistortionMisfit:
    """
    What a field that was found changes.

    Attributes
    ----------
    size_px : float
        Standard deviation of a coefficient.
    rms_px : float
        Root mean square displacement of the most probable field at the observations.
    region_ratio : float
        Of sigmas with errors that the regions of the image still share to those without.
    state : SceneState
        The optimum with the field allowed for.
    covariance : ndarray, shape (k, k)
        Of the internal parameters.
    residual : ndarray, shape (N, 2)
        Residuals that remain beside the field, pixels.
    modes : ndarray, shape (N, 2, q)
        Displacements of the coefficients.

    """

    size_px: float
    rms_px: float
    region_ratio: float
    state: SceneState
    covariance: np.ndarray
    residual: np.ndarray
    modes: np.ndarray

    def findings(self) -> tuple[Finding, ...]:
        """Tell how far the lens is from its model, and what is shared beyond that."""
        found = Finding('lens_deviates', rms_px=float(self.rms_px))
        return (found,) if self.region_ratio <= 1 else (
            found, Finding('regions_beyond_lens', ratio=float(self.region_ratio)))


@dataclass(frozen=True)
class Supposed:
    """
    A cause that residuals may have: a few coefficients.

    Attributes
    ----------
    columns : ndarray, shape (N, 2, n)
        Derivative of every residual by each of them, pixels.
    sigma : float
        How large they may be.

    """

    columns: np.ndarray
    sigma: float


@dataclass(frozen=True)
class _Spectrum:
    """
    How large the coefficients are, and what the images know of them.

    Attributes
    ----------
    gain : float
        Of log probability over no field.
    size_px : float
        Standard deviation of a coefficient of a low degree.
    share : ndarray, shape (q,)
        That of every coefficient over it.
    values : ndarray, shape (q,)
        Information of the images about coefficients of equal standard deviation, its eigenvalues.
    vectors : ndarray, shape (q, q)
        What those are of the coefficients themselves.

    """

    gain: float
    size_px: float
    share: np.ndarray
    values: np.ndarray
    vectors: np.ndarray

    @property
    def posterior(self) -> np.ndarray:
        """Variances (q,) along the eigenvectors, with what the images tell."""
        variance: np.ndarray = self.size_px**2 / (1 + self.size_px**2 * self.values)
        return variance

    def coefficients(self, pull: np.ndarray) -> np.ndarray:
        """Return the most probable coefficients (q,), pixels, from the gradient (q,) by them."""
        found: np.ndarray = -self.vectors @ (self.posterior * (self.vectors.T @ pull))
        return found


def displacement_modes(xy: np.ndarray, size: tuple[int, int], highest: int = MAX_DEGREE,
                       ) -> np.ndarray:
    """
    Displacements of every coefficient at image points.

    Parameters
    ----------
    xy : ndarray, shape (N, 2)
        Pixels.
    size : (int, int)
        Width and height of the image.
    highest : int
        Degree.

    Returns
    -------
    ndarray, shape (N, 2, k)

    """
    scaled = (xy - (np.array(size) - 1) / 2) / (max(size) / 2)
    along, across = (legendre.legvander(scaled[:, axis], highest) for axis in (0, 1))
    values = np.stack([along[:, i] * across[:, j] for i, j in _powers(highest)], axis=1)
    modes = np.zeros((len(xy), 2, 2 * values.shape[1]))
    modes[:, 0, :values.shape[1]] = values
    modes[:, 1, values.shape[1]:] = values
    return modes


def _powers(highest: int) -> list[tuple[int, int]]:
    """Powers of both coordinates, for every polynomial."""
    return [(i, j) for i in range(highest + 1) for j in range(highest + 1)
            if MIN_DEGREE <= i + j <= highest]


def _highest_degree(observations: int, cameras: int) -> int:
    """Return the highest degree whose derivatives do not take too much memory."""
    return next((degree for degree in range(MAX_DEGREE, LEAST_DEGREE, -1)
                 if 4 * cameras * len(_powers(degree)) * observations <= MOST_DERIVATIVES),
                LEAST_DEGREE)


def _modes_by_camera(xy: np.ndarray, sizes: np.ndarray, camera: np.ndarray | None,
                     highest: int) -> np.ndarray:
    """Displacements (N, 2, C k) of every coefficient of C cameras, each in its own images."""
    if camera is None:
        return displacement_modes(xy, (int(sizes[0]), int(sizes[1])), highest)
    parts = [displacement_modes(xy, (int(width), int(height)), highest)
             * (camera == k)[:, None, None] for k, (width, height) in enumerate(sizes)]
    return np.concatenate(parts, axis=2)


def find_distortion_misfit(fit: RobustFit, size: Sequence[int] | np.ndarray,
                           variance_inflation: float, rival: Supposed | None = None,
                           ) -> DistortionMisfit | None:
    """
    Look for a field in the residuals of an optimum.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    size : (int, int), or array of int, shape (C, 2)
        Width and height of the image, of a rig those of every camera.
    variance_inflation : float
        Variance of the estimate over that with independent errors (drift within tracks).
    rival : Supposed, optional
        What may explain the residuals with fewer coefficients. Where no field is left beside it,
        there is none.

    Returns
    -------
    DistortionMisfit or None
        None where the residuals show none.

    """
    sizes = np.asarray(size)
    modes, degree = _modes_of(fit, sizes)
    columns = modes if rival is None else np.concatenate([modes, rival.columns], axis=2)
    count, at_optimum = modes.shape[2], fit.information
    beside = at_optimum.system.beside(
        columns * fit.bundle.root_weights(fit.linearisation)[:, :, None])
    solved = at_optimum.covariance @ beside.coupling / at_optimum.factor
    spread, towards = fit.bundle.loss_factors(fit.linearisation)
    # the images are worth less by what errors share, and what is known beforehand with them
    worth = 1 / (spread * variance_inflation)
    own = (beside.own - beside.coupling.T @ solved) * worth
    pull = (beside.gradient - solved.T @ at_optimum.system.gradient) * towards * worth
    if rival is not None and _most_probable(
            *_eliminated(own, pull, count, rival.sigma), degree).gain < MIN_GAIN:
        return None
    spectrum = _most_probable(own[:count, :count], pull[:count], degree)
    if spectrum.gain < MIN_GAIN:
        return None
    return _allowed_for(fit, beside.first(count), solved[:, :count], spectrum,
                        spectrum.coefficients(pull[:count]), modes, sizes, variance_inflation)


def _modes_of(fit: RobustFit, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the displacements (N, 2, q) of every coefficient, and their degrees (q,).

    They are taken where the points project. At the measured places the modes would carry the
    noise itself, and one that the adjustment all but absorbs would explain the residuals by it.
    """
    highest = _highest_degree(len(fit.bundle.xy), np.size(sizes) // 2)
    modes = _modes_by_camera(fit.bundle.xy + fit.linearisation.residual, sizes,
                             fit.observations.camera, highest)
    return modes, np.tile([i + j for i, j in _powers(highest)], np.size(sizes))


def _allowed_for(fit: RobustFit, field: FurtherUnknowns, solved: np.ndarray, spectrum: _Spectrum,
                 coefficients: np.ndarray, modes: np.ndarray, sizes: np.ndarray,
                 variance_inflation: float) -> DistortionMisfit | None:
    """
    Go to the mean over all fields of the size found.

    Parameters
    ----------
    fit : RobustFit
    field : FurtherUnknowns
        Its equations beside those of the adjustment.
    solved : ndarray, shape (n, q)
        How the adjustment's unknowns follow the coefficients, with the sign turned.
    spectrum : _Spectrum
    coefficients : ndarray, shape (q,)
        The most probable ones, pixels.
    modes : ndarray, shape (N, 2, q)
    sizes, variance_inflation
        As in `find_distortion_misfit`.

    Returns
    -------
    DistortionMisfit or None
        None where it lies beyond the linear range, or where no lens is.

    """
    bundle, state, at_optimum = fit.bundle, fit.state, fit.information
    system, factor = at_optimum.system, at_optimum.factor
    _, towards = bundle.loss_factors(fit.linearisation)
    step = (-towards / factor * (at_optimum.covariance @ system.gradient)
            - solved @ coefficients)
    points = system.point_steps(step, system.half_b + field.through @ coefficients)
    found = bundle.moved(state, step, points)
    moved = np.abs(found.lens.focal_lengths / state.lens.focal_lengths - 1)
    if not (found.lens.is_possible and (moved < MAX_SHIFT).all()):
        return None
    change = system.predict(step, points) + field.columns @ coefficients
    moved_system = replace(system, residual=system.residual + change)
    rows, of_field = _covariance_rows(fit, solved, spectrum, variance_inflation)
    inner = rows[:, bundle.unknowns.lens]
    influence = moved_system.influence(rows) + field.influence(moved_system, of_field)
    influence *= towards / (factor * variance_inflation)
    ratio, added = region_excess(inner, influence,
                                 *images_alike(bundle.xy, sizes, fit.observations.camera))
    root = bundle.root_weights(fit.linearisation)
    displacement = modes @ coefficients
    rms_px = float(np.sqrt(np.mean(np.sum(displacement**2, 1))))
    return DistortionMisfit(spectrum.size_px, rms_px, ratio, found,
                            (inner + inner.T) / 2 + added,
                            fit.linearisation.residual + change / np.maximum(root, 1e-300),
                            modes * spectrum.share)


def _covariance_rows(fit: RobustFit, solved: np.ndarray, spectrum: _Spectrum,
                     variance_inflation: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the lens's unknowns (k, n) and (k, q) of the joint covariance with the field."""
    chosen = fit.bundle.unknowns.free_lens
    through = (solved[chosen] @ spectrum.vectors) * spectrum.posterior
    rows = np.zeros((len(fit.state.lens), len(solved)))
    rows[chosen] = (variance_inflation * fit.covariance[chosen]
                    + through @ (solved @ spectrum.vectors).T)
    of_field = np.zeros((len(rows), len(spectrum.values)))
    of_field[chosen] = -through @ spectrum.vectors.T
    return rows, of_field


def _eliminated(information: np.ndarray, pull: np.ndarray, count: int, sigma: float,
                ) -> tuple[np.ndarray, np.ndarray]:
    """Eliminate all but the first unknowns, which have so large a standard deviation."""
    own = information[count:, count:] + np.eye(len(pull) - count) / sigma**2
    solved = np.linalg.solve(own, information[count:, :count])
    return (information[:count, :count] - information[:count, count:] @ solved,
            pull[:count] - solved.T @ pull[count:])


def _most_probable(information: np.ndarray, pull: np.ndarray, degree: np.ndarray) -> _Spectrum:
    """Choose how coefficients of degrees (q,) are spread, from their information and gradient."""
    found = []
    for fall in FALLS:
        share = fall**np.maximum(degree - LEVEL_DEGREE, 0.0)
        values, vectors = np.linalg.eigh((information + information.T) / 2
                                         * np.outer(share, share))
        values, vectors = np.maximum(values, 0), share[:, None] * vectors
        size_px, gain = most_probable_size(values, vectors.T @ pull, SIZES_PX)
        found.append(_Spectrum(gain, size_px, share, values, vectors))
    return max(found, key=lambda one: one.gain)
