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
An estimate, and one after another the corrections of its covariance.

The equations alone say how independent errors spread. Beside them come what the errors share, and
what the lens does beyond its model. What is known of lenses counts, and so does what no residual
shows at all. Every motion runs through the same chain. It has steps of its own between the shared
ones, and where it leaves a shared one out it says why.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.uncertainty.cluster_covariance import (ClusterCovariance,
                                                                    robust_covariance_of,
                                                                    segment_findings)
from selfcal_ros.calibration.uncertainty.distortion_misfit import (DistortionMisfit,
                                                                   find_distortion_misfit)
from selfcal_ros.calibration.uncertainty.group_jackknife import segment_excess
from selfcal_ros.calibration.uncertainty.hidden_decentring import (
    hidden_decentring, HiddenDecentring, possible_decentring)
from selfcal_ros.calibration.uncertainty.lens_posterior import lens_posterior, LensPosterior
from selfcal_ros.calibration.uncertainty.prism import possible_prism
from selfcal_ros.calibration.uncertainty.uneven_ground import uneven_ground
from selfcal_ros.calibration.uncertainty.uneven_growth import (possible_growth, uneven_growth,
                                                               UnevenGrowth)
from selfcal_ros.findings.finding import Finding


@dataclass(frozen=True)
class AssessedEstimate:
    """
    An estimate with what its covariance allows for so far.

    Attributes
    ----------
    fit : RobustFit
        The optimum where errors count as independent; of one camera or of a rig.
    sizes : (int, int), or array of int, shape (C, 2)
        Width and height of the image, of a rig those of every camera.
    clusters : ClusterCovariance
        What errors of one track or region share.
    state : SceneState
        The estimate.
    covariance : ndarray, shape (k, k)
        Of the unknowns of the lens.
    residual : ndarray, shape (N, 2)
        What the estimate leaves, pixels; NaN where the point is not ahead of the camera.
    findings : tuple of Finding
    jackknife : (float, ndarray of shape (k, k)), optional
        Of `segment_excess`, where it was found on the way to the optimum.
    misfit : DistortionMisfit or None
        What the lens does beyond its model.
    hidden : HiddenDecentring or None
        What a fisheye does that its model has no coefficients for.
    behind : float
        Share of the points that lie behind the cameras, where that is in doubt.
    growth : UnevenGrowth or None
        What is open of a focal length that grows steadily.

    """

    fit: RobustFit
    sizes: Sequence[int] | np.ndarray
    clusters: ClusterCovariance
    state: SceneState
    covariance: np.ndarray
    residual: np.ndarray
    findings: tuple[Finding, ...]
    jackknife: tuple[float, np.ndarray] | None = None
    misfit: DistortionMisfit | None = None
    hidden: HiddenDecentring | None = None
    behind: float = 0.0
    growth: UnevenGrowth | None = None

    @classmethod
    def of(cls, fit: RobustFit, sizes: Sequence[int] | np.ndarray) -> AssessedEstimate:
        """Begin with an optimum, and what errors of one track or region share."""
        clusters = robust_covariance_of(fit, sizes)
        residual = np.where(fit.linearisation.ahead[:, None], fit.linearisation.residual, np.nan)
        return cls(fit, sizes, clusters, fit.state, clusters.covariance, residual,
                   clusters.findings())

    @property
    def variance_inflation(self) -> float:
        """Variance of the estimate over that with independent errors."""
        return self.clusters.variance_inflation

    def moved_to(self, other: DistortionMisfit | LensPosterior) -> AssessedEstimate:
        """Go on from where something puts state, covariance and residual."""
        return replace(self, state=other.state, covariance=other.covariance,
                       residual=other.residual)

    def widened(self, covariance: np.ndarray, findings: tuple[Finding, ...] = (),
                ) -> AssessedEstimate:
        """Add a covariance (k, k), and what is to be said of it."""
        return replace(self, covariance=self.covariance + covariance,
                       findings=self.findings + findings)


#: A step of the chain.
Correction = Callable[[AssessedEstimate], AssessedEstimate]


