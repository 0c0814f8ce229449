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
Planar motion → K: closed-form starts, one maximum-likelihood estimate, and its evidence.

The thesis's chain (fixed points v, i, j, then the pencil of conics; chapters 5 and 6) proposes
one calibration; a sweep over the focal length proposes others. Each proposal is a start for the
same bundle adjustment on a small share of the tracks, the best one is finished on all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.dependence import assess_dependence, Dependence, stretch_excess
from selfcal_ros.calibration.fixed_points import calibrate_estimate, fixed_points
from selfcal_ros.calibration.motion import describe_path
from selfcal_ros.calibration.observability import held_facts, parameter_status
from selfcal_ros.calibration.pair_tests import PARALLAX_RATIO
from selfcal_ros.calibration.refine import (bundle_of, choose_distortion, choose_motion, Fit,
                                            fit_robustly, flatten, leave_out_stretches,
                                            NEARLY_PLANAR, Observations, refit, with_all_points)
from selfcal_ros.calibration.result import (Calibration, FixedPoints, NotCalibrated,
                                            Reconstruction)
from selfcal_ros.calibration.start import planar_start, relative_rotations, spanning_order
from selfcal_ros.calibration.state import (ASPECT, BundleState, CX, CY, holding, K1, K2,
                                           MotionModel, parameter_covariance, Prior,
                                           priors_from_facts, SKEW)
from selfcal_ros.calibration.tracks import Tracks
from selfcal_ros.calibration.view_graph import ViewGraph
from selfcal_ros.geometry.camera import Camera, CameraFacts, PARAMETER_NAMES
from selfcal_ros.geometry.optimise import PointBlocks
from selfcal_ros.geometry.rotation import rotation_vector

#: Focal lengths that are tried, in units of the longer image side: from a wide lens (90°) to a
#: long one (13°), the likely ones first.
FOCAL_SWEEP = (1.0, 0.65, 1.6, 2.6, 0.45, 4.2)
#: A closed form outside this range (the same unit) is no start.
FOCAL_SWEEP_LEAST, FOCAL_SWEEP_MOST = 0.2, 10.0
#: Triplets that the closed form combines.
CLOSED_FORM_TRIPLETS = 6
#: While starts are compared, soft facts keep them from wandering: principal point within so
#: much of the middle (share of the longer side), distortion of ordinary lenses.
START_PRINCIPAL_POINT_SHARE = 0.06
START_K1_SIGMA, START_K2_SIGMA = 0.2, 0.1
#: A start that explains the images this well needs no rival (ratio to the noise of the
#: epipolar geometry, which has more freedom).
GOOD_ENOUGH = 1.25
#: Longer drives are started, and their models chosen, on the stretch of so many successive views
#: that turns most: the time for that does not grow with the drive.
WINDOW_VIEWS = 48
#: Tracks per view that the starts are compared on.
START_TRACKS_PER_VIEW = 40
#: Tracks per view that the estimate uses; more add time and little accuracy.
TRACKS_PER_VIEW = 400
#: Tracks per view on which the distortion model and the planarity are decided.
MODEL_TRACKS_PER_VIEW = 100
#: Fewer degrees of freedom than this cannot check themselves.
MINIMUM_FREEDOM = 12


@dataclass(frozen=True)
class Problem:
    """What every start is judged on."""

    observations: Observations
    pairs: list
    size: tuple[int, int]
    facts: CameraFacts
    noise_px: float

    @property
    def views(self) -> int:
        """Count the views."""
        return int(self.observations.view.max()) + 1

    def window(self) -> Problem:
        """Return the stretch of `WINDOW_VIEWS` that turns most, this problem if it is short."""
        if self.views <= WINDOW_VIEWS:
            return self
        camera = supposed_camera(max(self.size), self.size, self.facts)
        near = [pair for pair in self.pairs if pair.second - pair.first == 1]
        turn = np.zeros(self.views - 1)
        turn[[pair.first for pair in near]] = np.linalg.norm(
            rotation_vector(relative_rotations(near, camera)), axis=1)
        first = int(np.argmax(np.convolve(turn, np.ones(WINDOW_VIEWS - 1), 'valid')))
        last = first + WINDOW_VIEWS
        pairs = [replace(pair, first=pair.first - first, second=pair.second - first)
                 for pair in self.pairs if first <= pair.first and pair.second < last]
        if len(spanning_order(pairs, WINDOW_VIEWS)) < WINDOW_VIEWS - 1:
            return self
        observations = self.observations
        inside = (observations.view >= first) & (observations.view < last)
        within, _ = observations.select(inside)
        return replace(self, pairs=pairs,
                       observations=replace(within, view=within.view - first))


