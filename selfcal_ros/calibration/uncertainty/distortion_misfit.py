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

The field is a sum of low-degree Legendre polynomials over the image, from degree two (degrees
zero and one are the calibration matrix itself), with independent Gaussian coefficients. Their
standard deviation is the one under which the residuals are most probable (type-II maximum
likelihood; Bishop 2006, 3.5). Where the residuals show no field it comes out as zero and nothing
changes; where they do, the calibration is the mean, and its covariance that, over all fields of
the size found. One linear step at the optimum does it. Each camera of a rig has a field of its
own; all have one standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import cho_factor, cho_solve, LinAlgError

from selfcal_ros.calibration.bundle.information import HUBER_SIGMAS
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.uncertainty.cluster_covariance import (images_alike,
                                                                    region_excess)
from selfcal_ros.calibration.uncertainty.random_effects import most_probable_size
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.optimise import huber_weights

#: Degrees of the polynomials.
MIN_DEGREE, MAX_DEGREE = 2, 4
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


def displacement_modes(xy: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """
    Displacements of every coefficient at image points.

    Parameters
    ----------
    xy : ndarray, shape (N, 2)
        Pixels.
    size : (int, int)
        Width and height of the image.

    Returns
    -------
    ndarray, shape (N, 2, k)

    """
    scaled = (xy - (np.array(size) - 1) / 2) / (max(size) / 2)
    along, across = (legendre.legvander(scaled[:, axis], MAX_DEGREE) for axis in (0, 1))
    values = np.stack([along[:, i] * across[:, j]
                       for i in range(MAX_DEGREE + 1) for j in range(MAX_DEGREE + 1)
                       if MIN_DEGREE <= i + j <= MAX_DEGREE], axis=1)
    modes = np.zeros((len(xy), 2, 2 * values.shape[1]))
    modes[:, 0, :values.shape[1]] = values
    modes[:, 1, values.shape[1]:] = values
    return modes


def _modes_by_camera(xy: np.ndarray, sizes: np.ndarray, camera: np.ndarray | None) -> np.ndarray:
    """Displacements (N, 2, C k) of every coefficient of C cameras, each in its own images."""
    if camera is None:
        return displacement_modes(xy, (int(sizes[0]), int(sizes[1])))
    parts = [displacement_modes(xy, (int(width), int(height))) * (camera == k)[:, None, None]
             for k, (width, height) in enumerate(sizes)]
    return np.concatenate(parts, axis=2)


def find_distortion_misfit(fit: RobustFit, size: Sequence[int] | np.ndarray, known: float,
                           ) -> DistortionMisfit | None:
    """
    Look for a field in the residuals of an optimum.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    size : (int, int), or array of int, shape (C, 2)
        Width and height of the image, of a rig those of every camera.
    known : float
        Variance of the estimate over that with independent errors (drift within tracks).

    Returns
    -------
    DistortionMisfit or None
        None where the residuals show none.

    """
    bundle, state, linearisation = fit.bundle, fit.state, fit.linearisation
    unknowns, shared_count = bundle.unknowns, bundle.unknowns.shared.stop
    # where the points project: at the measured places the modes would carry the noise itself,
    # and one that the rest of the adjustment all but absorbs would explain the residuals by it
    sizes, camera = np.asarray(size), fit.observations.camera
    modes = _modes_by_camera(bundle.xy + linearisation.residual, sizes, camera)
    count = modes.shape[2]
    distance = np.linalg.norm(linearisation.residual, axis=1) / bundle.sigma_px
    weight = huber_weights(distance, HUBER_SIGMAS) * linearisation.ahead
    weight /= known * bundle.sigma_px**2
    root = np.sqrt(weight)[:, None]
    shared = np.concatenate([linearisation.shared, modes], axis=2)
    shared *= root[..., None]
    system = bundle.blocks.reduce(shared, linearisation.view * root[..., None],
                                  linearisation.eliminated * root[..., None],
                                  linearisation.residual * root)
    # of the adjustment's unknowns, and of the field
    place = np.r_[:shared_count, shared_count + count:len(system.matrix)]
    field = np.arange(shared_count, shared_count + count)
    bundle.add_priors(system, state, place, 1 / known)
    gauge = bundle.model.gauge(state, unknowns)
    if gauge is not None:
        system.matrix[np.ix_(place, place)] += (np.mean(system.diagonal[place])
                                                * np.outer(gauge, gauge))

    E = unknowns.selection
    matrix = E.T @ (E.T @ system.matrix[np.ix_(place, place)]).T
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    try:
        factor = cho_factor(matrix / np.outer(scale, scale))
    except (LinAlgError, ValueError):
        return None
    coupling = E.T @ system.matrix[np.ix_(place, field)] / scale[:, None]
    slope = E.T @ system.gradient[place] / scale
    solved = cho_solve(factor, coupling)
    own = system.matrix[np.ix_(field, field)] - coupling.T @ solved
    pull = system.gradient[field] - solved.T @ slope
    values, vectors = np.linalg.eigh((own + own.T) / 2)
    values = np.maximum(values, 0)
    turned = vectors.T @ pull
    size_px, gain = most_probable_size(values, turned, SIZES_PX)
    if gain < MIN_GAIN:
        return None
    posterior = size_px**2 / (1 + size_px**2 * values)
    coefficients = -vectors @ (posterior * turned)

    step = np.zeros(len(system.matrix))
    step[field] = coefficients
    step[place] = -E @ ((cho_solve(factor, slope) + solved @ coefficients) / scale)
    points = system.point_steps(step)
    chosen = unknowns.free_lens
    unit = np.zeros((len(scale), len(chosen)))
    unit[np.arange(len(chosen)), np.arange(len(chosen))] = 1 / scale[:len(chosen)]
    through = (solved[:len(chosen)] / scale[:len(chosen), None]) @ vectors
    # rows of the joint covariance of the adjustment's unknowns and the field
    rows = np.zeros((len(state.lens), len(system.matrix)))
    rows[np.ix_(chosen, place)] = (E @ ((cho_solve(factor, unit).T
                                         + (through * posterior) @ (solved @ vectors).T)
                                        / scale).T).T
    rows[np.ix_(chosen, field)] = -(through * posterior) @ vectors.T
    inner = rows[:, unknowns.lens]
    found = bundle.moved(state, step[place], points)
    if not (np.abs(found.lens.focal_lengths / state.lens.focal_lengths - 1) < MAX_SHIFT).all():
        return None
    displacement = modes @ coefficients
    change = system.predict(step, points)
    system.residual = system.residual + change
    ratio, added = region_excess(inner, system.influence(rows),
                                 *images_alike(bundle.xy, sizes, camera))
    rms_px = float(np.sqrt(np.mean(np.sum(displacement**2, 1))))
    return DistortionMisfit(size_px, rms_px, ratio, found,
                            (inner + inner.T) / 2 + added,
                            linearisation.residual + change / np.maximum(root, 1e-300), modes)
