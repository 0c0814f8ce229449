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
A moving thing that few views see: there the tracks crowd that nothing explains.

It pulls the poses of these views, so that still points fit badly there, too. Over the whole
recording that looks as if image patches drifted. But drift and gross errors occur in all views,
while such a thing leaves the other views undisturbed.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.inliers import VERIFYING_VIEWS
from selfcal_ros.calibration.bundle.robust_fit import Observations
from selfcal_ros.calibration.moving.sorting import UNEXPLAINED_SHARE
from selfcal_ros.calibration.moving.track_judgement import freedom_of, TrackTest
from selfcal_ros.geometry.distributions import chi2_isf

#: A view is calm where the upper quartile of its tracks leaves no more than so many times that of
#: noise; a quarter of the views has to be. Things that cross leave up to 1.22 there, recorded and
#: rendered still scenes 1.34 and more.
CALM = 1.27
#: Some view shows more tracks that nothing explains than its share of them, by so many sigmas of
#: chance. Tails that are heavy everywhere reach 2.9, most things that cross 4 to 10.
CROWDED = 4.0
#: Views with fewer tracks tell nothing.
LEAST_TRACKS = 8


def crowd_in_few_views(test: TrackTest, observations: Observations) -> bool:
    """
    Tell whether tracks that nothing explains crowd in some views, while others are calm.

    Parameters
    ----------
    test : TrackTest
    observations : Observations
        Of the tracks that were judged.

    """
    if np.mean(~test.explained[test.tested]) <= UNEXPLAINED_SHARE:
        return False
    seen = np.zeros((int(observations.view.max()) + 1, len(test.length)), bool)
    seen[observations.view, observations.point] = True
    left = test.length - test.lost
    ratio = test.square / chi2_isf(0.25, np.maximum(freedom_of(left), 1))
    quartiles = [np.percentile(ratio[some], 75)
                 for some in seen & (test.tested & (left >= VERIFYING_VIEWS))
                 if some.sum() >= LEAST_TRACKS]
    if not quartiles or np.percentile(quartiles, 25) > CALM:
        return False
    tested = np.sum(seen & test.tested, axis=1)
    failed = np.sum(seen & (test.tested & ~test.explained), axis=1)
    share = failed.sum() / max(tested.sum(), 1)
    chance = np.sqrt(np.maximum(tested, LEAST_TRACKS) * share * (1 - share))
    return bool(np.any(failed - share * tested > CROWDED * chance))
