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
An optimum with all that its covariance has to hold.

The equations alone say how independent errors spread. Beside them come what the errors share, what
the lens does beyond its model, what was chosen on the way, and what no residual shows at all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.depths import share_behind
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.model_selection import ModelDecision, robust_covariance_of
from selfcal_ros.calibration.estimators.stated_facts import (examine_facts, FactsVerdict,
                                                             LENS_MODEL)
from selfcal_ros.calibration.estimators.stated_lens import contradicted_lens
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.uncertainty.cluster_covariance import segment_findings
from selfcal_ros.calibration.uncertainty.distortion_misfit import (DistortionMisfit,
                                                                   find_distortion_misfit)
from selfcal_ros.calibration.uncertainty.hidden_decentring import (
    hidden_decentring, HiddenDecentring, possible_decentring)
from selfcal_ros.calibration.uncertainty.lens_posterior import lens_posterior
from selfcal_ros.calibration.uncertainty.points_ahead import points_ahead
from selfcal_ros.calibration.uncertainty.prism import possible_prism
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import CameraFacts

#: With more than this share of the points behind the cameras the scene is inside out.
MAX_BEHIND = 0.03


@dataclass(frozen=True)
class SupportedOptimum:
    """
    An optimum, corrected and widened by what is known beside its equations.

    Attributes
    ----------
    state : SceneState
    covariance : ndarray, shape (n, n)
        Of the lens's parameters as they are adjusted.
    residual : ndarray, shape (N, 2)
        Pixels; NaN where the point is not ahead of the camera.
    findings : tuple of Finding
    dependence : float
        Variance of the estimate over that with independent errors.
    field : DistortionMisfit or None
        What the lens does beyond its model.
    stated : FactsVerdict
        What the images say of the facts.
    behind : float
        Share of the points that lie behind the cameras, where that is in doubt.

    """

    state: SceneState
    covariance: np.ndarray
    residual: np.ndarray
    findings: tuple[Finding, ...]
    dependence: float
    field: DistortionMisfit | None
    stated: FactsVerdict
    behind: float = 0.0

    def moved_to(self, other) -> SupportedOptimum:
        """Go on from where something puts state, covariance and residual."""
        return replace(self, state=other.state, covariance=other.covariance,
                       residual=other.residual)

    def widened(self, covariance: np.ndarray, findings: tuple[Finding, ...]) -> SupportedOptimum:
        """Add a covariance, and what is to be said of it."""
        return replace(self, covariance=self.covariance + covariance,
                       findings=self.findings + findings)


def supported_optimum(fit: RobustFit, model: ModelDecision, problem: SelfCalibrationProblem,
                      stated: CameraFacts) -> SupportedOptimum:
    """
    Correct and widen an optimum by what is known beside its equations.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    model : ModelDecision
        What was chosen on the way to it.
    problem : SelfCalibrationProblem
    stated : CameraFacts
        Those of the user; the problem's have what was chosen, too.

    Returns
    -------
    SupportedOptimum

    """
    shared = robust_covariance_of(fit, problem.size)
    dependence = shared.inflation**2
    field = find_distortion_misfit(fit, problem.size, shared.ratios['track']**2,
                                   possible_decentring(fit))
    hidden = hidden_decentring(fit, dependence,
                               *(() if field is None else (field.modes, field.size_px)))
    residual = np.where(fit.linearisation.ahead[:, None], fit.linearisation.residual, np.nan)
    found = SupportedOptimum(fit.state, shared.covariance, residual, shared.findings(), dependence,
                             field, _of_facts(fit, problem, stated, dependence, field, hidden))
    if field is not None:
        # the field is what the image's regions share
        found = replace(found.moved_to(field),
                        findings=(*shared.findings('track'), *field.findings()))
    ratio, added = model.jackknife
    found = found.widened(added + model.profile_excess * dependence, segment_findings(ratio))
    # what no model has is no error of the images, and comes after
    posterior = lens_posterior(fit, found.state, found.covariance, found.residual)
    if posterior is not None:
        found = found.moved_to(posterior)
    if problem.is_weak:
        found = _with_points_ahead(found, fit, problem.motion.fixed_pivot)
    if hidden is not None:
        found = found.widened(hidden.covariance, hidden.findings())
    prism = possible_prism(fit, found.covariance, dependence)
    return found if prism is None else found.widened(prism.covariance, prism.findings())


def _of_facts(fit: RobustFit, problem: SelfCalibrationProblem, stated: CameraFacts,
              dependence: float, field: DistortionMisfit | None,
              hidden: HiddenDecentring | None) -> FactsVerdict:
    """Hold the facts against the images."""
    verdict = examine_facts(fit, stated, problem.size, dependence, hidden)
    if field is None or problem.facts.distortion == 'none':
        return verdict
    # what the lens does beyond its model is in the sigmas, or too much for any lens; unless
    # another model does the same
    return verdict.without(LENS_MODEL).blaming(
        contradicted_lens(fit, stated, problem.size, dependence, field))


def _with_points_ahead(found: SupportedOptimum, fit: RobustFit, is_pivot: bool,
                       ) -> SupportedOptimum:
    """Count the points behind; what the images leave open of a turn, points ahead settle."""
    behind = share_behind(fit)
    if behind < MAX_BEHIND or not is_pivot:
        return replace(found, behind=behind)
    share = share_behind(replace(fit, state=found.state))
    if share < MAX_BEHIND:
        return replace(found, behind=share)
    ahead, behind = points_ahead(fit, found.state, found.covariance, found.residual)
    found = replace(found, behind=behind)
    if ahead is None:
        return found
    alone = {'value': found.state.lens['f'], 'sigma': float(np.sqrt(found.covariance[0, 0]))}
    return replace(found.moved_to(ahead), findings=(
        *found.findings, Finding('points_ahead_counted', share=share, images_fx=alone)))
