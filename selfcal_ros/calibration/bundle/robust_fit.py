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
"""From a start to the maximum-likelihood estimate: outliers, noise level, how planar."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.centres import all_rays, points_from_centres
from selfcal_ros.calibration.bundle.clock import Clock
from selfcal_ros.calibration.bundle.hidden_depths import hidden_depths, with_hidden_depths
from selfcal_ros.calibration.bundle.information import Information
from selfcal_ros.calibration.bundle.inliers import verified
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.model import Linearisation
from selfcal_ros.calibration.bundle.motion import MotionModel
from selfcal_ros.calibration.bundle.neighbour_motion import followed, LEAST_FOLLOWED
from selfcal_ros.calibration.bundle.point_of_rest import resting_near
from selfcal_ros.calibration.bundle.priors import Priors
from selfcal_ros.calibration.bundle.rig_model import RigModel
from selfcal_ros.calibration.bundle.scene_model import rescaled, SceneModel
from selfcal_ros.calibration.bundle.shutter import row_shifts, RowShifts
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import (SHARE_OF_COST, TO_COMPARE, TO_ESTIMATE,
                                                       TO_GO_ON)
from selfcal_ros.geometry.chain_inverse import ChainInverse
from selfcal_ros.geometry.projective import lengths
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.values.tracks import of_longest, Tracks

#: Residuals beyond so many sigmas (in either coordinate's scale) are outliers: one in 3000 of
#: Gaussian residuals.
OUTLIER_SIGMAS = 4.0
#: What lowers the cost by more than so many standard deviations of its chi-square is no chance.
DEVIATIONS_OF_CHANCE = 4.0
#: Fewer outliers than this share of the observations end the search for them.
FEW = 0.003
#: Observations whose points a start has behind the camera, or projects so far off (pixels), are
#: left out if they are no more than this share: beside the camera a projection goes to infinity.
FEW_ABSURD, ABSURD_PX = 0.02, 1e5
#: A start that leaves so many times the supposed noise is a good one. What it leaves beyond so
#: many sigmas is a gross error, of which there are no more than this share.
FOUND, GROSS_SIGMAS, FEW_GROSS = 1.2, 20.0, 0.1
#: The rows' displacements are renewed so often at most, and until they change by no more than
#: this share of the noise (root mean square).
RENEWALS, SETTLED = 6, 0.03
#: At the ends of the path only so many observations, the nearest to the middle row, count where
#: rows are read one after the other: the camera may stand still before the first of them.
AT_ENDS = 8


@dataclass(frozen=True)
class Observations:
    """
    Observations by index, sorted by point, then view.

    Attributes
    ----------
    view, point : ndarray of int, shape (N,)
    xy : ndarray, shape (N, 2)
        Pixels.
    track : ndarray of int, shape (P,)
        Track identity of each point.
    clock : Clock, optional
        When the views were taken, where that is known.
    shutter : RowShifts, optional
        Displacements by the rows' delay, where that is estimated.
    neighbours : ndarray, shape (N, 2, 3), optional
        Of a video: pixels just before and after, and intervals from here to there.
    camera : ndarray of int, shape (N,), optional
        Of a rig: which camera made each observation.

    """

    view: np.ndarray
    point: np.ndarray
    xy: np.ndarray
    track: np.ndarray
    clock: Clock | None = None
    shutter: RowShifts | None = None
    neighbours: np.ndarray | None = None
    camera: np.ndarray | None = None

    @cached_property
    def remembered(self) -> dict[Any, Any]:
        """What was found of these observations, for who asks again; by what was asked."""
        return {}

    @classmethod
    def of(cls, tracks: Tracks, frames: np.ndarray) -> Observations:
        """Index the observations of tracks that are seen twice; frames (V,) are the views."""
        tracks = tracks.with_at_least(2)
        identity, point = np.unique(tracks.track, return_inverse=True)
        return cls(np.searchsorted(frames, tracks.frame), point, tracks.xy, identity,
                   neighbours=tracks.neighbours)

    def select(self, mask: np.ndarray, least: int = 2) -> tuple[Observations, np.ndarray]:
        """
        Keep the observations in mask (N,) of points that keep at least so many.

        Returns
        -------
        Observations
        ndarray of int
            Indices of the points that remain.

        """
        counts = np.bincount(self.point[mask], minlength=len(self.track))
        mask = mask & (counts[self.point] >= least)
        points, index = np.unique(self.point[mask], return_inverse=True)
        return Observations(self.view[mask], index, self.xy[mask], self.track[points], self.clock,
                            self.shutter and self.shutter.select(mask),
                            None if self.neighbours is None else self.neighbours[mask],
                            None if self.camera is None else self.camera[mask]), points

    def read_in_rows(self) -> Observations:
        """Return the same, with the line delay as another unknown."""
        known = None if self.clock is None else self.clock.known
        return replace(self, shutter=RowShifts.none(len(self.view), known))

    def read_like(self, shutter: RowShifts | None) -> Observations:
        """Return the same, with the unknowns of a rolling shutter as others have them."""
        if shutter is None or self.clock is None:
            return replace(self, shutter=None)
        return replace(self, shutter=shutter.of_others(len(self.view), len(self.clock.times)))

    @property
    def moves_by_view(self) -> bool:
        """Tell whether views move while they are read, each in its own way; see `OwnRows`."""
        return self.shutter is not None and self.shutter.own is not None

    def surely_timed(self) -> Observations:
        """
        Keep the observations of which it is known how the camera moved until they were read.

        The first and the last view have neighbours on one side alone, unless a video goes on
        there: then only the few nearest to the middle row, which give the view a pose.
        """
        return self if self.clock is None else self.select(self.surely_timed_rows())[0]

    def surely_timed_rows(self) -> np.ndarray:
        """Mark those observations, shape (N,)."""
        keep = np.ones(len(self.view), bool)
        if self.clock is None or self.moves_by_view:
            return keep
        for end in (0, len(self.clock.times) - 1):
            rows = np.flatnonzero(self.view == end)
            if self.neighbours is not None and followed(self.neighbours[rows]).sum() >= (
                    LEAST_FOLLOWED):
                continue
            late = np.abs(self.clock.delays(self.xy[rows]))
            keep[rows[np.argsort(late)[AT_ENDS:]]] = False
        return keep

    def displaced(self, state: SceneState) -> Observations:
        """Renew the displacements by the rows' delay, where it is estimated."""
        if self.shutter is None or self.clock is None:
            return self
        own = self.shutter.own
        renewed = row_shifts(state, PointBlocks(self.point, self.view), self.xy, self.clock,
                             self.neighbours if own is None else None, own=own,
                             before=self.shutter.at(state, self.view))
        return replace(self, shutter=replace(renewed, known=self.shutter.known))

    def is_displaced_like(self, other: Observations, state: SceneState, px: float) -> bool:
        """Tell whether displacements differ by less than so many pixels, root mean square."""
        if self.shutter is None or other.shutter is None:
            return True
        apart = self.shutter.shift - other.shutter.at(state, other.view)
        return bool(np.sqrt(np.mean(apart**2)) < px)

    def longest(self, per_view: int) -> Observations:
        """Keep the longest tracks, so many in every view."""
        return self.select(of_longest(self.view, self.point, per_view))[0]


