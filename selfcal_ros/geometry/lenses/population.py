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
A prior over real lenses: which coefficients lenses that somebody built have.

Made from measured lenses of the gyroflow project (CC0) by `bench/lenses/lens_population.py`. Each
row was refitted over its own image with each member, the focal length free. The natural unit is
what a coefficient moves the image's corner, over the corner's distance, so ki is scaled by
corner^(2i). Mean and covariance of these depend on the corner.

The prior is weak on purpose. Lenses have long tails, so the covariance is broadened until 99 % of
them lie in its 99 % ellipsoid; its 60 % ellipsoid then holds more than 75 %. The table knows
nothing of decentring: the spread of p1 and p2 is stated, not measured. Nor has it lenses that
were measured with the rational model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.lenses.population_table import KNOTS, TABLE

#: Spread of p1 and p2. Ordinary lenses have 0.0003 to 0.001, bad ones up to 0.005.
TANGENTIAL_SIGMA = 0.002
#: Spread of a factor common to both polynomials of the rational model, in units of the corner;
#: it cancels, and published calibrations have it up to 5.
_COMMON_FACTOR = (2.0, 4.0, 4.0)
#: The quotient may bend more than three coefficients do.
_RATIONAL_BROADER = 3.0
_COEFFICIENTS = {
    'none': (),
    'radial1': ('k1',),
    'radial2': ('k1', 'k2'),
    'radial3': ('k1', 'k2', 'k3'),
    'plumb_bob': ('k1', 'k2', 'p1', 'p2', 'k3'),
    'rational_polynomial': ('k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'k5', 'k6'),
    'equidistant': ('k1', 'k2', 'k3', 'k4'),
}
_OTHER_NAMES = {'rational': 'rational_polynomial'}


@dataclass(frozen=True)
class Population:
    """
    What lenses of a kind are like: a joint Gaussian over some unknowns.

    Attributes
    ----------
    names : tuple of str
    mean : ndarray, shape (k,)
    information : ndarray, shape (k, k)
        Inverse of the covariance.

    """

    names: tuple[str, ...]
    mean: np.ndarray
    information: np.ndarray

    def terms(self, names: tuple[str, ...], values: np.ndarray,
              ) -> tuple[float, np.ndarray, np.ndarray]:
        """
        Return cost, gradient (n,) and matrix (n, n) over the unknowns of a lens.

        Parameters
        ----------
        names : tuple of str
            Of these unknowns.
        values : ndarray, shape (n,)

        """
        places = [names.index(name) for name in self.names]
        off = values[places] - self.mean
        gradient, matrix = np.zeros(len(values)), np.zeros((len(values), len(values)))
        gradient[places] = self.information @ off
        matrix[np.ix_(places, places)] = self.information
        return float(0.5 * off @ self.information @ off), gradient, matrix


def lens_population(model: str, corner: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the Gaussian prior of a lens model's coefficients.

    Parameters
    ----------
    model : str
        'none', 'radial1', 'radial2', 'radial3', 'plumb_bob', 'rational' or 'equidistant'.
    corner : float
        Distance of the image's corner from the principal point over the focal length: half the
        diagonal in normalised image units. Between the corners of the table everything changes
        steadily. Below them the displacement of the corner keeps its spread, above them the
        coefficients do.

    Returns
    -------
    mean : ndarray, shape (k,)
        In the model's order, as files have it: k1 k2 p1 p2 k3.
    covariance : ndarray, shape (k, k)

    Raises
    ------
    ArgumentError
        If there is no prior for such a lens.

    """
    model = _OTHER_NAMES.get(model, model)
    if model not in _COEFFICIENTS or not (np.isfinite(corner) and corner > 0):
        raise ArgumentError(f'There is no prior over lenses {model!r:.40} whose corner is at '
                            f'{corner!r} focal lengths; known are {", ".join(_COEFFICIENTS)}.')
    names = _COEFFICIENTS[model]
    radial = [k for k, name in enumerate(names) if name[0] == 'k']
    mean, covariance = np.zeros(len(names)), np.zeros((len(names), len(names)))
    tangential = [k for k, name in enumerate(names) if name[0] == 'p']
    covariance[tangential, tangential] = TANGENTIAL_SIGMA**2
    if radial:
        mean[radial], covariance[np.ix_(radial, radial)] = _radial(model, corner)
    return mean, covariance


def _radial(model: str, corner: float) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance of the radial coefficients."""
    if model == 'rational_polynomial':
        return _rational(corner)
    table = np.array(TABLE['radial3' if model == 'plumb_bob' else model])
    at = np.interp(np.log(corner), np.log(KNOTS), np.arange(len(KNOTS)))
    low = min(int(at), len(KNOTS) - 2)
    count = int(np.sqrt(2 * table.shape[1] + 2.25) - 1.5)
    factors = np.zeros((2, count, count))
    rows, columns = np.tril_indices(count)
    factors[:, rows, columns] = table[low:low + 2, count:]
    weight = np.array([low + 1 - at, at - low])
    mean = weight @ table[low:low + 2, :count]
    covariance = np.einsum('w,wij,wkj->ik', weight, factors, factors)
    scale = min(corner, KNOTS[-1])**(-2.0 * np.arange(1, count + 1))
    return mean * scale, covariance * np.outer(scale, scale)


def _rational(corner: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Build the prior of the rational model's k1, ..., k6 on that of three coefficients.

    To first order the quotient has the coefficients k1 - k4, k2 - k5, k3 - k6. They have the
    prior of 'radial3', broadened; what is common to both polynomials is nearly free.
    """
    mean, difference = _radial('radial3', corner)
    scale = min(corner, KNOTS[-1])**np.array([-2.0, -4.0, -6.0])
    common = np.diag((scale * _COMMON_FACTOR)**2)
    difference = _RATIONAL_BROADER**2 * difference
    return (np.concatenate([mean, np.zeros(3)]),
            np.block([[difference + common, common], [common, common]]))
