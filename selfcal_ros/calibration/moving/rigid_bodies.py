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
Things that move by themselves: rigid bodies among tracks that the still scene does not explain.

With the camera known, a rigid body is a scene of its own before a camera on a path of its own.
Pairs of views tell its motion (`geometry.relative_pose`), and one view after another is attached
to those that stand. An adjustment with the camera held has the last word.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.centres import all_rays
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import all_fixed
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, Observations
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_CHOOSE
from selfcal_ros.calibration.initialisation.initial_structure import (PairGeometry,
                                                                      planar_start,
                                                                      spanning_order)
from selfcal_ros.calibration.moving.track_judgement import freedom_of, judge_tracks, TrackTest
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.relative_pose import relative_motion
from selfcal_ros.geometry.rotation import nearest_rotation

#: Views of a body are compared with so many successors.
SUCCESSORS = 2
#: Fewest matches of a pair that agree; fewest tracks and views of a body.
LEAST_MATCHES, LEAST_TRACKS, LEAST_VIEWS = 7, 8, 3
#: Share of the tracks in its views that a body has to explain, of those that are not explained
#: otherwise: chance explains few.
LEAST_SHARE = 0.3
#: Or it explains so many degrees of freedom a view, of which its own path takes six.
PROVED = 24.0
#: A body explains a track that loses no more than this share to gross errors.
MOST_LOST = 0.2
#: Share of the pairs that show it in which a track of a body agrees.
OF_PAIRS = 0.5
#: Matches agree within so many sigmas.
MATCH_SIGMAS = 4.0
#: Turns of leaving out what agrees least.
TRIMS = 4
#: Sigmas at which residuals begin to weigh less, at first.
COARSE = 20.0


@dataclass(frozen=True)
class RigidBody:
    """
    A thing that moves by itself, and the camera's path relative to it.

    Attributes
    ----------
    views : ndarray of int, shape (n,)
        Views that show it, ascending.
    bundle : Bundle
    state : SceneState
        Path of the camera in a frame of the body.

    """

    views: np.ndarray
    bundle: Bundle[SceneState]
    state: SceneState

    def test(self, observations: Observations) -> tuple[TrackTest, np.ndarray] | None:
        """
        Judge tracks by the body's motion.

        Parameters
        ----------
        observations : Observations

        Returns
        -------
        TrackTest
            Of their observations in the body's views.
        ndarray of int
            Indices of the points that it speaks of; two views at least.

        """
        inside = np.isin(observations.view, self.views)
        within, points = observations.select(inside)
        if not len(points):
            return None
        within = replace(within, view=np.searchsorted(self.views, within.view), shutter=None)
        test = judge_tracks(self.bundle, self.state, within)
        return None if test is None else (test, points)


def find_bodies(observations: Observations, camera: Camera, sigma_px: float,
                rng: np.random.Generator, most: int = 3) -> Iterator[tuple[RigidBody, np.ndarray]]:
    """
    Find the rigid bodies that explain most tracks, one after another.

    Parameters
    ----------
    observations : Observations
        Of tracks that the still scene does not explain.
    camera : Camera
    sigma_px : float
        Noise of an image coordinate.
    rng : numpy.random.Generator
    most : int
        Bodies to look for.

    Yields
    ------
    RigidBody
    ndarray of int
        Indices of the tracks that it explains.

    """
    # a body has a path of its own, which says how far its rows are displaced: little, mostly
    observations = replace(observations, shutter=None)
    left = np.arange(len(observations.track))
    for _ in range(most):
        rest, places = observations.select(np.isin(observations.point, left))
        if len(places) < LEAST_TRACKS:
            return
        body = _body(rest, camera, sigma_px, rng)
        found = body and body.test(rest)
        if body is None or not found:
            return
        test, seen = found
        # of a track that the body's views show in part, the greater part has to be explained
        whole = np.bincount(rest.point, minlength=len(places))[seen]
        fits = test.explained & (2 * test.length > whole) & (test.lost <= MOST_LOST * test.length)
        spare = freedom_of((test.length - test.lost)[fits]).sum() / len(body.views)
        if fits.sum() < LEAST_TRACKS or (spare < PROVED
                                         and fits.sum() < LEAST_SHARE * test.tested.sum()):
            return
        explained = places[seen[fits]]
        yield body, explained
        left = np.setdiff1d(left, explained)


