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
A camera that only rotates, such as a pan-tilt head (thesis 3.1.4).

Image homographies are infinite homographies, so that omega* = H omega* H^T starts the camera in
closed form. The last word is a bundle adjustment over rotations, camera, lens distortion and the
directions of the points, with its covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from selfcal_ros.calibration.affine.infinite_homography_calibration import (
    camera_from_homographies)
from selfcal_ros.calibration.bundle.image_shift import shifts
from selfcal_ros.calibration.bundle.lens import to_parameters
from selfcal_ros.calibration.bundle.motion import MotionModel, ROTATION
from selfcal_ros.calibration.bundle.priors import (ORDINARY_DECENTRING, priors_from_facts,
                                                   with_fixed)
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, Observations,
                                                       OUTLIER_SIGMAS, RobustFit)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_COMPARE_ROUGHLY, TO_MEASURE
from selfcal_ros.calibration.bundle.zoom import ZoomModel
from selfcal_ros.calibration.estimators.acceptance import (deviates_too_far, most_agree,
                                                           too_wide, unchecked)
from selfcal_ros.calibration.estimators.image_shift_choice import (are_shifts,
                                                                   are_within_crop, LEAST_GAIN,
                                                                   LEFT_AT_LAST,
                                                                   LEFT_BESIDE_ROWS,
                                                                   shift_evidence,
                                                                   shift_findings)
from selfcal_ros.calibration.estimators.lens_selection import choose_lens, LensDecision
from selfcal_ros.calibration.estimators.rotation_corrections import rotation_corrections
from selfcal_ros.calibration.estimators.rotation_start import (best_rotation_start,
                                                               RotationProblem)
from selfcal_ros.calibration.estimators.shutter_choice import (choose_shutter, readout_of,
                                                               row_motion_of, shutter_findings,
                                                               ShutterDecision, timed)
from selfcal_ros.calibration.estimators.sliding_images import only_slides
from selfcal_ros.calibration.estimators.supported_optimum import verdict_on_facts
from selfcal_ros.calibration.estimators.view_effects_choice import left_otherwise_px
from selfcal_ros.calibration.estimators.zoom_selection import (seems_to_vary, settle_zoom,
                                                               START_SIGMA)
from selfcal_ros.calibration.initialisation.rotation_homographies import (MIN_MATCHES,
                                                                          rotation_homographies)
from selfcal_ros.calibration.observability import (held_facts, LEAST_NOISE_PX, parameter_status,
                                                   without_held)
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.path_precision import pose_precision
from selfcal_ros.calibration.uncertainty.assessed_estimate import AssessedEstimate
from selfcal_ros.calibration.uncertainty.focal_course import course_findings, focal_course
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.fundamental import eight_point, PairMatches, refine_general
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import rms_length
from selfcal_ros.values.parameter_status import unobservable_among
from selfcal_ros.values.tracks import Tracks

#: The camera only rotated if that leaves no more than so many times the noise of the epipolar
#: geometry, which has more freedom.
ROTATION_RATIO = 2.0
#: Fewer observations to spare than this cannot check themselves.
MIN_FREEDOM = 12
#: Noise below this is rounding, which tells nothing apart.
MIN_NOISE_PX = 1e-3
#: A focal length beyond so many image sides is a camera at infinity.
MAX_FOCAL_FRACTION = 30.0
#: A skew beyond this share of the focal length is no camera's.
MAX_SKEW_FRACTION = 0.2
#: Fewer views tell too little of shifts, and these leave no more than so many times the noise of
#: epipolar geometry, which they do not touch.
MIN_VIEWS_OF_SHIFTS, MAX_NOISE_OF_SHIFTS = 6, 1.1
#: Views of a stretch that tells whether there is any hope of a rotation, and tracks of a view.
STRETCH, STRETCH_TRACKS_PER_VIEW = 24, 100
#: Refusals that say that there was no rotation.
_NOT_ROTATED = ('views_not_rotated', 'views_rotated_within_noise')


