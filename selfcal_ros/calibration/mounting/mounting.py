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
"""`mount_camera`: from a calibration and poses of the body to where the camera sits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import logging

import numpy as np

from selfcal_ros.calibration.known_directions import PlaceAlong
from selfcal_ros.calibration.mount import Mount, MountFacts, NAMES, TURN as ANGLES
from selfcal_ros.calibration.mounting.adjustment import Adjustment, NEAR_M
from selfcal_ros.calibration.mounting.body_track import BodyTrack
from selfcal_ros.calibration.mounting.camera_errors import with_errors_of_camera
from selfcal_ros.calibration.mounting.camera_poses import (
    camera_poses, CameraPoses, chance_of_pull, with_lens)
from selfcal_ros.calibration.mounting.clocks import (
    APART_S, Clocks, LEAST_IMAGES, LEAST_TIMED, STEP_S)
from selfcal_ros.calibration.mounting.disagreement import (contradicted_fact, why_no_start,
                                                           WRONG)
from selfcal_ros.calibration.mounting.mistaken_poses import clocks_apart, what_is_meant
from selfcal_ros.calibration.mounting.model import (COUNT, LAG, METRE, OFFSET, SCALE, State, T,
                                                    TURN)
from selfcal_ros.calibration.mounting.open_freedoms import (
    axis_in_camera, degrees_of_freedom, known_places, missing_motion, open_axis, open_places,
    without_sense)
from selfcal_ros.calibration.mounting.optimum import Optimum
from selfcal_ros.calibration.mounting.pose_errors import PoseErrors
from selfcal_ros.calibration.mounting.starts import pairs_of, starts
from selfcal_ros.calibration.mounting.turning_sense import (alike_in_a_row, HEADING,
                                                            open_sense)
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.body_poses import BodyPoses

_LOGGER = logging.getLogger(__name__)

#: Share of what tells the offset of the clocks that is no noise, at least.
LEAST_TRUE = 0.25
#: Images keep their poses while the offset moves by this, seconds.
_MARGIN_S = 0.05
#: Each start is refined in so many rounds, in which the errors are estimated anew.
_START_ROUNDS = 3
#: A body that moved and turned by less than this, stood still: metres, radians.
STILL_M, STILL_RAD = 1e-3, 2e-3
#: Poses that disagree with the images by this share of what moved belong to another motion.
CONTRADICTION = 0.3
#: Odometry drifts where its heading errs by less, radians for a metre or radian of the way, and
#: successive errors are not alike. Else it is of another body.
MOST_DRIFT_RAD = 0.05
#: Places of the poses are late behind their turns where that shows by so many sigmas, and is
#: more than this, seconds.
LAG_SHOWS, LEAST_LAG_S = 4.0, 5e-4
#: Two offsets of the clocks meet other errors of the poses. They are told apart where twice the
#: logarithm of the likelihood differs by so many sigmas of what that makes by chance.
TOLD_APART = 3.0
#: Poses that are right change the camera by as much with this chance: three sigmas.
PULLED = 0.0027
#: No camera sits so far from the middle of its robot; with millimetres for metres one does.
FAR_M = 8.0
#: How far the metre of poses may be from that of an object, as a standard deviation; where one is
#: wrong by more than the second, nothing is told.
ANY_SCALE, MOST_APART = 0.3, 0.05
#: Where a smaller share of the images has a pose, poses stopped, or began late.
LEAST_COVERED = 0.7
#: More wrong poses than this are no few.
MOST_WRONG = 0.4
#: Kind of refusal where the equations have no solution.
SINGULAR = 'mount_singular'
#: Where more of the poses contradict the others, a stated sigma may be why, if the misfits are so
#: many times larger.
MOST_BY_SIGMA, SIGMA_TOO_SMALL = 0.1, 2.0


def mount_camera(calibration: Calibration, poses: BodyPoses,
                 stamps_ns: Mapping[int, int] | None = None,
                 facts: MountFacts = MountFacts()) -> Calibration:
    """
    Find where a calibrated camera sits on its robot.

    Parameters
    ----------
    calibration : Calibration
        With its reconstruction, from images that the moving camera took.
    poses : BodyPoses
        Of the body that carries it.
    stamps_ns : mapping of int to int, optional
        Instants of the frames by the camera's clock, where poses are by instants.
    facts : MountFacts
        What is known beforehand.

    Returns
    -------
    Calibration
        With `mount` set, to a `Mount` or a `NoEstimate` with its reason; camera and covariance are
        those of images and poses together.

    Raises
    ------
    ArgumentError
        If the calibration comes without its reconstruction.

    """
    found = _solved(calibration, poses, stamps_ns, facts)
    others = MountFacts(scale=facts.scale)
    failed = isinstance(found.mount, NoEstimate) and found.mount.kind == SINGULAR
    if facts == others or not (failed or isinstance(found.mount, Mount)):
        return found
    free = _solved(calibration, poses, stamps_ns, others).mount
    if not isinstance(free, Mount):
        return found
    wrong = contradicted_fact(facts, free)
    if wrong is None and failed:
        # without them there is a solution
        wrong = NoEstimate('mount_facts_wrong', facts=tuple(facts.stated))
    return found if wrong is None else replace(calibration, mount=wrong)


def _solved(calibration: Calibration, poses: BodyPoses, stamps_ns: Mapping[int, int] | None,
            facts: MountFacts) -> Calibration:
    """Find where a camera sits, or that the equations have no solution."""
    try:
        return _mounted(calibration, poses, stamps_ns, facts)
    except np.linalg.LinAlgError:
        _LOGGER.debug('equations without a solution', exc_info=True)
        return replace(calibration, mount=NoEstimate('mount_singular', count=len(poses)))


def _mounted(calibration: Calibration, poses: BodyPoses, stamps_ns: Mapping[int, int] | None,
             facts: MountFacts) -> Calibration:
    """Find where a camera sits; see `mount_camera`."""
    camera = camera_poses(calibration)
    track = BodyTrack(poses, camera.frames, stamps_ns)
    refusal = _too_little(camera, track, poses, facts)
    if refusal is not None:
        return replace(calibration, mount=refusal)
    middle, roughly = facts.time_offset or (0.0, np.inf)
    # what is stated roughly is looked for about its value
    clocks = Clocks(camera, track, middle)
    tried = [middle] if roughly < STEP_S and track.timed else clocks.offsets()
    rows = np.flatnonzero(track.known(tried[0], _MARGIN_S if track.timed else 0.0))
    part, body = camera.chosen(rows), track.at(tried[0], rows)
    meant = what_is_meant(part, track, tried[0], rows) if len(rows) >= LEAST_IMAGES else None
    if meant is None and len(rows) >= LEAST_IMAGES:
        meant = clocks_apart(clocks, tried[0], rows)
    if meant is not None:
        return replace(calibration, mount=meant)
    started = [_from_start(camera, track, poses, facts, offset) for offset in tried]
    found = [one for one in started if one is not None]
    if not found:
        return replace(calibration, mount=why_no_start(part, body, len(poses))
                       if len(rows) >= LEAST_IMAGES
                       else NoEstimate('no_mount_fits', count=len(poses)))
    adjustment, optimum, rows = min(found, key=lambda one: one[1].cost / len(one[2]))
    part, track = camera.chosen(rows), adjustment.track
    if (~optimum.keep).sum() > MOST_BY_SIGMA * len(optimum.keep):
        small = _sigma_too_small(calibration, poses, stamps_ns, facts, optimum)
        if small is not None:
            return replace(calibration, mount=small)
    refusal = _contradiction(part, track, optimum, rows)
    if refusal is not None:
        return replace(calibration, mount=refusal)
    other = (_other_metre(part, track, optimum, rows, facts)
             if part.is_metric and facts.scale is None else None)
    if other is not None:
        adjustment, optimum = other
        ratio = float(np.exp(optimum.state.log_metre))
        if abs(ratio - 1) > MOST_APART:
            return replace(calibration, mount=NoEstimate('metres_differ', ratio=ratio))
    mount = _mount(part, poses, facts, adjustment, optimum, rows)
    if mount.status['time_offset'] == 'estimated' and _clock_is_open(
            clocks, poses, facts, optimum, len(rows)):
        mount = _without_clock(mount)
    if other is not None:
        mount = _in_either_metre(mount, optimum)
    findings = _findings(mount, track, facts, optimum)
    if len(rows) < LEAST_COVERED * len(camera):
        findings = (Finding('body_poses_partly', found=len(rows), images=len(camera)), *findings)
    w, spread = optimum.state.w, optimum.covariance[COUNT:, COUNT:]
    if chance_of_pull(part, w, spread) < PULLED:
        # what poses err in common would be taken for what they tell of the camera
        return replace(calibration, mount=mount, findings=(
            *calibration.findings, Finding('poses_pull_camera'), *findings))
    return replace(with_lens(calibration, camera, w, spread), mount=mount,
                   findings=(*calibration.findings, *findings))


def _too_little(camera: CameraPoses, track: BodyTrack, poses: BodyPoses,
                facts: MountFacts) -> NoEstimate | None:
    """Return why the poses of the body do not suffice; None where they may."""
    stated = facts.time_offset[0] if facts.time_offset is not None and track.timed else 0.0
    known = int(track.known(stated).sum())
    needed = LEAST_TIMED if track.timed and facts.time_offset is None else LEAST_IMAGES
    if known < needed and known > LEAST_COVERED * len(camera):
        return NoEstimate('too_few_images_for_mount', needed=needed, found=known)
    if known < needed:
        return NoEstimate('too_few_body_poses', needed=needed, found=known, images=len(camera))
    turned = np.linalg.norm(poses.rotation - poses.rotation[0], axis=(1, 2)).max() / np.sqrt(2)
    moved = np.linalg.norm(poses.position - poses.position[0], axis=1).max()
    if turned < STILL_RAD and moved < STILL_M:
        return NoEstimate('body_stood_still', body=poses.body_frame)
    return None


def _from_start(camera: CameraPoses, track: BodyTrack, poses: BodyPoses, facts: MountFacts,
                offset: float) -> tuple[Adjustment, Optimum, np.ndarray] | None:
    """Refine the best of the starts at an offset of the clocks; None where there is none."""
    margin = _MARGIN_S if track.timed else 0.0
    rows = np.flatnonzero(track.known(offset, margin))
    if len(rows) < LEAST_IMAGES:
        return None
    track = track.anchored(offset)
    part = camera.chosen(rows)
    started = _best_start(part, track, poses, facts, offset, rows)
    if started is None:
        return None
    best, rough = started
    adjustment, optimum = _with_lag(Adjustment(part, track, rows, facts), best, rough)
    lost = open_places(optimum, adjustment.free, track.odometry)
    if len(lost):
        optimum = _near_origin(adjustment.held_along(lost), lost, best, rough)
    return adjustment, optimum, rows


def _best_start(part: CameraPoses, track: BodyTrack, poses: BodyPoses, facts: MountFacts,
                offset: float, rows: np.ndarray) -> tuple[State, PoseErrors] | None:
    """Return the likeliest of the starts in closed form, and how large errors are there."""
    # with exact poses of the camera, which is quick
    stiff = part.stiff()
    coarse = Adjustment(stiff, track, rows, facts)
    errors = PoseErrors.of(poses, track, offset, rows, part.has_path)
    every = np.ones(errors.shapes.shape[1], bool)
    tried = []
    for start in starts(stiff, track.at(offset, rows), offset):
        state = coarse.with_facts(start)
        rough = errors.from_medians(coarse.predict(state).residual, every)
        for _ in range(_START_ROUNDS):
            state, _ = coarse.descend(state, rough)
            rough = errors.from_medians(coarse.predict(state).residual, every)
        # the determinant stands for the size of the misfits, whichever their kind
        size = np.linalg.slogdet(rough.covariances)[1].sum()
        tried.append((coarse.descend(state, rough)[1] + size, state, rough))
    if not tried:
        return None
    _, best, rough = min(tried, key=lambda one: one[0])
    best = replace(best, w=np.zeros(part.roots.shape[2]))
    return best, rough if track.odometry else with_errors_of_camera(rough, best, part)


def _with_lag(adjustment: Adjustment, start: State, errors: PoseErrors,
              ) -> tuple[Adjustment, Optimum]:
    """Find the optimum; places of the poses may be late behind their turns where that shows."""
    optimum = adjustment.optimum(start, errors)
    if not adjustment.track.timed:
        return adjustment, optimum
    adjustment = adjustment.anchored(optimum.state.offset)
    optimum = adjustment.optimum(optimum.state, errors)
    lag, sigma = adjustment.lag(optimum)
    if abs(lag) > max(LAG_SHOWS * sigma, LEAST_LAG_S):
        adjustment = adjustment.with_lag()
        optimum = adjustment.optimum(optimum.state, errors)
        adjustment = adjustment.anchored(optimum.state.offset)
        optimum = adjustment.optimum(optimum.state, errors)
    return adjustment, optimum


def _clock_is_open(clocks: Clocks, poses: BodyPoses, facts: MountFacts, optimum: Optimum,
                   count: int) -> bool:
    """Tell whether an offset of the clocks far from the one found explains all as well."""
    per_image, kinds = optimum.cost / count, 3 if clocks.track.flat else 6
    for offset in clocks.alike(optimum.state.offset):
        found = _from_start(clocks.camera, clocks.track, poses, facts, offset)
        if found is None or abs(found[1].state.offset - optimum.state.offset) < APART_S / 2:
            continue
        images = len(found[2])
        worse = (found[1].cost / images - per_image) * min(images, count)
        # n log s² of a variance from n misfits has the variance 2 n, and there are two
        if worse < TOLD_APART * np.sqrt(4 * kinds * min(images, count)):
            return True
    return False


def _without_clock(mount: Mount) -> Mount:
    """Return a mount that does not know the offset of the clocks."""
    covariance, index = mount.covariance.copy(), NAMES.index('time_offset')
    covariance[index], covariance[:, index] = 0, 0
    covariance[index, index] = np.inf
    return replace(mount, covariance=covariance, time_offset_s=np.nan,
                   status={**mount.status, 'time_offset': 'unobservable'},
                   missing={**mount.missing, 'time_offset': Finding('time_offset_open').sentence})


def _near_origin(near: Adjustment, lost: np.ndarray, start: State, errors: PoseErrors) -> Optimum:
    """Find the optimum whose place is at the body's origin along open directions (n, 3)."""
    place = start.place - lost.T @ (lost @ start.place)
    nearer, _ = near.descend(replace(start, place=place), errors)
    optimum = near.optimum(nearer, errors)
    # what holds the place tells nothing of it
    held = np.zeros_like(optimum.information)
    held[T, T] = lost.T @ lost / NEAR_M**2
    return replace(optimum, information=optimum.information - held)


