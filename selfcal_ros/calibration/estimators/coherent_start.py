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
"""A start from the more coherent half of the tracks, where moving things spoil other starts."""

from __future__ import annotations

from collections.abc import Iterable

from selfcal_ros.calibration.bundle.priors import with_fixed
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.initialisation.multi_start import FOCAL_SWEEP, GOOD_ENOUGH
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem, start_priors
from selfcal_ros.calibration.initialisation.supposed_lens import (is_strong, likely_focal_lengths,
                                                                  supposed_camera)
from selfcal_ros.calibration.moving.coherent_tracks import coherent_half
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.schur_complement import PointBlocks

#: Scale at which starts from pairs of views begin, in units of the noise.
COARSE = 10.0
#: Focal lengths from which to seek, of each kind of lens.
FOCAL_LENGTHS = 4


def straight_and_bent(problem: SelfCalibrationProblem) -> list[Camera]:
    """Suppose cameras; what moves may look like a lens that bends lines, so without that first."""
    bends = ((), problem.bend) if is_strong(problem.bend) else (problem.bend,)
    return [supposed_camera(focal_px, problem.size, problem.facts, bend)
            for k in range(FOCAL_LENGTHS) for bend in bends
            for focal_px in likely_focal_lengths(problem.size, bend, FOCAL_SWEEP)[k:k + 1]]


def coherent_fit(problem: SelfCalibrationProblem, per_view: int, proposals: Iterable[Camera],
                 enough: float = GOOD_ENOUGH) -> RobustFit | None:
    """
    Fit the most coherent half of the tracks, from pairs of views under supposed calibrations.

    Parameters
    ----------
    problem : SelfCalibrationProblem
    per_view : int
        Of the longest tracks, so many in every view.
    proposals : iterable of Camera
        Tried until one leaves little more than pairs of views do.
    enough : float
        So many times that noise is little; what moves adds to it, too.

    Returns
    -------
    RobustFit or None
        The one with the least noise; see `coherent_half`. None where there is none.

    """
    tried = problem.observations.longest(per_view)
    blocks, best = PointBlocks(tried.point, tried.view), None
    for camera in proposals:
        priors = start_priors(problem, camera)
        for start in problem.starts(blocks, tried.xy, camera):
            half = coherent_half(tried, with_fixed(start, priors), problem.motion, priors,
                                 COARSE * problem.noise_px, problem.noise_px)
            if half is not None and (best is None
                                     or half.bundle.sigma_px < best.bundle.sigma_px):
                best = half
        if best is not None and best.bundle.sigma_px < enough * problem.noise_px:
            break
    return best
