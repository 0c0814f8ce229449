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
"""What an optimum of a rig says: each lens and pose, what is open, in which unit; or a refusal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.lens import to_parameters_slopes
from selfcal_ros.calibration.bundle.rig import name_in_rig, POSE_NAMES, Rig
from selfcal_ros.calibration.bundle.rig_model import RigState
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.estimators.acceptance import MAX_OUTLIERS
from selfcal_ros.calibration.known_directions import PlaceAlong, places_along
from selfcal_ros.calibration.observability import held_facts, parameter_status, without_held
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.calibration.rigs.overlap import Overlap, unseen_heights
from selfcal_ros.calibration.rigs.result import CameraInRig, PLACE, RigCalibration, TURN
from selfcal_ros.calibration.rigs.start import RigObservations
from selfcal_ros.calibration.rigs.steadiness import steadiness
from selfcal_ros.calibration.structure.metric_structure import IN_A_PLANE
from selfcal_ros.calibration.structure.path_precision import path_slopes, pose_precision
from selfcal_ros.calibration.structure.structure_measurement import regression
from selfcal_ros.calibration.uncertainty.assessed_estimate import AssessedEstimate, Chain, SHARED
from selfcal_ros.calibration.uncertainty.cluster_covariance import (ClusterCovariance,
                                                                    robust_covariance_of)
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import rms_length
from selfcal_ros.values.motion import Motion
from selfcal_ros.values.parameter_status import Status, unobservable_among
from selfcal_ros.version import SOFTWARE

#: Cameras that are rigid to each other leave less than so many times what each leaves alone.
RIGID = 2.0
#: A place counts as open where its sigma is more than this share of the spread of the path, a
#: turn beyond so many radians.
OPEN_PLACE, OPEN_TURN_RAD = 0.25, np.radians(5.0)
#: A length that is stated gives the scale where the images know its share of the path so well;
#: or where points that both cameras see tell how far they are, whatever the path.
BASELINE_SIGMA = 0.2


@dataclass(frozen=True)
class RigOptimum:
    """
    An optimum, and what it came from.

    Attributes
    ----------
    fit : RobustFit
        Its state is a `RigState`.
    found : RigObservations
    facts : mapping of str to CameraFacts
        Of every camera, the lens chosen.
    sizes : mapping of str to (int, int)
        Width and height of the images.
    motion : str
    noise_px : float
        What single cameras leave.
    shared : bool
        Whether the cameras may share points.

    """

    fit: RobustFit
    found: RigObservations
    facts: Mapping[str, CameraFacts]
    sizes: Mapping[str, tuple[int, int]]
    motion: Motion
    noise_px: float
    shared: bool

    @property
    def camera(self) -> np.ndarray:
        """Which camera made each observation, (N,)."""
        assert self.fit.observations.camera is not None
        return self.fit.observations.camera

    def clusters(self) -> ClusterCovariance:
        """Assess what errors of one track or region share, each camera in its own image."""
        return robust_covariance_of(self.fit, self.image_sizes)

    @property
    def image_sizes(self) -> np.ndarray:
        """Width and height of the images of every camera, (C, 2)."""
        return np.array([self.sizes[name] for name in self.found.cameras])

    def corrections(self) -> Chain:
        """Return what the covariance of a rig has to allow for."""
        def allow_for_unsteadiness(found: AssessedEstimate) -> AssessedEstimate:
            added, cause = steadiness(found.fit, self.found, found.variance_inflation)
            return found.widened(added, () if cause is None else (cause.finding(),))

        return Chain((*SHARED, allow_for_unsteadiness))


def refused(optimum: RigOptimum) -> NoEstimate | None:
    """Refuse what is not one rigid body, or is no explanation."""
    fit = optimum.fit
    rejected = fit.outliers / max(fit.outliers + len(fit.observations.view), 1)
    if fit.bundle.sigma_px > RIGID * optimum.noise_px or rejected > MAX_OUTLIERS:
        # whether the rig was rigid all the time
        _, cause = steadiness(fit, optimum.found, optimum.clusters().variance_inflation)
        left_px = float(fit.bundle.sigma_px)
        if cause is not None and cause.explained > 0.5 * (1 - (optimum.noise_px / left_px)**2):
            # more than half of what is beyond the noise of single cameras
            return cause.refusal(left_px, optimum.noise_px, optimum.motion)
        return NoEstimate('rig_not_rigid', left_px=left_px,
                          noise_px=optimum.noise_px, rejected=float(rejected),
                          motion=optimum.motion)
    return None


def judge(optimum: RigOptimum, alone: Mapping[str, Calibration | NotCalibrated],
          baseline: tuple[float, float] | None) -> RigCalibration | NoEstimate:
    """
    Judge an optimum, and put it into the terms of users.

    Parameters
    ----------
    optimum : RigOptimum
    alone : mapping of str to Calibration or NotCalibrated
        What the images of each camera say by themselves.
    baseline : (float, float), optional
        Distance of the first two cameras and its sigma, metres.

    Returns
    -------
    RigCalibration or NoEstimate

    """
    refusal = refused(optimum)
    if refusal is not None:
        return refusal
    found = optimum.corrections().applied_to(
        AssessedEstimate.of(optimum.fit, optimum.image_sizes))
    terms, findings = _terms(optimum, found, baseline)
    rig, covariance = terms.rig, terms.covariance
    cameras, poses, parameters = {}, {}, []
    for k, name in enumerate(rig.cameras):
        one = _camera(optimum, found, k, covariance, terms.scale)
        missing = unobservable_among(one.status, MATRIX_PARAMETERS)
        if missing:
            return NoEstimate('rig_lens_open', camera=name, missing=missing,
                              motion=optimum.motion, status=one.status)
        cameras[name], poses[name] = one, _pose(optimum, terms, k)
        parameters += [name_in_rig(name, parameter) for parameter in one.parameter_names]
        covariance[rig.of_lens(k), rig.of_lens(k)] = one.covariance
        remark = poses[name].remark
        findings += () if remark is None else (remark,)
    for k, name in enumerate(rig.cameras[1:], 1):
        parameters += [name_in_rig(name, one) for one in POSE_NAMES]
        _open(covariance, rig.of_pose(k), poses[name])
    points = terms.shared_points
    findings = (Finding('rig_overlap', points=int(points.max())) if points.any()
                else Finding('rig_no_overlap'), *findings)
    fit = optimum.fit
    residuals = found.residual[fit.linearisation.ahead]
    return RigCalibration(
        cameras=cameras, poses=poses, parameter_names=tuple(parameters), covariance=covariance,
        unit=terms.unit, scale=terms.scale * found.state.path.step_length(),
        motion=optimum.motion, frames=tuple(int(frame) for frame in optimum.found.frames),
        noise_sigma_px=fit.bundle.sigma_px,
        reprojection_rms_px=rms_length(residuals),
        observation_count=len(fit.observations.view), outlier_count=fit.outliers,
        reconstruction=next(iter(cameras.values())).reconstructed, alone=dict(alone),
        findings=findings, software=SOFTWARE)


@dataclass(frozen=True)
class _Terms:
    """
    A rig in the terms of users: parameters, places in a unit of length, and their covariance.

    Attributes
    ----------
    rig : Rig
        In the scale of the adjustment.
    unit : {'path', 'm'}
        Of places: the usual step of the path, or metres.
    scale : float
        So many units is the length one of the adjustment.
    covariance : ndarray, shape (n, n)
        Of the cameras' parameters and poses, in the order of `Rig.names`, in that unit. Heights
        that are open have the variance of the path.
    path_spread : float
        Root mean square distance of the path from its middle, in that unit.
    heights : tuple of (tuple of int, ndarray)
        Cameras whose common height above the others is open, and its direction (3,) in the rig.
    shared_points : ndarray of int, shape (C,)
        Points that every camera shares with others.

    """

    rig: Rig
    unit: str
    scale: float
    covariance: np.ndarray
    path_spread: float
    heights: Sequence[tuple[Sequence[int], np.ndarray]]
    shared_points: np.ndarray

    def open_height(self, k: int) -> np.ndarray:
        """Return the direction (3,) in which the place of a camera is open; zero if in none."""
        return next((normal for group, normal in self.heights if k in group), np.zeros(3))


def _terms(optimum: RigOptimum, found: AssessedEstimate, baseline: tuple[float, float] | None,
           ) -> tuple[_Terms, tuple[Finding, ...]]:
    """Carry an estimate to parameters and a unit of length: metres where a baseline gives it."""
    state, inner, findings = found.state, found.covariance.copy(), found.findings
    assert isinstance(state, RigState)
    rig = state.lens
    unit, scale, slopes = 'path', 1 / state.path.step_length(), _slopes(rig)
    overlap = Overlap.of(optimum.fit.observations)
    heights, spread = (unseen_heights(optimum.fit, overlap, found.clusters.sigma_inflation),
                       _spread(state.path.centres()))
    for group, normal in heights:
        # all of them are up together
        rise = np.zeros(len(inner))
        for k in group:
            rise[rig.of_pose(k)][:3] = normal
        inner += spread**2 * np.outer(rise, rise)
    if baseline is not None:
        # a length that is partly an open height is not known, however long that may be
        if overlap.links(0, 1) or not any(1 in group for group, _ in heights) and (
                _knows_baseline(rig, inner)):
            unit, scale = 'm', baseline[0] / float(np.linalg.norm(rig.place(1)))
            slopes = _carried_by_baseline(rig, slopes)
            length_share = baseline[1] / baseline[0]
            if not baseline[1]:
                findings += (Finding('rig_baseline_exact', baseline_m=baseline[0]),)
        else:
            findings += (Finding('rig_baseline_of_no_use', camera=rig.cameras[1]),)
    if unit == 'path':
        follows, variance = _step_after_lens(optimum.fit)
        slopes = _carried_by_step(rig, slopes, follows)
        length_share = float(np.sqrt(variance * found.variance_inflation))
    of_length = np.zeros(len(slopes))
    for k in range(1, len(rig.cameras)):
        slopes[rig.of_pose(k)][:3] *= scale
        of_length[rig.of_pose(k)][:3] = rig.place(k) * scale * length_share
    covariance = slopes @ inner @ slopes.T + np.outer(of_length, of_length)
    return _Terms(rig, unit, scale, covariance, scale * spread, heights,
                  overlap.points), findings


def _step_after_lens(fit: RobustFit) -> tuple[np.ndarray, float]:
    """
    Return how the step of the path follows the unknowns of the lens block, and what is its own.

    The adjustment holds another length than the unit of users.

    Returns
    -------
    follows : ndarray, shape (k,)
        Derivative of the step's logarithm.
    variance : float
        Of the logarithm, for independent errors, with the lens block held.

    """
    path, unknowns = fit.state.path, fit.bundle.unknowns
    _, moves = path_slopes(path, unknowns)
    steps = np.diff(path.centres(), axis=0)
    slope = (moves[3:] - moves[:-3]).T @ steps.ravel() / (len(steps) * path.step_length()**2)
    shared = fit.covariance @ slope
    follows = regression(fit.lens_covariance, shared[unknowns.lens])
    return follows, max(float(slope @ shared - follows @ shared[unknowns.lens]), 0.0)


def _spread(centres: np.ndarray) -> float:
    """Root mean square distance of places (V, 3) from their middle."""
    return float(np.sqrt(np.mean(np.sum((centres - centres.mean(axis=0))**2, axis=1))))


def _slopes(rig: Rig) -> np.ndarray:
    """Derivatives of the cameras' parameters and poses by the unknowns of the block, (n, n)."""
    slopes = np.eye(len(rig.names))
    for k in range(len(rig.cameras)):
        slopes[rig.of_lens(k), rig.of_lens(k)] = to_parameters_slopes(rig.lens(k))
    return slopes


