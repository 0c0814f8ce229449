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
What of a window a still scene and any camera explain.

Things that move by themselves, and rows that are read one after the other, look like another
camera to first order. So before a window is scored, its tracks are judged as wholes, with a camera
that may be another one, and with a line delay: what is not explained then is not the camera's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.clock import Clock, was_turned_upright
from selfcal_ros.calibration.bundle.image_shift import shifts
from selfcal_ros.calibration.bundle.inliers import verified
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL, MotionModel
from selfcal_ros.calibration.bundle.priors import all_fixed, Prior, Priors
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, Observations,
                                                       OUTLIER_SIGMAS, RobustFit,
                                                       with_all_points)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import SHARE_OF_COST, TO_CHOOSE, TO_MEASURE
from selfcal_ros.calibration.initialisation.initial_structure import planar_start
from selfcal_ros.calibration.initialisation.view_graph import MIN_NOISE_PX, ViewGraph
from selfcal_ros.calibration.moving.track_judgement import judged
from selfcal_ros.geometry.camera import Camera

#: Any camera: by so much of the focal length it may differ from the supposed one.
FOCAL_FRACTION, CENTRE_FRACTION = 0.2, 0.1
#: Any shutter: readout time, in intervals between keyframes.
READOUT = 0.3
#: Turns of fitting and judging, unless no more than this share of the tracks changes sides.
ROUNDS, SETTLED = 4, 0.02
#: The rows' displacements are renewed so often at most.
RENEWALS = 3
#: Variance of the sum over a track over that of independent errors: trackers drift.
TRACK_SPREAD = 2.0


@dataclass(frozen=True)
class WindowFit:
    """
    What of a window is a still scene, with the camera that it looks like.

    Attributes
    ----------
    fit : RobustFit
        The camera held, where these images prefer it; the line delay free.
    still : float
        Share of the tracks that stand still, of all that were judged.

    """

    fit: RobustFit
    still: float


def fit_window(graph: ViewGraph, observations: Observations, camera: Camera,
               shift_px: float = 0.0) -> WindowFit | None:
    """
    Adjust a window, sort out what moves by itself, and hold the camera that explains the rest.

    Parameters
    ----------
    graph : ViewGraph
    observations : Observations
    camera : Camera
        To begin with.
    shift_px : float
        How far each image is shifted by itself, standard deviation; see `image_shift`.

    Returns
    -------
    WindowFit or None
        None where the camera does not see the points, or too few stand still.

    """
    lens, sigma_px = Lens.of(camera), max(graph.noise_px, MIN_NOISE_PX)
    motion = replace(GENERAL, shift=shifts(shift_px)) if shift_px else GENERAL
    bundle = bundle_of(observations, motion, all_fixed(lens), sigma_px)
    state = planar_start(graph.pairs, bundle.blocks, observations.xy, camera, exact=False)
    if state is None or not np.isfinite(bundle.cost(state)):
        return None
    state = bundle.optimise(state, iterations=12, tolerance=SHARE_OF_COST * bundle.cost(state))
    observations = _timed(observations, clock_of(graph, camera)).read_in_rows()
    found = _still(observations, state, motion, _any_camera(lens), sigma_px)
    if found is None:
        return None
    kept, state, still, sigma_px = found
    for _ in range(RENEWALS):
        bundle = bundle_of(kept, motion, _any_camera(lens), sigma_px)
        state = bundle.optimise(state, iterations=15, tolerance=TO_MEASURE)
        renewed = kept.displaced(state)
        if renewed.is_displaced_like(kept, state, 0.1 * sigma_px):
            break
        kept = renewed
    bundle = bundle.with_priors(all_fixed(state.lens))
    sigma_px = max(bundle.noise_rms(state), MIN_NOISE_PX)
    return WindowFit(RobustFit(bundle.with_sigma(sigma_px), state, kept,
                               len(observations.view) - len(kept.view)), still)


def clock_of(graph: ViewGraph, camera: Camera) -> Clock:
    """Tell when the keyframes were taken, in usual intervals between them."""
    stamps = graph.tracks.stamps_ns or {}
    taken = np.array([stamps.get(int(frame), 0) for frame in graph.frames])
    stamped = bool((np.diff(taken) > 0).all())
    times = (taken - taken[0]) * 1e-9 if stamped else np.asarray(graph.frames, float)
    times, interval = times - times[0], float(np.median(np.diff(times)))
    axis = 0 if was_turned_upright((camera.width, camera.height)) else 1
    return Clock(times / interval, (camera.width, camera.height)[axis], interval, stamped,
                 Prior(0.0, READOUT), axis)


def _timed(observations: Observations, clock: Clock) -> Observations:
    """Add when the views were taken; neighbours are seconds away, and clocks count intervals."""
    beside = observations.neighbours
    if beside is not None:
        beside = beside * [1, 1, 1 / clock.unit] if clock.is_stamped else None
    return replace(observations, clock=clock, neighbours=beside)


def _any_camera(lens: Lens) -> Priors:
    """Let focal length and principal point be any near those of a lens."""
    f = lens['f']
    return all_fixed(lens).updated({
        'f': Prior(f, FOCAL_FRACTION * f), 'cx': Prior(lens['cx'], CENTRE_FRACTION * f),
        'cy': Prior(lens['cy'], CENTRE_FRACTION * f)})


def _still(observations: Observations, state: SceneState, motion: MotionModel, priors: Priors,
           sigma_px: float) -> tuple[Observations, SceneState, float, float] | None:
    """Sort out what stands still: observations, state, their share of the tracks, and noise."""
    kept, still = observations.displaced(state), np.ones(len(observations.track), bool)
    for _ in range(ROUNDS):
        bundle = bundle_of(kept, motion, priors, sigma_px)
        state = bundle.optimise(state, iterations=12, tolerance=TO_CHOOSE)
        sigma_px = max(bundle.noise_sigma(state), MIN_NOISE_PX)
        placed = with_all_points(state, observations)
        if placed is None or not np.isfinite(sigma_px):
            return None
        shown = observations.displaced(placed)
        every = bundle_of(shown, motion, priors, sigma_px)
        placed = every.refine_points(placed)
        distance = np.nan_to_num(np.linalg.norm(every.residuals(placed), axis=1) / sigma_px,
                                 nan=np.inf)
        test = judged(observations.point, distance, TRACK_SPREAD)
        before, still = still, np.where(test.tested, test.explained, test.lost == 0)
        keep = still[observations.point] & (distance < OUTLIER_SIGMAS)
        kept, points = shown.select(keep & verified(observations.point, keep))
        if len(np.unique(kept.view)) < len(state.path):
            return None
        state = replace(placed, points=placed.points[points])
        if np.mean(before != still) <= SETTLED:
            break
    return kept, state, float(np.mean(still)), sigma_px