def epipolar_noise(tracks: Tracks, frames: Sequence[int] | np.ndarray) -> float:
    """Median noise of a coordinate by general F between the first of frames and the others."""
    pairs = [tracks.matches(int(frames[0]), int(f))[1:] for f in frames[1:]]
    pairs = [pair for pair in pairs if len(pair[0]) >= MIN_MATCHES]
    if not pairs:
        return np.nan
    data = PairMatches.from_pixels(pairs)
    F, cost, _, _ = refine_general(data, eight_point(data))
    return float(np.median(np.sqrt(cost / (4 * np.maximum(data.counts - 7, 1)))))


@dataclass(frozen=True)
class RotationFit:
    """
    The best explanation of views by rotations alone, not yet judged.

    Attributes
    ----------
    problem : RotationProblem
    motion : MotionModel
        Rotations, with a focal length that varies perhaps.
    start : SceneState
        The best start, with a simple lens.
    start_px : float
        Standard deviation of what it leaves, robustly.
    noise_px : float
        Standard deviation of an image coordinate by epipolar geometry, which knows no rotations.

    """

    problem: RotationProblem
    motion: MotionModel
    start: SceneState
    start_px: float
    noise_px: float

    @cached_property
    def lens(self) -> LensDecision:
        """The lens that fits best; it is looked for once, when it is asked for."""
        lens = _richest_lens(self.start, self.problem, self.motion)
        return self._by_shifts(lens) or lens

    def _by_shifts(self, lens: LensDecision) -> LensDecision | None:
        """Return the lens of images that are shifted, each by itself, if these are."""
        problem, fit = self.problem, lens.fit
        if fit.motion.zoom is not None or len(self.frames) < MIN_VIEWS_OF_SHIFTS:
            return None
        if shift_evidence(fit, problem.size)[1] <= LEAST_GAIN:
            return None
        # neither rows read in turn nor a zoom explain as much
        otherwise = self.decided(fit).fit
        in_turn = otherwise.observations.shutter is not None
        sigma_px, gain = shift_evidence(otherwise, problem.size)
        if gain <= LEAST_GAIN:
            return None
        instants = tuple(self.frames.astype(float).tolist())
        limit_px = min((LEFT_BESIDE_ROWS if in_turn else LEFT_AT_LAST)
                       * left_otherwise_px(otherwise, instants, gain),
                       MAX_NOISE_OF_SHIFTS * max(self.noise_px, LEAST_NOISE_PX))
        shifted = _richest_lens(self.start, problem, replace(self.motion,
                                                             shift=shifts(sigma_px)))
        # rows that are read in turn look like shifts until they are known to be
        found = self.decided(shifted.fit).fit
        are_found = are_shifts(found) and are_within_crop(found, problem.size)
        return shifted if found.bundle.sigma_px < limit_px and are_found else None

    def decided(self, fit: RobustFit) -> ShutterDecision:
        """Tell how rows are read; in turn they leave more than rotations do."""
        problem = self.problem
        return choose_shutter(_without_gross_errors(fit, self), problem.observed, problem.facts,
                              problem.size)

    @property
    def frames(self) -> np.ndarray:
        """Frame of each view, shape (V,)."""
        return self.problem.frames

    @property
    def left_px(self) -> float:
        """Standard deviation of what the rotations leave, robustly."""
        fit = self.lens.fit
        return fit.bundle.noise_sigma(fit.state)