def _knows_baseline(rig: Rig, inner: np.ndarray) -> bool:
    """Tell whether the images know the first two cameras' distance as a share of the path."""
    place = rig.place(1)
    length, rows = float(np.linalg.norm(place)), rig.of_pose(1)
    along = place / max(length, 1e-300)
    of_place = inner[rows, rows][:3, :3]
    return bool(length > 0 and along @ of_place @ along < (BASELINE_SIGMA * length)**2)


def _carried_by_baseline(rig: Rig, slopes: np.ndarray) -> np.ndarray:
    """Let all places follow the scale that one length states: p_k / |p_1| |p_1| held."""
    carried, first, at = slopes.copy(), rig.place(1), rig.of_pose(1).start
    for k in range(1, len(rig.cameras)):
        rows = rig.of_pose(k).start + np.arange(3)
        carried[rows[:, None], at + np.arange(3)] -= np.outer(rig.place(k),
                                                              first) / (first @ first)
    return carried


def _carried_by_step(rig: Rig, slopes: np.ndarray, follows: np.ndarray) -> np.ndarray:
    """Tell all places in steps of the path, which follow the unknowns themselves."""
    carried = slopes.copy()
    for k in range(1, len(rig.cameras)):
        carried[rig.of_pose(k)][:3] -= np.outer(rig.place(k), follows)
    return carried


