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
Which degrees of freedom of a mount the motion shows, and in words what would show the others.

The information on a place comes from turns of the body; on the turn of the camera, from turns
and moves; on the scale, from moves. Errors of the measured turns and moves look like a little
motion. What they would feign is taken off before anything counts as seen.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from selfcal_ros.calibration.known_directions import AxisInCamera, PlaceAlong, places_along
from selfcal_ros.calibration.mount import MountFacts, NAMES, PLACE, TURN as ANGLES
from selfcal_ros.calibration.mounting.body_track import BodyTrack
from selfcal_ros.calibration.mounting.model import COUNT, OFFSET, SCALE, T, TURN
from selfcal_ros.calibration.mounting.optimum import Optimum
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.scaled_inverse import unit_diagonal
from selfcal_ros.values.parameter_status import Status

#: Sigma from which on a degree of freedom counts as unobservable: no better than a look at the
#: robot. Metres, radians, share of the scale, seconds.
LIMIT_M, LIMIT_RAD, LIMIT_SCALE, LIMIT_S = 0.2, 0.1, 0.1, 0.1
#: Motion must show so many times what errors feign.
ABOVE_NOISE = 3.0
#: Turns about the vertical by so many times those about other axes are those of a vehicle.
UPRIGHT = 5.0
#: Sigma along a motion that is not seen, in limits; and where nobody says how the camera's poses
#: err, so that an estimate may have run away along it.
_UNSEEN, _RUN_AWAY = 10.0, 100.0
#: A curve turns by more than this, and has a larger radius than a robot that turns on the spot.
LEAST_CURVE_RAD, LEAST_RADIUS_M = np.radians(10.0), 0.1
_COLUMNS = np.r_[T, TURN, SCALE, OFFSET]
_LIMITS = np.array([LIMIT_M] * 3 + [LIMIT_RAD] * 3 + [LIMIT_SCALE, LIMIT_S])


def degrees_of_freedom(optimum: Optimum, free: np.ndarray, track: BodyTrack,
                       facts: MountFacts) -> dict[str, Status]:
    """
    Tell 'estimated', 'held' or 'unobservable' for each of `NAMES`.

    Parameters
    ----------
    optimum : Optimum
    free : ndarray of bool, shape (16 + k,)
        Which unknowns are.
    track : BodyTrack
    facts : MountFacts

    Returns
    -------
    dict of str to str

    """
    sigma = _honest_sigma(optimum, free, track.odometry)
    held = {name for name, (_, spread) in facts.stated.items() if spread == 0}
    # wheels whose scale is exact do not hold that of the images
    held.discard('scale')
    if not track.timed:
        held.add('time_offset')
    status: dict[str, Status] = {}
    for name, column, limit, value in zip(NAMES, _COLUMNS, _LIMITS, sigma):
        if name in held:
            status[name] = 'held'
        elif name == 'scale' and not free[column]:
            # before a known object the images' own unit is the metre; turning has none
            status[name] = 'held' if free[T].any() else 'unobservable'
        else:
            status[name] = 'estimated' if free[column] and value < limit else 'unobservable'
    if status['scale'] == 'unobservable':
        # places are told in metres: without one they may be any multiple of themselves
        for name in PLACE:
            if name not in facts.stated:
                status[name] = 'unobservable'
    return status


def open_places(optimum: Optimum, free: np.ndarray, odometry: bool) -> np.ndarray:
    """Return unit vectors (n, 3) in the body along which the place is not shown."""
    return _open_directions(optimum, free, odometry, T)


def known_places(optimum: Optimum, free: np.ndarray, odometry: bool) -> tuple[PlaceAlong, ...]:
    """Return what is known of the place, by directions in the body."""
    if not free[T].all():
        return ()
    return places_along(optimum.state.place, optimum.covariance[T, T],
                        open_places(optimum, free, odometry), LIMIT_M)


