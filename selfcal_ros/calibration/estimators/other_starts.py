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
Other starts where the focal length is so uncertain that there may be a better optimum.

The search for starts ends with the first that explains the images well. Where the focal length is
poorly determined, several optima do, some sigmas apart; so other starts are followed, too.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import OUTLIER_SIGMAS
from selfcal_ros.calibration.estimators.one_motion import OneMotion
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.initialisation.supposed_lens import supposed_camera
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.result import Calibration

#: A focal length with a larger sigma than this share of it is loose.
LOOSE_FOCAL = 0.02
#: Factors of it to begin at once more.
FACTORS = (1.0, 0.8, 1.25)
#: Starts that lead to first fits so near each other, in sigmas, lead to the same optimum.
SAME = 0.05
#: Another optimum is better where the cost falls by so much, in units of sigma².
BETTER_BY = 1.0


def likeliest_start(result: Calibration, problem: SelfCalibrationProblem, graph: ViewGraph,
                    ) -> Calibration:
    """
    Begin elsewhere, too, where a focal length is loose; return what explains the images best.

    Parameters
    ----------
    result : Calibration
    problem : SelfCalibrationProblem
        With the motion of the result.
    graph : ViewGraph

    Returns
    -------
    Calibration
        The same one where no other is clearly better.

    """
    if result.focal_sigma_share <= LOOSE_FOCAL:
        return result
    found, same_px = [result], SAME * result.sigma['fx']
    reached: list[float] = []
    for factor in FACTORS:
        start = supposed_camera(factor * float(result.camera.K[0, 0]), problem.size,
                                problem.facts, problem.bend)
        anew = OneMotion(problem, graph, [start], None)
        focal_px = anew.first_focal_px()
        if any(abs(focal_px - one) < same_px for one in reached):
            continue
        reached.append(focal_px)
        other = anew.with_any_focal()
        if other:
            found.append(other)
    noise_px = min(one.noise_sigma_px for one in found)
    # half the squares of both coordinates; outliers count what makes them such
    cost = [one.observation_count * (one.noise_sigma_px / noise_px)**2
            + 0.5 * OUTLIER_SIGMAS**2 * one.outlier_count for one in found]
    best = int(np.argmin(cost))
    return found[best] if cost[best] < cost[0] - BETTER_BY else result
