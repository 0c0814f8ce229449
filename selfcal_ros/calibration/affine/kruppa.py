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
Kruppa's equations (thesis 3.1.2): K from the fundamental matrices of pairs alone.

F omega* F^T ~ [e']x omega* [e']x^T holds for every pair, without any structure. Kept for
comparison: it sees neither points in three views nor where infinity lies, and is weaker for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import cross_matrix

#: Focal lengths to start from, in longer image sides.
_FOCAL_SWEEP = (0.45, 0.65, 1.0, 1.6, 2.6, 4.2)
#: Smallest singular value of the equations' slopes that counts (both sides have unit norm).
_MIN_SLOPE = 1e-5
_UPPER = np.triu_indices(3)


@dataclass(frozen=True)
class KruppaCalibration:
    """
    A camera from Kruppa's equations.

    Attributes
    ----------
    K : ndarray, shape (3, 3)
        Pixels.
    residual : float
        Root mean square of the equations, both sides scaled to unit norm.

    """

    K: np.ndarray
    residual: float


def kruppa_residuals(F: np.ndarray, dual_conic: np.ndarray) -> np.ndarray:
    """
    Difference of both sides of Kruppa's equations, each scaled to unit norm.

    Parameters
    ----------
    F : ndarray, shape (n, 3, 3)
        x'^T F x = 0.
    dual_conic : ndarray, shape (3, 3)
        omega* = K K^T in the coordinates of F.

    Returns
    -------
    ndarray, shape (n, 6)

    """
    epipole = np.linalg.svd(np.swapaxes(F, 1, 2))[2][:, -1]
    cross = cross_matrix(epipole)
    left = F @ dual_conic @ np.swapaxes(F, 1, 2)
    right = cross @ dual_conic @ np.swapaxes(cross, 1, 2)
    left, right = (side / np.linalg.norm(side, axis=(1, 2), keepdims=True)
                   for side in (left, right))
    difference: np.ndarray = (left - right)[:, _UPPER[0], _UPPER[1]]
    return difference


def calibrate_kruppa(F: ArrayLike, size: tuple[int, int], facts: CameraFacts | None = None,
                     ) -> KruppaCalibration | NoEstimate:
    """
    Calibrate from the fundamental matrices of pairs of views.

    Parameters
    ----------
    F : array_like, shape (n, 3, 3)
        In undistorted pixels, of rank 2; two equations each.
    size : (int, int)
        Width and height of the image, pixels.
    facts : CameraFacts, optional
        Aspect ratio, skew and principal point that are stated are held.

    Returns
    -------
    KruppaCalibration or NoEstimate

    """
    facts = CameraFacts() if facts is None else facts
    of_pixels = np.asarray(F, float).reshape(-1, 3, 3)
    scale, middle = float(max(size)), (np.array(size, float) - 1) / 2
    back = np.array([[scale, 0, middle[0]], [0, scale, middle[1]], [0, 0, 1]])
    scaled = back.T @ of_pixels @ back
    scaled = scaled / np.linalg.norm(scaled, axis=(1, 2), keepdims=True)
    start = np.zeros(5)          # log f, log aspect, cx, cy, skew
    free = np.ones(5, bool)
    if facts.aspect_ratio is not None:
        start[1], free[1] = np.log(facts.aspect_ratio), False
    if facts.principal_point is not None:
        start[2:4], free[2:4] = (np.array(facts.principal_point) - middle) / scale, False
    if facts.skew is not None:
        start[4], free[4] = facts.skew / scale, False
    if 2 * len(scaled) < free.sum():
        return NoEstimate('too_few', what="camera from Kruppa's equations", needed=int(free.sum()),
                          items='equations, two a pair', found=2 * len(scaled))

    def camera(values: np.ndarray) -> np.ndarray:
        f, ratio = np.exp(values[:2])
        cx, cy, skew = values[2:]
        return np.array([[f, skew, cx], [0, f * ratio, cy], [0, 0, 1]])

    def residuals(unknown: np.ndarray) -> np.ndarray:
        values = start.copy()
        values[free] = unknown
        K = camera(values)
        return kruppa_residuals(scaled, K @ K.T).ravel()

    # loaded by the few that need it
    from scipy.optimize import least_squares
    low = np.array([np.log(0.1), np.log(0.2), -2, -2, -1])[free]
    trials = []
    for focal in _FOCAL_SWEEP:
        start[0] = np.log(focal)
        trials.append(least_squares(residuals, start[free], bounds=(low, np.where(
            low == np.log(0.1), np.log(20), -low)), x_scale=0.1, max_nfev=60))
    best = min(trials, key=lambda trial: trial.cost)
    singular = np.linalg.svd(best.jac, compute_uv=False)
    if not singular[-1] > _MIN_SLOPE or np.any(best.active_mask):
        return NoEstimate('pairs_leave_camera_open')
    values = start.copy()
    values[free] = best.x
    K = back @ camera(values)
    return KruppaCalibration(K / K[2, 2], float(np.sqrt(2 * best.cost / (6 * len(scaled)))))