@dataclass(frozen=True)
class RobustFit:
    """An optimum, with the problem that it solves and the observations that it explains."""

    bundle: Bundle[SceneState]
    state: SceneState
    observations: Observations
    outliers: int

    @property
    def model(self) -> SceneModel:
        """The product of blocks."""
        model = self.bundle.model
        assert isinstance(model, SceneModel)
        return model

    @property
    def motion(self) -> MotionModel:
        """The kind of motion."""
        return self.model.motion

    def lenses(self) -> list[tuple[Lens, slice, np.ndarray, set[str]]]:
        """
        Take the cameras apart, which are one unless this is a rig.

        Returns
        -------
        list of (Lens, slice, ndarray of bool, set of str)
            Of every camera: its lens, where that stands in the block, which observations are its
            own (N,), and the names of its unknowns that are free.

        """
        free, camera = self.bundle.unknowns.free, self.observations.camera
        return [(lens, part,
                 np.ones(len(self.bundle.view), bool) if camera is None else camera == k,
                 {name for name, one in zip(lens.names, free[part]) if one})
                for k, (lens, part) in enumerate(self.state.lens.parts)]

    @property
    def cost(self) -> float:
        """Robust cost in units of sigma²."""
        return self.bundle.cost(self.state)

    @cached_property
    def linearisation(self) -> Linearisation:
        """Residuals and their derivatives; computed once."""
        return self.bundle.linearise(self.state)

    @cached_property
    def information(self) -> Information:
        """Covariance, and the influence of every observation; computed once."""
        return self.bundle.information(self.state, self.linearisation)

    @property
    def covariance(self) -> np.ndarray | ChainInverse:
        """Covariance of lens and path for independent noise, (n, n)."""
        return self.information.covariance

    @property
    def independent_covariance(self) -> np.ndarray | ChainInverse:
        """Covariance of the independent unknowns of lens and path, (k, k)."""
        if isinstance(self.covariance, ChainInverse):
            return self.covariance.of_independent()
        members = self.bundle.unknowns.members
        independent: np.ndarray = self.covariance[np.ix_(members, members)]
        return independent

    @property
    def lens_covariance(self) -> np.ndarray:
        """Covariance of the unknowns of the lens for independent noise, (k, k)."""
        return self.information.lens_covariance

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is computed once: it is large, and can be computed again."""
        return {one.name: getattr(self, one.name) for one in fields(self)}


def with_all_points(state: SceneState, observations: Observations) -> SceneState | None:
    """Intersect the points of all observations from the views and calibration of a state."""
    directions = _directions(state, observations)
    if directions is None:
        return None
    blocks = PointBlocks(observations.point, observations.view)
    points = points_from_centres(blocks, directions, state.path.centres())
    return replace(state, points=points)


def with_all_directions(state: SceneState, observations: Observations) -> SceneState | None:
    """Give all observations points at infinity, for a camera that only turns."""
    directions = _directions(state, observations)
    if directions is None:
        return None
    total = np.stack([np.bincount(observations.point, column) for column in directions.T], axis=1)
    return replace(state, points=np.column_stack([
        total / np.linalg.norm(total, axis=1, keepdims=True), np.zeros(len(total))]))


def _directions(state: SceneState, observations: Observations) -> np.ndarray | None:
    """Return the directions of all observations in the world (N, 3); None if one has none."""
    rays = all_rays(state.camera(), state.steadied(observations.xy, observations.view))
    if not np.isfinite(rays).all():
        return None
    directions: np.ndarray = np.einsum(
        'nji,nj->ni', state.path.rotations()[observations.view], rays @ state.path.mount)
    return directions


def bundle_of(observations: Observations, motion: MotionModel, priors: Priors,
              sigma_px: float) -> Bundle[SceneState]:
    """Set up the adjustment of observations of a scene."""
    model = (SceneModel(motion, observations.shutter) if observations.camera is None
             else RigModel(motion, camera=observations.camera))
    return Bundle(model, observations.view, observations.point, observations.xy, priors=priors,
                  sigma_px=sigma_px)


def fit_robustly(observations: Observations, state: SceneState, motion: MotionModel,
                 priors: Priors, sigma_px: float, rounds: int = 5) -> RobustFit:
    """
    Optimise, estimate the noise, drop outliers, and repeat until nothing changes.

    Parameters
    ----------
    observations : Observations
    state : SceneState
        Its points belong to the observations.
    motion : MotionModel
    priors : Priors
    sigma_px : float
        First guess of the noise.
    rounds : int

    Returns
    -------
    RobustFit

    """
    before, supposed_px = len(observations.view), sigma_px
    for k in range(rounds):
        observations = observations.displaced(state)
        bundle = bundle_of(observations, motion, priors, sigma_px)
        if k == 0:
            state = bundle.refine_points(state)
            offered = observations
            observations, state = _predicted(bundle, observations, state, motion)
            if observations is not offered:
                bundle = bundle_of(observations, motion, priors, sigma_px)
        # no finer than the choice of outliers needs
        iterations, tolerance = ((12, SHARE_OF_COST * bundle.cost(state)) if k == 0
                                 else (3, TO_GO_ON))
        state = bundle.optimise(state, iterations, tolerance)
        distance = lengths(bundle.residuals(state))
        estimate = bundle.noise_sigma_of(distance)
        if not np.isfinite(estimate):
            break
        keep = distance < OUTLIER_SIGMAS * estimate      # NaN, behind the camera: not kept
        # what a bad start leaves is no noise that could hide depths
        shown = _with_directions(bundle.with_sigma(min(estimate, supposed_px)), state,
                                 observations, motion)
        settled = shown is state and (
            abs(estimate / sigma_px - 1) < 0.02 or len(keep) - keep.sum() < FEW * len(keep))
        state = shown
        sigma_px = estimate
        if keep.all():
            if settled:
                break
            continue
        smaller, points = observations.select(keep & verified(observations.point, keep))
        if not len(smaller.view) or len(np.unique(smaller.view)) < len(state.path):
            break
        # what agrees but goes with the rest of its track is no outlier
        before -= int(np.sum(keep & ~verified(observations.point, keep)))
        observations = smaller
        state = replace(state, points=state.points[points])
        if settled:
            break
    state = rescaled(state)
    renewed = observations
    for _ in range(RENEWALS):
        observations = renewed
        bundle = bundle_of(observations, motion, priors, sigma_px)
        state = _optimum(bundle, state, motion)
        renewed = observations.displaced(state)
        if renewed.is_displaced_like(observations, state, SETTLED * sigma_px):
            break
    return RobustFit(bundle.with_sigma(bundle.noise_rms(state)), state, observations,
                     before - len(observations.view))


def _with_directions(bundle: Bundle[SceneState], state: SceneState, observations: Observations,
                     motion: MotionModel) -> SceneState:
    """Take points whose depth no view shows for directions; the same state where none changes."""
    if not motion.goes_anywhere or observations.camera is not None:
        return state
    hidden = hidden_depths(state, bundle.blocks, bundle.sigma_px)
    if (hidden == (state.points[:, 3] == 0)).all():
        return state
    directions = _directions(state, observations)
    return state if directions is None else with_hidden_depths(state, bundle.blocks, hidden,
                                                               directions)


def _predicted(bundle: Bundle[SceneState], observations: Observations, state: SceneState,
               motion: MotionModel) -> tuple[Observations, SceneState]:
    """Leave out the few observations that a start knows nothing of: they decide every step."""
    limit_px, few = ABSURD_PX, FEW_ABSURD
    if motion.fixed_pivot:
        found_px = bundle.noise_sigma(state)
        if found_px < FOUND * bundle.sigma_px:
            # along the valley of a short lever a few gross errors lead away from a good start
            limit_px, few = GROSS_SIGMAS * found_px, FEW_GROSS
    # NaN behind the camera
    known = lengths(bundle.residuals(state)) < limit_px
    if known.all() or np.mean(~known) > few:
        return observations, state
    kept, points = observations.select(known)
    if len(np.unique(kept.view)) < len(state.path):
        return observations, state
    return kept, replace(state, points=state.points[points])


def _optimum(bundle: Bundle[SceneState], state: SceneState, motion: MotionModel) -> SceneState:
    """Optimise, and from the nearest point that may rest, too; return the better one."""
    starts = [state, resting_near(state) if motion.fixed_pivot else None]
    optima: list[SceneState] = [bundle.optimise(one, iterations=30, tolerance=TO_ESTIMATE)
                                for one in starts if one is not None]
    return min(optima, key=bundle.cost)


def refit(fit: RobustFit, motion: MotionModel, state: SceneState | None = None) -> RobustFit:
    """Optimise the same observations, at the same noise level, under another motion model."""
    bundle = bundle_of(fit.observations, motion, fit.bundle.priors, fit.bundle.sigma_px)
    state = bundle.optimise(fit.state if state is None else state, iterations=40,
                            tolerance=TO_COMPARE)
    return RobustFit(bundle, state, fit.observations, fit.outliers)


def is_chance(excess: float, freedom: float, deviations: float = DEVIATIONS_OF_CHANCE,
              ) -> bool:
    """
    Tell whether so many unknowns lower twice the cost so much by chance.

    Beyond so many standard deviations of its chi-square it is none. Beyond four is 1 in 200 of
    three unknowns, and 1 in 1400 of thirty.
    """
    return bool(excess <= freedom + deviations * np.sqrt(2 * freedom))