def supposed_camera(focal_px: float, size: tuple[int, int], facts: CameraFacts) -> Camera:
    """Camera with a supposed focal length; what no fact states is what most cameras have."""
    centre = facts.principal_point or ((size[0] - 1) / 2, (size[1] - 1) / 2)
    aspect = facts.aspect_ratio or 1.0
    return Camera([[focal_px, facts.skew or 0.0, centre[0]], [0, focal_px * aspect, centre[1]],
                   [0, 0, 1]], width=size[0], height=size[1])


def start_priors(problem: Problem) -> dict[int, Prior]:
    """Facts, and for the starts alone what most cameras have."""
    priors = priors_from_facts(problem.facts)
    longer = max(problem.size)
    usual = {CX: Prior((problem.size[0] - 1) / 2, START_PRINCIPAL_POINT_SHARE * longer),
             CY: Prior((problem.size[1] - 1) / 2, START_PRINCIPAL_POINT_SHARE * longer),
             K1: Prior(0.0, START_K1_SIGMA), K2: Prior(0.0, START_K2_SIGMA),
             ASPECT: Prior(1.0, 0.1), SKEW: Prior(0.0, 0.02 * longer)}
    return {**usual, **priors}


def starts(problem: Problem, proposals: Iterator[Camera]) -> Iterator[tuple[BundleState, float]]:
    """
    Follow proposed calibrations to their nearest optimum on a share of the tracks.

    Yields
    ------
    BundleState
        Without the points of the other tracks.
    float
        Robust estimate of the noise there, pixels.

    """
    mask = problem.observations.longest(START_TRACKS_PER_VIEW)
    few, _ = problem.observations.select(mask)
    priors = start_priors(problem)
    blocks = PointBlocks(few.point, few.view)
    coarse = bundle_of(few, NEARLY_PLANAR, priors, 10 * problem.noise_px)
    fine = bundle_of(few, NEARLY_PLANAR, priors, 1.5 * problem.noise_px)
    for camera in proposals:
        candidates = [planar_start(problem.pairs, blocks, few.xy, camera, exact)
                      for exact in (True, False)]
        costs = [np.inf if c is None else coarse.cost(c) for c in candidates]
        if not np.isfinite(min(costs)):
            continue
        chosen = holding(candidates[int(np.argmin(costs))], priors)
        # a coarse scale first: far from the optimum most residuals are large
        state = coarse.optimise(chosen, 8, 1.0)
        state = fine.optimise(state, 12, 1.0)
        yield state, fine.noise_sigma(state)


def closed_form(problem: Problem) -> list[Camera]:
    """
    Calibration of the thesis's chain: horizon, v, circular points, pencil (chapters 5 and 6).

    Empty where it does not apply: distortion and uneven ground upset it, which the bundle
    adjustment does not mind.
    """
    few, _ = problem.observations.select(problem.observations.longest(START_TRACKS_PER_VIEW))
    tracks = Tracks(few.view, few.point, few.xy, problem.size)
    estimate = fixed_points(tracks, limit=CLOSED_FORM_TRIPLETS)
    found = calibrate_estimate(estimate, problem.facts) if estimate else None
    if not found:
        return []
    K = np.triu(found.K)
    focal = K[0, 0] / max(problem.size)
    if not FOCAL_SWEEP_LEAST < focal < FOCAL_SWEEP_MOST:
        return []
    return [Camera(K / K[2, 2], width=problem.size[0], height=problem.size[1])]


