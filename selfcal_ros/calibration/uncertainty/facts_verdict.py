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
What becomes of a calibration whose images contradict a stated fact.

Where the camera moves by more than its sigmas hold once the fact is released, the calibration is
refused, unless the facts were declared exact (`CameraFacts.trusted`). Else the sigmas take up the
difference. Either way the value that the images prefer is told.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.no_estimate import NoEstimate

#: A fact is contradicted where what the images say would be an accident so rarely; what is an
#: accident less often than the second is allowed for in the sigmas.
CONTRADICTED, DOUBTED = 1e-4, 0.03
#: A camera that would move by more than so many of its sigmas is refused.
SILENT_SIGMAS = 4.0
#: What moves by less than this share of the focal length the sigmas can hold, however many.
HELD_SHARE = 2e-3
#: One is refused, too, of which any parameter of K would move by more than this share of the focal
#: length, whatever its sigma: the misfit has widened that.
MOVED_FRACTION = 5e-3
#: Errors of facts that are not unusual: of skew and principal point as shares of the focal length.
PLAUSIBLE = {'aspect': 0.05, 'skew': 0.004, 'cx': 0.02, 'cy': 0.02, 'p1': 1e-3, 'p2': 1e-3}
#: Coefficients that a stated lens holds at zero, and that the images are asked about.
HELD_COEFFICIENTS = {'none': ('k1', 'k2', 'p1', 'p2'), 'radial1': ('k2', 'p1', 'p2'),
                     'radial2': ('k3', 'p1', 'p2'), 'radial3': ('p1', 'p2'), 'radtan': ('k3',)}
#: The fact that a stated lens is.
LENS_MODEL = 'lens model'
#: Unknowns of the lens that each fact is about.
ABOUT = {'aspect ratio': ('aspect',), 'skew': ('skew',), 'principal point': ('cx', 'cy')}


@dataclass(frozen=True)
class Contradiction:
    """
    A fact, and what the images prefer to it.

    Attributes
    ----------
    fact : str
    preferred : list of dict
        Of each unknown that the fact is about: name, value, sigma, stated.
    sigmas : float
        How surely the images prefer it.
    shift : ndarray, shape (k,)
        How the parameters of the camera move where the fact is released; not at all by default.
    is_large : bool
        Whether a parameter of the calibration matrix would be off by much.
    has_sigma : bool
        Whether the fact was stated with a sigma.

    """

    fact: str
    preferred: list[dict[str, Any]]
    sigmas: float
    shift: np.ndarray = field(default_factory=lambda: np.zeros(len(MATRIX_PARAMETERS)))
    is_large: bool = False
    has_sigma: bool = False

    @property
    def values(self) -> dict[str, Any]:
        """What findings say of it."""
        return {'fact': self.fact, 'preferred': self.preferred, 'sigmas': self.sigmas}


class Unchecked(NamedTuple):
    """
    An error of a fact that the images would let pass.

    Attributes
    ----------
    fact, unknown : str
        The fact, and an unknown of the lens that it is about.
    error : float
    shift : ndarray, shape (k,)
        What it would do to the parameters of the camera.
    is_whole : bool
        Whether that is all of an error that is not unusual; else the images limit it.

    """

    fact: str
    unknown: str
    error: float
    shift: np.ndarray
    is_whole: bool