def _contradiction(camera: CameraPoses, track: BodyTrack, optimum: Optimum,
                   rows: np.ndarray) -> NoEstimate | None:
    """Return in what the poses of body and camera disagree; None where they agree."""
    wrong = 1 - optimum.keep.mean()
    if wrong > MOST_WRONG:
        return NoEstimate('body_poses_wrong', share=float(wrong))
    body = track.at(optimum.state.offset, rows)
    pairs = pairs_of(camera, body)
    ours, theirs = (np.linalg.norm(one, axis=1) for one in (pairs.camera_turn, pairs.body_turn))
    apart = float(np.median(np.abs(ours - theirs)))
    usual = float(np.median(np.maximum(ours, theirs)))
    if (usual > 5 * STILL_RAD and apart > CONTRADICTION * usual
            and not (track.odometry and _drifts(optimum))):
        return NoEstimate('body_turns_otherwise', camera_deg=float(np.rad2deg(np.median(ours))),
                          body_deg=float(np.rad2deg(np.median(theirs))),
                          apart_deg=float(np.rad2deg(apart)))
    return None


def _sigma_too_small(calibration: Calibration, poses: BodyPoses,
                     stamps_ns: Mapping[int, int] | None, facts: MountFacts,
                     optimum: Optimum) -> NoEstimate | None:
    """Tell that poses contradict each other by their stated sigmas alone, or return None."""
    stated = poses.sigma_position_m, poses.sigma_rotation_rad
    if stated == (None, None):
        return None
    free = _mounted(calibration, replace(poses, sigma_position_m=None, sigma_rotation_rad=None),
                    stamps_ns, facts).mount
    if not isinstance(free, Mount) or 2 * free.outlier_count > (~optimum.keep).sum():
        return None
    shown = free.sigma_position_m, free.sigma_rotation_rad
    too_small = [(1e3 * one, 1e3 * other, 'mm') if k == 0 else
                 (float(np.degrees(one)), float(np.degrees(other)), 'degrees')
                 for k, (one, other) in enumerate(zip(stated, shown))
                 if one is not None and other is not None and other > SIGMA_TOO_SMALL * one]
    if not too_small:
        return None
    return NoEstimate('robot_sigma_too_small', share=float(1 - optimum.keep.mean()),
                      stated=[f'{one:.2g} {unit}' for one, _, unit in too_small],
                      shown=[f'{other:.2g} {unit}' for _, other, unit in too_small])


