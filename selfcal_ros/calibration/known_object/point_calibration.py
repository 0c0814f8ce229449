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
Calibration from known objects (thesis 3.2): any number of views of points with known coordinates.

One image of a solid suffices; boards need several views under different tilts. A closed form
(`object_start`) starts one robust adjustment of calibration, distortion and poses together
(`bundle.Bundle`), which owns the result and its covariance.
"""

from __future__ import annotations

from dataclasses import replace
import logging
from typing import NamedTuple

import numpy as np

from selfcal_ros.calibration.blas_threads import on_one_thread
from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.lens import to_parameters
from selfcal_ros.calibration.bundle.object_poses import VIEW_NAMES
from selfcal_ros.calibration.bundle.priors import Prior, priors_from_facts, start_lens, with_fixed
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.calibration.known_object.bent_board import BoardShape, may_bend, USUAL_FLATNESS
from selfcal_ros.calibration.known_object.moving_board import (motion_findings, moving_fit,
                                                               row_motion_of)
from selfcal_ros.calibration.known_object.object_pose_precision import pose_precision
from selfcal_ros.calibration.known_object.object_start import (fisheye_cameras, fisheye_state,
                                                               start_state, supposed_cameras)
from selfcal_ros.calibration.known_object.object_views import gathered_views, ObjectViews
from selfcal_ros.calibration.observability import held_facts, parameter_status, without_held
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.calibration.uncertainty.cluster_covariance import (ClusterCovariance,
                                                                    cluster_robust_covariance)
from selfcal_ros.calibration.uncertainty.free_of_facts import with_tested_facts
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.lenses.catalogue import LensChoice
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import rms_length
from selfcal_ros.values.known_object import KnownObject
from selfcal_ros.values.motion import Motion
from selfcal_ros.values.parameter_status import Status, unobservable_among
from selfcal_ros.values.tracks import Tracks
from selfcal_ros.version import SOFTWARE

_LOGGER = logging.getLogger(__name__)
MOTION: Motion = 'known-object'
#: Distortion models that 'auto' tries, the richest first.
AUTOMATIC_DISTORTION: tuple[LensChoice, ...] = ('plumb_bob', 'radtan', 'radial2', 'radial1',
                                                'none')
#: Points seen so far from the axis, radians, may belong to a fisheye: 'auto' tries one.
WIDE_ANGLE = np.deg2rad(40.0)
#: The same where a perspective lens explains less than this share of the points.
MOSTLY_FITTED = 0.9
#: It is one where the sum of squared residuals, in units of the variance, falls by so much; each
#: residual counts as an outlier's at most.
FAMILY_MARGIN = 25.0
#: Residuals beyond so many sigmas are outliers.
OUTLIER_SIGMAS = 4.0
#: An image noise beyond this share of the image's diagonal is no noise: points and object do not
#: belong together.
MISFIT_FRACTION = 0.006
#: Starts are compared on so many points a view.
START_POINTS = 40
#: Where descents stop, in units of sigma²: of starts, of rounds that seek the noise and outliers,
#: and of the estimate. With an object they are so cheap that the last goes on to rounding.
_OF_STARTS, _OF_ROUNDS, _FINAL = 1e-2, 0.1, 1e-7


@on_one_thread
def calibrate_known_object(tracks: Tracks, target: KnownObject, *,
                           facts: CameraFacts | None = None, flatness: float | None = None,
                           ) -> Calibration | NotCalibrated:
    """
    Calibrate a camera from images of known points.

    Parameters
    ----------
    tracks : Tracks
        Where each point was seen; `track` is the point's identity. Of any number of views.
    target : KnownObject
    facts : CameraFacts, optional
        What is known of the camera; nothing by default. Distortion 'auto': the richest model
        that the data determine. Shutter 'rolling', or a line delay, whose value is not
        used: the object may move while an image is read.
    flatness : float, optional
        Standard deviation of the bend of a plane object, in its unit. By default the bend is
        estimated with hardly anything supposed of it, and so is a print that is not to scale.
        0 for an exactly flat object that is exactly as stated.

    Returns
    -------
    Calibration or NotCalibrated
        Motion 'known-object'; the reconstruction holds the object's points, where they are on
        it, and the pose of the object in every camera (units of the object).

    References
    ----------
    M. N. Armstrong (1996), section 3.2: one image of a solid. Z. Zhang (2000): images of a plane.

    Examples
    --------
    Four views of a board, tilted about different axes:

    >>> import numpy as np
    >>> from scipy.spatial.transform import Rotation
    >>> from selfcal_ros import calibrate_known_object, Camera, CameraFacts, KnownObject, Tracks
    >>> camera = Camera([[520, 0, 330], [0, 520, 236], [0, 0, 1]], width=640, height=480)
    >>> corners = np.array([(0.04 * x, 0.04 * y, 0.0) for y in range(5) for x in range(7)])
    >>> tilts = Rotation.from_rotvec([(0.5, 0, 0), (-0.5, 0, 0), (0, 0.5, 0), (0.2, -0.5, 0)])
    >>> seen = corners @ tilts.as_matrix().transpose(0, 2, 1) + [-0.12, -0.08, 0.6]
    >>> pixels = camera.project(seen) + np.random.default_rng(0).normal(0, 0.05, (4, 35, 2))
    >>> tracks = Tracks(np.repeat(np.arange(4), 35), np.tile(np.arange(35), 4),
    ...                 pixels.reshape(-1, 2), image_size=(640, 480))
    >>> result = calibrate_known_object(tracks, KnownObject(range(35), corners),
    ...                                 facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
    >>> bool(abs(result.camera.K[0, 0] - 520) < 4 * result.sigma['fx'])
    True

    """
    facts = CameraFacts() if facts is None else facts
    width, height = np.maximum(np.ceil(tracks.xy.max(axis=0, initial=0) + 1), 1)
    size = tracks.image_size or (int(width), int(height))
    facts.check_for(size)
    result: Calibration | NoEstimate
    try:
        result = with_tested_facts(
            lambda stated: _calibrate(tracks, target, size, stated, flatness), facts)
    except np.linalg.LinAlgError:
        _LOGGER.debug('equations without a solution', exc_info=True)
        result = NoEstimate('equations_singular')
    if isinstance(result, NoEstimate):
        return NotCalibrated.of(result, frames=tracks.frames, facts=facts, motion=MOTION,
                                software=SOFTWARE)
    return replace(result, software=SOFTWARE)


def _calibrate(tracks: Tracks, target: KnownObject, size: tuple[int, int],
               facts: CameraFacts, flatness: float | None) -> Calibration | NoEstimate:
    """Calibrate in a centred frame of the object, and go back to its own."""
    origin = target.points.mean(axis=0) if len(target) else np.zeros(3)
    extent = float(np.sqrt(np.mean(np.sum((target.points - origin)**2, axis=1)))) if len(
        target) else 0.0
    if not extent > 0:
        return NoEstimate('object_without_extent')
    scaled = replace(target, points=(target.points - origin) / extent)
    gathered = gathered_views(tracks, scaled)
    if isinstance(gathered, NoEstimate):
        return gathered
    views, findings = gathered
    fit = _fit(views, size, facts)
    if isinstance(fit, NoEstimate):
        return fit
    bent = None
    if flatness != 0:
        bent = _bent_fit(views, fit, scaled.points,
                         USUAL_FLATNESS if flatness is None else flatness / extent, size)
    still = fit if bent is None else bent
    moving = _moving_fit(views, still, scaled.points, size, facts)
    used, bundle, state, chosen, judgement = still if moving is None else moving
    limit = MISFIT_FRACTION * float(np.hypot(*size))
    if all(view.mirrored and view.error_px < limit for view in views.linear):
        return NoEstimate('object_mirrored')
    if not bundle.sigma_px <= limit:
        return NoEstimate('object_misfit', left_px=float(bundle.sigma_px), limit_px=limit)
    clusters, covariance, status = judgement
    missing = unobservable_among(status, MATRIX_PARAMETERS)
    if missing:
        return _unobservable(missing, used).saying(status=status)
    residuals = bundle.residuals(state)
    lost = np.setdiff1d(views.frames, used.frames)
    if len(lost):
        findings += (Finding('object_misfits_frames', frames=tuple(lost.tolist())),)
    # back to the object's own frame and unit
    poses = np.array(state.path.cam_from_object)
    poses[:, :, 3] = extent * poses[:, :, 3] - poses[:, :, :3] @ origin
    points = np.column_stack([target.points, np.ones(len(target))])
    if bent is not None:
        shape = BoardShape.of(bundle, state, clusters, scaled.points, extent)
        points[:, :3] += shape.off
        findings += shape.findings()
    findings += motion_findings(bundle, state)
    rejected = len(views.view) - len(used.view)
    return Calibration(
        camera=state.camera(*size), covariance=covariance, status=status,
        held_by=held_facts(chosen), motion=MOTION, facts=chosen,
        frames=tuple(int(f) for f in used.frames),
        reprojection_rms_px=rms_length(residuals),
        noise_sigma_px=bundle.sigma_px, observation_count=len(used.view),
        outlier_count=rejected,
        reconstruction=Reconstruction(used.frames, poses, target.identity, points,
                                      pose_precision=pose_precision(bundle, state, extent),
                                      row_motion=row_motion_of(bundle, state, extent)),
        findings=findings + clusters.findings(track='errors_at_object_points'),
        residuals=residuals)


class _Judgement(NamedTuple):
    """
    What an optimum says of the camera.

    Attributes
    ----------
    clusters : ClusterCovariance
        How far errors are shared.
    covariance : ndarray, shape (k, k)
        Of the camera's parameters.
    status : dict of str to str
        Of every parameter.

    """

    clusters: ClusterCovariance
    covariance: np.ndarray
    status: dict[str, Status]

    @property
    def is_complete(self) -> bool:
        """Tell whether every parameter is determined."""
        return 'unobservable' not in self.status.values()


class _Fitted(NamedTuple):
    """
    An optimum, and what it says.

    Attributes
    ----------
    views : ObjectViews
        Without outliers.
    bundle : Bundle
    state : ObjectState
    facts : CameraFacts
        With the distortion model that was fitted.
    judgement : _Judgement

    """

    views: ObjectViews
    bundle: Bundle[ObjectState]
    state: ObjectState
    facts: CameraFacts
    judgement: _Judgement


def _moving_fit(views: ObjectViews, fit: _Fitted, points: np.ndarray, size: tuple[int, int],
                facts: CameraFacts) -> _Fitted | None:
    """Return the fit with an object that moves while it is read; None where it held still."""
    if facts.shutter != 'rolling' and not (facts.line_delay_s or facts.line_delay_sigma_s):
        # what a lens or a print lacks looks like motion, too: it must be said that rows are read
        return None
    offered = views.select(np.isin(views.frames, fit.views.frames)[views.view])
    bend = fit.views.bend
    if bend is not None:
        offered = may_bend(offered, points, bend.sigma[0]) or offered
    found = moving_fit(offered, (fit.views, fit.bundle, fit.state), size,
                       lambda moving, state: _robust_fit(moving, state, fit.facts))
    if found is None:
        return None
    judgement = _judge(*found, fit.facts, size)
    return _Fitted(*found, fit.facts, judgement) if judgement.is_complete else None


def _bent_fit(views: ObjectViews, fit: _Fitted, points: np.ndarray, sigma: float,
              size: tuple[int, int]) -> _Fitted | None:
    """Return the fit with a board that may bend; None where the images do not determine it."""
    seen = np.isin(views.frames, fit.views.frames)[views.view]
    free = may_bend(views.select(seen), points, sigma)
    bent = None if free is None else _robust_fit(free, fit.state, fit.facts)
    if bent is None or isinstance(bent, NoEstimate):
        return None
    judgement = _judge(*bent, fit.facts, size)
    return _Fitted(*bent, fit.facts, judgement) if judgement.is_complete else None


def _fit(views: ObjectViews, size: tuple[int, int], facts: CameraFacts) -> _Fitted | NoEstimate:
    """Fit the lens of the family that explains the views best, if none is stated."""
    found = _fit_family(views, size, facts)
    if facts.distortion != 'auto' or not _may_be_wide(views, found):
        return found
    other = _fit_family(views, size, replace(facts, distortion='equidistant'))
    if isinstance(other, NoEstimate):
        return found
    if isinstance(found, NoEstimate):
        return other
    sigma = min(found.bundle.sigma_px, other.bundle.sigma_px)
    gain = _misfit(views, found, sigma) - _misfit(views, other, sigma)
    return other if gain > FAMILY_MARGIN else found


def _may_be_wide(views: ObjectViews, fit: _Fitted | NoEstimate) -> bool:
    """Tell whether points lie far from the axis of a fitted perspective, or do not fit it."""
    if isinstance(fit, NoEstimate):
        return True
    angle = np.arccos(np.clip(fit.state.camera().rays(fit.views.xy)[:, 2], -1, 1))
    return (len(fit.views.view) < MOSTLY_FITTED * len(views.view)
            or not (angle < WIDE_ANGLE).all())


def _misfit(views: ObjectViews, fit: _Fitted, sigma_px: float) -> float:
    """Sum of squared residuals over the variance, an outlier's share for what was left out."""
    square = np.sum(fit.bundle.residuals(fit.state)**2, axis=1) / sigma_px**2
    most, left_out = OUTLIER_SIGMAS**2, len(views.view) - len(fit.views.view)
    return float(np.minimum(square, most).sum() + most * left_out)


def _fit_family(views: ObjectViews, size: tuple[int, int],
                facts: CameraFacts) -> _Fitted | NoEstimate:
    """Fit the richest member of one family that the views determine; see `_fit`."""
    state = _start(views, size, facts)
    names = AUTOMATIC_DISTORTION if facts.distortion == 'auto' else (facts.distortion,)
    found: _Fitted | NoEstimate = NoEstimate('no_fit_to_points')
    for name in names:
        chosen = replace(facts, distortion=name)
        bundle = views.bundle(priors_from_facts(chosen), 1.0)
        if bundle.degrees_of_freedom < 1:
            if name != names[-1]:
                continue
            unknowns = bundle.unknowns.count + len(VIEW_NAMES) * len(views.frames)
            return NoEstimate('too_few_points', coordinates=2 * len(views.view),
                              unknowns=unknowns)
        fit = _robust_fit(views, with_fixed(state, bundle.priors), chosen)
        if isinstance(fit, NoEstimate):
            continue
        used, bundle, fitted = fit
        judgement = _judge(used, bundle, fitted, chosen, size)
        found = _Fitted(used, bundle, fitted, chosen, judgement)
        if judgement.is_complete:
            break
    return found


def _start(views: ObjectViews, size: tuple[int, int], facts: CameraFacts) -> ObjectState:
    """Return the best of the supposed cameras after a short, held adjustment of a few points."""
    rank = np.arange(len(views.view)) - np.searchsorted(views.view, views.view)
    count = np.bincount(views.view)[views.view]
    few = views.select(rank * START_POINTS % count < START_POINTS)
    longer = max(size)
    priors = start_lens(facts).under({'cx': Prior((size[0] - 1) / 2, 0.2 * longer),
                                      'cy': Prior((size[1] - 1) / 2, 0.2 * longer)})
    # a pixel or two for what the linear solution and the short adjustment leave
    bundle = few.bundle(priors, 0.002 * longer)
    best, least = None, np.inf
    if priors.lens.is_perspective:
        starts = (start_state(K, few.linear, priors.lens)
                  for K in supposed_cameras(few.linear, size, facts))
    else:
        starts = (fisheye_state(camera, few.linear, few.view, few.points, few.xy)
                  for camera in fisheye_cameras(size, facts, priors.lens))
    for number, state in enumerate(starts):
        state = bundle.optimise(with_fixed(state, priors), iterations=25, tolerance=_OF_STARTS)
        cost = bundle.cost(state)
        if best is None or cost < least:
            best, least = state, cost
        # the range of focal lengths is for those that the linear equations left without
        if number and least < len(few.view):
            break
    assert best is not None     # a range of focal lengths is always supposed
    return best


def _robust_fit(views: ObjectViews, state: ObjectState, facts: CameraFacts,
                ) -> tuple[ObjectViews, Bundle[ObjectState], ObjectState] | NoEstimate:
    """Adjust, estimate the noise, leave out outliers."""
    priors = priors_from_facts(facts)
    bundle = views.bundle(priors, 1.0)
    sigma = bundle.noise_sigma(state)
    for _ in range(6):
        if not np.isfinite(sigma):
            return NoEstimate('no_fit_to_points')
        bundle = views.bundle(priors, sigma)
        state = bundle.optimise(state, tolerance=_OF_ROUNDS)
        before, sigma = sigma, bundle.noise_sigma(state)
        if abs(sigma - before) < 0.05 * before:
            break
    for _ in range(3):
        distance = np.linalg.norm(bundle.residuals(state), axis=1)
        good = distance < OUTLIER_SIGMAS * sigma
        if good.all():
            break
        rest = views.select(good)
        if not len(rest.view) or rest.bundle(priors, sigma).degrees_of_freedom < 1:
            return NoEstimate('no_fit_to_points')
        kept = np.isin(views.frames, rest.frames)
        state = state.of_views(kept)
        views, bundle = rest, rest.bundle(priors, sigma)
        state = bundle.optimise(state, tolerance=_OF_ROUNDS)
        sigma = bundle.noise_sigma(state)
    bundle = views.bundle(priors, bundle.noise_rms(state))
    state = bundle.optimise(state, tolerance=_FINAL)
    return views, bundle, state


def _judge(views: ObjectViews, bundle: Bundle[ObjectState], state: ObjectState, facts: CameraFacts,
           size: tuple[int, int]) -> _Judgement:
    """Return how far errors are shared, the covariance, and every parameter's status."""
    # the shape of a board with the lens: what moves the one moves the other
    information = replace(bundle.information(state), lens=bundle.unknowns.shared)
    clusters = cluster_robust_covariance(information, views.point, views.xy, size)
    camera = state.camera(*size)
    of_lens = clusters.covariance[bundle.unknowns.lens, bundle.unknowns.lens]
    covariance = without_held(to_parameters(of_lens, state.lens), camera, facts)
    status = parameter_status(camera, covariance, facts, bundle.sigma_px)
    return _Judgement(clusters, covariance,
                      {**status, **_open_without_lens(bundle, state, facts, size)})


def _open_without_lens(bundle: Bundle[ObjectState], state: ObjectState, facts: CameraFacts,
                       size: tuple[int, int]) -> dict[str, Status]:
    """
    Return the parameters that the same views leave open where the lens does not distort.

    The distortion of a board alone shows the principal point, and with it the rest. It does so
    only as far as the lens is exactly what its model says.
    """
    pinhole = replace(facts, distortion='none')
    priors = priors_from_facts(facts).updated(
        {name: Prior(0.0, 0.0) for name in state.lens.model.coefficients})
    ideal, bare = with_fixed(state, priors), bundle.with_priors(priors)
    # what that camera would have seen
    exact = Bundle(bundle.model, bundle.view, bundle.part,
                   bundle.xy + np.nan_to_num(bare.residuals(ideal)), priors=priors,
                   sigma_px=bundle.sigma_px)
    lens = exact.unknowns.lens
    covariance = to_parameters(exact.ideal_covariance(ideal)[lens, lens], ideal.lens)
    status = parameter_status(ideal.camera(*size), covariance, pinhole, bundle.sigma_px)
    return {name: status[name] for name in MATRIX_PARAMETERS if status[name] == 'unobservable'}


def _unobservable(missing: tuple[str, ...], views: ObjectViews) -> NoEstimate:
    """Tell which parameters the views leave open."""
    if not all(view.flat for view in views.linear):
        return NoEstimate('object_leaves_open', missing=missing)
    if len(views.linear) == 1:
        return NoEstimate('one_flat_image', missing=missing)
    return NoEstimate('views_alike', missing=missing, views=len(views.linear))
