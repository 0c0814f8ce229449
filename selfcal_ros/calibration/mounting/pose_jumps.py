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
"""Jumps of poses: odometry that begins anew, and bodies that are found elsewhere at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.values.body_poses import BodyPoses

#: A step is a jump if it is so many times as large as both its neighbours, and as all but so many
#: percent of the steps.
TIMES, MOST_STEPS = 6.0, 95
#: Odometry begins anew no more often; a robot that hops and rests, told at a low rate, does.
MOST_RESTARTS = 3
#: Smaller steps are none: metres, radians.
LEAST_M, LEAST_RAD = 1e-3, 1e-3


def jumps_of(poses: BodyPoses) -> np.ndarray:
    """
    Tell which steps of poses by instants are jumps: no body moves so for one step alone.

    Parameters
    ----------
    poses : BodyPoses

    Returns
    -------
    ndarray of bool, shape (N - 1,)

    """
    found = np.zeros(max(len(poses) - 1, 0), bool)
    if poses.stamps_ns is None or len(poses) < 4:
        return found
    seconds = np.diff(poses.stamps_ns) * 1e-9
    # stamps may come in bursts, and poses may be missing
    share = np.maximum(seconds / np.median(seconds), 1.0)
    back = np.swapaxes(poses.rotation[:-1], 1, 2)
    for size, least in ((np.diff(poses.position, axis=0), LEAST_M),
                        (rotation_vector(back @ poses.rotation[1:]), LEAST_RAD)):
        speed = np.linalg.norm(size, axis=1) / share
        padded = np.concatenate([[0.0], speed, [0.0]])
        beside = np.maximum(padded[:-2], padded[2:])
        usual = np.maximum(beside, np.percentile(speed, MOST_STEPS))
        found |= speed > np.maximum(TIMES * usual, least)
    return found


def without_jumps(poses: BodyPoses, jumps: np.ndarray) -> BodyPoses:
    """
    Join odometry at its jumps, as if the body had gone on as in the step before.

    Parameters
    ----------
    poses : BodyPoses
    jumps : ndarray of bool, shape (N - 1,)

    Returns
    -------
    BodyPoses
        What comes after a jump is moved as a whole: the way on each side is as it was.

    """
    R, p = poses.rotation.copy(), poses.position.copy()
    times = np.arange(len(poses)) if poses.stamps_ns is None else poses.stamps_ns * 1e-9
    for k in np.flatnonzero(jumps):
        turn, move, share = np.zeros(3), np.zeros(3), 0.0
        if k:
            turn, move = rotation_vector(R[k - 1].T @ R[k]), R[k - 1].T @ (p[k] - p[k - 1])
            share = (times[k + 1] - times[k]) / (times[k] - times[k - 1])
        there = R[k] @ rotation_matrix(share * turn)
        G = there @ R[k + 1].T
        p[k + 1:] = (p[k + 1:] - p[k + 1]) @ G.T + p[k] + R[k] @ (share * move)
        R[k + 1:] = G @ R[k + 1:]
    return replace(poses, rotation=R, position=p)