def open_axis(optimum: Optimum, free: np.ndarray, odometry: bool) -> AxisInCamera | None:
    """Return the one axis about which the turn of the camera is not shown, or None."""
    found = _open_directions(optimum, free, odometry, TURN)
    return axis_in_camera(optimum, found[0]) if len(found) == 1 else None


def axis_in_camera(optimum: Optimum, axis: np.ndarray) -> AxisInCamera:
    """Return where the camera has an axis (3,) of the body, whatever the turn about it."""
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    across = np.eye(3) - np.outer(axis, axis)
    # the larger of the two
    sigma = np.sqrt(np.linalg.eigvalsh(across @ optimum.covariance[TURN, TURN] @ across)[-1])
    return AxisInCamera(axis, optimum.state.turn.T @ axis, float(sigma))


def without_sense(status: dict[str, Status], way: np.ndarray | None) -> dict[str, Status]:
    """
    Call unobservable what a half turn of the camera about an axis would change.

    Parameters
    ----------
    status : dict of str to str
    way : ndarray, shape (3,), or None
        Unit vector in the body of an axis about which the data allow such a turn; None if of
        none.

    Returns
    -------
    dict of str to str

    """
    if way is None:
        return status
    turned = [name for name, part in zip(ANGLES, way) if 2 * abs(part) > LIMIT_RAD]
    return {name: 'unobservable' if how == 'estimated' and name in (*PLACE, *turned) else how
            for name, how in status.items()}


def _open_directions(optimum: Optimum, free: np.ndarray, odometry: bool,
                     columns: slice) -> np.ndarray:
    """Return unit vectors (n, 3) in the body along which place or turn is not shown."""
    if not free[columns].all():
        return np.zeros((0, 3))
    ratio, motions, _ = _shown(optimum, free, odometry, np.arange(COUNT)[columns])
    unseen = motions[:, ratio <= 1]
    return np.linalg.qr(unseen)[0].T if unseen.shape[1] else np.zeros((0, 3))


def _shown(optimum: Optimum, free: np.ndarray, odometry: bool, columns: np.ndarray) -> tuple[
        np.ndarray, np.ndarray, np.ndarray]:
    """
    Take apart what is shown of some unknowns, motion by motion.

    Returns
    -------
    ratio : ndarray, shape (n,)
        Information over what errors feign and a look at the robot tells.
    motions : ndarray, shape (n, n)
        Columns, in limits.
    unit : ndarray, shape (n,)
        The limits.

    """
    others = np.setdiff1d(np.flatnonzero(free), columns)
    H = optimum.information
    tied = H[np.ix_(others, columns)]
    inner = H[np.ix_(others, others)]
    scaled, root = unit_diagonal(inner)
    tied = tied / root[:, None]
    shown = H[np.ix_(columns, columns)] - tied.T @ np.linalg.solve(
        scaled + 1e-12 * np.eye(len(others)), tied)
    feigned = _feigned(optimum, odometry)[np.ix_(columns, columns)]
    limits = dict(zip(_COLUMNS, _LIMITS))
    unit = np.array([limits[column] for column in columns])
    in_limits = np.outer(unit, unit)
    ratio, motions = eigh(shown * in_limits,
                          ABOVE_NOISE * feigned * in_limits + np.eye(len(columns)))
    return ratio, motions, unit


def _honest_sigma(optimum: Optimum, free: np.ndarray, odometry: bool) -> np.ndarray:
    """Return sigmas (8,) without the information that errors of the poses feign."""
    columns = _COLUMNS[free[_COLUMNS]]
    ratio, motions, unit = _shown(optimum, free, odometry, columns)
    seen = ratio > 1
    spread = (motions[:, seen]**2 / ratio[seen]).sum(axis=1)
    unseen = motions[:, ~seen] / np.linalg.norm(motions[:, ~seen], axis=0)
    far = _RUN_AWAY if _is_bare(optimum) else _UNSEEN
    spread += far**2 * (unseen**2).sum(axis=1)
    sigma = np.full(COUNT, np.inf)
    sigma[columns] = np.sqrt(spread) * unit
    found: np.ndarray = sigma[_COLUMNS]
    return found


