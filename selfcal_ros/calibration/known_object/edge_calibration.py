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
Calibration from the edges of a tracked object (the thesis's future work, 8.2).

A rigid object of known shape was followed through many images by its edges. Every edgel gives one
equation, and one robust adjustment of calibration, distortion and all poses sees them together.
Edgels of one primitive share errors (the object is not quite its model, shading moves an edge),
so the covariance is that of clustered errors where the residuals show them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.lens import Lens, to_parameters
from selfcal_ros.calibration.bundle.object_model import KnownEdges
from selfcal_ros.calibration.bundle.object_poses import ObjectPoses
from selfcal_ros.calibration.bundle.priors import (all_fixed, Prior, priors_from_facts,
                                                   with_fixed)
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.calibration.known_object.edge_delay import LineDelay
from selfcal_ros.calibration.known_object.edge_jackknife import (covariance_by_edges,
                                                                 segment_excess)
from selfcal_ros.calibration.known_object.edge_views import EdgeViews
from selfcal_ros.calibration.observability import held_facts, parameter_status, without_held
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.calibration.uncertainty.cluster_covariance import (cluster_robust_covariance,
                                                                    segment_findings, widest)
from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera, MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.lenses.catalogue import LensChoice
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import rms_length
from selfcal_ros.values.motion import Motion
from selfcal_ros.values.parameter_status import Status, unobservable_among
from selfcal_ros.version import SOFTWARE

MOTION: Motion = 'known-object'
#: Distortion models that 'auto' tries, the richest first.
AUTOMATIC_DISTORTION: tuple[LensChoice, ...] = ('radial2', 'radial1', 'none')
#: Residuals beyond so many sigmas are outliers.
OUTLIER_SIGMAS = 4.0
#: Edgels farther than this from the model, rms, do not belong to it (fraction of the diagonal):
#: the nearest of any edges around would lie about as far.
MISFIT_FRACTION = 0.00075
#: Focal lengths beyond these, over the longer side of the image, are those of no lens.
FOCAL_FRACTIONS = (0.2, 30.0)
#: Two halves of the sequence may differ in focal length by so many sigmas, or by this fraction.
ZOOM_SIGMAS, ZOOM_FRACTION = 5.0, 0.02
#: Where descents stop, in units of sigma²: of rounds that seek the noise and outliers, of parts of
#: the sequence, which are compared, and of the estimate.
_OF_ROUNDS, _OF_PARTS, _FINAL = 1e-2, 1e-4, 1e-6


@dataclass(frozen=True)
class _Judged:
    """
    An adjustment to edges under some facts, and what is determined by it.

    Attributes
    ----------
    views : EdgeViews
        Those that were used.
    bundle : Bundle
    state : ObjectState
    facts : CameraFacts
    covariance : ndarray, shape (n, n)
        Of the parameters of the camera.
    sigma_inflation : float
        How much wider the sigmas are than for independent errors.
    findings : tuple of Finding
    status : dict of str to str
        Of each parameter.
    delay : LineDelay or None
        Where lines are read one after the other.

    """

    views: EdgeViews
    bundle: Bundle[ObjectState]
    state: ObjectState
    facts: CameraFacts
    covariance: np.ndarray
    sigma_inflation: float
    findings: tuple[Finding, ...]
    status: dict[str, Status]
    delay: LineDelay | None


def calibrate_from_edges(views: EdgeViews, start: Camera, *,
                         facts: CameraFacts | None = None) -> Calibration | NotCalibrated:
    """
    Calibrate a camera from the edges of a known object.

    Parameters
    ----------
    views : EdgeViews
    start : Camera
        With which the poses are approximately right.
    facts : CameraFacts, optional
        What is known of the camera; no skew by default.

    Returns
    -------
    Calibration or NotCalibrated
        Motion 'known-object'; the reconstruction holds the control points and the pose of the
        object in every image (metres).

    """
    facts = CameraFacts(skew=0.0) if facts is None else facts
    result = _calibrate(views.select(np.ones(len(views), bool)), start, facts)
    if isinstance(result, NoEstimate):
        return NotCalibrated.of(result, frames=views.frames, facts=facts, motion=MOTION,
                                software=SOFTWARE)
    return replace(result, software=SOFTWARE)


def _calibrate(views: EdgeViews, start: Camera, facts: CameraFacts) -> Calibration | NoEstimate:
    """Calibrate from views with enough edges."""
    size = views.image_size
    if len(views.frames) < 2:
        return NoEstimate('too_few_edge_images')
    if facts.shutter == 'global' or facts.line_delay_s is not None:
        views = views.read_with(facts.line_delay_s or 0.0)
    first = _first_state(views, start)
    found = None
    names = AUTOMATIC_DISTORTION if facts.distortion == 'auto' else (facts.distortion,)
    for name in names:
        chosen = replace(facts, distortion=name)
        fit = _fit_as_read(views, first, chosen)
        if isinstance(fit, NoEstimate):
            continue
        found = _judge(*fit, chosen, size)
        if 'unobservable' not in found.status.values():
            break
    if found is None:
        return NoEstimate('no_fit_to_edges')
    used, bundle, state = found.views, found.bundle, found.state
    if not bundle.sigma_px <= MISFIT_FRACTION * float(np.hypot(*size)):
        return NoEstimate('edges_misfit', left_px=float(bundle.sigma_px))
    missing = unobservable_among(found.status, MATRIX_PARAMETERS)
    low, high = FOCAL_FRACTIONS[0] * max(size), FOCAL_FRACTIONS[1] * max(size)
    if not missing and not low < state.lens['f'] < high:
        missing = ('fx', 'fy')
    if missing:
        return NoEstimate('edges_leave_open', missing=missing, status=found.status)
    zoomed = _zoomed(used, state, found.sigma_inflation)
    if zoomed is not None:
        return zoomed
    camera = state.camera(*size)
    residuals = _offsets(bundle, state)
    points, first_seen = np.unique(used.point, return_index=True)
    return Calibration(
        camera=camera, covariance=found.covariance, status=found.status,
        held_by=held_facts(found.facts), motion=MOTION, facts=found.facts,
        frames=tuple(int(f) for f in used.frames),
        reprojection_rms_px=rms_length(residuals),
        noise_sigma_px=bundle.sigma_px, observation_count=len(used),
        outlier_count=len(views) - len(used),
        reconstruction=Reconstruction(
            used.frames, np.array(state.path.cam_from_object), points,
            np.column_stack([used.points[first_seen], np.ones(len(points))])),
        shutter=None if found.delay is None else found.delay.readout(bundle, size),
        findings=found.findings, residuals=residuals)


def adjust_to_edges(views: EdgeViews, start: Camera, facts: CameraFacts,
                    ) -> tuple[Camera, dict[int, np.ndarray]] | NoEstimate:
    """
    Adjust camera and poses to edges, without judging them.

    Returns
    -------
    (Camera, dict of int to ndarray (3, 4)) or NoEstimate
        The camera and the pose of the object in each image that was used.

    """
    views = replace(views.select(np.ones(len(views), bool)), rows=None)
    if len(views.frames) < 2:
        return NoEstimate('too_few_edge_images')
    if facts.distortion == 'auto':
        facts = replace(facts, distortion='none')
    fit = _fit(views, _first_state(views, start), facts)
    if isinstance(fit, NoEstimate):
        return fit
    used, _, state = fit
    try:
        camera = state.camera(*views.image_size)
    except ArgumentError:
        return NoEstimate('no_fit_to_edges')
    return camera, dict(zip(used.frames.tolist(), state.path.cam_from_object))


def _first_state(views: EdgeViews, start: Camera) -> ObjectState:
    return ObjectState(Lens.of(start), ObjectPoses(views.cam_from_object.copy()),
                       line_delay_s=0.0 if views.rows is None else views.rows.line_delay_s)


def _offsets(bundle: Bundle[ObjectState], state: ObjectState) -> np.ndarray:
    """Residuals as vectors from the edgel to its edge, (N, 2) pixels."""
    edges = cast(KnownEdges, bundle.model)
    distance: np.ndarray = bundle.residuals(state) * edges.normals(state, bundle.view, bundle.xy)
    return distance


def _fit_as_read(views: EdgeViews, state: ObjectState, facts: CameraFacts,
                 ) -> tuple[EdgeViews, Bundle[ObjectState], ObjectState] | NoEstimate:
    """Adjust; the line delay is estimated where it is asked for, or where the edges show it."""
    fit = _fit(views, state, facts)
    if views.rows is None or isinstance(fit, NoEstimate) or facts.shutter == 'rolling':
        return fit
    used, bundle, optimum = fit
    if LineDelay.of(bundle.information(optimum), bundle, optimum, *_groups(used)).is_certain:
        return fit
    return _fit(views.read_with(0.0), replace(state, line_delay_s=0.0), facts)


def _groups(views: EdgeViews) -> tuple[np.ndarray, np.ndarray]:
    """Return edgels that may share errors, (N,) twice: of a primitive, and of it in an image."""
    _, view = np.unique(views.frame, return_inverse=True)
    return views.primitive, view * (int(views.primitive.max()) + 1) + views.primitive


def _fit(views: EdgeViews, state: ObjectState, facts: CameraFacts,
         ) -> tuple[EdgeViews, Bundle[ObjectState], ObjectState] | NoEstimate:
    """Adjust, estimate the noise, leave out outliers."""
    none = NoEstimate('no_fit_to_edges')
    priors = priors_from_facts(facts)
    state = with_fixed(state, priors)
    # at first the poses settle, and the principal point may not run away with them
    longer = max(views.image_size)
    held = {'cx': Prior((views.image_size[0] - 1) / 2, 0.05 * longer),
            'cy': Prior((views.image_size[1] - 1) / 2, 0.05 * longer),
            'aspect': Prior(1.0, 0.05)}
    bundle = views.bundle(priors.under(held), 1.0)
    if bundle.degrees_of_freedom < 1:
        return none
    state = bundle.optimise(state, tolerance=_OF_ROUNDS)
    for _ in range(4):
        bundle = views.bundle(priors, bundle.noise_sigma(state))
        if not np.isfinite(bundle.sigma_px):
            return none
        state = bundle.optimise(state, tolerance=_OF_ROUNDS)
        distance = np.abs(bundle.residuals(state)).ravel()
        sigma = bundle.noise_sigma(state)
        good = distance < OUTLIER_SIGMAS * sigma
        if good.all():
            break
        rest = views.select(good)
        kept = np.isin(views.frames, rest.frames)
        if len(rest.frames) < 2:
            return none
        state = replace(state, path=state.path.of_views(kept))
        views, bundle = rest, rest.bundle(priors, sigma)
        if bundle.degrees_of_freedom < 1:
            return none
    bundle = views.bundle(priors, bundle.noise_rms(state))
    return views, bundle, bundle.optimise(state, tolerance=_FINAL)


def _judge(views: EdgeViews, bundle: Bundle[ObjectState], state: ObjectState, facts: CameraFacts,
           size: tuple[int, int]) -> _Judged:
    """Tell what edges determine, and how well."""
    information = bundle.information(state)
    groups = _groups(views)
    wider = max((cluster_robust_covariance(information, group, views.xy, size)
                 for group in groups), key=lambda found: found.sigma_inflation)
    ratio, more = segment_excess(views, bundle, state, wider.variance_inflation)
    camera = state.camera(*size)
    covariance = wider.covariance + more
    if wider.sigma_inflation > 1:
        # sums over a dozen edges tell that they share errors, and hardly how large these are
        covariance = widest(covariance, covariance_by_edges(views, bundle, state))
    covariance = without_held(to_parameters(covariance, state.lens), camera, facts)
    findings = wider.findings(track='errors_within_edge') + segment_findings(ratio)
    delay = None if views.rows is None else LineDelay.of(information, bundle, state,
                                                         *groups)
    return _Judged(views, bundle, state, facts, covariance, wider.sigma_inflation * ratio,
                   findings, parameter_status(camera, covariance, facts), delay)


def _zoomed(views: EdgeViews, state: ObjectState, sigma_inflation: float) -> NoEstimate | None:
    """Refuse a focal length that has changed between the halves of the sequence."""
    frames = views.frames
    if len(frames) < 8:
        return None
    half = frames[len(frames) // 2]
    priors = all_fixed(state.lens).without(('f',))
    found = []
    for keep in (views.frame < half, views.frame >= half):
        part = views.select(keep)
        if len(part.frames) < 3:
            return None
        own = replace(state, path=state.path.of_views(np.isin(frames, part.frames)))
        bundle = part.bundle(priors, 1.0)
        bundle = part.bundle(priors, bundle.noise_sigma(own))
        own = bundle.optimise(own, iterations=30, tolerance=_OF_PARTS)
        variance = bundle.ideal_covariance(own)[0, 0]
        found.append((own.lens['f'], float(np.sqrt(variance))))
    (a, sigma_a), (b, sigma_b) = found
    limit = max(ZOOM_SIGMAS * sigma_inflation * np.hypot(sigma_a, sigma_b),
                ZOOM_FRACTION * state.lens['f'])
    if abs(a - b) < limit:
        return None
    return NoEstimate('focal_length_changes', first_px=float(a), second_px=float(b))
