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
Stretches of a path in which the camera turns on the spot, and on which side its lever lies.

A lever from the camera to the point of the turn adds to all motion in the images, nearly as a
longer focal length does. So a start may take a lever for none, and the differences of depth then
choose its sign by noise. No step of an adjustment leads from one sign to the other: between them
all points of the stretch pass through infinity. So levers of both signs are tried.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.depths import cost_of_all_ahead, share_behind
from selfcal_ros.calibration.bundle.inliers import verified
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import Prior
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, Observations,
                                                       OUTLIER_SIGMAS, RobustFit,
                                                       with_all_points)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_GO_ON
from selfcal_ros.calibration.estimators.model_selection import first_fit
from selfcal_ros.calibration.estimators.motion_class import widest_turn_rad
from selfcal_ros.calibration.initialisation.multi_start import START_TRACKS_PER_VIEW
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem

#: Steps shorter than this share of the longest, and of the depth of what is seen, are those of a
#: camera that stays where it is.
SHORT_STEP = (0.2, 0.015)
#: So many views at least make a stretch, and it must turn by so much.
LEAST_VIEWS, LEAST_TURN_RAD = 4, np.radians(5.0)
#: Levers that are tried, as shares of the usual depth.
LEVERS = (0.005, 0.015, 0.05)
#: So many of the best starts are followed to the end.
RIVALS = 3
#: A lever that was found shows the next one better.
ROUNDS = 2
#: So many stretches at most get another lever, the longest ones.
MOST_STRETCHES = 3


def turned_about(fit: RobustFit, tried: Observations, problem: SelfCalibrationProblem,
                 ) -> RobustFit:
    """
    Return the likeliest fit with other levers where the camera turns on the spot.

    Parameters
    ----------
    fit : RobustFit
    tried : Observations
        That it began with.
    problem : SelfCalibrationProblem
        Of the same views.

    Returns
    -------
    RobustFit
        `fit` itself where no stretch turns on the spot, or no lever explains more.

    """
    if problem.pivot is not None or problem.flat is not None:
        return fit
    for _ in range(ROUNDS):
        before = fit
        longest = sorted(turning_stretches(fit), key=lambda one: one[0] - one[1])
        for first, last in longest[:MOST_STRETCHES]:
            other = _with_other_lever(fit, tried, problem, first, last)
            fit = fit if other is None else _likeliest([fit, other])
        if fit is before or not share_behind(fit):
            break
    return fit


def _with_other_lever(fit: RobustFit, tried: Observations, problem: SelfCalibrationProblem,
                      first: int, last: int) -> RobustFit | None:
    """Return what another lever of one stretch leads to, where that seems to explain more."""
    # hardly anything that is explained is a gross error, which would mislead a start
    kept = fit.observations
    few = kept.longest(START_TRACKS_PER_VIEW)
    followed = []
    for start in starts_about(fit, first, last):
        state = with_all_points(start, few)
        if state is not None:
            followed.append(_followed(fit, few, state, problem.noise_px))
    rivals = [replace(fit, outliers=0)]
    for _, state in sorted(followed, key=lambda one: one[0])[:RIVALS]:
        near = with_all_points(state, kept)
        if near is not None:
            rivals.append(first_fit(problem, kept, _followed(fit, kept, near,
                                                             problem.noise_px)[1]))
    best = _likeliest(rivals)
    return None if best is rivals[0] else _of_all(best, tried, problem)


def _likeliest(fits: list[RobustFit]) -> RobustFit:
    sigma_px = min(one.bundle.sigma_px for one in fits)
    return min(fits, key=lambda one: cost_of_all_ahead(one, sigma_px))


def _of_all(fit: RobustFit, tried: Observations, problem: SelfCalibrationProblem,
            ) -> RobustFit | None:
    """Fit all observations that a fit explains, those that another has set aside among them."""
    state = with_all_points(fit.state, tried)
    if state is None:
        return None
    bundle = bundle_of(tried, fit.motion, fit.bundle.priors, fit.bundle.sigma_px)
    state = bundle.refine_points(state)
    off_px = np.linalg.norm(bundle.residuals(state), axis=1)
    explained = off_px < OUTLIER_SIGMAS * fit.bundle.sigma_px
    vouched = explained & verified(tried.point, explained)
    some, points = tried.select(vouched)
    if not len(some.view) or len(np.unique(some.view)) < len(state.path):
        return None
    again = first_fit(problem, some, replace(state, points=state.points[points]))
    # what agrees but goes with the rest of its track is no outlier
    contradict = len(tried.view) - np.count_nonzero(explained)
    lost = np.count_nonzero(vouched) - len(again.observations.view)
    return replace(again, outliers=int(contradict + lost))


def _followed(fit: RobustFit, few: Observations, state: SceneState, noise_px: float,
              ) -> tuple[float, SceneState]:
    """
    Follow a start on few tracks; noise in pixels there, and where it leads.

    The focal length is held first: then all that a turn moves tells on which side its lever is.
    """
    free = fit.bundle.priors
    held = free.updated({'f': Prior(state.lens['f'], 0.0)})
    for priors, scale in ((held, 5.0), (held, 1.5), (free, 1.5)):
        bundle = bundle_of(few, fit.motion, priors, scale * noise_px)
        state = bundle.optimise(bundle.refine_points(state), iterations=12, tolerance=TO_GO_ON)
    left_px = bundle.noise_sigma(state)
    return left_px if np.isfinite(left_px) else np.inf, state