@dataclass(frozen=True)
class FactsVerdict:
    """
    What the images say of the stated facts.

    Attributes
    ----------
    contradicted : tuple of Contradiction
        Beyond chance.
    doubted : tuple of Contradiction
        What may be an accident; and all, where rows that views move by while they are read may be
        what the images contradict a fact by.
    unchecked : tuple of Unchecked
        What the images let pass.
    trusted : bool
        Whether the facts were declared exact.

    """

    contradicted: tuple[Contradiction, ...]
    doubted: tuple[Contradiction, ...]
    unchecked: tuple[Unchecked, ...]
    trusted: bool

    def refusal(self, covariance: np.ndarray, focal_px: float) -> NoEstimate | None:
        """
        Refuse a camera that rests on a wrong fact by more than its sigmas hold.

        Parameters
        ----------
        covariance : ndarray, shape (k, k)
            Of the parameters of the camera, under the facts.
        focal_px : float

        """
        if not self.contradicted or self.trusted:
            return None
        shift = np.sum([one.shift for one in self.contradicted], axis=0)
        moved = np.abs(shift[:len(MATRIX_PARAMETERS)]).max() / focal_px
        if ((_in_sigmas(shift, covariance).max() <= SILENT_SIGMAS or moved < HELD_SHARE)
                and not any(one.is_large for one in self.contradicted)):
            return None
        return self.cause

    def without(self, fact: str) -> FactsVerdict:
        """Return the verdict without what concerns one fact."""
        return replace(self, contradicted=tuple(o for o in self.contradicted if o.fact != fact),
                       doubted=tuple(o for o in self.doubted if o.fact != fact))

    def blaming(self, further: Contradiction | None) -> FactsVerdict:
        """Return the verdict with one more contradiction before all others, if there is one."""
        return self if further is None else replace(self, contradicted=(further,
                                                                        *self.contradicted))

    def concerns(self, fact: str) -> bool:
        """Tell whether the images prefer something else to a fact, surely or perhaps."""
        return fact in [one.fact for one in (*self.contradicted, *self.doubted)]

    @property
    def is_kept(self) -> bool:
        """Tell whether a fact counts that the images contradict."""
        return self.trusted and bool(self.contradicted)

    @property
    def cause(self) -> NoEstimate | None:
        """Why a calibration fails, as far as the facts are to blame."""
        if not self.contradicted or self.trusted:
            return None
        first, *more = self.contradicted
        return NoEstimate('fact_contradicted', **first.values, further=[
            Finding('fact_contradicted_too', **one.values) for one in more])

    def widened(self, covariance: np.ndarray, names: tuple[str, ...],
                ) -> tuple[np.ndarray, tuple[Finding, ...]]:
        """
        Let a covariance hold what the facts may be off by, and tell.

        Parameters
        ----------
        covariance : ndarray, shape (k, k)
        names : tuple of str
            Of the parameters.

        Returns
        -------
        ndarray, shape (k, k)
        tuple of Finding

        """
        found, wider = [], covariance
        estimated = np.diag(covariance) > 0
        for kind, one in (*(('fact_doubtful', one) for one in self.contradicted),
                          *(('fact_unsure', one) for one in self.doubted)):
            if self.trusted:
                found.append(Finding('fact_trusted', **one.values))
                continue
            # what is no more than doubtful, the sigma that was stated holds already
            if kind == 'fact_doubtful' or not one.has_sigma:
                shift = one.shift * estimated
                wider = wider + np.outer(shift, shift)
            found.append(Finding(kind, **one.values))
        told: dict[str, Finding] = {}
        left_open: dict[str, Finding] = {}
        for fact, unknown, error, shift, is_whole in self.unchecked:
            # a parameter that is held has no sigma that could hold the whole of such an error
            if is_whole and unknown in MATRIX_PARAMETERS and not estimated[names.index(unknown)]:
                left_open[fact] = Finding('fact_open', fact=fact, unknown=unknown, error=error)
            ratio = _in_sigmas(shift, wider)
            place = int(np.argmax(ratio))
            beyond = float(ratio[place])
            if beyond > max(SILENT_SIGMAS, told[fact].values['sigmas'] if fact in told else 0):
                told[fact] = Finding('fact_unchecked', fact=fact, unknown=unknown, error=error,
                                     name=names[place], change=float(abs(shift[place])),
                                     sigmas=beyond, moves=[names[one] for one in np.flatnonzero(
                                         ratio > SILENT_SIGMAS)])
        if not self.trusted:
            found += told.values()
            found += (one for fact, one in left_open.items() if fact not in told)
        return wider, tuple(found)


def _in_sigmas(shift: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Shifts (5,) of the parameters of K over their sigmas; held ones do not count."""
    count = len(MATRIX_PARAMETERS)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0))[:count]
    ratio: np.ndarray = np.where(
        sigma > 0, np.abs(shift[:count]) / np.maximum(sigma, 1e-300), 0.0)
    return ratio