def _body(observations: Observations, camera: Camera, sigma_px: float,
          rng: np.random.Generator) -> RigidBody | None:
    """Find the body that most tracks belong to, in the views that it connects."""
    rays = camera.rays(observations.xy)
    limit = MATCH_SIGMAS * sigma_px / float(camera.K[0, 0])
    found = list(_pairs(observations, rays, limit, rng))
    if not found:
        return None
    pairs, turns = _agreeing([pair for pair, _ in found], [turn for _, turn in found])
    views = np.unique([[pair.first, pair.second] for pair in pairs])
    if len(views) < LEAST_VIEWS:
        return None
    members = _members(observations, pairs)
    mask = np.isin(observations.view, views) & np.isin(observations.point, members)
    within, points = observations.select(mask, LEAST_VIEWS)
    if len(points) < LEAST_TRACKS or len(np.unique(within.view)) < len(views):
        return None
    within = replace(within, view=np.searchsorted(views, within.view))
    local = [replace(pair, first=int(np.searchsorted(views, pair.first)),
                     second=int(np.searchsorted(views, pair.second))) for pair in pairs]
    fitted = _adjusted(within, local, np.array(turns), camera, sigma_px, rng)
    return None if fitted is None else RigidBody(views, *fitted)


def _pairs(observations: Observations, rays: np.ndarray, limit: float,
           rng: np.random.Generator) -> Iterator[tuple[PairGeometry, np.ndarray]]:
    """Compare neighbouring views; yields what agrees in each pair, and the turn."""
    views = int(observations.view.max()) + 1
    row = np.full((views, len(observations.track)), -1)
    row[observations.view, observations.point] = np.arange(len(observations.view))
    for gap in range(1, SUCCESSORS + 1):
        for first in range(views - gap):
            both = np.flatnonzero((row[first] >= 0) & (row[first + gap] >= 0))
            a, b = row[first, both], row[first + gap, both]
            motion = relative_motion(rays[a], rays[b], limit, rng)
            if motion is None:
                continue
            R, t, agree = motion
            if agree.sum() < LEAST_MATCHES:
                continue
            yield PairGeometry(first, first + gap, cross_matrix(t) @ R, both[agree],
                               observations.xy[a[agree]], observations.xy[b[agree]]), R


def _members(observations: Observations, pairs: list[PairGeometry]) -> np.ndarray:
    """Return the tracks that agree in most of the pairs that show them, not by chance in one."""
    seen = np.zeros((int(observations.view.max()) + 1, len(observations.track)), bool)
    seen[observations.view, observations.point] = True
    shown, agrees = np.zeros((2, len(observations.track)), int)
    for pair in pairs:
        shown += seen[pair.first] & seen[pair.second]
        agrees[pair.track] += 1
    return np.flatnonzero(agrees > OF_PAIRS * shown)


def _agreeing(pairs: list[PairGeometry], turns: list[np.ndarray],
              ) -> tuple[list[PairGeometry], list[np.ndarray]]:
    """Keep the pairs that are linked to the strongest one, by views and by tracks."""
    strongest = int(np.argmax([len(pair.track) for pair in pairs]))
    chosen, views = {strongest}, {pairs[strongest].first, pairs[strongest].second}
    members = set(pairs[strongest].track.tolist())
    growing = True
    while growing:
        growing = False
        for k, pair in enumerate(pairs):
            if k in chosen or not {pair.first, pair.second} & views:
                continue
            own = set(pair.track.tolist())
            # a pair that shows another body has few of the tracks
            if len(own & members) >= max(3, 0.3 * len(own)):
                chosen.add(k)
                views |= {pair.first, pair.second}
                members |= own
                growing = True
    order = sorted(chosen)
    return [pairs[k] for k in order], [turns[k] for k in order]