def _other_metre(camera: CameraPoses, track: BodyTrack, optimum: Optimum, rows: np.ndarray,
                 facts: MountFacts) -> tuple[Adjustment, Optimum] | None:
    """Estimate how the poses' metre differs from the known object's; None where it does not."""
    free = Adjustment(camera, track, rows, replace(facts, scale=(1.0, ANY_SCALE)))
    found = free.optimum(optimum.state, optimum.errors)
    sigma = float(np.sqrt(found.covariance[METRE, METRE]))
    return None if abs(found.state.log_metre) < WRONG * sigma else (free, found)


def _in_either_metre(mount: Mount, optimum: Optimum) -> Mount:
    """Give a mount in metres of the object the sigmas that hold metres of the poses, too."""
    scale, sigma = np.exp(-optimum.state.log_metre), np.sqrt(optimum.covariance[METRE, METRE])
    covariance, place = mount.covariance.copy(), np.nan_to_num(mount.T_body_camera[:3, 3])
    covariance[:3, :3] += np.outer(place, place) * (scale - 1)**2
    index = NAMES.index('scale')
    covariance[index], covariance[:, index] = 0, 0
    covariance[index, index] = (scale * sigma)**2
    return replace(mount, covariance=covariance, scale=float(scale),
                   status={**mount.status, 'scale': 'estimated'})


