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
Epipoles and screw axes of the pairs of views, in undistorted pixels.

From the poses of a reconstruction they obey its motion model exactly. From every pair's own
fundamental matrix they tell whether that model holds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.fundamental import fundamental
from selfcal_ros.geometry.planar_pairs import decompose_planar
from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.report.observations import ObservationTable

#: Pairs that turn by less than this, or come as close to half a turn, show no usable screw axis.
MIN_TURN_RAD = np.radians(2.0)
#: Pairs this many views apart are looked at singly, if they share so many points.
STEPS, MIN_COMMON = (1, 2, 3, 5, 8), 30
#: Normalised points farther out, 76 degrees from the axis, have no place in a flat image.
FLAT = 4.0


@dataclass(frozen=True)
class EpipolesAndAxes:
    """
    What the pairs of views look like in the image (thesis 5.1, figure 5.14).

    Attributes
    ----------
    pairs : ndarray of int, shape (N, 2)
        Indices of views, first < second.
    epipoles : ndarray, shape (N, 2, 3)
        Image in each view of the pair of the other view's centre, homogeneous, unit norm.
    screw_axes : ndarray, shape (N, 3)
        Line m, the image of the screw axis, the same in both views; unit norm, NaN where the
        pair does not turn enough.

    """

    pairs: np.ndarray
    epipoles: np.ndarray
    screw_axes: np.ndarray


def flat_enough(xy: np.ndarray) -> np.ndarray:
    """Return normalised points (N, 2) with NaN for those that a flat image cannot show."""
    return np.where((np.abs(xy) < FLAT).all(axis=1)[:, None], xy, np.nan)


def pair_geometry(reconstruction: Reconstruction, K: np.ndarray,
                  most_pairs: int = 400) -> EpipolesAndAxes:
    """
    Derive the epipoles and the screw axes of pairs of views from their poses.

    Parameters
    ----------
    reconstruction : Reconstruction
    K : ndarray, shape (3, 3)
    most_pairs : int
        An even choice of so many pairs, if there are more.

    Returns
    -------
    EpipolesAndAxes

    """
    poses = np.asarray(reconstruction.cam_from_world, float)
    first, second = np.triu_indices(len(poses), 1)
    chosen = np.unique(np.linspace(0, len(first) - 1, most_pairs).astype(int)) \
        if len(first) > most_pairs else np.arange(len(first))
    pairs = np.stack([first[chosen], second[chosen]], axis=1)
    R, t = poses[:, :, :3], poses[:, :, 3]
    centres = camera_centres(poses)
    a, b = pairs.T
    epipoles = np.stack([_seen(K, R[a], t[a], centres[b]), _seen(K, R[b], t[b], centres[a])],
                        axis=1)
    return EpipolesAndAxes(pairs, epipoles, _screw_axes(K, R, t, a, b))


def single_pairs(result: Calibration, seen: ObservationTable,
                 most_pairs: int = 150) -> EpipolesAndAxes:
    """
    Estimate the epipoles and the screw axis of pairs, each from its own matches alone.

    Parameters
    ----------
    result : Calibration
        Its camera removes the distortion.
    seen : ObservationTable
    most_pairs : int

    Returns
    -------
    EpipolesAndAxes
        Empty where no pair shares enough points.

    """
    K = result.camera.K
    poses = np.asarray(result.reconstructed.cam_from_world, float)
    xy = flat_enough(result.camera.normalised(seen.xy)) @ K[:2, :2].T + K[:2, 2]
    usable = np.flatnonzero(seen.used & np.isfinite(xy).all(axis=1))
    rows = [usable[seen.view[usable] == view] for view in range(len(poses))]
    candidates = [(a, a + step) for step in STEPS for a in range(len(poses) - step)]
    stride = max(len(candidates) / most_pairs, 1.0)
    found_pairs: list[tuple[int, int]] = []
    matrices = []
    for k in np.unique(np.arange(0, len(candidates), stride).astype(int)):
        a, b = candidates[k]
        _, in_a, in_b = np.intersect1d(seen.track[rows[a]], seen.track[rows[b]],
                                       return_indices=True)
        if len(in_a) < MIN_COMMON:
            continue
        found = fundamental(xy[rows[a][in_a]], xy[rows[b][in_b]])
        if found and np.isfinite(found.F).all():
            found_pairs.append((a, b))
            matrices.append(found.F)
    if not found_pairs:
        return EpipolesAndAxes(np.empty((0, 2), int), np.empty((0, 2, 3)), np.empty((0, 3)))
    pairs, F = np.array(found_pairs), np.array(matrices)
    U, _, Vt = np.linalg.svd(F)
    _, axes, _, _, real = decompose_planar(F)
    turning = _turns(poses[:, :, :3], *pairs.T) & real
    return EpipolesAndAxes(pairs, np.stack([Vt[:, 2], U[:, :, 2]], axis=1),
                           np.where(turning[:, None], axes, np.nan))


def _turns(R: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Tell which pairs turn enough, and not by half a turn."""
    turn = np.einsum('nji,njk->nik', R[a], R[b])
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    return np.asarray((angle > MIN_TURN_RAD) & (angle < np.pi - MIN_TURN_RAD))


def _seen(K: np.ndarray, R: np.ndarray, t: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Project world points to unit homogeneous pixels, whether ahead or behind."""
    image = (np.einsum('nij,nj->ni', R, points) + t) @ K.T
    return np.asarray(image / np.maximum(np.linalg.norm(image, axis=1, keepdims=True), 1e-300))


def _screw_axes(K: np.ndarray, R: np.ndarray, t: np.ndarray, a: np.ndarray, b: np.ndarray,
                ) -> np.ndarray:
    """
    Return the lines m of the pairs.

    A world point that both cameras have at the same place but for a shift along the axis is on
    the screw axis: (R_b - R_a) X = t_a - t_b in the plane across the axis.
    """
    if not len(a):
        return np.empty((0, 3))
    U, s, Vt = np.linalg.svd(R[b] - R[a])
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=s > 0)
    inverse[:, 2] = 0        # along the axis, where a rotation moves nothing
    X = np.einsum('nij,ni->nj', Vt, inverse * np.einsum('nki,nk->ni', U, t[a] - t[b]))
    on_axis = np.einsum('nij,nj->ni', R[a], X) + t[a]
    direction = np.einsum('nij,nj->ni', R[a], Vt[:, 2])
    lines = np.cross(on_axis @ K.T, direction @ K.T)
    length = np.linalg.norm(lines, axis=1, keepdims=True)
    usable = _turns(R, a, b) & (length[:, 0] > 0)
    return np.where(usable[:, None], lines / np.maximum(length, 1e-300), np.nan)
