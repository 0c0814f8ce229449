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
One estimate from many: calibrations of one camera, weighted by their information.

Each calibration i says N(x_i, C_i) of the same parameters x. Facts with a spread are in every one
of them, though they are only known once; so the information of the facts is taken out of each,
and put back once:

    D_i = C_i⁻¹ - P,   (Σ D_i + P) x = Σ (C_i⁻¹ x_i - P x_P) + P x_P.

The sum of the squared deviations, each in its own D_i, is chi-square distributed if the camera
stayed the same and the covariances are right: that is tested, as is each calibration against all
others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens, MATRIX_NAMES, to_intrinsics, to_parameters
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.observability import parameter_status
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.distributions import chi2_sf

#: A p-value below this is no accident.
SURE = 0.001
#: Scatter beyond the covariances by less than this widens sigma and is no disagreement: first
#: order covariances are not truer than that.
NEARLY = 1.25
#: At most this share of the calibrations may be left out as contradicting the rest.
MAX_LEFT_OUT = 0.25


@dataclass(frozen=True)
class JointCalibration:
    """
    The joint estimate, and whether its parts agree.

    Attributes
    ----------
    calibration : Calibration
        Without reconstruction; its covariance is widened by `scatter` where that exceeds 1.
    used : ndarray of bool, shape (N,)
        Which calibrations are in it.
    deviation : ndarray, shape (N,)
        Distance of each calibration from all others that are used, in sigmas: the root of
        chi-square over its degrees of freedom. NaN for a single one.
    chi2 : float
    freedom : int
    p_value : float
        Of the calibrations that are used; 1 for a single one.
    scatter : float
        Root of chi-square over its degrees of freedom.

    """

    calibration: Calibration
    used: np.ndarray
    deviation: np.ndarray
    chi2: float
    freedom: int
    p_value: float

    @property
    def scatter(self) -> float:
        """How many times larger the spread is than the covariances say."""
        return float(np.sqrt(self.chi2 / self.freedom)) if self.freedom else 1.0

    @property
    def agree(self) -> bool:
        """Tell whether all calibrations, those left out too, are of one camera."""
        return bool(self.used.all() and (self.p_value >= SURE or self.scatter < NEARLY))


@dataclass(frozen=True)
class _Share:
    """Information of one calibration without the facts: D and D y."""

    D: np.ndarray
    b: np.ndarray

    def deviation(self, x: np.ndarray) -> float:
        """Chi-square of the data alone at x."""
        d = np.linalg.pinv(self.D, hermitian=True) @ self.b - x
        return float(d @ self.D @ d)

    @property
    def rank(self) -> int:
        """Number of directions that the data determine."""
        return int(np.linalg.matrix_rank(self.D, hermitian=True))


def combine(calibrations: list[Calibration]) -> JointCalibration:
    """
    Combine calibrations of one camera.

    Parameters
    ----------
    calibrations : list of Calibration
        From different data, of one image size, under the same facts, distortion model included.

    Returns
    -------
    JointCalibration

    Raises
    ------
    InputError
        If there is none, or sizes or facts differ.

    """
    if not calibrations:
        raise InputError('There is no calibration to combine.')
    first = calibrations[0]
    if any(one.facts != first.facts or (one.camera.width, one.camera.height)
           != (first.camera.width, first.camera.height) for one in calibrations):
        raise InputError('Calibrations of different image sizes or facts cannot be combined.')
    priors = priors_from_facts(first.facts)
    lens = Lens.of(first.camera)
    names = [name for name in lens.names if name not in priors or priors[name].sigma > 0]
    free = lens.places(names)
    # in units in which every parameter has a size of about one
    pixels = set(MATRIX_NAMES) - {'aspect'}
    unit = np.array([first.camera.K[0, 0] if name in pixels else 1.0 for name in names])
    value, weight = np.zeros(len(free)), np.zeros(len(free))
    for place, name in enumerate(names):
        if name in priors:
            value[place] = priors[name].value / unit[place]
            weight[place] = (unit[place] / priors[name].sigma)**2
    stated = np.diag(weight)
    # what lenses are like counts in every one of them, and once in all
    supposed = [_supposed(one, names, unit, stated, value) for one in calibrations]
    P, value = supposed[0]
    shares = [_share(one, free, unit, *own) for one, own in zip(calibrations, supposed)]
    used = np.ones(len(shares), bool)
    while True:
        x, information, total, freedom = _solve(shares, used, P, value)
        deviation, doubt = _against_others(shares, used, P, value)
        scatter = np.sqrt(total / freedom) if freedom else 1.0
        worst = int(np.argmin(np.where(used, doubt, np.inf)))
        alone = used.sum() <= 2 or (~used).sum() + 1 > MAX_LEFT_OUT * len(used)
        if scatter < NEARLY or alone or doubt[worst] * len(used) > SURE:
            break
        used[worst] = False
    inner = np.zeros((len(lens),) * 2)
    covariance = np.linalg.inv(information) * max(scatter, 1.0)**2
    inner[np.ix_(free, free)] = covariance * np.outer(unit, unit)
    lens = lens.with_values(dict(zip(names, x * unit)))
    found = _calibration([one for one, use in zip(calibrations, used) if use],
                         lens.camera(first.camera.width, first.camera.height),
                         to_parameters(inner, lens))
    p_value = float(chi2_sf(total, freedom)) if freedom else 1.0
    return JointCalibration(found, used, deviation, total, freedom, p_value)