def _feigned(optimum: Optimum, odometry: bool) -> np.ndarray:
    """Return the information (16, 16) that errors of turns and moves would feign."""
    slopes, keep = optimum.prediction.slopes[optimum.keep], optimum.keep
    W = np.linalg.inv(optimum.cautious.covariances[keep])
    # of the predicted turns and moves, whatever they come from
    errors = slopes @ optimum.covariance @ np.swapaxes(slopes, 1, 2)
    if _is_bare(optimum):
        # it may be the camera's poses that leave the misfits
        errors = errors + optimum.cautious.covariances[keep]
    Q, P = errors[:, 3:, 3:], errors[:, :3, :3]
    # in the axes of the body: the earlier one of a pair, or that of the pose
    axes = np.eye(3)[None] if odometry else -slopes[:, 3:, TURN]
    back = np.swapaxes(axes, 1, 2)
    place, turn, Q, P = (back @ one @ axes for one in (W[:, :3, :3], W[:, 3:, 3:], Q, P))
    feigned = np.zeros((COUNT, COUNT))
    feigned[T, T] = _by_crossing(Q, place)
    feigned[TURN, TURN] = _by_crossing(Q, turn)
    if odometry:
        feigned[TURN, TURN] += _by_crossing(P, place)
    feigned[SCALE, SCALE] = np.einsum('mij,mji->', place, P)
    return feigned


def _is_bare(optimum: Optimum) -> bool:
    """Tell whether nobody says how the poses of the camera err."""
    return bool(optimum.prediction.slopes.shape[2] == COUNT)


def _by_crossing(Q: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Return the mean of [δ]xᵀ W [δ]x for errors δ of covariance Q (m, 3, 3), summed."""
    across = cross_matrix(np.eye(3))
    total: np.ndarray = np.einsum('mkl,kia,mij,ljb->ab', Q, across, W, across)
    return total


def missing_motion(status: dict[str, Status], track: BodyTrack, turns: np.ndarray,
                   slight: bool = False, moves: np.ndarray | None = None) -> dict[str, str]:
    """
    Say which motion or fact would show what is open.

    Parameters
    ----------
    status : dict of str to str
    track : BodyTrack
    turns : ndarray, shape (m, 3)
        Of the body between images, in its own axes (rad).
    slight : bool
        The poses err by as much as the body turned.
    moves : ndarray, shape (m, 3), optional
        Of the body between images, metres.

    Returns
    -------
    dict of str to str

    """
    about = np.linalg.norm(turns, axis=0) / np.sqrt(max(len(turns), 1))
    upright = track.flat or about[2] > UPRIGHT * np.hypot(about[0], about[1])
    told = {}
    circle = upright and moves is not None and _is_circle(status, turns, moves)
    for name, verdict in status.items():
        if verdict != 'unobservable':
            continue
        if circle and name in ('x', 'y', 'yaw', 'scale'):
            finding = Finding('open_on_a_circle')
        elif slight and name in ANGLES:
            finding = Finding('turn_within_errors')
        elif name == 'z' and upright:
            finding = Finding('height_open')
        elif name in PLACE:
            finding = Finding('place_open_in_plane') if upright else Finding('place_open')
        elif name in ANGLES:
            finding = Finding('angles_open_in_plane') if upright else Finding('angles_open')
        elif name == 'scale':
            finding = Finding('metric_scale_open')
        else:
            finding = Finding('time_offset_open')
        told[name] = finding.sentence
    return told


def _is_circle(status: dict[str, Status], turns: np.ndarray, moves: np.ndarray) -> bool:
    """Tell whether a vehicle drove one curve that leaves all but roll and pitch open."""
    turned, way = np.abs(turns[:, 2]).sum(), np.linalg.norm(moves, axis=1).sum()
    return bool(status['yaw'] == status['scale'] == 'unobservable' and turned > LEAST_CURVE_RAD
                and way > LEAST_RADIUS_M * turned)