def turning_stretches(fit: RobustFit, short: float = SHORT_STEP[0],
                      most: float = SHORT_STEP[1]) -> list[tuple[int, int]]:
    """
    Find stretches of successive views that turn and hardly move.

    Parameters
    ----------
    fit : RobustFit
    short, most : float
        See `stretches_of`.

    Returns
    -------
    list of (int, int)
        First and last view of each, which both belong to it.

    """
    path = fit.state.path
    return stretches_of(path.centres(), path.rotations(), _inverse_depths(fit), short, most)


def stretches_of(centres: np.ndarray, rotations: np.ndarray, inverse_depths: np.ndarray,
                 short: float, most: float = np.inf) -> list[tuple[int, int]]:
    """
    Find the stretches of a path that turn and hardly move.

    Parameters
    ----------
    centres : ndarray, shape (V, 3)
    rotations : ndarray, shape (V, 3, 3)
        View from world.
    inverse_depths : ndarray, shape (V,)
        Usual ones of what each view sees.
    short : float
        Largest step there, as a share of the longest one, each over the depth.
    most : float
        Largest step there over the depth.

    Returns
    -------
    list of (int, int)
        First and last view of each.

    """
    steps = _step_shares(centres, inverse_depths)
    limit = min(short * steps.max(initial=0.0), most)
    edges = np.flatnonzero(np.diff(np.r_[False, steps < limit, False]))
    return [(int(first), int(last)) for first, last in zip(edges[::2], edges[1::2])
            if last - first + 1 >= LEAST_VIEWS
            and widest_turn_rad(rotations[first:last + 1]) > LEAST_TURN_RAD]


def _step_shares(centres: np.ndarray, inverse_depths: np.ndarray) -> np.ndarray:
    """Steps between successive views over the usual depth of what both see, shape (V - 1,)."""
    near = (inverse_depths[1:] + inverse_depths[:-1]) / 2
    shares: np.ndarray = np.linalg.norm(np.diff(centres, axis=0), axis=1) * near
    return shares


def _inverse_depths(fit: RobustFit) -> np.ndarray:
    """Usual ones of what each view sees, shape (V,)."""
    state, seen = fit.state, fit.observations
    return usual_inverse_depths(state.points[seen.point], seen.view, state.path.centres())


def usual_inverse_depths(points: np.ndarray, view: np.ndarray, centres: np.ndarray,
                         ) -> np.ndarray:
    """
    Median inverse distance of what each view sees.

    Parameters
    ----------
    points : ndarray, shape (N, 4)
        Homogeneous point of every observation.
    view : ndarray of int, shape (N,)
    centres : ndarray, shape (V, 3)

    Returns
    -------
    ndarray, shape (V,)

    """
    distance = np.linalg.norm(points[:, :3] - points[:, 3:] * centres[view], axis=1)
    inverse = np.abs(points[:, 3]) / np.maximum(distance, 1e-300)
    return np.array([np.median(inverse[view == one]) for one in range(len(centres))])


def starts_about(fit: RobustFit, first: int, last: int) -> list[SceneState]:
    """
    Let the views of a stretch turn about points on all sides of the camera.

    Parameters
    ----------
    fit : RobustFit
    first, last : int
        Views of the stretch. All before it moves along with its first view.

    Returns
    -------
    list of SceneState
        The focal length is what then explains the turn. Points are not adapted.

    """
    state, near = fit.state, _inverse_depths(fit)
    path, lens = state.path, state.lens
    steps = _step_shares(path.centres(), near)
    # where it hardly moves depths are not known: of what is seen from elsewhere
    travels = np.append(steps, 0.0) >= SHORT_STEP[0] * steps.max(initial=0.0)
    usual = np.median(near[travels])
    if not usual > 0:
        return []
    centres, R = path.centres(), path.rotations()[first:last + 1]
    starts = []
    for lever in lever_directions(path, fit.motion.keeps_plane):
        for share in LEVERS:
            turned = np.einsum('vji,j->vi', R, -share / usual * lever)
            moved = centres.copy()
            moved[first:last + 1] = centres[last] + turned - turned[-1]
            moved[:first] += moved[first] - centres[first]
            focal = lens['f'] / (1 - share * float(path.mount[2] @ lever))
            starts.append(replace(state, path=path.placed_at(moved),
                                  lens=lens.with_values({'f': focal})))
    return starts


def lever_directions(path: AxisPath, in_plane: bool) -> np.ndarray:
    """
    Return the directions of levers that look like turns, before the mount, shape (n, 3).

    Those are along the view; in the image where it looks along the axis of the turns.
    """
    if not in_plane:
        return np.concatenate([path.mount, -path.mount])
    along = path.mount[2] * [1.0, 1.0, 0.0]
    length = np.linalg.norm(along)
    if length < 0.5:
        return np.concatenate([path.mount[:2], -path.mount[:2]]) * [1.0, 1.0, 0.0]
    ends: np.ndarray = np.array([along, -along]) / length
    return ends
