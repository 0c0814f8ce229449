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
An optimum with its covariance, widened for every error beyond independent noise.

The corrections that all motions share run here with two more: for the models that were chosen on
the way to the optimum, and for the constraint that points lie ahead of the camera.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.depths import share_behind
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.estimators.model_selection import ModelDecision
from selfcal_ros.calibration.estimators.stated_facts import examine_facts
from selfcal_ros.calibration.estimators.stated_lens import contradicted_lens
from selfcal_ros.calibration.estimators.zoom_selection import may_vary
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.uncertainty.assessed_estimate import (
    allow_for_distortion_misfit, allow_for_hidden_decentring, allow_for_prism, allow_for_segments,
    allow_for_uneven_ground, allow_for_uneven_growth, allowing_for_growth, apply_lens_posterior,
    AssessedEstimate, Chain)
from selfcal_ros.calibration.uncertainty.facts_verdict import FactsVerdict, LENS_MODEL
from selfcal_ros.calibration.uncertainty.points_ahead import points_ahead
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import CameraFacts

#: With more than this share of the points behind the cameras the scene is inside out.
MAX_BEHIND = 0.03


def corrections(model: ModelDecision, problem: SelfCalibrationProblem) -> Chain:
    """
    Return what the covariance of an optimum has to allow for.

    Parameters
    ----------
    model : ModelDecision
        What was chosen on the way to it.
    problem : SelfCalibrationProblem

    Returns
    -------
    Chain

    """
    def allow_for_choices(found: AssessedEstimate) -> AssessedEstimate:
        return found.widened(model.covariance_of_choices(found.variance_inflation))

    def count_points_ahead(found: AssessedEstimate) -> AssessedEstimate:
        return _with_points_ahead(found, problem.motion.fixed_pivot)

    return Chain((allow_for_distortion_misfit, allow_for_segments, allow_for_choices,
                  allowing_for_growth(problem.instants if may_vary(problem) else ()),
                  allow_for_uneven_ground, allow_for_uneven_growth,
                  apply_lens_posterior,
                  *((count_points_ahead,) if problem.is_weak else ()),
                  allow_for_hidden_decentring, allow_for_prism))


def supported_optimum(fit: RobustFit, model: ModelDecision, problem: SelfCalibrationProblem,
                      stated: CameraFacts) -> tuple[AssessedEstimate, FactsVerdict]:
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
    AssessedEstimate
    FactsVerdict
        What the images say of the facts.

    """
    found = corrections(model, problem).applied_to(replace(
        AssessedEstimate.of(fit, problem.size), jackknife=model.jackknife))
    return found, verdict_on_facts(found, problem.size, problem.facts, stated)


def verdict_on_facts(found: AssessedEstimate, size: tuple[int, int], chosen: CameraFacts,
                     stated: CameraFacts) -> FactsVerdict:
    """
    Hold the facts against the images.

    Parameters
    ----------
    found : AssessedEstimate
    size : (int, int)
        Width and height of the image.
    chosen, stated : CameraFacts
        Those that the estimate obeys, and those of the user among them.

    Returns
    -------
    FactsVerdict

    """
    verdict = examine_facts(found.fit, stated, size, found.variance_inflation, found.hidden)
    if found.misfit is None or chosen.distortion == 'none':
        return verdict
    # what the lens does beyond its model is in the sigmas, or too much for any lens; unless
    # another model does the same
    return verdict.without(LENS_MODEL).blaming(contradicted_lens(
        found.fit, stated, size, found.variance_inflation, found.misfit))


def _with_points_ahead(found: AssessedEstimate, is_pivot: bool) -> AssessedEstimate:
    """Count the points behind; what the images leave open of a turn, points ahead settle."""
    behind = share_behind(found.fit)
    if behind < MAX_BEHIND or not is_pivot:
        return replace(found, behind=behind)
    share = share_behind(replace(found.fit, state=found.state))
    if share < MAX_BEHIND:
        return replace(found, behind=share)
    ahead, behind = points_ahead(found.fit, found.state, found.covariance, found.residual)
    found = replace(found, behind=behind)
    if ahead is None:
        return found
    alone = {'value': found.state.lens['f'], 'sigma': float(np.sqrt(found.covariance[0, 0]))}
    return replace(found.moved_to(ahead), findings=(
        *found.findings, Finding('points_ahead_counted', share=share, images_fx=alone)))
