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
What a few successive keyframes say about the internal parameters of a camera in force.

The camera is held while poses and points are adjusted; the score, the derivative of the
likelihood by the internal parameters once poses and points are eliminated, then tells how far the
camera is from that which the images show. It costs a fraction of an estimate, and needs
none of what makes estimates fail: no start for the camera, no choice of models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.information import Information
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.priors import all_fixed
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, Observations, OUTLIER_SIGMAS
from selfcal_ros.calibration.initialisation.initial_structure import planar_start
from selfcal_ros.calibration.initialisation.problem import observations_of
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph, MIN_NOISE_PX
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.estimate import NoEstimate
from selfcal_ros.geometry.two_view_tests import PARALLAX_RATIO
from selfcal_ros.values.tracks import Tracks

#: Tracks per view that a window uses, the longest ones.
WINDOW_TRACKS_PER_VIEW = 120
#: Windows with fewer views or points say too little to be judged.
MIN_VIEWS, MIN_POINTS = 4, 20
#: No path is assumed: even where the calibration's motion was planar, the plane would add one


@dataclass(frozen=True)
class WindowScore:
    """
    Information of one window about some unknowns of the lens, first order.

    Attributes
    ----------
    frames : tuple of int
        Keyframes of the window.
    at : ndarray, shape (k,)
        Parameters of the camera that was supposed.
    step : ndarray, shape (k,)
        From there to the camera that the window shows (one Newton step).
    information : ndarray, shape (k, k)
        Inverse covariance of the step for independent errors.
    dependence : float
        Variance of the step with errors shared within tracks over that with independent errors;
        scatters about 1 where the errors are independent.
    noise_px : float
        Standard deviation of an image coordinate, with that camera.
    misfit : float
        That noise over what the epipolar geometry leaves, which knows no camera.

    """

    frames: tuple
    at: np.ndarray
    step: np.ndarray
    information: np.ndarray
    dependence: float
    noise_px: float
    misfit: float


def window_score(tracks: Tracks, camera: Camera, free: tuple[str, ...],
                 rng: np.random.Generator) -> WindowScore | NoEstimate:
    """
    Score a window of keyframes against a camera.

    Parameters
    ----------
    tracks : Tracks
        Of these keyframes only, in pixels.
    camera : Camera
        That is supposed: the one in force, or where it is thought to be now.
    free : tuple of str
        Those unknowns of the lens that it is to tell of.
    rng : numpy.random.Generator
        For RANSAC.

    Returns
    -------
    WindowScore or NoEstimate
        The latter where the window says nothing.

    """
    found = adjusted(tracks, camera, rng)
    if isinstance(found, NoEstimate):
        return found
    graph, bundle, state, observations = found
    places = state.lens.places(free)
    told = without_camera(bundle, free).information(state)
    covariance = told.covariance[np.ix_(places, places)]
    scale = np.sqrt(np.diag(covariance))
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        return NoEstimate('window_singular')
    information = np.linalg.pinv(covariance / np.outer(scale, scale),
                                 hermitian=True) / np.outer(scale, scale)
    return WindowScore(
        tuple(int(frame) for frame in graph.frames), state.lens.values[places],
        told.influence[:, places].sum(axis=0), information,
        shared_within_tracks(told, observations.point, places, information),
        bundle.sigma_px, bundle.sigma_px / max(graph.noise_px, MIN_NOISE_PX))


def adjusted(tracks: Tracks, camera: Camera, rng: np.random.Generator):
    """
    Adjust poses and points of a window with the camera held.

    Returns
    -------
    ViewGraph, Bundle, SceneState, Observations
        Or a NoEstimate, where the window says nothing.

    """
    graph = build_view_graph(tracks, rng)
    if isinstance(graph, NoEstimate):
        return graph
    if len(graph.frames) < MIN_VIEWS:
        return NoEstimate('window_disconnected')
    if graph.parallax < PARALLAX_RATIO:
        return NoEstimate('window_without_parallax')
    observations = observations_of(graph.tracks, graph.frames)
    observations, _ = observations.select(observations.longest(WINDOW_TRACKS_PER_VIEW))
    if len(observations.track) < MIN_POINTS:
        return NoEstimate('window_few_points', points=len(observations.track))
    fitted = _fit(graph, observations, camera)
    if fitted is None:
        return NoEstimate('window_outside_lens')
    return graph, *fitted


def without_camera(bundle: Bundle, free: tuple[str, ...]) -> Bundle:
    """Return the same adjustment with these unknowns of the lens free."""
    return bundle.with_priors(bundle.priors.without(free))


def _fit(graph, observations: Observations, camera: Camera):
    """Adjust poses and points with the camera held; gross errors go once."""
    fixed = all_fixed(Lens.of(camera))
    bundle = bundle_of(observations, GENERAL, fixed, max(graph.noise_px, MIN_NOISE_PX))
    state = planar_start(graph.pairs, bundle.blocks, observations.xy, camera, exact=False)
    if state is None or not np.isfinite(bundle.cost(state)):
        return None
    state = bundle.optimise(state, iterations=20, tolerance=0.05)
    sigma_px = bundle.noise_sigma(state)
    distance = np.linalg.norm(bundle.residuals(state), axis=1)
    fewer, points = observations.select(distance < OUTLIER_SIGMAS * sigma_px)
    if not np.isfinite(sigma_px) or len(np.unique(fewer.view)) < len(state.path):
        return None
    state = replace(state, points=state.points[points])
    bundle = bundle_of(fewer, GENERAL, fixed, sigma_px)
    state = bundle.optimise(state, iterations=15, tolerance=0.01)
    return bundle.with_sigma(max(bundle.noise_rms(state), MIN_NOISE_PX)), state, fewer


def shared_within_tracks(told: Information, point, places, information) -> float:
    """Variance of sums of influences over tracks, over that of independent errors."""
    points = int(point.max()) + 1
    sums = np.stack([np.bincount(point, column, points)
                     for column in told.influence[:, places].T], axis=1)
    # the step itself is no error: what it shifts, every track shares
    sums -= sums.mean(axis=0)
    square = np.einsum('pi,ij,pj->', sums, information, sums) / told.track_fraction
    return float(square * points / (points - 1) / len(places))
