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
"""Carry what was found on some of the views and tracks over to all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.priors import with_fixed
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, with_all_points
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.lens_selection import gentle_lens, with_lens
from selfcal_ros.calibration.estimators.model_selection import ModelDecision
from selfcal_ros.calibration.initialisation.multi_start import START_TRACKS_PER_VIEW
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.geometry.estimate import NoEstimate


def extend(problem: SelfCalibrationProblem, model: ModelDecision) -> SceneState | NoEstimate:
    """Start for all views and tracks from what was found on a fraction of them."""
    found = model.fit.state
    folded = NoEstimate('distortion_not_invertible', model=model.facts.distortion)
    if len(found.path) == problem.views:
        return with_all_points(found, problem.observations) or folded
    few, _ = problem.observations.select(problem.observations.longest(START_TRACKS_PER_VIEW))
    # the rows' displacements are found once there is a path
    few = replace(few, shutter=None)
    lens, priors = gentle_lens(model.fit, problem.facts, problem.size)
    bundle = bundle_of(few, problem.motion, priors, 10 * problem.noise_px)
    camera = replace(found, lens=lens).camera()
    standing = [state if not model.exact else replace(state, path=state.path.flat())
                for state in problem.starts(bundle.blocks, few.xy, camera)]
    costs = [bundle.cost(state) for state in standing]
    if not np.isfinite(min(costs, default=np.inf)):
        return folded
    state = with_fixed(standing[int(np.argmin(costs))], bundle.priors)
    state = replace(state, path=state.path.aligned(problem.motion))
    state = bundle.optimise(state, iterations=15, tolerance=1.0)
    whole = with_all_points(replace(state, line_delay=found.line_delay), problem.observations)
    if whole is None:
        return folded
    return with_lens(whole, problem.observations.xy, problem.facts.distortion)
