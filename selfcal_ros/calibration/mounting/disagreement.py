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
"""In what poses of a body disagree with those of the camera, by the closed forms alone."""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.mount import Mount, MountFacts, PLACE, TURN
from selfcal_ros.calibration.mounting.body_track import BodyAt
from selfcal_ros.calibration.mounting.camera_poses import CameraPoses
from selfcal_ros.calibration.mounting.starts import closed_forms, pairs_of
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_matrix

#: Poses that leave less than this share of what moved agree.
AGREES = 0.05
#: A stated part that comes out so many sigmas away without the statement is wrong.
WRONG = 5.0
#: Ways are noise where no place and scale take more than this share off.
NOISE = 0.2


def misfits(camera: CameraPoses, body: BodyAt) -> list[tuple[float, float, float]]:
    """
    Say how well the closed forms explain a body.

    Parameters
    ----------
    camera : CameraPoses
    body : BodyAt
        At the same images.

    Returns
    -------
    list of (float, float, float)
        Of every way of starting: what is left of the turns and of the ways (medians over the
        median turn and way), and the scale.

    """
    pairs = pairs_of(camera, body)
    turned, moved = (_median(one) for one in (pairs.body_turn, pairs.body_move))
    found = []
    for M, place, scale in closed_forms(camera, pairs):
        by_mount = (np.eye(3) - rotation_matrix(pairs.body_turn)) @ place + (
            scale * pairs.camera_move @ M.T)
        found.append((_median(pairs.body_turn - pairs.camera_turn @ M.T) / turned,
                      _median(pairs.body_move - by_mount) / moved if camera.has_path else 0.0,
                      scale))
    return found


def why_no_start(camera: CameraPoses, body: BodyAt, count: int) -> NoEstimate:
    """
    Say why no closed form has a positive scale.

    Parameters
    ----------
    camera : CameraPoses
    body : BodyAt
        At the same images.
    count : int
        Poses of the body.

    Returns
    -------
    NoEstimate

    """
    turns, ways, _ = min(misfits(camera, body))
    if turns < AGREES and ways > 1 - NOISE:
        moved_mm = 1e3 * _median(pairs_of(camera, body).body_move)
        return NoEstimate('body_only_turned', count=count, moved_mm=moved_mm)
    return NoEstimate('no_mount_fits', count=count)


def contradicted_fact(facts: MountFacts, free: Mount) -> NoEstimate | None:
    """
    Name the stated part of a mount that images and poses contradict most.

    Parameters
    ----------
    facts : MountFacts
    free : Mount
        From the same images and poses, without these facts.

    Returns
    -------
    NoEstimate or None
        None where chance explains it, or nothing but the facts tells.

    """
    values = {**dict(zip(PLACE, free.T_body_camera[:3, 3])), **free.angles,
              'time_offset': free.time_offset_s}
    sigmas = {**free.sigma, **free.angles_sigma}
    worst: NoEstimate | None = None
    for name, (stated, sigma) in facts.stated.items():
        if name not in values or free.status[name] != 'estimated':
            continue
        away = values[name] - stated
        if name in TURN:
            away = (away + np.pi) % (2 * np.pi) - np.pi
        beyond = float(abs(away) / np.hypot(sigma, sigmas[name]))
        if beyond > (WRONG if worst is None else worst.values['sigmas']):
            size, unit = (180 / np.pi, 'degrees') if name in TURN else (
                1.0, 'm' if name in PLACE else 's')
            worst = NoEstimate('mount_fact_contradicted', fact=name.replace('_', ' '), unit=unit,
                               sigmas=beyond, preferred=[
                                   {'name': name, 'value': size * float(values[name]),
                                    'sigma': size * sigmas[name], 'stated': size * stated}])
    return worst


def _median(vectors: np.ndarray) -> float:
    """Return the median length of vectors (m, 3), above zero."""
    return max(float(np.median(np.linalg.norm(vectors, axis=1))), 1e-12)
