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
"""How well a rig explains what two of its cameras see at once: distances from epipolar planes."""

from __future__ import annotations

from collections.abc import Mapping
import itertools

import numpy as np

from selfcal_ros.calibration.rigs.result import RigCalibration
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.values.tracks import Tracks

#: A match that is farther off, pixels, is of two different points.
WRONG_PX = 3.0
#: Of the differences that stand for derivatives, pixels.
_STEP_PX = 0.1


def epipolar_distances(rig: RigCalibration, tracks: Mapping[str, Tracks],
                       ) -> dict[tuple[str, str], np.ndarray]:
    """
    Return how far matches lie from the epipolar geometry of every two cameras.

    First-order distances (Sampson 1982) of pixels, by the derivatives of the rays, so that any
    lens will do. Nothing of the path or of points is in them.

    Parameters
    ----------
    rig : RigCalibration
    tracks : mapping of str to Tracks
        Equal numbers in two cameras are the same point.

    Returns
    -------
    dict of (str, str) to ndarray, shape (N,)
        Pixels, signed. Pairs without matches, and those whose pose is open, are left out.

    """
    found = {}
    for first, second in itertools.combinations(rig.cameras, 2):
        T = rig.between(first, second)
        if not np.isfinite(T).all():
            continue
        a, b = tracks[first], tracks[second]
        keys = [np.stack([one.frame, one.track], axis=1).astype(np.int64) for one in (a, b)]
        width = 1 + max((int(key[:, 1].max(initial=0)) for key in keys))
        both = [key[:, 0] * width + key[:, 1] for key in keys]
        _, i, k = np.intersect1d(both[0], both[1], return_indices=True)
        R, along = T[:3, :3], T[:3, 3]
        q, q_slopes = _rays(rig.cameras[first].camera, a.xy[i])
        p, p_slopes = (one @ R.T for one in _rays(rig.cameras[second].camera, b.xy[k]))
        of_first, of_second = np.cross(q, along), np.cross(along, p)
        square = (np.sum(np.einsum('cni,ni->cn', q_slopes, of_second)**2, axis=0)
                  + np.sum(np.einsum('cni,ni->cn', p_slopes, of_first)**2, axis=0))
        distance = np.einsum('ni,ni->n', q, of_second) / np.sqrt(np.maximum(square, 1e-300))
        distance = distance[np.isfinite(distance)]
        if len(distance):
            found[first, second] = distance
    return found


def _rays(camera: Camera, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit rays (N, 3) of pixels, and their derivatives (2, N, 3) by the pixels."""
    def unit(at: np.ndarray) -> np.ndarray:
        rays = camera.rays(at)
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
    steps = _STEP_PX * np.eye(2)
    slopes = [(unit(xy + step) - unit(xy - step)) / (2 * _STEP_PX) for step in steps]
    return unit(xy), np.array(slopes)