def _camera(optimum: RigOptimum, found: AssessedEstimate, k: int, covariance: np.ndarray,
            scale: float) -> Calibration:
    """Return a camera as if it had been calibrated by itself."""
    state, fit = found.state, optimum.fit
    assert isinstance(state, RigState)
    rig = state.lens
    name = rig.cameras[k]
    facts, part = optimum.facts[name], rig.of_lens(k)
    camera = rig.lens(k).camera(*optimum.sizes[name])
    own = without_held(covariance[part, part], camera, facts)
    rows = (optimum.camera == k) & fit.linearisation.ahead
    offered = optimum.found.observations.camera
    assert offered is not None
    residuals = found.residual[rows]
    path = state.path.cam_from_world()
    path[:, :, 3] -= rig.place(k)
    path = rig.rotations[k].T @ path
    path[:, :, 3] *= scale
    seen, at = np.unique(fit.observations.view[rows], return_index=False), np.unique(
        fit.observations.point[rows])
    points = state.points[at] * [scale, scale, scale, 1.0]
    frames = optimum.found.frames[seen]
    return Calibration(
        camera=camera, covariance=own,
        status=parameter_status(camera, own, facts, fit.bundle.sigma_px),
        held_by=held_facts(facts), motion=optimum.motion, facts=facts,
        frames=tuple(int(frame) for frame in frames),
        reprojection_rms_px=rms_length(residuals),
        noise_sigma_px=fit.bundle.sigma_px, observation_count=int(rows.sum()),
        outlier_count=int(np.count_nonzero(offered == k) - rows.sum()),
        software=SOFTWARE,
        reconstruction=Reconstruction(
            frames, path[seen], fit.observations.track[at],
            points / np.linalg.norm(points, axis=1, keepdims=True),
            pose_precision=pose_precision(fit, optimum.motion in IN_A_PLANE)
            if k == 0 and len(seen) == len(path) else None),
        residuals=residuals)


