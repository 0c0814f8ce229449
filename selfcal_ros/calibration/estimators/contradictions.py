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

from selfcal_ros.calibration.bundle.inliers import VERIFYING_VIEWS
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, Observations, OUTLIER_SIGMAS,
                                                       RobustFit)
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph


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
        Of tracks without a point all count, if they are long enough to vouch for themselves.
        One where it is not known.

    """
    if graph.given is None or fit.observations.shutter is not None:
        return 1.0
    given = graph.given.in_frames(graph.frames)
    place = np.searchsorted(fit.observations.track, given.track)
    place = np.minimum(place, len(fit.observations.track) - 1)
    known = fit.observations.track[place] == given.track
    _, which, length = np.unique(given.track[~known], return_inverse=True, return_counts=True)
    lost = int(np.sum(length[which] > VERIFYING_VIEWS))
    order = np.lexsort((given.frame[known], place[known]))
    points, index = np.unique(place[known][order], return_inverse=True)
    every = Observations(np.searchsorted(graph.frames, given.frame[known][order]), index,
                         given.xy[known][order], fit.observations.track[points])
    state = replace(fit.state, points=fit.state.points[points])
    bundle = bundle_of(every, fit.motion, fit.bundle.priors, fit.bundle.sigma_px)
    distance = np.linalg.norm(bundle.residuals(state), axis=1)
    # behind the camera: not a number, and not less
    lost += int(np.sum(~(distance < OUTLIER_SIGMAS * fit.bundle.sigma_px)))
    return lost / max(len(given) - int(np.sum(length[which] <= VERIFYING_VIEWS)), 1)