def best_start(problem: Problem, first: list[Camera]) -> BundleState | None:
    """
    Choose the start that explains the images best.

    Parameters
    ----------
    problem : Problem
    first : list of Camera
        Proposals to try before the sweep over the focal length.

    Returns
    -------
    BundleState or None

    """
    longer = max(problem.size)

    def proposals():
        yield from first
        for share in FOCAL_SWEEP:
            yield supposed_camera(share * longer, problem.size, problem.facts)

    best, best_noise = None, np.inf
    for state, noise in starts(problem, proposals()):
        if noise < best_noise:
            best, best_noise = state, noise
        if best_noise < GOOD_ENOUGH * problem.noise_px:
            break
    return best


def calibrate_planar(graph: ViewGraph, size: tuple[int, int], facts: CameraFacts,
                     proposals: list[Camera]) -> Calibration | NotCalibrated:
    """
    Calibrate from planar motion.

    Parameters
    ----------
    graph : ViewGraph
    size : (int, int)
        Width and height of the image, pixels.
    facts : CameraFacts
    proposals : list of Camera
        Calibrations to start from; the sweep over the focal length follows.

    Returns
    -------
    Calibration or NotCalibrated

    """
    frames = tuple(int(f) for f in graph.frames)

    def refuse(reason, advice='', motion='unknown', status=None):
        return NotCalibrated(reason, advice, motion, frames, facts, status or {})

    observations = observations_of(graph.tracks, graph.frames)
    if len(graph.frames) < 3:
        return refuse(f'Only {len(graph.frames)} images share points; planar motion needs at '
                      'least three.', 'Record a longer drive with turns.')
    if graph.parallax < PARALLAX_RATIO:
        return refuse('One homography explains every pair of images to within the noise '
                      f'({graph.parallax:.1f} times it): the camera only rotated, or all points '
                      'lie on one plane.',
                      'Planar self-calibration needs a camera that also moves, before a scene '
                      'with depth.', 'rotation')
    problem = Problem(observations, graph.pairs, size, facts, max(graph.noise_px, 0.02))
    freedom = bundle_of(observations, MotionModel(), priors_from_facts(facts),
                        1.0).degrees_of_freedom
    if freedom < MINIMUM_FREEDOM:
        return refuse(f'{len(observations.track)} points in {len(frames)} images leave '
                      f'{freedom} degrees of freedom; the estimate could not be checked.',
                      'More points or more images are needed.')
    window = problem.window()
    start = best_start(window, [*proposals, *closed_form(window)])
    if start is None:
        return refuse('No focal length between 0.45 and 4.2 times the image width gives a '
                      'consistent reconstruction.')
    medium, _ = window.observations.select(window.observations.longest(MODEL_TRACKS_PER_VIEW))
    state = with_all_points(start, medium)
    if state is None:
        return refuse('The distortion of the best start cannot be undone over the whole image.')
    model = choose_model(window, medium, state)
    problem = replace(problem, facts=model.facts)
    state = extended(problem, model)
    if state is None:
        return refuse(f'The distortion found ({model.facts.distortion}) cannot be undone over '
                      'the whole image.', 'State a simpler distortion model.')
    fit = fit_robustly(observations, state, model.fit.bundle.motion,
                       priors_from_facts(model.facts), model.fit.bundle.sigma_px)
    return conclude(fit, model, problem, graph)


def extended(problem: Problem, model: Model) -> BundleState | None:
    """Start for all views and tracks from what was found on a share of them."""
    found = model.fit.state
    if len(found.views) == problem.views:
        return with_all_points(found, problem.observations)
    few, _ = problem.observations.select(problem.observations.longest(START_TRACKS_PER_VIEW))
    bundle = bundle_of(few, model.fit.bundle.motion, priors_from_facts(model.facts),
                       10 * problem.noise_px)
    starts = [planar_start(problem.pairs, bundle.blocks, few.xy, found.camera(), exact)
              for exact in (True, False)]
    starts = [state if state is None or not model.exact else flatten(state) for state in starts]
    costs = [np.inf if state is None else bundle.cost(state) for state in starts]
    if not np.isfinite(min(costs)):
        return None
    state = bundle.optimise(holding(starts[int(np.argmin(costs))], bundle.priors), 15, 1.0)
    return with_all_points(state, problem.observations)


