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

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.robust_fit import Fit
from selfcal_ros.calibration.bundle.state import BundleState, parameter_covariance
from selfcal_ros.calibration.estimators.model_selection import dependence_of, Model
from selfcal_ros.calibration.estimators.motion_class import describe_path
from selfcal_ros.calibration.initialisation.problem import Problem
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.observability import held_facts, parameter_status
from selfcal_ros.calibration.result import Calibration, FixedPoints, NotCalibrated, Reconstruction
from selfcal_ros.calibration.structure.structure_measurement import sample_structure
from selfcal_ros.calibration.uncertainty.cluster_covariance import stretch_note
from selfcal_ros.calibration.uncertainty.distortion_misfit import find_lens_field
from selfcal_ros.calibration.uncertainty.experiment_design import say, suggest_motions
from selfcal_ros.calibration.uncertainty.identifiability import identify
from selfcal_ros.geometry.camera import PARAMETER_NAMES

#: A larger share of outliers than this, and the rest proves nothing.
MOST_OUTLIERS = 1 / 3
#: With its distortion free a lens deviates from its model by less than this share of the image's
#: longer side (kitti, the worst of the recorded sets that are right: 0.0002), or than so many
#: sigmas of the noise; what deviates by more is not the lens.
FIELD_SHARE, FIELD_SIGMAS = 8e-4, 3.0
#: Fewer degrees of freedom than this cannot check themselves: of eight points in three or four
#: views one in three results was off by more than three of its sigmas.
MINIMUM_FREEDOM = 40
#: A calibration whose weakest direction has more than this share of the sigma that would make it
#: unobservable comes with advice.
WEAK = 0.05


def conclude(fit: Fit, model: Model, problem: Problem, graph: ViewGraph,
             ) -> Calibration | NotCalibrated:
    """Judge an optimum: what the data determine, and what the motion lacks."""
    facts, state = problem.facts, fit.state
    frames = tuple(int(f) for f in graph.frames)
    dependence = dependence_of(fit, problem.size)
    inner, notes = dependence.covariance, dependence.notes()
    residuals = np.where(fit.line.ahead[:, None], fit.line.residual, np.nan)
    field = find_lens_field(fit, problem.size, dependence.ratios['track']**2)
    if field is not None:
        # the field is what the image's regions share
        state, inner, residuals = field.state, field.covariance, field.residual
        notes = (*dependence.notes('track'), field.note())
    ratio, added = model.stretches
    inner = inner + added + model.valley * dependence.inflation**2
    notes += stretch_note(ratio)
    camera = state.camera(*problem.size)
    covariance = parameter_covariance(inner, state.intrinsics)
    held = held_facts(facts)
    for k, name in enumerate(PARAMETER_NAMES):
        if name in held:
            covariance[k] = covariance[:, k] = 0
    path = describe_path(state, model.exact, problem.motion.keeps_plane, model.turned)
    status = parameter_status(camera, covariance, facts)
    rms = float(np.sqrt(np.nanmean(np.sum(residuals**2, axis=1))))
    rejected = (fit.outliers + graph.rejected) / max(fit.outliers + graph.rejected
                                                     + len(fit.observations.view), 1)
    if rejected > MOST_OUTLIERS:
        return NotCalibrated(
            f'{100 * rejected:.0f} % of the observations contradict the rest: what remains may be '
            'chosen to fit.', 'The scene must stand still and be distinct: repeated patterns are '
            'easily taken for one another.', path.motion, frames, facts, status)
    if field is not None and facts.distortion != 'none' and field.rms_px > max(
            FIELD_SHARE * max(problem.size), FIELD_SIGMAS * fit.bundle.sigma_px):
        return NotCalibrated(
            f'The images disagree with the camera by {field.rms_px:.2g} px, smoothly over the '
            'image and beyond the distortion that was estimated: what is found may be wrong by '
            'more than its sigmas.', 'The scene may be nearly one plane, move, or repeat itself; '
            'or the lens needs another distortion model (--distortion plumb_bob).', path.motion,
            frames, facts, status)
    if fit.bundle.degrees_of_freedom < MINIMUM_FREEDOM:
        return NotCalibrated(*unchecked(fit.bundle), path.motion, frames, facts, status)
    missing = [name for name in ('fx', 'fy', 'cx', 'cy', 'skew') if status[name] == 'unobservable']
    if missing or path.refusal:
        if path.motion == 'translation':
            # without rotation a small sigma is an accident of a wrong optimum
            status = {name: 'held' if name in held else 'unobservable' for name in status}
        reason, advice = path.explain(missing, camera, facts)
        names = tuple(missing) or tuple(n for n in ('fx', 'cx', 'cy') if n not in held)
        better = say(suggest_motions(model.fit, problem.size, names, model.share), names)
        return NotCalibrated(reason, f'{advice} {better}'.strip(), path.motion, frames, facts,
                             status)
    estimated = tuple(name for name in status if status[name] == 'estimated')
    known = identify(model.fit, problem.size, estimated)
    if known.weakest_share > WEAK:
        names = tuple(n for n in known.weakest if n in ('fx', 'fy', 'cx', 'cy', 'skew'))
        notes += tuple(filter(None, [say(suggest_motions(model.fit, problem.size, names,
                                                         model.share), names)]))
    return Calibration(
        camera=camera, covariance=covariance, status=status, held_by=held, motion=path.motion,
        facts=facts, frames=frames, reprojection_rms_px=rms,
        noise_sigma_px=fit.bundle.sigma_px, observation_count=len(fit.observations.view),
        outlier_count=fit.outliers + graph.rejected,
        reconstruction=Reconstruction(graph.frames, state.cam_from_world(),
                                      fit.observations.track, state.points,
                                      replace(fit)),      # without what it has computed
        fixed_points=_fixed_points(state, camera.K) if problem.motion.keeps_plane else None,
        notes=path.notes + notes, residuals=residuals, identifiability=known,
        measured=sample_structure(fit, state.points, covariance))


def unchecked(bundle: Bundle) -> tuple[str, str]:
    """Say that the estimate would go unchecked, and what would help."""
    return (f'{bundle.blocks.point_count} points in {bundle.blocks.view_count} images leave '
            f'{bundle.degrees_of_freedom} degrees of freedom; the estimate could not be checked.',
            'More points or more images are needed.')


def _fixed_points(state: BundleState, K: np.ndarray) -> FixedPoints:
    """Horizon, vanishing point and circular point of the estimated plane and axis."""
    axis = state.mount[:, 2]
    return FixedPoints(np.linalg.solve(K.T, axis), K @ axis,
                       K @ (state.mount[:, 0] + 1j * state.mount[:, 1]))