def calibrate_rotating(tracks: Tracks, size: tuple[int, int], facts: CameraFacts | None = None,
                       may_zoom: bool = True, may_miss: bool = False,
                       ) -> Calibration | NoEstimate:
    """
    Calibrate a camera that only rotates.

    Parameters
    ----------
    tracks : Tracks
        Pixels, distorted or not; gross errors should be few.
    size : (int, int)
        Width and height, pixels.
    facts : CameraFacts, optional
    may_zoom : bool
        Whether the focal length may vary. A step along the axis looks like a zoom: where the
        camera may have moved, it may not.
    may_miss : bool
        Whether the camera may miss the point that it turns about: the sigmas allow for it then.

    Returns
    -------
    Calibration or NoEstimate
        No estimate where the views show parallax, or where their rotations leave a
        parameter open; the reason says which rotation would help.

    """
    facts = CameraFacts() if facts is None else facts
    found = fit_rotations(tracks, size, facts, varying=facts.focal == 'varying')
    return (found if isinstance(found, NoEstimate)
            else judge_rotations(found, may_zoom, may_miss))


def fit_rotations(tracks: Tracks, size: tuple[int, int], facts: CameraFacts,
                  hopeless_px: float = np.inf, varying: bool = False,
                  ) -> RotationFit | NoEstimate:
    """
    Explain views by rotations alone; see `calibrate_rotating`.

    Where the first start leaves more than `hopeless_px` no other is tried. Nor is it where a
    stretch of the views leaves so much, or a share of the tracks.
    """
    tracks = tracks.with_at_least(2)
    if len(tracks.frames) < 2:
        return NoEstimate('too_few_images_share_points')
    # a share of many views and tracks tells as much, and sooner
    share = tracks_of_stretch(tracks) if hopeless_px < np.inf else tracks
    if len(share) < len(tracks):
        few = fit_rotations(share, size, facts, hopeless_px, varying)
        if isinstance(few, NoEstimate) and few.kind == 'moved_not_rotated':
            return few
    frames, homographies, sigma_px = rotation_homographies(tracks)
    if len(frames) < 2:
        return NoEstimate('no_homography_pair', needed=MIN_MATCHES)
    conic = camera_from_homographies(homographies, size, facts)
    if isinstance(conic, NoEstimate) and conic.kind in _NOT_ROTATED:
        return NoEstimate('no_motion', motion='none', status={
            k: v for k, v in conic.values['status'].items() if k != 'aspect_ratio'})
    kept = tracks.in_frames(frames).with_at_least(2)
    order = np.argsort(frames)
    frames = frames[order]
    observed = timed(Observations.of(kept, frames), kept, frames, size, facts)
    bundle = bundle_of(observed, ROTATION, priors_from_facts(facts), 1.0)
    if bundle.degrees_of_freedom < MIN_FREEDOM:
        return NoEstimate('too_few_observations', points=len(observed.track), images=len(frames),
                          freedom=bundle.degrees_of_freedom, motion='rotation')
    problem = RotationProblem(observed, frames, homographies.H, order, conic, sigma_px, size,
                              facts)
    motion = _zooming(frames) if varying else ROTATION
    started = best_rotation_start(problem, motion, hopeless_px)
    return started if isinstance(started, NoEstimate) else RotationFit(
        problem, motion, *started, epipolar_noise(tracks, frames))


def tracks_of_stretch(tracks: Tracks) -> Tracks:
    """Return the share of tracks that tells whether there is any hope of a rotation."""
    if len(tracks.frames) >= 2 * STRETCH:
        tracks = tracks.in_frames(middle_stretch(tracks.frames))
    return tracks.thinned(STRETCH_TRACKS_PER_VIEW)