def _drifts(optimum: Optimum) -> bool:
    """Tell whether odometry errs by chance, as wheels do, and not by another motion."""
    return bool(optimum.errors.by_component[HEADING] < MOST_DRIFT_RAD
                and not alike_in_a_row(optimum))


def _mount(camera: CameraPoses, poses: BodyPoses, facts: MountFacts, adjustment: Adjustment,
           optimum: Optimum, rows: np.ndarray) -> Mount:
    """Put an optimum in the form of a result."""
    state, track = optimum.state, adjustment.track
    body = track.at(state.offset, rows)
    pairs = pairs_of(camera, body)
    status = degrees_of_freedom(optimum, adjustment.free, track, facts)
    either = None
    angles = {status[name] for name in ANGLES}
    if 'estimated' in angles and 'unobservable' not in angles:
        either = open_sense(adjustment, optimum, body)
        status = without_sense(status, either)
    covariance, scale = _covariance(track, optimum, rows), float(np.exp(state.log_scale))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = state.turn, state.place
    for index, name in enumerate(NAMES):
        if status[name] != 'estimated':
            covariance[index], covariance[:, index] = 0, 0
        if status[name] == 'unobservable':
            covariance[index, index] = np.inf
            if index < 3:
                pose[index, 3] = np.nan
    places: tuple[PlaceAlong, ...] = ()
    axis = None
    if 'unobservable' in (status['x'], status['y'], status['z']) and (
            status['scale'] != 'unobservable'):
        places = known_places(optimum, adjustment.free, track.odometry)
    if any(status[name] == 'unobservable' for name in ANGLES):
        pose[:3, :3] = np.nan
        axis = (open_axis(optimum, adjustment.free, track.odometry) if either is None
                else axis_in_camera(optimum, either))
    if status['scale'] == 'unobservable':
        scale = np.nan
    offset = state.offset if status['time_offset'] != 'unobservable' else np.nan
    return Mount(poses.body_frame, pose, covariance, status, scale, float(offset),
                 missing_motion(status, track, pairs.body_turn, either is not None,
                                pairs.body_move), len(rows),
                 int((~optimum.keep).sum()), optimum.errors.sigma(0), optimum.errors.sigma(3),
                 places=places, axis=axis, pose_sigmas=optimum.errors.by_component)


