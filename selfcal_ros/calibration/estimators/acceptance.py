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
"""From an optimum to a verdict: what the data determine, and what the motion lacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.lens import to_parameters
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.contradictions import contradictions_of
from selfcal_ros.calibration.estimators.image_shift_choice import shift_findings
from selfcal_ros.calibration.estimators.model_selection import ModelDecision
from selfcal_ros.calibration.estimators.motion_class import (axis_place, describe_path,
                                                             PathDescription, widest_turn_rad)
from selfcal_ros.calibration.estimators.rectified import rectified_findings
from selfcal_ros.calibration.estimators.shutter_choice import (readout_of, row_motion_of,
                                                               shutter_findings)
from selfcal_ros.calibration.estimators.supported_optimum import MAX_BEHIND, supported_optimum
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.observability import held_facts, parameter_status, without_held
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration, CENTRE_OUTSIDE, FixedPoints, HINT
from selfcal_ros.calibration.structure.metric_structure import IN_A_PLANE
from selfcal_ros.calibration.structure.path_precision import pose_precision
from selfcal_ros.calibration.structure.structure_measurement import precision_of, sample_structure
from selfcal_ros.calibration.uncertainty.assessed_estimate import AssessedEstimate
from selfcal_ros.calibration.uncertainty.distortion_misfit import DistortionMisfit
from selfcal_ros.calibration.uncertainty.experiment_design import best_motion, suggest_motions
from selfcal_ros.calibration.uncertainty.facts_verdict import FactsVerdict, LENS_MODEL
from selfcal_ros.calibration.uncertainty.focal_course import course_findings, focal_course
from selfcal_ros.calibration.uncertainty.identifiability import identify
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import lengths, rms_length
from selfcal_ros.values.parameter_status import Status, unobservable_among

#: A start, or an optimum, explains the images when it leaves less than so many times the noise
#: of the epipolar geometry (which has more freedom, and absorbs distortion).
EXPLAINED = 4.0
#: A larger fraction of outliers than this, and the rest proves nothing.
MAX_OUTLIERS = 1 / 3
#: A focal length of each view is there to explain what contradicts one: more than this share that
#: contradicts it all the same, and something else is the cause. Gross errors are none of it: they
#: are told by no more tracks that contradict as wholes, beyond those that they make fall.
MAX_BESIDE_ZOOM, FEW_AS_WHOLES = 0.2, 0.05
#: With its distortion free a lens deviates from its model by less than this fraction of the
#: image's longer side, or than so many sigmas of the noise. What deviates by more is not the lens.
#: Of the recorded sets that are right the drone's deviates most, by 0.7e-4. Simulated lenses with
#: bumps all over the image deviate by up to 4.4e-4 and 1.4 sigmas. The circles of `rct_circles`
#: by 6.2e-4 and 2.2 sigmas, and their principal point was off by 11 px.
FIELD_FRACTION, FIELD_SIGMAS = 5e-4, 2.0
#: The same where another lens model than the one that was stated explains the images better,
#: which is told by its name, and where such a field is little beside sigma of the focal length.
LENIENT_FRACTION, LENIENT_SIGMAS = 8e-4, 3.0
#: The same where views move by themselves while they are read: on the average that is such a
#: field, which the images do not tell from a lens. The covariance holds it.
ROWS_FRACTION = 2.5e-3
#: Fewer degrees of freedom than this cannot check themselves: of eight points in three or four
#: views one in three results was off by more than three of its sigmas.
MINIMUM_FREEDOM = 40
#: A turn that is smaller in all, with a focal length that has a larger share of uncertainty, is
#: a hint: what is supposed of noise and path weighs more there than the images.
SMALL_TURN_RAD, HINT_SIGMA = np.radians(15.0), 0.01
#: So is one beside a principal point that is certain to so many sigmas, and lies farther from the
#: middle than this share of the image's side. Of 9810 measured cameras 2 % are so, as crops.
FAR_OFF_SIGMAS, FAR_OFF = 3.0, 0.25
#: No lens has a shorter focal length than this share of the image's longer side: of 9810 measured
#: cameras one has.
SHORTEST_FOCAL = 0.1
#: Circular motion with an unknown principal point determines the focal length better than this
#: share, or not at all: what is left of the systematic errors is a multiple of such sigmas.
OF_CIRCLE_SIGMA = 0.015
#: A plane turns in itself where its normal is nearer than this to the axis, radians.
PARALLEL_RAD = np.radians(15.0)
#: A calibration whose weakest direction has more than this fraction of the sigma that would make
#: it unobservable comes with advice.
ADVISED_FRACTION = 0.05

#: What a wrong fact leaves of the images, and who declares it exact accepts.
OF_WRONG_FACTS = ('tracks_unexplained', 'smooth_misfit')


@dataclass(frozen=True)
class _Optimum:
    """What an optimum is accepted or refused by."""

    fit: RobustFit
    model: ModelDecision
    problem: SelfCalibrationProblem
    path: PathDescription
    status: dict[str, Status]
    held: dict[str, str]
    rejected: float
    by_itself: bool
    pair_noise_px: float
    field: DistortionMisfit | None
    stated: FactsVerdict
    covariance: np.ndarray
    behind: float

    @property
    def focal_share(self) -> float:
        """Sigma of the focal length as a share of it."""
        return float(np.sqrt(self.covariance[0, 0])) / float(self.fit.state.lens['f'])

    @property
    def missing(self) -> tuple[str, ...]:
        """The parameters of K that the images leave open."""
        return unobservable_among(self.status, MATRIX_PARAMETERS)

    def motion_for(self, names: tuple[str, ...], is_open: bool = False) -> tuple[Finding, ...]:
        """Tell which motion would determine these parameters, of a camera known or open."""
        return best_motion(suggest_motions(self.model.fit, self.problem.size, names,
                                           self.model.fraction), names, is_open)


def _most_agree(found: _Optimum) -> NoEstimate | None:
    """Refuse what most observations contradict."""
    return most_agree(found.rejected, found.fit.motion.zoom is not None and not found.by_itself)


def _facts_hold(found: _Optimum) -> NoEstimate | None:
    """Refuse what rests on a fact that the images contradict."""
    return found.stated.refusal(found.covariance, found.fit.state.lens['f'])


def _is_explained(found: _Optimum) -> NoEstimate | None:
    """Refuse what leaves far more than pairs of images do, as a start does that led astray."""
    noise_px = max(found.pair_noise_px, found.problem.noise_px)
    if found.fit.bundle.sigma_px < EXPLAINED * noise_px:
        return None
    return NoEstimate('tracks_unexplained', left_px=float(found.fit.bundle.sigma_px),
                      noise_px=float(noise_px))


def _lens_fits(found: _Optimum) -> NoEstimate | None:
    """Refuse deviations that are smooth over the image and larger than a lens's."""
    return deviates_too_far(found.field, found.problem.size, found.fit.bundle.sigma_px,
                            found.problem.facts, found.stated, found.focal_share,
                            found.fit.observations.moves_by_view)