def middle_stretch(frames: np.ndarray) -> np.ndarray:
    """Return the frames in the middle, as many as tell of a rotation; all, if they are fewer."""
    first = max(len(frames) // 2 - STRETCH // 2, 0)
    return frames[first:first + STRETCH]


def judge_rotations(found: RotationFit, may_zoom: bool = True, may_miss: bool = False,
                    ) -> Calibration | NoEstimate:
    """Tell whether rotations alone explain the views; see `calibrate_rotating`."""
    result = _assess(found, may_miss)
    if may_zoom and found.problem.facts.focal == 'auto' and not result and result.kind in (
            'focal_not_constant', 'moved_not_rotated'):
        motion = _zooming(found.frames)
        started = best_rotation_start(found.problem, motion)
        if not isinstance(started, NoEstimate):
            start, start_px = started
            zoomed = replace(found, motion=motion, start=start, start_px=start_px)
            return _assess(zoomed, may_miss) or result
    return result


def _zooming(frames: np.ndarray) -> MotionModel:
    """Return rotations with a focal length that varies."""
    return replace(ROTATION, zoom=ZoomModel(tuple(frames.astype(float).tolist()), START_SIGMA))


def _richest_lens(state: SceneState, problem: RotationProblem, motion: MotionModel,
                  ) -> LensDecision:
    """Choose the lens, if none is stated; see `choose_lens`."""
    observed, facts, size = problem.observed, problem.facts, problem.size
    priors = priors_from_facts(facts)
    bundle = bundle_of(observed, motion, priors, 1.0)
    state = with_fixed(state, priors)
    bundle = bundle.with_sigma(max(bundle.noise_sigma(state), MIN_NOISE_PX))
    state = bundle.optimise(state, iterations=30, tolerance=TO_COMPARE_ROUGHLY)
    bundle = bundle.with_sigma(max(bundle.noise_sigma(state), MIN_NOISE_PX))
    fit = RobustFit(bundle, state, observed, 0)
    if motion.zoom is not None:
        fit = settle_zoom(fit, facts, size)

    def determined(trial: RobustFit, stated: CameraFacts) -> bool:
        covariance = to_parameters(trial.covariance, trial.state.lens)
        return trial.state.lens['f'] > 0 and 'unobservable' not in parameter_status(
            trial.state.camera(*size), covariance, stated, trial.bundle.sigma_px).values()

    # a step aside that goes with the turn looks like decentring: lenses have the last word
    return choose_lens(fit, facts, size, lambda _: 1.0, determined, ORDINARY_DECENTRING)


def _assess(found: RotationFit, may_miss: bool) -> Calibration | NoEstimate:
    """Drop gross errors, estimate the noise, and judge the optimum."""
    lens = found.lens
    size, stated, observed = found.problem.size, found.problem.facts, found.problem.observed
    decided = found.decided(lens.fit)
    fit, facts, frames = decided.fit, lens.facts, found.frames
    refusal = _refused(fit, facts, found)
    if refusal is not None:
        return refusal
    bundle, motion = fit.bundle, fit.motion
    choices = lens.excess + decided.covariance(len(fit.state.lens), bundle.unknowns.free)
    instants = tuple(frames.astype(float).tolist()) if stated.focal == 'auto' else ()
    assessed = rotation_corrections(may_miss, choices, instants).applied_to(
        AssessedEstimate.of(fit, size))
    inner, variance_inflation = assessed.covariance, assessed.variance_inflation
    state, camera = assessed.state, assessed.state.camera(*size)
    course = focal_course(fit, state, frames, inner, variance_inflation, assessed.growth)
    covariance = without_held(to_parameters(inner, state.lens), camera, facts)
    status = parameter_status(camera, covariance, facts, bundle.sigma_px)
    missing = unobservable_among(status, MATRIX_PARAMETERS)
    if missing:
        refusal = (found.problem.conic if isinstance(found.problem.conic, NoEstimate)
                   else NoEstimate('rotations_leave_open', missing=missing))
        return refusal.saying(status=status, motion='rotation', facts=facts)
    if motion.zoom is None and only_slides(fit, size, float(np.sqrt(inner[0, 0])),
                                           variance_inflation):
        return NoEstimate('images_slide', motion='rotation', facts=facts, status={
            **status, 'fx': 'unobservable', 'fy': 'unobservable'})
    # the gates of every other motion
    verdict = verdict_on_facts(assessed, size, facts, stated)
    deviates = None if verdict.is_kept else deviates_too_far(
        assessed.misfit, size, bundle.sigma_px, facts, verdict,
        float(np.sqrt(covariance[0, 0]) / state.lens['f']))
    for refused in (most_agree(fit.outliers / len(observed.view)), unchecked(bundle),
                    verdict.refusal(covariance, state.lens['f']),
                    deviates and (verdict.cause or deviates),
                    too_wide(state.lens.focal_lengths, size)):
        if refused is not None:
            return refused.saying(**{'status': status, **refused.values, 'motion': 'rotation',
                                     'facts': facts})
    covariance, of_facts = verdict.widened(covariance, camera.parameter_names)
    residuals = assessed.residual
    shutter = readout_of(fit, assessed.clusters.sigma_inflation)
    return Calibration(
        camera=camera, covariance=covariance, status=status, held_by=held_facts(facts),
        motion='rotation', facts=facts, frames=tuple(int(f) for f in frames),
        reprojection_rms_px=rms_length(residuals),
        noise_sigma_px=bundle.sigma_px, observation_count=len(fit.observations.view),
        outlier_count=fit.outliers,
        reconstruction=Reconstruction(frames, state.path.cam_from_world(), fit.observations.track,
                                      state.points, pose_precision=pose_precision(fit, False),
                                      row_motion=row_motion_of(fit, state),
                                      shift_px=state.shift),
        residuals=residuals, population=bundle.priors.population, focal=course, shutter=shutter,
        findings=(*shift_findings(fit), *course_findings(course), *of_facts, *assessed.findings,
                  *shutter_findings(shutter)))


def _without_gross_errors(fit: RobustFit, found: RotationFit) -> RobustFit:
    """Drop gross errors, and estimate the noise of the rest."""
    every = found.problem.observed
    observed, state, priors = every, fit.state, fit.bundle.priors
    bundle = bundle_of(observed, fit.motion, priors, max(found.noise_px, LEAST_NOISE_PX))
    for _ in range(3):
        sigma = max(bundle.noise_sigma(state), 1e-6)
        near = np.linalg.norm(bundle.residuals(state), axis=1) < OUTLIER_SIGMAS * sigma
        if not near.all():
            smaller, points = observed.select(near)
            if len(np.unique(smaller.view)) < len(found.frames):
                break
            observed, state = smaller, replace(state, points=state.points[points])
        bundle = bundle_of(observed, fit.motion, priors, sigma)
        state = bundle.optimise(state, iterations=30, tolerance=TO_MEASURE)
        if near.all():
            break
    bundle = bundle.with_sigma(max(bundle.noise_rms(state), MIN_NOISE_PX))
    return RobustFit(bundle, state, observed, len(every.view) - len(observed.view))


def _refused(fit: RobustFit, facts: CameraFacts, found: RotationFit) -> NoEstimate | None:
    """Refuse what rotations do not explain, what is no camera, and a lens that zooms."""
    sigma_px, noise_px, size = fit.bundle.sigma_px, found.noise_px, found.problem.size
    if not sigma_px < ROTATION_RATIO * max(noise_px, LEAST_NOISE_PX):
        return NoEstimate('moved_not_rotated', left_px=sigma_px, noise_px=noise_px, facts=facts)
    focal, skew = fit.state.lens['f'], fit.state.lens['skew']
    if not 1 / MAX_FOCAL_FRACTION < focal / max(size) < MAX_FOCAL_FRACTION \
            or abs(skew) > MAX_SKEW_FRACTION * focal:
        return NoEstimate('no_such_camera', focal_px=float(focal), skew_px=float(skew),
                          motion='rotation', facts=facts)
    if fit.motion.zoom is None and not (facts.focal == 'constant' and facts.trusted) \
            and seems_to_vary(fit, tuple(found.frames.astype(float).tolist()), size):
        return NoEstimate('focal_not_constant', motion='rotation', facts=facts)
    return None
