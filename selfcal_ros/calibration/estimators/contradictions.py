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
How many of the observations contradict an optimum, and do they as gross errors do?

What pairs of views and the adjustment leave out on the way is more than that. Of a track that has
lost some, others go with them, and pairs judge a good observation by bad partners. So before a
calibration is refused for that, all observations are held against the points that were found.

Gross errors hit single observations, each by itself. What moves, and a path that is wrong, take
tracks as wholes. How many tracks fall by the former follows from those that stand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import bdtr, bdtrc

from selfcal_ros.calibration.bundle.inliers import VERIFYING_VIEWS
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, Observations, OUTLIER_SIGMAS,
                                                       RobustFit)
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.moving.sorting import observed_like
from selfcal_ros.calibration.moving.track_judgement import distances, scene_of
from selfcal_ros.geometry.projective import lengths

#: No more of the observations than this are gross errors, each by itself.
MOST_GROSS = 0.5
#: Standard deviations of what gross errors make fall that are chance.
CHANCE = 2.0


@dataclass(frozen=True)
class Contradictions:
    """
    What of the given tracks contradicts an optimum.

    Attributes
    ----------
    length, lost : ndarray of int, shape (P,)
        Observations of every track, and how many of them contradict.

    """

    length: np.ndarray
    lost: np.ndarray

    @property
    def most(self) -> np.ndarray:
        """Observations that each track may lose and still show which of them is wrong, (P,)."""
        most: np.ndarray = np.minimum(self.length - VERIFYING_VIEWS, self.length // 2)
        return most

    @property
    def stands(self) -> np.ndarray:
        """Mark the tracks (P,) that stand, though some of each may contradict."""
        stands: np.ndarray = (self.lost == 0) | (self.lost <= self.most)
        return stands

    @property
    def share(self) -> float:
        """Share of the observations that contradict, with all of every track that falls."""
        contradict = np.where(self.stands, self.lost, self.length)
        return float(contradict.sum() / self.length.sum()) if len(self.length) else 1.0

    @property
    def share_as_wholes(self) -> float:
        """
        Share of the observations on tracks that fall, beyond those that gross errors make fall.

        Of the tracks that stand, the losses are binomial, cut off where they would fall. That
        tells how probable a gross error is, and so how many tracks fall by such errors. Chance
        may take some more.
        """
        # loaded by the few that need it
        from scipy.optimize import minimize_scalar
        tested = self.length > VERIFYING_VIEWS
        length, lost, most, stands = (one[tested] for one in (
            self.length, self.lost, self.most, self.stands))
        if not stands.any():
            return 1.0
        seen = length[stands], lost[stands], most[stands]
        gross = minimize_scalar(lambda share: _surprise(share, *seen), (0, MOST_GROSS),
                                (1e-6, MOST_GROSS), method='bounded').x
        falls = bdtrc(most, length, gross)
        chance = CHANCE * np.sqrt(length**2 @ (falls * (1 - falls)))
        fallen = length[~stands].sum() - length @ falls - chance
        return float(max(fallen, 0.0) / self.length.sum())


def _surprise(share: float, length: np.ndarray, lost: np.ndarray, most: np.ndarray) -> float:
    """Return minus the log likelihood of the losses of tracks that stand, but for a constant."""
    return -float(np.sum(lost * np.log(share) + (length - lost) * np.log1p(-share)
                         - np.log(bdtr(most, length, share))))


def contradictions_of(fit: RobustFit, graph: ViewGraph) -> Contradictions | None:
    """
    Hold all given observations against an optimum.

    Parameters
    ----------
    fit : RobustFit
    graph : ViewGraph
        With all tracks that were given.

    Returns
    -------
    Contradictions or None
        Tracks without a point are given one, if they are long enough to vouch for themselves.
        None where it is not known.

    """
    if graph.given is None or fit.observations.camera is not None:
        return None
    given = graph.given.in_frames(graph.frames)
    placed = np.isin(given.track, fit.observations.track)
    every = observed_like(fit, given.select(placed), graph.frames)
    points = np.searchsorted(fit.observations.track, every.track)
    known = replace(fit.state, points=fit.state.points[points])
    bundle = bundle_of(every.displaced(known), fit.motion, fit.bundle.priors, fit.bundle.sigma_px)
    found = [(every, lengths(bundle.residuals(known)) / bundle.sigma_px)]
    others = observed_like(fit, given.select(~placed).with_at_least(VERIFYING_VIEWS + 1),
                           graph.frames)
    others, _ = others.select(np.ones(len(others.view), bool), VERIFYING_VIEWS + 1)
    if len(others.view):
        found.append((others, _from_own_points(fit, others)))
    # behind the camera: not a number, and not less
    return Contradictions(
        np.concatenate([np.bincount(one.point, minlength=len(one.track)) for one, _ in found]),
        np.concatenate([np.bincount(one.point, ~(distance < OUTLIER_SIGMAS), len(one.track))
                        for one, distance in found]).astype(int))


def _from_own_points(fit: RobustFit, observations: Observations) -> np.ndarray:
    """
    Return how far observations (N,) are from where a fit has points of their own, in sigmas.

    A gross error spoils the point of all of its track. So the worst of a track is left out until
    enough of it agrees, or too little is left to show which is wrong.
    """
    distance = np.full(len(observations.view), np.inf)
    point, keep = observations.point, np.ones(len(observations.view), bool)
    while True:
        scene = scene_of(fit.bundle, fit.state, observations.select(keep)[0])
        if scene is None:
            return distance
        distance[keep] = distances(*scene)
        # what was left out contradicts
        disagrees = ~(distance < OUTLIER_SIGMAS)
        worst = np.lexsort((-np.where(keep, np.nan_to_num(distance, nan=np.inf), -np.inf), point))
        worst = worst[np.unique(point[worst], return_index=True)[1]]
        left = np.bincount(point, keep)
        drop = worst[(np.bincount(point, disagrees & keep) > 0) & (left > VERIFYING_VIEWS)]
        if not len(drop):
            return distance
        keep[drop] = False
        distance[drop] = np.inf