def allow_for_distortion_misfit(found: AssessedEstimate) -> AssessedEstimate:
    """Allow for what the lens does beyond its model."""
    misfit = find_distortion_misfit(found.fit, found.sizes, found.clusters.ratios['track']**2,
                                    possible_decentring(found.fit))
    if misfit is None:
        return found
    # the field is what the image's regions share
    return replace(found.moved_to(misfit), misfit=misfit,
                   findings=(*found.clusters.findings('track'), *misfit.findings()))


def allow_for_segments(found: AssessedEstimate) -> AssessedEstimate:
    """Allow for errors that segments of views share."""
    ratio, covariance = (segment_excess(found.fit, found.variance_inflation)
                         if found.jackknife is None else found.jackknife)
    return found.widened(covariance, segment_findings(ratio))


def allow_for_uneven_ground(found: AssessedEstimate) -> AssessedEstimate:
    """Allow for a ground that tilts views in a row alike."""
    more = uneven_ground(found.fit, found.variance_inflation)
    return found if more is None else found.widened(more)


def allow_for_uneven_growth(found: AssessedEstimate) -> AssessedEstimate:
    """Allow for a focal length that does not grow quite steadily."""
    growth = uneven_growth(found.fit, found.variance_inflation)
    return found if growth is None else replace(found, growth=growth).widened(growth.covariance)


def allowing_for_growth(instants: tuple[float, ...]) -> Correction:
    """Return what allows for a focal length that may grow; by no instants, for nothing."""
    def allow_for_growth(found: AssessedEstimate) -> AssessedEstimate:
        if not instants or found.fit.motion.zoom is not None:
            return found
        return found.widened(possible_growth(found.fit, instants, found.variance_inflation))
    return allow_for_growth


def apply_lens_posterior(found: AssessedEstimate) -> AssessedEstimate:
    """Weigh what lenses are like anew, now that the images' errors are known."""
    # beside a field all that is known was worth less by what tracks share
    share = 1.0 if found.misfit is None else found.clusters.ratios['track']**2
    posterior = lens_posterior(found.fit, found.state, found.covariance, found.residual, share)
    return found if posterior is None else found.moved_to(posterior)


def allow_for_hidden_decentring(found: AssessedEstimate) -> AssessedEstimate:
    """Allow for decentring of a fisheye, which its model lacks."""
    misfit = found.misfit
    hidden = hidden_decentring(found.fit, found.variance_inflation,
                               *(() if misfit is None else (misfit.modes, misfit.size_px)))
    if hidden is None:
        return found
    return replace(found, hidden=hidden).widened(hidden.covariance, hidden.findings())


def allow_for_prism(found: AssessedEstimate) -> AssessedEstimate:
    """Allow for a prism where the lens is decentred by more than most."""
    prism = possible_prism(found.fit, found.covariance, found.variance_inflation)
    return found if prism is None else found.widened(prism.covariance, prism.findings())


#: What every motion allows for, in this order. The posterior weighs the errors of the images and
#: of the plane. What no model has is none of them, and comes after. A prism is asked for where all
#: sigmas are known.
SHARED: tuple[Correction, ...] = (
    allow_for_distortion_misfit, allow_for_segments, allow_for_uneven_ground,
    allow_for_uneven_growth, apply_lens_posterior, allow_for_hidden_decentring, allow_for_prism)


@dataclass(frozen=True)
class Chain:
    """
    The corrections of a motion: the shared ones in their order, and steps of its own among them.

    Attributes
    ----------
    steps : tuple of Correction

    """

    steps: tuple[Correction, ...]

    def __post_init__(self) -> None:
        """Let no motion differ from the others in silence."""
        if tuple(step for step in self.steps if step in SHARED) != SHARED:
            raise ValueError('A chain has every shared correction, each once and in its order.')

    def applied_to(self, found: AssessedEstimate) -> AssessedEstimate:
        """Run an estimate through all steps."""
        for step in self.steps:
            found = step(found)
        return found