def _can_be_checked(found: _Optimum) -> NoEstimate | None:
    """Refuse what has too few observations to spare."""
    return unchecked(found.fit.bundle)


def _is_ahead(found: _Optimum) -> NoEstimate | None:
    """Refuse a scene inside out, which free translations find beside large rotations."""
    if not found.problem.is_weak:
        return None
    return None if found.behind < MAX_BEHIND else NoEstimate('points_behind', share=found.behind)


def _is_determined(found: _Optimum) -> NoEstimate | None:
    """Refuse a motion that leaves parameters of K open, and tell which would not."""
    missing, status = found.missing, found.status
    if _turns_in_itself(found):
        # a small sigma of all three would rest on where the distortion is centred
        open_names = tuple(name for name in ('fx', 'fy', 'cx', 'cy') if name not in found.held)
        return NoEstimate('flat_turntable', missing=missing or open_names, status={
            **status, **dict.fromkeys(open_names, 'unobservable')})
    if not missing and found.path.refusal is None:
        return _centre_of_circle(found)
    if found.path.motion == 'translation':
        # without rotation a small sigma is an accident of a wrong optimum
        status = {name: 'held' if name in found.held else 'unobservable' for name in status}
    names = missing or tuple(n for n in ('fx', 'cx', 'cy') if n not in found.held)
    return found.path.explain(missing, found.problem.facts).saying(
        status=status, further=found.motion_for(names, is_open=True))


