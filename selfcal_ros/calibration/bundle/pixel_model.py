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
"""From points of the camera frame to pixels, and the derivatives that every adjustment shares."""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.state import ASPECT, CX, CY, F, K1, K2, P1, P2, SKEW


class PixelModel:
    """
    Plumb-bob projection of normalised image points.

    Parameters
    ----------
    intrinsics : ndarray, shape (9,)
        `state.INTRINSIC_NAMES`.
    x, y : ndarray, shape (N,)
        Undistorted normalised coordinates.

    Attributes
    ----------
    uv : ndarray, shape (N, 2)
        Pixels.

    """

    def __init__(self, intrinsics: np.ndarray, x: np.ndarray, y: np.ndarray):
        self.intrinsics, self.x, self.y = intrinsics, x, y
        f, aspect, cx, cy, skew, k1, k2, p1, p2 = intrinsics
        self.r2 = r2 = x * x + y * y
        self.radial = 1 + r2 * (k1 + r2 * k2)
        self.xd = x * self.radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        self.yd = y * self.radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        self.uv = np.stack([f * self.xd + skew * self.yd + cx, f * aspect * self.yd + cy], axis=1)

    def by_points(self, depth: np.ndarray) -> np.ndarray:
        """Differentiate by points of the camera frame at depths (N,); shape (N, 2, 3)."""
        f, aspect, _, _, skew, k1, k2, p1, p2 = self.intrinsics
        x, y = self.x, self.y
        slope = 2 * (k1 + 2 * k2 * self.r2)
        cross = slope * x * y + 2 * p1 * x + 2 * p2 * y
        dxx = self.radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
        dyy = self.radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
        du_dx, du_dy = f * dxx + skew * cross, f * cross + skew * dyy
        dv_dx, dv_dy = f * aspect * cross, f * aspect * dyy
        J = np.empty((len(x), 2, 3))
        J[:, 0, 0], J[:, 0, 1] = du_dx / depth, du_dy / depth
        J[:, 1, 0], J[:, 1, 1] = dv_dx / depth, dv_dy / depth
        J[:, 0, 2] = -(du_dx * x + du_dy * y) / depth
        J[:, 1, 2] = -(dv_dx * x + dv_dy * y) / depth
        return J

    def by_intrinsics(self, free: np.ndarray, columns: int = 9) -> np.ndarray:
        """
        Differentiate by the internal parameters.

        Parameters
        ----------
        free : ndarray of bool, shape (9,) or longer
            Distortion coefficients that are held get zero derivatives.
        columns : int
            Width of the result; columns from the tenth on are zero.

        Returns
        -------
        ndarray, shape (N, 2, columns)

        """
        f, aspect, _, _, skew = self.intrinsics[:5]
        x, y, r2 = self.x, self.y, self.r2
        J = np.zeros((len(x), 2, columns))
        J[:, 0, F], J[:, 1, F] = self.xd, aspect * self.yd
        J[:, 1, ASPECT] = f * self.yd
        J[:, 0, CX] = J[:, 1, CY] = 1
        J[:, 0, SKEW] = self.yd
        bases = {K1: (x * r2, y * r2), K2: (x * r2 * r2, y * r2 * r2),
                 P1: (2 * x * y, r2 + 2 * y * y), P2: (r2 + 2 * x * x, 2 * x * y)}
        for index, (bx, by) in bases.items():
            if free[index]:
                J[:, 0, index] = f * bx + skew * by
                J[:, 1, index] = f * aspect * by
        return J
