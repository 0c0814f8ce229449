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
"""Search of a start: the thesis's closed form first, then a sweep over the focal length."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.affine.modulus import MIN_VIEWS, propose_camera
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.priors import with_fixed
from selfcal_ros.calibration.bundle.robust_fit import bundle_of
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_GO_ON
from selfcal_ros.calibration.initialisation.affine_start import affine_starts
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem, start_priors
from selfcal_ros.calibration.initialisation.supposed_lens import (is_strong, likely_focal_lengths,
                                                                  supposed_camera)
from selfcal_ros.calibration.planar.fixed_points import calibrate_estimate, fixed_points
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.values.tracks import Tracks

#: Focal lengths that are tried, in units of the longer image side: from a wide lens (90°) to a
#: long one (13°), the likely ones first.
FOCAL_SWEEP = (1.0, 0.65, 1.6, 2.6, 0.45, 4.2)
#: A closed form outside this range (the same unit) is no start.
FOCAL_SWEEP_MIN, FOCAL_SWEEP_MAX = 0.2, 10.0
#: Triplets that the closed form combines.
CLOSED_FORM_TRIPLETS = 6
#: A start that explains the images this well needs no rival (ratio to the noise of the
#: epipolar geometry, which has more freedom).
GOOD_ENOUGH = 1.25
#: General views up to which the modulus constraint proposes a start where no other stands.
MODULUS_MAX_VIEWS = 8
#: Tracks per view that the starts are compared on.
START_TRACKS_PER_VIEW = 40
#: A plane that nobody stated, and whose first start needs a rival, is given up for free motion.
#: The noise that free motion leaves must be below the first (the same unit), and below this share
#: of what the plane leaves. Its path must leave every plane by the last (radians): those of
#: vehicles leave it by half of that, even from bad starts.
STILL_FREE, CLEARLY_LESS, FAR_OUT_RAD = 4.0, 0.75, np.radians(10.0)
#: Where free motion comes to the focal length of the best start, but for the first share, what
#: the plane leaves is the ground's: no other focal length needs to be tried. The noise that free
#: motion leaves must be below the second (the same unit): gross errors are among the tracks yet.
ALIKE, VOUCHED = 0.02, 1.5


def starts(problem: SelfCalibrationProblem, proposals: Iterable[Camera], as_affine: bool = False,
           ) -> Iterator[tuple[SceneState, float]]:
    """
    Follow proposed calibrations to their nearest optimum on a share of the tracks.

    Parameters
    ----------
    problem : SelfCalibrationProblem
    proposals : iterable of Camera
    as_affine : bool
        Begin with all views at once, as affine images; with pairs of them by default.

    Yields
    ------
    SceneState
        Without the points of the other tracks.
    float
        Robust estimate of the noise there, pixels.

    """
    few = problem.observations.longest(START_TRACKS_PER_VIEW)
    blocks = PointBlocks(few.point, few.view)
    for camera in proposals:
        priors = start_priors(problem, camera)
        coarse = bundle_of(few, problem.motion, priors, 10 * problem.noise_px)
        fine = bundle_of(few, problem.motion, priors, 1.5 * problem.noise_px)
        candidates = (affine_starts(blocks, few.xy, camera) if as_affine
                      else problem.starts(blocks, few.xy, camera))
        costs = [coarse.cost(state) for state in candidates]
        if not np.isfinite(min(costs, default=np.inf)):
            continue
        # affine images leave open which way round the depths are; what is right shows in the end
        for chosen in candidates if as_affine else [candidates[int(np.argmin(costs))]]:
            # a coarse scale first: far from the optimum most residuals are large
            state = coarse.optimise(with_fixed(chosen, priors), iterations=8,
                                    tolerance=TO_GO_ON)
            state = fine.optimise(state, iterations=12, tolerance=TO_GO_ON)
            yield state, fine.noise_sigma(state)


def closed_form(problem: SelfCalibrationProblem) -> list[Camera]:
    """
    Calibration of the thesis's chain: horizon, v, circular points, pencil (chapters 5 and 6).

    Empty where it does not apply: distortion and uneven ground upset it, which the bundle
    adjustment does not mind.
    """
    few = problem.observations.longest(START_TRACKS_PER_VIEW)
    tracks = Tracks(few.view, few.point, few.xy, problem.size)
    estimate = fixed_points(tracks, limit=CLOSED_FORM_TRIPLETS)
    found = calibrate_estimate(estimate, problem.facts) if estimate else None
    if not found:
        return []
    K = np.triu(found.K)
    focal = K[0, 0] / max(problem.size)
    if not FOCAL_SWEEP_MIN < focal < FOCAL_SWEEP_MAX:
        return []
    return [Camera(K / K[2, 2], width=problem.size[0], height=problem.size[1])]


def best_start(problem: SelfCalibrationProblem, first: list[Camera],
               ) -> tuple[SceneState | None, float] | NoEstimate:
    """
    Choose the start that explains the images best.

    Parameters
    ----------
    problem : SelfCalibrationProblem
    first : list of Camera
        Proposals to try before the closed form and the sweep over the focal length.

    Returns
    -------
    SceneState or None
    float
        Robust estimate of the noise there, pixels.
        No estimate where a plane was supposed that the motion leaves.

    """
    best, best_noise, doubted = None, np.inf, False
    for state, noise in _followed(problem, first):
        if noise < best_noise:
            best, best_noise = state, noise
        # of a plane every start leaves little, also with poses of the plane's mirror image
        if (problem.flat is None and best_noise < GOOD_ENOUGH * problem.noise_px
                and best is not None and _is_plausible(best, problem.size)):
            break
        if not doubted and problem.supposes_plane and problem.motion.keeps_plane:
            doubted = True
            free, free_px = _free_start(problem, _proposals(problem, first))
            if free is None:
                continue
            off_plane = _off_plane_rad(free)
            if free_px <= CLEARLY_LESS * best_noise and off_plane > FAR_OUT_RAD:
                return NoEstimate('not_planar', tilt_deg=float(np.degrees(off_plane)),
                                  motion='general')
            if best is not None and _vouches(free, free_px, best, problem):
                break
    return best, best_noise


def _followed(problem: SelfCalibrationProblem, first: list[Camera],
              ) -> Iterator[tuple[SceneState, float]]:
    """Follow one proposal by pairs of views, by affine images if motion is free, then others."""
    others = _proposals(problem, first)
    one = [next(others)]
    yield from _first_followed(problem, one[0])
    if not problem.motion.keeps_plane and problem.flat is None and problem.pivot is None:
        yield from starts(problem, one, as_affine=True)
    yield from starts(problem, others)


def _first_followed(problem: SelfCalibrationProblem, camera: Camera,
                    ) -> list[tuple[SceneState, float]]:
    """Follow a first proposal, once for who supposes a plane and who searches free motion."""
    if problem.flat is not None or problem.pivot is not None:
        return list(starts(problem, [camera]))
    question = (starts, problem.motion, problem.facts, problem.bend, problem.noise_px,
                camera.model, tuple(camera.parameters.tolist()))
    remembered = problem.observations.remembered
    if question not in remembered:
        remembered[question] = list(starts(problem, [camera]))
    found: list[tuple[SceneState, float]] = remembered[question]
    return found


def _proposals(problem: SelfCalibrationProblem, first: list[Camera]) -> Iterator[Camera]:
    """Propose cameras: `first`, the sweep with the closed form in it, the modulus constraint."""
    yield from first
    for k, focal_px in enumerate(likely_focal_lengths(problem.size, problem.bend, FOCAL_SWEEP)):
        # an ordinary lens is tried in less time than the closed form takes
        if k == 1 and problem.motion.keeps_plane and problem.flat is None \
                and not is_strong(problem.bend):
            yield from closed_form(problem)
        yield supposed_camera(focal_px, problem.size, problem.facts, problem.bend)
    if is_strong(problem.bend):
        # far scenes show little of the bend, and it may be an illusion
        for focal_px in likely_focal_lengths(problem.size, (), FOCAL_SWEEP):
            yield supposed_camera(focal_px, problem.size, problem.facts)
    # a principal point far off the middle, which the sweep does not suppose
    if not problem.motion.keeps_plane and problem.flat is None \
            and MIN_VIEWS <= problem.views <= MODULUS_MAX_VIEWS \
            and not is_strong(problem.bend):
        yield from _by_modulus(problem)


def _by_modulus(problem: SelfCalibrationProblem) -> list[Camera]:
    """Propose cameras by the modulus constraint, once for all searches on these observations."""
    few, question = problem.observations, (propose_camera, problem.size, problem.facts)
    if question not in few.remembered:
        few.remembered[question] = propose_camera(
            Tracks(few.view, few.point, few.xy, problem.size), problem.size, problem.facts)
    found: list[Camera] = few.remembered[question]
    return found


def _free_start(problem: SelfCalibrationProblem, proposals: Iterator[Camera],
                ) -> tuple[SceneState | None, float]:
    """Follow the first proposal by free motion; None where that explains little."""
    if problem.flat is not None or problem.pivot is not None:
        return None, np.inf
    motion = replace(GENERAL.with_images_of(problem.motion), parallel=problem.motion.parallel)
    found = _first_followed(replace(problem, motion=motion), next(proposals))
    free, noise_px = found[0] if found else (None, np.inf)
    if (free is None or not _is_plausible(free, problem.size)
            or noise_px > STILL_FREE * problem.noise_px):
        return None, np.inf
    return free, noise_px


def _off_plane_rad(free: SceneState) -> float:
    """How far free motion leaves every plane."""
    R = free.path.rotations()
    # turns against the first view are all about one axis, if there is a plane
    turns = rotation_vector(R @ R[0].T)
    across = np.linalg.svd(turns, compute_uv=False)[1:]
    return float(np.sqrt(np.sum(across**2) / len(turns)))


def _vouches(free: SceneState, noise_px: float, planar: SceneState,
             problem: SelfCalibrationProblem) -> bool:
    """Tell whether free motion explains the images, by the camera that a start in a plane has."""
    apart = abs(np.log(free.lens['f'] / planar.lens['f']))
    return bool(noise_px < VOUCHED * problem.noise_px and apart < ALIKE
                and free.lens.model is planar.lens.model
                and _is_plausible(planar, problem.size))


def _is_plausible(state: SceneState, size: tuple[int, int]) -> bool:
    """Whether the principal point is in the image: else a rival may explain it better."""
    return 0 < state.lens['cx'] < size[0] and 0 < state.lens['cy'] < size[1]
