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
How far apart two calibrations are: in pixels over the image, and in sigmas.

Images alone do not tell a rotation of one camera against the other from a shift of its principal
point. So the best one is taken out first (as D. Kogan's mrcal does). What remains is tested
against the covariances of both, in every direction that these leave free, at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import gammaln

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.distributions import chi2_sf, normal_isf
from selfcal_ros.report.projection_uncertainty import parameter_effect

#: Points a side of the grid on which two cameras are compared.
GRID = 25
#: Verdicts: a p-value below the first is a difference, below the second worth a look.
SURE, DOUBTFUL = 0.001, 0.05
#: Nothing but rounding, as after a conversion.
ALIKE_PX = 1e-9
#: Below the first nobody will notice, below the second few: the noise of a corner, and a pixel.
SAME_PX, SMALL_PX = 0.1, 1.0
#: Effects of parameters below this share of the largest are rounding: the root of that of a
#: covariance, which has been through some inversions.
_RANK = 1e-5
#: The same for lenses of two models, whose parameters do nearly, not exactly, the same: below it
#: is what linearisation leaves.
_RANK_OF_TWO = 1e-2
#: What may be left untested between lenses of two models, over the largest difference.
OTHER_MODEL = 0.25


@dataclass(frozen=True)
class Comparison:
    """
    Two calibrations side by side.

    Attributes
    ----------
    pixels : ndarray, shape (N, 2)
        Pixels of the first camera, GRID x GRID of them.
    difference_px : ndarray, shape (N, 2)
        Where the second camera sees the same rays, after the best rotation, less `pixels`; NaN
        where it does not.
    rotation_rad : float
        Angle of the rotation that was taken out.
    chi2, p_value : float or None
        Of the whole difference against the covariances; None without any.
    freedom : int
        Directions in which the covariances leave the cameras free.
    sigmas : ndarray, shape (N,), or None
        Length of each difference in standard deviations along its own direction.
    untested_px : float
        Largest part of a difference that no free parameter can make: what both calibrations
        hold, but differently; or, of two lens models, what neither can express of the other.
    one_model : bool
        Whether both have the same lens model.

    """

    pixels: np.ndarray
    difference_px: np.ndarray
    rotation_rad: float
    chi2: float | None = None
    p_value: float | None = None
    freedom: int = 0
    sigmas: np.ndarray | None = None
    untested_px: float = 0.0
    one_model: bool = True

    @property
    def distance_px(self) -> np.ndarray:
        """Length of each difference, shape (N,)."""
        return np.asarray(np.linalg.norm(self.difference_px, axis=1))

    @property
    def worst(self) -> int:
        """Row of the largest difference."""
        return int(np.nanargmax(self.distance_px))

    @property
    def contradiction(self) -> bool:
        """Tell whether they differ in what no free parameter can explain."""
        # lenses of two models differ by a little that is no contradiction
        limit = SAME_PX if self.one_model else max(
            SAME_PX, OTHER_MODEL * float(np.nanmax(self.distance_px)))
        return self.p_value is not None and self.untested_px >= limit

    @property
    def agree(self) -> bool | None:
        """Tell whether the covariances explain the difference; None without any."""
        if self.p_value is None:
            return None
        return bool(self.p_value >= SURE and not self.contradiction)

    @property
    def joint_sigmas(self) -> float | None:
        """
        Say the whole difference in sigmas: as improbable as so many of one normal number.

        None without covariances.
        """
        if self.p_value is None or self.chi2 is None:
            return None
        return in_sigmas(self.chi2, self.p_value, self.freedom)

    def beyond(self, sigmas: float) -> bool | None:
        """
        Tell whether the calibrations differ by more than so many sigmas, all parameters at once.

        What both hold and contradict each other in is beyond any. None without covariances.
        """
        found = self.joint_sigmas
        return None if found is None else found > sigmas or self.contradiction

    @property
    def verdict(self) -> str:
        """Say in words what the difference means."""
        most = float(np.nanmax(self.distance_px))
        if most < ALIKE_PX and self.agree is not False:
            return 'The calibrations are the same, but for rounding.'
        size = ('nobody will notice' if most < SAME_PX else
                'matters to precise measurements only' if most < SMALL_PX else
                'matters to whoever measures in these images')
        if self.p_value is None:
            words = 'practically the same' if most < SAME_PX else 'different'
            return (f'The calibrations are {words}: {most:.2g} px at most, which {size}. Without '
                    'covariances nobody can say whether chance explains that; camera files of '
                    'selfcal have one, and result.json.')
        chance = f'chi2 {self.chi2:.3g} with {self.freedom} degrees of freedom, '
        chance += f'p = {self.p_value:.2g}' if self.p_value >= 1e-6 else 'p < 1e-6'
        if self.p_value < SURE:
            return (f'The calibrations differ, and their uncertainties do not explain it '
                    f'({chance}): the camera has changed, or one of them rests on something '
                    f'wrong. It is {most:.2g} px at most, which {size}.')
        if not self.agree:
            how = ('what both hold as known, by {:.2g} px: their facts contradict each other.'
                   if self.one_model else
                   'what their lens models cannot express of each other, by {:.2g} px.')
            return (f'The calibrations differ in {how.format(self.untested_px)} It is '
                    f'{most:.2g} px at most, which {size}.')
        if self.p_value < DOUBTFUL:
            return (f'The calibrations agree barely ({chance}): if nothing has changed, one '
                    f'comparison in {1 / self.p_value:.0f} looks like this. It is {most:.2g} px '
                    f'at most, which {size}.')
        return (f'The calibrations agree within their uncertainties ({chance}): {most:.2g} px at '
                f'most, which {size}.')


def in_sigmas(statistic: float, p_value: float, freedom: int) -> float:
    """Say a statistic in sigmas: as improbable as so many of one normal number."""
    if p_value > 1e-200:
        # a chance of one is no sigma, neither above nor below
        return max(0.0, float(normal_isf(p_value / 2)))
    # beyond what a number holds: the first terms for large arguments, of chi2 (DLMF 8.11.2)
    # and of the normal distribution (DLMF 7.12.1)
    half = freedom / 2
    log_p = (half - 1) * np.log(statistic / 2) - statistic / 2 - gammaln(half)
    x = np.sqrt(-2 * log_p)
    return float(np.sqrt(-2 * log_p - 2 * np.log(x * np.sqrt(np.pi / 2))))


def compare_cameras(a: Camera, b: Camera, covariance_a: np.ndarray | None = None,
                    covariance_b: np.ndarray | None = None) -> Comparison:
    """
    Compare where two cameras see the same rays.

    Parameters
    ----------
    a, b : Camera
        Of one image size.
    covariance_a, covariance_b : ndarray, shape (k, k), optional
        Of the parameters of each camera, of whatever lens model, independent of each other; a
        camera without one counts as exact.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If the sizes differ, no ray is seen by both, or a covariance is of other parameters.

    """
    if (a.width, a.height) != (b.width, b.height) or min(a.width, a.height) <= 0:
        raise InputError(f'The first calibration is for {a.width}x{a.height} pixels, the second '
                         f'for {b.width}x{b.height}; compare calibrations of one size.')
    pixels = np.stack(np.meshgrid(np.linspace(0, a.width - 1, GRID),
                                  np.linspace(0, a.height - 1, GRID)), axis=-1).reshape(-1, 2)
    rays = a.rays(pixels)
    if not np.isfinite(rays).all(axis=1).any():
        raise InputError('The distortion of the first calibration cannot be undone anywhere in '
                         'the image.')
    good = np.isfinite(b.project(rays)).all(axis=1)
    if good.sum() < 3:
        raise InputError('The second calibration sees nothing of what the first one sees.')

    def apart(vector: np.ndarray) -> np.ndarray:
        return np.asarray(b.project(Rotation.from_rotvec(vector).apply(rays[good])) - pixels[good])

    # a ray that leaves the sight of the second camera on the way says nothing
    best = least_squares(lambda vector: np.nan_to_num(apart(vector)).ravel(), np.zeros(3),
                         x_scale=0.01, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    difference = np.full(pixels.shape, np.nan)
    difference[good] = apart(best.x)
    found = Comparison(pixels, difference, float(np.linalg.norm(best.x)),
                       one_model=a.model == b.model)
    known = [(camera, np.asarray(C, float))
             for camera, C in ((a, covariance_a), (b, covariance_b)) if C is not None]
    if not known:
        return found
    for camera, C in known:
        if C.shape != (len(camera.parameter_names),) * 2:
            raise InputError(f'A covariance of {len(C)} parameters is none of the '
                             f'{len(camera.parameter_names)} of a camera with the lens model '
                             f'{camera.model}.')
        if not np.isfinite(C).all():
            raise InputError('A covariance is not finite: its calibration leaves a parameter '
                             'undetermined, so that nothing can be tested against it.')
    if found.one_model:
        # to first order both do the same, so they count as one
        return _tested(found, [(a, np.sum([C for _, C in known], axis=0))], _RANK)
    return _tested(found, known, _RANK_OF_TWO)


def _tested(found: Comparison, known: list[tuple[Camera, np.ndarray]], rank: float,
            ) -> Comparison:
    """Test the difference against covariances, each by what its own camera makes of it."""
    roots = []
    for camera, covariance in known:
        values, vectors = np.linalg.eigh(covariance)
        roots.append(parameter_effect(camera, found.pixels)
                     @ (vectors * np.sqrt(np.maximum(values, 0))))
    root = np.concatenate(roots, axis=2)
    good = np.isfinite(root).all(axis=(1, 2)) & np.isfinite(found.difference_px).all(axis=1)
    root = root[good]
    U, s, _ = np.linalg.svd(root.reshape(-1, root.shape[2]), full_matrices=False)
    free = s > rank * max(s.max(initial=0), 1e-300)
    d = found.difference_px[good]
    shares = U[:, free].T @ d.ravel()
    statistic = float(np.sum((shares / s[free])**2))
    rest = (d.ravel() - U[:, free] @ shares).reshape(d.shape)
    length = np.linalg.norm(d, axis=1, keepdims=True)
    along = np.divide(d, length, out=np.zeros_like(d), where=length > 0)
    spread = np.linalg.norm(np.einsum('nk,nkj->nj', along, root), axis=1)
    sigmas = np.full(len(found.pixels), np.nan)
    sigmas[good] = np.divide(length[:, 0], spread, out=np.zeros(len(d)), where=spread > 0)
    return Comparison(found.pixels, found.difference_px, found.rotation_rad, statistic,
                      # without a free parameter there is nothing that chance could explain
                      float(chi2_sf(statistic, free.sum())) if free.any() else 1.0,
                      int(free.sum()), sigmas,
                      float(np.linalg.norm(rest, axis=1).max(initial=0.0)), found.one_model)
