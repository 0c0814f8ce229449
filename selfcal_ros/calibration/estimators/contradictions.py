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
How many of the observations contradict an optimum?

What pairs of views and the adjustment leave out on the way is more than that. Of a track that has
lost some, others go with them, and pairs judge a good observation by bad partners. So before a
calibration is refused for that, all observations are held against the points that were found.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.inliers import VERIFYING_VIEWS
from selfcal_ros.calibration.bundle.motion import MotionModel
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, Observations, OUTLIER_SIGMAS,
                                                       RobustFit, with_all_points)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.geometry.projective import lengths


def share_that_contradicts(fit: RobustFit, graph: ViewGraph) -> float:
    """
    Return the share of the given observations that contradict an optimum.

    Parameters
    ----------
    fit : RobustFit
    graph : ViewGraph
        With all tracks that were given.

    Returns
    -------
    float
        Tracks without a point are given one, if they are long enough to vouch for themselves.
        One where it is not known.

    """
    if graph.given is None or fit.observations.shutter is not None:
        return 1.0
    given = graph.given.in_frames(graph.frames)
    placed = np.isin(given.track, fit.observations.track)
    every = Observations.of(given.select(placed), graph.frames)
    points = np.searchsorted(fit.observations.track, every.track)
    known = replace(fit.state, points=fit.state.points[points])
    lost = _contradicting(_bundle(fit, every, fit.motion), known)
    others = Observations.of(given.select(~placed).with_at_least(VERIFYING_VIEWS + 1),
                             graph.frames)
    if len(others.view):
        # an adjustment counts the views that it is given
        shown = np.arange(others.view.max() + 1)
        state = with_all_points(fit.state.of_views(shown, np.zeros(0, int)), others)
        bundle = _bundle(fit, others, fit.motion.of_views(shown))
        lost += (len(others.view) if state is None
                 else _contradicting(bundle, bundle.refine_points(state)))
    return lost / max(len(every.view) + len(others.view), 1)


def _bundle(fit: RobustFit, observations: Observations,
            motion: MotionModel) -> Bundle[SceneState]:
    return bundle_of(observations, motion, fit.bundle.priors, fit.bundle.sigma_px)


def _contradicting(bundle: Bundle[SceneState], state: SceneState) -> int:
    """Count the observations that are not where a state, which knows their points, has them."""
    distance = lengths(bundle.residuals(state))
    # behind the camera: not a number, and not less
    return int(np.sum(~(distance < OUTLIER_SIGMAS * bundle.sigma_px)))
