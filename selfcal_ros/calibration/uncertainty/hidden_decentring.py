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
A fisheye whose lens elements are decentred: what the equidistant model has no coefficients for.

Decentring moves the image by p₁, p₂ as in Brown's model (1966), here over the radius of the
equidistant image. No file of ROS has names for it beside k1 to k4, so that it is not estimated.
The images still tell its size by one step of the estimate that has it. What it would move is added
to the covariance of the camera, and stated facts are asked with it set aside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.uncertainty.distortion_misfit import Supposed
from selfcal_ros.calibration.uncertainty.random_effects import most_probable_size
from selfcal_ros.calibration.uncertainty.suppositions import (added_covariance, free_response,
                                                              joint_information, likely_size,
                                                              Supposition, Tested)
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.distributions import chi2_sf
from selfcal_ros.geometry.lenses.plumb_bob import tangential

#: Sizes of decentring, p1 and p2, that lenses may have: each is as likely beforehand.
DECENTRING = np.geomspace(2e-4, 5e-3, 9)
#: It is told of where without it the images would be an accident so rarely.
ACCIDENT = 1e-6
_DECENTRING = 'no decentring'


@dataclass(frozen=True)
class HiddenDecentring:
    """
    What decentring that the model lacks may do to a calibration.

    Attributes
    ----------
    value : ndarray, shape (n, 2)
        p1 and p2 of every fisheye as the images suggest, among lenses of the size found.
    size : ndarray, shape (n,)
        Standard deviation of either among lenses.
    is_certain : ndarray of bool, shape (n,)
        Whether the images show it beyond doubt.
    covariance : ndarray, shape (k, k)
        To add to that of the unknowns of the lens block.
    columns : ndarray, shape (N, 2, 2 n)
        Derivative of every residual by each p1 and p2, pixels.

    """

    value: np.ndarray
    size: np.ndarray
    is_certain: np.ndarray
    covariance: np.ndarray
    columns: np.ndarray

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation of each p1 and p2 among lenses, shape (2 n,)."""
        return np.repeat(self.size, 2)

    def findings(self) -> tuple[Finding, ...]:
        """Tell of the largest that is certain."""
        certain = self.value[self.is_certain]
        return ((Finding('fisheye_decentred',
                         decentring=float(np.hypot(*certain.T).max())),)
                if len(certain) else ())


@dataclass(frozen=True)
class DecentredLens:
    """
    What the lens of a fisheye would be with decentring of the likeliest size.

    Attributes
    ----------
    gain : float
        By how much the images are likelier, the log of their probability. Zero where no size in
        `DECENTRING` makes them likelier, or the model has coefficients for it.
    shift : ndarray, shape (k,)
        How the unknowns of the lens would move.
    covariance : ndarray, shape (k, k)
        Of that movement, to be added to theirs.

    """

    gain: float
    shift: np.ndarray
    covariance: np.ndarray

    @classmethod
    def none(cls, fit: RobustFit) -> DecentredLens:
        """Return that the lens stays as it is."""
        count = len(fit.lens_covariance)
        return cls(0.0, np.zeros(count), np.zeros((count, count)))


def hidden_decentring(fit: RobustFit, variance_inflation: float, field: np.ndarray | None = None,
                      field_px: float = 1.0) -> HiddenDecentring | None:
    """
    Ask the images of an optimum for decentring that their lens models lack.

    Parameters
    ----------
    fit : RobustFit
        At its optimum; of one camera or of a rig.
    variance_inflation : float
        Variance of the estimate over that with independent errors.
    field : ndarray, shape (N, 2, q), optional
        Displacements by a smooth field that the calibration allows for already.
    field_px : float
        Standard deviation of its coefficients.

    Returns
    -------
    HiddenDecentring or None
        None where the models have coefficients for it, or no lens is estimated.

    """
    possible = possible_decentring(fit)
    if possible is None:
        return None
    tested = _asked(fit, possible, variance_inflation, field, field_px)
    widest, spread = tested.with_prior(DECENTRING[-1]**2)
    lenses = [slice(k, k + 2) for k in range(0, len(tested.value), 2)]
    size = np.array([likely_decentring(widest[one], spread[one, one]) for one in lenses])
    variance = np.repeat(size, 2)**2
    return HiddenDecentring(
        tested.with_prior(variance)[0].reshape(-1, 2), size,
        np.array([_is_certain(tested.value[one], tested.covariance[one, one])
                  for one in lenses]),
        added_covariance(fit, tested, variance), possible.columns)


def decentred_lens(fit: RobustFit, variance_inflation: float) -> DecentredLens:
    """
    Return what a fisheye would be with decentring, and how much likelier that is.

    Parameters
    ----------
    fit : RobustFit
        At its optimum, of one camera.
    variance_inflation : float
        Variance of the estimate over that with independent errors.

    Returns
    -------
    DecentredLens

    """
    possible = possible_decentring(fit)
    if possible is None:
        return DecentredLens.none(fit)
    tested = _asked(fit, possible, variance_inflation)
    if not np.isfinite(tested.covariance).all():
        return DecentredLens.none(fit)
    values, vectors = np.linalg.eigh(tested.information)
    values = np.maximum(values, 0)
    size, gain = most_probable_size(values, values * (vectors.T @ tested.value), DECENTRING)
    if gain <= 0:
        return DecentredLens.none(fit)
    (found, after), response = tested.with_prior(size**2), free_response(fit, tested)
    return DecentredLens(float(gain), response @ found, response @ after @ response.T)


def _asked(fit: RobustFit, possible: Supposed, variance_inflation: float,
           field: np.ndarray | None = None, field_px: float = 1.0) -> Tested:
    """Ask the images for p1 and p2 of each lens."""
    names = ('p1', 'p2') * (possible.columns.shape[2] // 2)
    return joint_information(fit, [Supposition(_DECENTRING, names, possible.columns)],
                             variance_inflation, field, field_px).test(_DECENTRING)


def possible_decentring(fit: RobustFit) -> Supposed | None:
    """Return what decentring of the fisheyes among the cameras would do, if there are any."""
    columns = [_by_decentring(fit, lens, rows) for lens, _, rows, free in fit.lenses()
               if not lens.model.is_perspective and {'k1', 'k2'} <= free]
    return Supposed(np.concatenate(columns, axis=2), DECENTRING[-1]) if columns else None


def _is_certain(value: np.ndarray, covariance: np.ndarray) -> bool:
    """Tell whether p1 and p2 of a lens, shape (2,), are no accident."""
    if not np.isfinite(np.diag(covariance)).all():
        return False
    return bool(chi2_sf(value @ np.linalg.pinv(covariance, hermitian=True) @ value, 2)
                < ACCIDENT)


def _by_decentring(fit: RobustFit, lens: Lens, rows: np.ndarray) -> np.ndarray:
    """Differentiate the residuals by p1 and p2 of the lens that made some rows, (N, 2, 2)."""
    f, aspect, cx, cy, skew = lens.values[:5]
    at = (fit.bundle.xy + fit.linearisation.residual)[rows]
    y = (at[:, 1] - cy) / (f * aspect)
    x = (at[:, 0] - cx - skew * y) / f
    square = x * x + y * y
    columns = np.zeros((len(rows), 2, 2))
    for k, (p1, p2) in enumerate(((1.0, 0.0), (0.0, 1.0))):
        dx, dy = tangential(p1, p2, x, y, square)
        columns[rows, 0, k], columns[rows, 1, k] = f * dx + skew * dy, f * aspect * dy
    return columns


def likely_decentring(found: np.ndarray, variance: np.ndarray) -> float:
    """
    Return the sigma of p1 and p2 that their estimate suggests.

    See `likely_size`; the sizes are those of `DECENTRING`.

    Parameters
    ----------
    found : ndarray, shape (2,)
        Estimated with the largest size as prior.
    variance : ndarray, shape (2, 2)
        Of that estimate, the prior included.

    Returns
    -------
    float

    """
    values, vectors = np.linalg.eigh(variance)
    values = np.clip(values, 1e-16, 0.999 * DECENTRING[-1]**2)
    # the prior taken out again
    told = 1 / values - 1 / DECENTRING[-1]**2
    free = vectors @ ((vectors.T @ found) / (values * told))
    return likely_size(free, (vectors * told) @ vectors.T, DECENTRING)