def _covariance(track: BodyTrack, optimum: Optimum, rows: np.ndarray) -> np.ndarray:
    """Return the covariance of `NAMES`, (8, 8): metres, radians, a factor and seconds."""
    state, total = optimum.state, optimum.covariance.copy()
    # rates that noise made up tell nothing
    feigned = total[OFFSET, OFFSET] * track.feigned_information(
        rows, optimum.keep, optimum.errors.covariances, optimum.cautious.covariances)
    wider = 1 / max(1 - feigned, LEAST_TRUE)
    total[OFFSET] *= wider
    total[:, OFFSET] *= wider
    # the turns' clock is taken; that of the places may be the right one
    total[OFFSET, OFFSET] += state.lag**2
    # a factor of the poses' metres goes to scale and place alike; the state has its logarithm
    unit = np.ones(len(NAMES))
    unit[NAMES.index('scale')] = float(np.exp(state.log_scale))
    columns = np.r_[T, TURN, SCALE, OFFSET]
    of_names: np.ndarray = total[np.ix_(columns, columns)] * np.outer(unit, unit)
    return of_names


def _findings(mount: Mount, track: BodyTrack, facts: MountFacts, optimum: Optimum,
              ) -> tuple[Finding, ...]:
    """Tell what a user should know of a mount."""
    found = []
    if mount.outlier_count:
        found.append(Finding('body_poses_set_aside', count=mount.outlier_count,
                             of=mount.pose_count))
    if track.begun_anew:
        found.append(Finding('odometry_begun_anew', count=track.begun_anew))
    if optimum.state.lag:
        found.append(Finding('body_places_late', late_ms=1e3 * optimum.state.lag,
                             sigma_ms=1e3 * float(np.sqrt(optimum.covariance[LAG, LAG]))))
    if optimum.state.log_metre and facts.scale is None:
        found.append(Finding('metres_differ_a_little', scale={
            'value': mount.scale, 'sigma': mount.sigma['scale']}))
    distance_m = float(np.linalg.norm(np.nan_to_num(mount.T_body_camera[:3, 3])))
    if distance_m > FAR_M:
        found.append(Finding('mount_far_off', distance_m=distance_m, body=mount.frame))
    roll = mount.angles['roll']
    if track.odometry and facts.roll is None and abs(roll) > np.pi / 2:
        found.append(Finding('mount_upside_down', body=mount.frame,
                             roll_deg=float(np.degrees(roll))))
    if track.odometry and facts.scale is None:
        found.append(Finding('metre_of_odometry'))
    return tuple(found)
