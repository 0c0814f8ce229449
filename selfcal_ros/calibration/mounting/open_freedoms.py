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

from selfcal_ros.calibration.mount import MountFacts, NAMES, PLACE, TURN as ANGLES
from selfcal_ros.calibration.mounting.adjustment import Optimum
from selfcal_ros.calibration.mounting.body_track import BodyTrack
from selfcal_ros.calibration.mounting.model import COUNT, OFFSET, SCALE, T, TURN
from selfcal_ros.findings.finding import Finding

#: Sigma from which on a degree of freedom counts as unobservable: no better than a look at the
#: robot. Metres, radians, share of the scale, seconds.
LIMIT_M, LIMIT_RAD, LIMIT_SCALE, LIMIT_S = 0.3, 0.2, 0.2, 0.1
#: Motion must show so many times what errors feign.
ABOVE_NOISE = 3.0
#: Turns about the vertical by so many times those about other axes are those of a vehicle.
UPRIGHT = 5.0
_COLUMNS = np.r_[T, TURN, SCALE, OFFSET]
_LIMITS = np.array([LIMIT_M] * 3 + [LIMIT_RAD] * 3 + [LIMIT_SCALE, LIMIT_S])


def degrees_of_freedom(optimum: Optimum, free: np.ndarray, track: BodyTrack,
                       facts: MountFacts) -> dict[str, str]:
    """
    Tell 'estimated', 'held' or 'unobservable' for each of `NAMES`.

    Parameters
    ----------
    optimum : Optimum
    free : ndarray of bool, shape (15 + k,)
        Which unknowns are.
    track : BodyTrack
    facts : MountFacts

    Returns
    -------
    dict of str to str

    """
    sigma = _honest_sigma(optimum, free)
    held = {name for name, (_, spread) in facts.stated.items() if spread == 0}
    # wheels whose scale is exact do not hold that of the images
    held.discard('scale')
    if not track.timed:
        held.add('time_offset')
    status = {}
    for name, column, limit, value in zip(NAMES, _COLUMNS, _LIMITS, sigma):
        if name in held:
            status[name] = 'held'
        elif name == 'scale' and not free[column]:
            # before a known object the images' own unit is the metre; turning has none
            status[name] = 'held' if free[T].any() else 'unobservable'
        else:
            status[name] = 'estimated' if free[column] and value < limit else 'unobservable'
    return status


def _honest_sigma(optimum: Optimum, free: np.ndarray) -> np.ndarray:
    """Return sigmas (8,) without the information that errors of the poses feign."""
    columns = _COLUMNS[free[_COLUMNS]]
    others = np.setdiff1d(np.flatnonzero(free), columns)
    H = optimum.information
    tied = H[np.ix_(others, columns)]
    inner = H[np.ix_(others, others)]
    root = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    tied = tied / root[:, None]
    scaled = inner / np.outer(root, root) + 1e-12 * np.eye(len(others))
    shown = H[np.ix_(columns, columns)] - tied.T @ np.linalg.solve(scaled, tied)
    shown = shown - ABOVE_NOISE * _feigned(optimum)[np.ix_(columns, columns)]
    sigma = np.full(COUNT, np.inf)
    limits = dict(zip(_COLUMNS, _LIMITS))
    unit = np.array([limits[column] for column in columns])
    # in units of the limits; what nothing shows is left with far more than one of them
    values, vectors = np.linalg.eigh(shown * np.outer(unit, unit))
    spread = (vectors**2 / np.maximum(values, 1e-4)).sum(axis=1)
    sigma[columns] = np.sqrt(spread) * unit
    found: np.ndarray = sigma[_COLUMNS]
    return found


def _feigned(optimum: Optimum) -> np.ndarray:
    """Return the information (15, 15) that errors of turns and moves would feign."""
    slopes, keep = optimum.prediction.slopes[optimum.keep], optimum.keep
    W = np.linalg.inv(optimum.errors.covariances()[keep])
    own = optimum.covariance[COUNT:, COUNT:]
    by_images = slopes[:, :, COUNT:]
    errors = by_images @ own @ np.swapaxes(by_images, 1, 2)
    feigned = np.zeros((COUNT, COUNT))
    place, turn = W[:, :3, :3], W[:, 3:, 3:]
    Q, P = errors[:, 3:, 3:], errors[:, :3, :3]
    # a place is seen by turns, which are wrong by δ: E[(δ x)ᵀ W (δ x)], W about isotropic
    R = slopes[:, :3, T]
    by_turns = _of_cross(Q, np.trace(place, axis1=1, axis2=2) / 3)
    feigned[T, T] = np.einsum('mia,mij,mjb->ab', R, by_turns, R)
    R = slopes[:, 3:, TURN]
    by_turns = _of_cross(Q, np.trace(turn, axis1=1, axis2=2) / 3)
    feigned[TURN, TURN] = np.einsum('mia,mij,mjb->ab', R, by_turns, R)
    feigned[SCALE, SCALE] = np.einsum('mij,mji->', place, P)
    return feigned


def _of_cross(Q: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return weight · (tr(Q) I - Q), the mean of -[δ]x² for errors δ of covariance Q."""
    trace = np.trace(Q, axis1=1, axis2=2)
    squares: np.ndarray = weight[:, None, None] * (trace[:, None, None] * np.eye(3) - Q)
    return squares


def missing_motion(status: dict[str, str], track: BodyTrack, turns: np.ndarray) -> dict[str, str]:
    """
    Say which motion or fact would show what is open.

    Parameters
    ----------
    status : dict of str to str
    track : BodyTrack
    turns : ndarray, shape (m, 3)
        Of the body between images, in its own axes (rad).

    Returns
    -------
    dict of str to str

    """
    about = np.linalg.norm(turns, axis=0) / np.sqrt(max(len(turns), 1))
    upright = track.flat or about[2] > UPRIGHT * np.hypot(about[0], about[1])
    told = {}
    for name, verdict in status.items():
        if verdict != 'unobservable':
            continue
        if name == 'z' and upright:
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