def _adjusted(observations: Observations, pairs: list[PairGeometry], turns: np.ndarray,
              camera: Camera, sigma_px: float, rng: np.random.Generator,
              ) -> tuple[Bundle[SceneState], SceneState] | None:
    """Adjust the body's path and points with the camera held; the better one of two starts."""
    fixed = all_fixed(Lens.of(camera))
    bundle = bundle_of(observations, GENERAL, fixed, sigma_px)
    best, least = None, np.inf
    for state in (planar_start(pairs, bundle.blocks, observations.xy, camera, False, turns),
                  _from_afar(bundle, camera, pairs, rng)):
        if state is None or not np.isfinite(bundle.cost(state)):
            continue
        for sigmas in (COARSE, 2.0):
            loose = bundle.with_sigma(sigmas * sigma_px)
            state = loose.optimise(state, iterations=25, tolerance=TO_CHOOSE)
        trimmed = _trimmed(observations, state, bundle)
        if trimmed[2] < least:
            best, least = trimmed[:2], trimmed[2]
        if least < 2:
            break
    return best


def _trimmed(observations: Observations, state: SceneState, bundle: Bundle[SceneState],
             ) -> tuple[Bundle[SceneState], SceneState, float]:
    """Leave out what agrees least, in turns; returns the cost of a degree of freedom, too."""
    views = bundle.blocks.view_count
    for _ in range(TRIMS):
        distance = np.linalg.norm(bundle.residuals(state), axis=1) / bundle.sigma_px
        limit = max(MATCH_SIGMAS, 3 * float(np.nanmedian(distance)))
        agrees = distance < limit
        rest, points = observations.select(
            agrees & (2 * np.bincount(observations.point, agrees)
                      > np.bincount(observations.point))[observations.point], LEAST_VIEWS)
        if len(points) < LEAST_TRACKS or len(np.unique(rest.view)) < views:
            break
        settled = len(rest.view) == len(observations.view)
        observations, state = rest, replace(state, points=state.points[points])
        bundle = bundle_of(observations, GENERAL, bundle.priors, bundle.sigma_px)
        state = bundle.optimise(state, iterations=25, tolerance=TO_CHOOSE)
        if settled:
            break
    return bundle, state, bundle.cost(state) / max(bundle.degrees_of_freedom, 1)


def _from_afar(bundle: Bundle[SceneState], camera: Camera, pairs: list[PairGeometry],
               rng: np.random.Generator) -> SceneState:
    """
    Start as if a small body stood far off before a camera that turns after it.

    Where little but the turn is seen, pairs of views do not tell depths. The body's size in the
    image tells how far off it is in each view. Depths within it begin at random, and the
    adjustment finds them.
    """
    blocks = bundle.blocks
    rotations = np.tile(np.eye(3), (blocks.view_count, 1, 1))
    distance = np.zeros(blocks.view_count)
    for k, standing, new in spanning_order(pairs, blocks.view_count):
        pair = pairs[k]
        a, b = camera.rays(pair.xy_first), camera.rays(pair.xy_second)
        if pair.first == new:
            a, b = b, a
        # the turn that carries rays onto rays
        rotations[new] = nearest_rotation(b.T @ a) @ rotations[standing]
        distance[new] = distance[standing] + np.median(np.log(_apart(a) / _apart(b)))
    distance = np.exp(distance - distance.mean())
    directions = np.einsum('nji,nj->ni', rotations[blocks.view], all_rays(camera, bundle.xy))
    mean = blocks.sum_over_points(directions)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    middle = np.median(mean, axis=0)
    spread = float(np.sqrt(np.mean(np.sum((mean - mean.mean(axis=0))**2, axis=1))))
    depth = 1 + 0.5 * spread * rng.standard_normal(len(mean))
    points = np.column_stack([mean * depth[:, None], np.ones(len(mean))])
    # seen from one line alone nothing has a depth: views stand apart by chance
    centres = ((1 - distance)[:, None] * middle
               + 0.03 * spread * rng.standard_normal((blocks.view_count, 3)))
    poses = np.concatenate([rotations, -rotations @ centres[..., None]], axis=2)
    return SceneState(Lens.of(camera), AxisPath.of_poses(np.eye(3), poses),
                      points / np.linalg.norm(points, axis=1, keepdims=True))


def _apart(rays: np.ndarray) -> np.ndarray:
    """Return the distances between any two of some rays (n, 3)."""
    first, second = np.triu_indices(len(rays), 1)
    apart: np.ndarray = np.linalg.norm(rays[first] - rays[second], axis=1)
    return apart + 1e-12