def _supposed(one: Calibration, names: list[str], unit: np.ndarray, stated: np.ndarray,
              value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information and values of the facts and of what lenses are like, in the units at hand."""
    population = one.population
    if population is None:
        return stated, value
    known = [k for k, name in enumerate(population.names) if name in names]
    places = [names.index(population.names[k]) for k in known]
    P, at = stated.copy(), value.copy()
    P[np.ix_(places, places)] += (population.information[np.ix_(known, known)]
                                  * np.outer(unit[places], unit[places]))
    at[places] = population.mean[known] / unit[places]
    return P, at


def _share(one: Calibration, free: np.ndarray, unit: np.ndarray, P: np.ndarray, value: np.ndarray,
           ) -> _Share:
    """Take the facts out of a calibration."""
    lens = Lens.of(one.camera)
    C = to_intrinsics(np.asarray(one.covariance, float), lens)[np.ix_(free, free)]
    C = C / np.outer(unit, unit)
    x = lens.values[free] / unit
    information = np.linalg.pinv((C + C.T) / 2, hermitian=True, rcond=1e-14)
    # rounding, and covariances that were widened, leave directions less than the facts alone
    values, vectors = np.linalg.eigh(information - P)
    kept = vectors[:, values > 1e-9 * max(values.max(), 0.0)]
    project = kept @ kept.T
    D = project @ (information - P) @ project
    return _Share(D, D @ x + project @ P @ (x - value))


def _solve(shares: Sequence[_Share], used: np.ndarray, P: np.ndarray, value: np.ndarray,
           ) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Return the joint estimate, its information, chi-square and degrees of freedom."""
    chosen = [share for share, use in zip(shares, used) if use]
    information = sum((share.D for share in chosen), P)
    x = np.linalg.solve(information, sum((share.b for share in chosen), P @ value))
    facts = float((value - x) @ P @ (value - x))
    total = sum(share.deviation(x) for share in chosen) + facts
    freedom = sum(share.rank for share in chosen) + int(np.count_nonzero(np.diag(P))) - len(x)
    return x, information, total, max(freedom, 0)


def _against_others(shares: Sequence[_Share], used: np.ndarray, P: np.ndarray, value: np.ndarray,
                    ) -> tuple[np.ndarray, np.ndarray]:
    """Test each calibration against those of the others that are used."""
    deviation, doubt = np.full(len(shares), np.nan), np.ones(len(shares))
    information = sum((share.D for share, use in zip(shares, used) if use), P)
    b = sum((share.b for share, use in zip(shares, used) if use), P @ value)
    for k, share in enumerate(shares):
        if used.sum() - used[k] < 1:
            continue
        rest, right = (information - share.D, b - share.b) if used[k] else (information, b)
        spread = np.linalg.pinv(share.D, hermitian=True) + np.linalg.pinv(rest, hermitian=True)
        d = (np.linalg.pinv(share.D, hermitian=True) @ share.b
             - np.linalg.pinv(rest, hermitian=True) @ right)
        total, freedom = float(d @ np.linalg.solve(spread, d)), max(share.rank, 1)
        deviation[k] = np.sqrt(total / freedom)
        doubt[k] = chi2_sf(total, freedom)
    return deviation, doubt


def _calibration(used: list[Calibration], camera: Camera, covariance: np.ndarray) -> Calibration:
    """Describe the joint estimate as a calibration."""
    observations = sum(one.observation_count for one in used)
    square = sum(one.observation_count * one.reprojection_rms_px**2 for one in used)
    noise = sum(one.observation_count * one.noise_sigma_px**2 for one in used)
    noise_px = float(np.sqrt(noise / max(observations, 1)))
    motions = {one.motion for one in used}
    return replace(
        used[0], camera=camera, covariance=covariance,
        status=parameter_status(camera, covariance, used[0].facts, noise_px),
        motion=motions.pop() if len(motions) == 1 else 'unknown',
        frames=tuple(range(sum(len(one.frames) for one in used))),
        reprojection_rms_px=float(np.sqrt(square / max(observations, 1))),
        noise_sigma_px=noise_px,
        observation_count=observations, outlier_count=sum(one.outlier_count for one in used),
        # of the first recording alone
        reconstruction=None, fixed_points=None, residuals=None, findings=(), measured=None,
        focal=None, identifiability=None, shutter=None, labels=None, mount=None)