def _centre_of_circle(found: _Optimum) -> NoEstimate | None:
    """Refuse a focal length that goes along with a principal point that the circle leaves open."""
    names = [name for name in ('fx', 'fy', 'cx', 'cy') if name not in found.held]
    if (found.path.motion != 'circular' or found.problem.facts.principal_point is not None
            or found.focal_share <= OF_CIRCLE_SIGMA or found.path.rotation_rad < SMALL_TURN_RAD
            or not _sees_axis(found)):
        return None
    return NoEstimate('circle_undetermined', missing=tuple(names),
                      turned_deg=float(np.degrees(found.path.rotation_rad)))


def _sees_axis(found: _Optimum) -> bool:
    """Tell whether the axis passes through the image at the height of the usual point."""
    state = found.fit.state
    place, points = axis_place(state.path), state.points
    near = np.abs(points[:, 3]) > 1e-6 * np.linalg.norm(points[:, :3], axis=1)
    if place is None or not near.any():
        return False
    at = state.path.mount @ [*place, np.median(points[near, 2] / points[near, 3])]
    pixel = state.camera(*found.problem.size).K @ at
    return bool(at[2] > 0 and (pixel[:2] > 0).all()
                and (pixel[:2] < pixel[2] * np.array(found.problem.size)).all())


def _turns_in_itself(found: _Optimum) -> bool:
    """Tell whether one plane turns about its normal, and the principal point is not known."""
    if (found.problem.flat is None or found.path.motion != 'circular'
            or found.problem.facts.principal_point is not None):
        return False
    points = found.fit.state.points
    near = points[np.abs(points[:, 3]) > 1e-6 * np.linalg.norm(points[:, :3], axis=1)]
    places = near[:, :3] / near[:, 3:]
    normal = np.linalg.svd(places - np.median(places, axis=0), full_matrices=False)[2][2]
    return bool(abs(normal[2]) > np.cos(PARALLEL_RAD))


def _lens_exists(found: _Optimum) -> NoEstimate | None:
    """Refuse a field of view that no lens has."""
    return too_wide(found.fit.state.lens.focal_lengths, found.problem.size)


#: What an optimum must pass to be a calibration, in the order in which it is tried.
ACCEPTANCE_TESTS = (_most_agree, _facts_hold, _is_explained, _lens_fits, _can_be_checked,
                    _is_determined, _is_ahead, _lens_exists)