@dataclass(frozen=True)
class Model:
    """What was decided on a share of the tracks: distortion, and how planar the motion is."""

    fit: Fit
    facts: CameraFacts
    exact: bool
    stretches: tuple[float, np.ndarray]


def choose_model(problem: Problem, observations: Observations, state: BundleState) -> Model:
    """Choose the distortion model, if the facts leave it open, and how planar the motion is."""
    facts = problem.facts
    soft = start_priors(problem)
    fit = fit_robustly(observations, state, NEARLY_PLANAR, soft, 1.5 * problem.noise_px)
    if facts.distortion == 'auto':
        dependence = dependence_of(fit, problem.size).inflation**2

        def determined(trial: Fit, trial_facts: CameraFacts) -> bool:
            covariance = parameter_covariance(trial.bundle.covariance(trial.state),
                                              trial.state.intrinsics) * dependence
            status = parameter_status(trial.state.camera(*problem.size), covariance, trial_facts)
            return 'unobservable' not in status.values()

        fit, facts = choose_distortion(fit, facts, determined)
    else:
        fit = replace(fit, bundle=bundle_of(fit.observations, NEARLY_PLANAR,
                                            priors_from_facts(facts), fit.bundle.sigma_px))
        fit = refit(fit, NEARLY_PLANAR)
    known = dependence_of(fit, problem.size).inflation**2
    fit, exact = choose_motion(fit, known)
    independent = fit.bundle.covariance(fit.state)[:9, :9]
    return Model(fit, facts, exact,
                 stretch_excess(*leave_out_stretches(fit), independent, known))


def dependence_of(fit: Fit, size: tuple[int, int]) -> Dependence:
    """Assess how far the residuals of a fit are from independent."""
    return assess_dependence(fit.bundle.evidence(fit.state), fit.observations.point,
                             fit.observations.xy, size)


def observations_of(tracks: Tracks, frames: np.ndarray) -> Observations:
    """Index the observations of tracks, no more than `TRACKS_PER_VIEW` of the longest a view."""
    tracks = tracks.with_at_least(2)
    identity, point = np.unique(tracks.track, return_inverse=True)
    result = Observations(np.searchsorted(frames, tracks.frame), point, tracks.xy, identity)
    return result.select(result.longest(TRACKS_PER_VIEW))[0]


def conclude(fit: Fit, model: Model, problem: Problem, graph: ViewGraph,
             ) -> Calibration | NotCalibrated:
    """Judge an optimum: what do the data determine, and what does the motion lack?"""
    facts, state = problem.facts, fit.state
    frames = tuple(int(f) for f in graph.frames)
    camera = state.camera(*problem.size)
    dependence = dependence_of(fit, problem.size).with_stretches(model.stretches)
    covariance = parameter_covariance(dependence.covariance, state.intrinsics)
    held = held_facts(facts)
    for k, name in enumerate(PARAMETER_NAMES):
        if name in held:
            covariance[k] = covariance[:, k] = 0
    path = describe_path(state, model.exact)
    status = parameter_status(camera, covariance, facts)
    residuals = fit.bundle.residuals(state)
    rms = float(np.sqrt(np.nanmean(np.sum(residuals**2, axis=1))))
    missing = [name for name in ('fx', 'fy', 'cx', 'cy', 'skew') if status[name] == 'unobservable']
    if missing or path.refusal:
        reason, advice = path.explain(missing, camera, facts)
        return NotCalibrated(reason, advice, path.motion, frames, facts, status)
    axis, K = state.mount[:, 2], camera.K
    return Calibration(
        camera=camera, covariance=covariance, status=status, held_by=held, motion=path.motion,
        facts=facts, frames=frames, reprojection_rms_px=rms,
        noise_sigma_px=fit.bundle.sigma_px, observation_count=len(fit.observations.view),
        outlier_count=fit.outliers + graph.rejected,
        reconstruction=Reconstruction(graph.frames, state.cam_from_world(),
                                      fit.observations.track, state.points),
        fixed_points=FixedPoints(np.linalg.solve(K.T, axis), K @ axis,
                                 K @ (state.mount[:, 0] + 1j * state.mount[:, 1])),
        notes=path.notes + dependence.notes(), residuals=residuals)
