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

Poses and points are adjusted, without what moves by itself (`window_fit`). The score is the
derivative of the likelihood by the internal parameters, once poses, points and the delay of the
rows are eliminated. It tells how far the camera in force is from that which the images show. It
costs a fraction of an estimate, and needs neither a start for the camera nor a choice of models,
which make estimates fail.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.information import Information
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.shutter import LINE_DELAY
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.initialisation.problem import observations_of
from selfcal_ros.calibration.initialisation.view_graph import (build_view_graph, MIN_NOISE_PX,
                                                               ViewGraph)
from selfcal_ros.calibration.monitoring.view_shapes import shape_of_views
from selfcal_ros.calibration.monitoring.window_fit import fit_window, WindowFit
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.scaled_inverse import scaled_pseudo_inverse
from selfcal_ros.geometry.two_view_tests import PARALLAX_RATIO
from selfcal_ros.values.tracks import Tracks

#: Tracks per view that a window uses, the longest ones.
WINDOW_TRACKS_PER_VIEW = 120
#: Windows with fewer views or points say too little to be judged.
MIN_VIEWS, MIN_POINTS = 4, 20


@dataclass(frozen=True)
class WindowScore:
    """
    Information of one window about some unknowns of the lens.

    Attributes
    ----------
    frames : tuple of int
        Keyframes of the window.
    at : ndarray, shape (k,)
        Parameters of the camera that was supposed.
    step : ndarray, shape (k,)
        From there to the camera that the window shows.
    information : ndarray, shape (k, k)
        Inverse covariance of the step for independent errors.
    variance_inflation : float
        Variance of the step with errors shared within tracks over that with independent errors;
        scatters about 1 where the errors are independent.
    noise_px : float
        Standard deviation of an image coordinate, with that camera.
    misfit : float
        That noise over what the epipolar geometry leaves, which knows no camera.
    still : float
        Share of the tracks that stand still.
    line_delay, line_delay_sigma : float
        Time in which the image is read, in intervals between keyframes.

    """

    frames: tuple[int, ...]
    at: np.ndarray
    step: np.ndarray
    information: np.ndarray
    variance_inflation: float
    noise_px: float
    misfit: float
    still: float = 1.0
    line_delay: float = 0.0
    line_delay_sigma: float = np.inf


def window_score(tracks: Tracks, camera: Camera, free: tuple[str, ...],
                 rng: np.random.Generator, shift_px: float = 0.0) -> WindowScore | NoEstimate:
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
    shift_px : float
        How far each image is shifted by itself, standard deviation; see `image_shift`.

    Returns
    -------
    WindowScore or NoEstimate
        The latter where the window says nothing.

    """
    found = adjusted(tracks, camera, rng, shift_px)
    return found if isinstance(found, NoEstimate) else score_of(*found, camera, free)


def score_of(graph: ViewGraph, window: WindowFit, camera: Camera,
             free: tuple[str, ...]) -> WindowScore | NoEstimate:
    """Score a window that is adjusted; see `window_score`."""
    fit = window.fit
    state, observations, bundle = fit.state, fit.observations, without_camera(fit.bundle, free)
    places = state.lens.places(free)
    linearisation = bundle.linearise(state)
    told = bundle.information(state, linearisation)
    # priors of shifts and of the line delay pull, too: their share is in the gradient alone
    pull = bundle.loss_factors(linearisation)[1]
    every = -pull / told.factor * (told.covariance @ told.system.gradient)
    step = every[places]
    covariance = told.covariance[np.ix_(places, places)]
    scale = np.sqrt(np.diag(covariance))
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        return NoEstimate('window_singular')
    information = scaled_pseudo_inverse(covariance)
    variance_inflation = shared_within_tracks(told, observations.point, places, information)
    shaped = shape_of_views(replace(fit, bundle=bundle), camera.height, variance_inflation)
    if shaped is not None:
        moved, root = (part[places] for part in shaped)
        step = step + moved
        information = scaled_pseudo_inverse(covariance + root @ root.T)
    row = bundle.unknowns.places((LINE_DELAY,))[0]
    supposed = Lens.of(camera).take(free)
    return WindowScore(
        tuple(int(frame) for frame in graph.frames), supposed,
        state.lens.values[places] + step - supposed, information, variance_inflation,
        bundle.sigma_px, bundle.sigma_px / max(graph.noise_px, MIN_NOISE_PX), window.still,
        float(state.line_delay + every[row]),
        float(np.sqrt(told.covariance[row, row])))


def adjusted(tracks: Tracks, camera: Camera, rng: np.random.Generator, shift_px: float = 0.0,
             ) -> tuple[ViewGraph, WindowFit] | NoEstimate:
    """
    Adjust poses and points of a window, without what moves by itself.

    Returns
    -------
    ViewGraph
    WindowFit
        Or a NoEstimate, where the window says nothing.

    """
    graph = build_view_graph(tracks, rng)
    if isinstance(graph, NoEstimate):
        return graph
    if len(graph.frames) < MIN_VIEWS:
        return NoEstimate('window_disconnected')
    if graph.parallax < PARALLAX_RATIO:
        return NoEstimate('window_without_parallax')
    observations = observations_of(graph.tracks, graph.frames).longest(WINDOW_TRACKS_PER_VIEW)
    if len(observations.track) < MIN_POINTS:
        return NoEstimate('window_few_points', points=len(observations.track))
    fitted = fit_window(graph, observations, camera, shift_px)
    return NoEstimate('window_outside_lens') if fitted is None else (graph, fitted)


def without_camera(bundle: Bundle[SceneState], free: tuple[str, ...]) -> Bundle[SceneState]:
    """Return the same adjustment with these unknowns of the lens free."""
    return bundle.with_priors(bundle.priors.without(free))


def shared_within_tracks(told: Information, point: np.ndarray, places: np.ndarray,
                         information: np.ndarray) -> float:
    """Variance of sums of influences over tracks, over that of independent errors."""
    points = int(point.max()) + 1
    sums = np.stack([np.bincount(point, column, points)
                     for column in told.influence[:, places].T], axis=1)
    # the step itself is no error: what it shifts, every track shares
    sums -= sums.mean(axis=0)
    square = np.einsum('pi,ij,pj->', sums, information, sums) / told.track_fraction
    return float(square * points / (points - 1) / len(places))