def _pose(optimum: RigOptimum, terms: _Terms, k: int) -> CameraInRig:
    """Return where a camera sits, and what of it is open; a height that is counts as none."""
    T, rig, scale, height = np.eye(4), terms.rig, terms.scale, terms.open_height(k)
    shared, open_place = int(terms.shared_points[k]), OPEN_PLACE * terms.path_spread
    if k == 0:
        return CameraInRig(T, np.zeros((6, 6)), dict.fromkeys((*PLACE, *TURN), 'held'),
                           shared)
    own = terms.covariance[rig.of_pose(k), rig.of_pose(k)].copy()
    sigma = np.sqrt(np.diag(own))
    is_open = sigma > np.r_[[open_place] * 3, [OPEN_TURN_RAD] * 3]
    place = rig.place(k)
    T[:3, :3], T[:3, 3] = rig.rotations[k], (place - height * (height @ place)) * scale
    places: tuple[PlaceAlong, ...] = ()
    if is_open[:3].any():
        # a direction that is open need not be an axis
        squares, turns = np.linalg.eigh(own[:3, :3])
        places = places_along(T[:3, 3].copy(), own[:3, :3],
                              turns[:, squares > open_place**2].T, np.inf)
    T[:3, 3][is_open[:3]] = np.nan
    if is_open[3:].any():
        T[:3, :3] = np.nan
    own[is_open] = own[:, is_open] = 0
    own[is_open, is_open] = np.inf
    status: dict[str, Status] = {name: 'unobservable' if one else 'estimated'
                                 for name, one in zip(POSE_NAMES, is_open)}
    return CameraInRig(T, own, status, shared, _remark(optimum, rig.cameras[k], status), places)


def _remark(optimum: RigOptimum, camera: str, status: Mapping[str, Status]) -> Finding | None:
    """Say what is open, and which motion would show it."""
    names = unobservable_among(status, status)
    if not names:
        return None
    kind = ('rig_circle_open' if optimum.motion == 'circular' else
            'rig_height_open' if optimum.fit.motion.keeps_plane else 'rig_pose_open')
    return Finding(kind, camera=camera, names=names)


def _open(covariance: np.ndarray, rows: slice, pose: CameraInRig) -> None:
    """Make the covariance of all agree with what of a pose is open."""
    is_open = rows.start + np.flatnonzero(np.isinf(np.diag(pose.covariance)))
    covariance[is_open] = covariance[:, is_open] = 0
    covariance[is_open, is_open] = np.inf
