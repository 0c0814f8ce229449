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
Does a point that stands still explain a whole track?

Single observations of a thing that moves often agree with some point, most of all along epipolar
lines; the track as a whole does not. So whole tracks are judged, by the sum of their squares.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import bdtrik

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.inliers import VERIFYING_VIEWS
from selfcal_ros.calibration.bundle.robust_fit import (Observations, OUTLIER_SIGMAS,
                                                       with_all_points)
from selfcal_ros.calibration.bundle.scene_model import SceneModel
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.geometry.distributions import chi2_isf, chi2_sf

#: A track that is as it should be fails by chance in less than this share.
CHANCE = 1e-4
#: Observations lost by chance are judged by tracks that kept more than this share.
MOSTLY = 0.5
#: Half of the tracks of a frame that repeats another move by less, in sigma; independent noise
#: alone would move half of them by 1.7.
COPIED = 1.0
#: Fewer tracks do not tell the noise.
LEAST_FOR_SCALE = 20


@dataclass(frozen=True)
class TrackTest:
    """
    How well one path of the camera explains tracks, each by a point of its own.

    Attributes
    ----------
    length, lost : ndarray of int, shape (P,)
        Observations of each track, and those of them that are gross errors.
    square : ndarray, shape (P,)
        Sum of squared residuals of the others, in sigma².
    explained : ndarray of bool, shape (P,)
        Tracks that are as they should be: no more lost than others lose, and no more left than
        noise leaves.
    tested : ndarray of bool, shape (P,)
        Tracks long enough to contradict.
    agrees : ndarray of bool, shape (N,)
        Observations that are no gross errors.

    """

    length: np.ndarray
    lost: np.ndarray
    square: np.ndarray
    explained: np.ndarray
    tested: np.ndarray
    agrees: np.ndarray


def freedom_of(count: np.ndarray) -> np.ndarray:
    """Degrees of freedom that so many views of one point leave."""
    freedom: np.ndarray = np.maximum(2 * count - 3, 0)
    return freedom


def judge_tracks(bundle: Bundle[SceneState], state: SceneState, observations: Observations,
                 ) -> TrackTest | None:
    """
    Judge every track by the poses of a state.

    Parameters
    ----------
    bundle : Bundle
        Of any observations; gives the model, the facts and the noise.
    state : SceneState
        Its poses and lens are held.
    observations : Observations
        Of the tracks; read in rows, those rows are displaced as the state's path moves.

    Returns
    -------
    TrackTest or None
        None where the lens does not see the observations.

    """
    scene = scene_of(bundle, state, observations)
    if scene is None:
        return None
    return judge_scene(scene, observations.point, instants(bundle))


def judge_scene(scene: tuple[Bundle[SceneState], SceneState], point: np.ndarray,
                instant: np.ndarray) -> TrackTest:
    """Judge tracks (N,) by the points of a scene (`scene_of`); instants (V,) number its views."""
    copies = int(np.bincount(instant).max())
    return judged(point, distances(*scene), copies, copies)


def scene_of(bundle: Bundle[SceneState], state: SceneState, observations: Observations,
             ) -> tuple[Bundle[SceneState], SceneState] | None:
    """
    Place a point for every track before the poses of a state, which are held.

    Parameters are those of `judge_tracks`.

    Returns
    -------
    Bundle
        Of the observations.
    SceneState
        None where the lens does not see the observations.

    """
    placed = with_all_points(state, observations)
    if placed is None:
        return None
    # an adjustment counts the views that it is given
    model, counted = bundle.model, np.arange(observations.view.max() + 1)
    if isinstance(model, SceneModel):
        model = replace(model, motion=model.motion.of_views(counted),
                        shutter=observations.displaced(placed).shutter)
    state = placed.of_views(counted, np.arange(len(placed.points)))
    own = Bundle(model, observations.view, observations.point, observations.xy,
                 priors=bundle.priors, sigma_px=bundle.sigma_px)
    return own, own.refine_points(state)


def distances(scene: Bundle[SceneState], state: SceneState) -> np.ndarray:
    """Lengths of the residuals (N,), in sigmas; infinite where there is none."""
    length: np.ndarray = np.nan_to_num(np.linalg.norm(scene.residuals(state), axis=1),
                                       nan=np.inf)
    return length / scene.sigma_px


def instants(bundle: Bundle[SceneState]) -> np.ndarray:
    """Number the views (V,); a frame that repeats the one before has its number."""
    rows = np.lexsort((bundle.view, bundle.part))
    view, point, xy = bundle.view[rows], bundle.part[rows], bundle.xy[rows]
    after = (np.diff(point) == 0) & (np.diff(view) == 1)
    moved = np.linalg.norm(np.diff(xy, axis=0), axis=1)[after] > COPIED * bundle.sigma_px
    to, count = view[1:][after], int(view.max()) + 1
    number: np.ndarray = np.cumsum(
        2 * np.bincount(to, moved, count) >= np.bincount(to, minlength=count)) - 1
    return number


def judged(point: np.ndarray, distance: np.ndarray, spread: float = 1.0, copies: int = 1,
           ) -> TrackTest:
    """
    Judge tracks by the residuals of their observations.

    Parameters
    ----------
    point : ndarray of int, shape (N,)
        Track of every observation, from zero.
    distance : ndarray, shape (N,)
        Length of its residual, sigmas.
    spread : float
        Variance of the sum over a track over that of independent errors, at most.
    copies : int
        Observations of a track that are lost together.

    Returns
    -------
    TrackTest

    """
    count = int(point.max(initial=-1)) + 1
    distance = distance / _scale(point, distance, count)
    agrees = distance < OUTLIER_SIGMAS * np.sqrt(spread)
    length = np.bincount(point, minlength=count)
    left = np.bincount(point, agrees, count).astype(int)
    lost = length - left
    square = np.bincount(point, np.where(agrees, distance**2, 0.0), count)
    freedom = freedom_of(left)
    quiet = chi2_sf(square / spread, np.maximum(freedom, 1)) > CHANCE
    tested = length >= VERIFYING_VIEWS
    explained = tested & quiet & (left >= VERIFYING_VIEWS)
    # there are far fewer lengths than tracks
    lengths, of_track = np.unique(length, return_inverse=True)
    for _ in range(3):
        usual = explained & (lost <= MOSTLY * length)
        share = (lost[usual].sum() + 1) / (length[usual].sum() + 1)
        # so many are lost of a track of this length by chance
        most = copies * np.ceil(bdtrik(1 - 1e-3, lengths / copies, min(share, 0.9)))
        explained &= lost <= np.maximum(most, copies)[of_track]
    return TrackTest(length, lost, square, explained, tested, agrees)


def _scale(point: np.ndarray, distance: np.ndarray, count: int) -> float:
    """
    Noise of the median track over the stated one, at most one.

    What moves with part of the scene makes the stated noise large, and then hides in it.
    """
    length = np.bincount(point, minlength=count)
    worst = np.zeros(count)
    np.maximum.at(worst, point, distance)
    good = (worst < OUTLIER_SIGMAS) & (length >= VERIFYING_VIEWS)
    if good.sum() < LEAST_FOR_SCALE:
        return 1.0
    square = np.bincount(point, distance**2, count)[good]
    return float(min(1.0, np.sqrt(np.median(square / chi2_isf(0.5, freedom_of(length[good]))))))