def assess(fit: RobustFit, model: ModelDecision, problem: SelfCalibrationProblem, graph: ViewGraph,
           stated: CameraFacts) -> Calibration | NoEstimate:
    """Judge an optimum: what the data determine, what the motion lacks, and what was stated."""
    found, verdict = supported_optimum(fit, model, problem, stated)
    optimum = _judged(found, verdict, model, problem, graph)
    refusal = _refusal(optimum)
    if refusal is not None:
        return refusal
    state, camera, path = found.state, found.state.camera(*problem.size), optimum.path
    course = focal_course(fit, state, graph.frames, found.covariance,
                          found.variance_inflation, found.growth)
    covariance, of_facts = verdict.widened(optimum.covariance, camera.parameter_names)
    # first, for all the rest rests on them
    findings = (of_facts + rectified_findings(camera, stated, of_facts) + shift_findings(fit)
                + course_findings(course) + found.findings)
    known = identify(model.fit, problem.size, tuple(
        name for name, one in optimum.status.items() if one == 'estimated'))
    # where images are shifted, no motion helps
    if known.weakest_share > ADVISED_FRACTION and fit.motion.shift is None:
        findings += optimum.motion_for(tuple(n for n in known.weakest if n in MATRIX_PARAMETERS))
    precision = precision_of(fit)
    shutter = readout_of(fit, found.clusters.sigma_inflation)
    # beside the camera the model predicts as little as behind it
    residuals = np.where(lengths(found.residual)[:, None] < max(problem.size), found.residual,
                         np.nan)
    return Calibration(
        camera=camera, covariance=covariance, status=optimum.status, held_by=optimum.held,
        motion=path.motion, facts=problem.facts, frames=tuple(int(f) for f in graph.frames),
        reprojection_rms_px=rms_length(residuals),
        noise_sigma_px=fit.bundle.sigma_px, observation_count=len(fit.observations.view),
        outlier_count=fit.outliers + graph.rejected,
        reconstruction=Reconstruction(graph.frames, state.path.cam_from_world(),
                                      fit.observations.track, state.points, precision,
                                      pose_precision(fit, path.motion in IN_A_PLANE),
                                      row_motion_of(fit, state), state.shift),
        fixed_points=_fixed_points(state.path, camera.K) if problem.motion.keeps_plane else None,
        findings=path.findings + findings + shutter_findings(shutter),
        residuals=residuals, identifiability=known,
        measured=sample_structure(precision, fit.observations.track, state.points,
                                  covariance),
        population=fit.bundle.priors.population, focal=course, shutter=shutter)


def _judged(found: AssessedEstimate, verdict: FactsVerdict, model: ModelDecision,
            problem: SelfCalibrationProblem, graph: ViewGraph) -> _Optimum:
    """Gather what an optimum is accepted or refused by."""
    fit, state, camera = found.fit, found.state, found.state.camera(*problem.size)
    covariance = without_held(to_parameters(found.covariance, state.lens), camera, problem.facts)
    path = describe_path(state.path, model.exact, problem.motion.keeps_plane, model.turned,
                         problem.motion.fixed_pivot)
    outliers = fit.outliers + graph.rejected
    rejected, by_itself = outliers / max(outliers + len(fit.observations.view), 1), False
    if most_agree(rejected, fit.motion.zoom is not None) is not None:
        contradicting = contradictions_of(fit, graph)
        if contradicting is not None:
            rejected = min(rejected, contradicting.share)
            by_itself = contradicting.share_as_wholes < FEW_AS_WHOLES
    return _Optimum(fit, model, problem, path,
                    parameter_status(camera, covariance, problem.facts, fit.bundle.sigma_px),
                    held_facts(problem.facts), rejected, by_itself, graph.noise_px, found.misfit,
                    verdict, covariance, found.behind)


def _refusal(optimum: _Optimum) -> NoEstimate | None:
    """Return why an optimum is no calibration, if it is none."""
    verdict = optimum.stated
    for accepted in ACCEPTANCE_TESTS:
        refusal = accepted(optimum)
        if refusal is not None and not (verdict.is_kept and refusal.kind in OF_WRONG_FACTS):
            # a wrong fact leaves residuals that look like a scene or a lens that is not right
            refusal = refusal if verdict.cause is None else verdict.cause
            return refusal.saying(**{
                'status': optimum.status, 'facts': optimum.problem.facts,
                'left_px': float(optimum.fit.bundle.sigma_px),
                'zooms': optimum.fit.motion.zoom is not None, **refusal.values,
                'motion': optimum.path.motion})
    return None


def only_a_hint(result: Calibration) -> NoEstimate | None:
    """
    Call a doubtful focal length what it is, whatever the motion was.

    It is doubtful from a small turn, and beside a principal point far from the middle of the
    image, which hardly a camera has. What is supposed of noise and path then weighs more than the
    images.

    Parameters
    ----------
    result : Calibration
        With its reconstruction.

    Returns
    -------
    NoEstimate or None
        Of the kind `HINT` or `CENTRE_OUTSIDE`; None where the result is a calibration.

    """
    camera = result.camera
    focal_px, sigma_px = float(camera.K[0, 0]), result.sigma['fx']
    if sigma_px <= HINT_SIGMA * focal_px:
        return None
    turned = widest_turn_rad(result.reconstructed.cam_from_world[:, :, :3])
    centre = camera.K[:2, 2]
    size = np.array([camera.width, camera.height])
    away = np.abs(centre - size / 2)
    uncertain = FAR_OFF_SIGMAS * np.array([result.sigma['cx'], result.sigma['cy']])
    outside = (result.facts.principal_point is None and bool(
        ((away > size / 2) | ((away > FAR_OFF * size) & (away > uncertain))).any()))
    if turned < SMALL_TURN_RAD:
        kind, shown = HINT, {'turned_deg': float(np.degrees(turned))}
    elif outside:
        kind, shown = CENTRE_OUTSIDE, {'cx': float(centre[0]), 'cy': float(centre[1])}
    else:
        return None
    return NoEstimate(kind, focal_px=focal_px, sigma_px=sigma_px, **shown, motion=result.motion,
                      facts=result.facts, status=result.status, hint=result,
                      further=tuple(one for one in result.findings
                                    if one.kind == 'motion_suggestion'))


def most_agree(rejected: float, zooms: bool = False) -> NoEstimate | None:
    """Refuse what a larger share of the observations contradicts than may."""
    return (NoEstimate('too_many_outliers', rejected=float(rejected))
            if rejected > (MAX_BESIDE_ZOOM if zooms else MAX_OUTLIERS) else None)


def too_wide(focal_px: np.ndarray, size: tuple[int, int]) -> NoEstimate | None:
    """Refuse a focal length, pixels, that is shorter than any lens's in images of this size."""
    shortest = float(np.min(focal_px))
    return (None if shortest >= SHORTEST_FOCAL * max(size)
            else NoEstimate('focal_too_short', focal_px=shortest, side_px=int(max(size))))


def deviates_too_far(field: DistortionMisfit | None, size: tuple[int, int], sigma_px: float,
                     facts: CameraFacts, verdict: FactsVerdict, focal_share: float,
                     moves_by_view: bool = False) -> NoEstimate | None:
    """Refuse a field that is larger than what a lens does beyond its model."""
    share, sigmas = ((LENIENT_FRACTION, LENIENT_SIGMAS)
                     if verdict.concerns(LENS_MODEL) or focal_share > HINT_SIGMA
                     else (FIELD_FRACTION, FIELD_SIGMAS))
    if moves_by_view:
        share = ROWS_FRACTION
    limit = max(share * max(size), sigmas * sigma_px)
    if field is None or facts.distortion == 'none' or field.rms_px <= limit:
        return None
    return NoEstimate('smooth_misfit', rms_px=float(field.rms_px))


def unchecked(bundle: Bundle[SceneState]) -> NoEstimate | None:
    """Refuse an adjustment that could not be checked, having too few degrees of freedom."""
    if bundle.degrees_of_freedom >= MINIMUM_FREEDOM:
        return None
    return NoEstimate('too_few_observations', points=bundle.blocks.point_count,
                      images=bundle.blocks.view_count, freedom=bundle.degrees_of_freedom)


def _fixed_points(path: AxisPath, K: np.ndarray) -> FixedPoints:
    """Horizon, vanishing point and circular point of the estimated plane and axis."""
    axis = path.mount[:, 2]
    return FixedPoints(np.linalg.solve(K.T, axis), K @ axis,
                       K @ (path.mount[:, 0] + 1j * path.mount[:, 1]))
