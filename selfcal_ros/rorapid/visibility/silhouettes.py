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
Solid cylinders: the two lines of their outline, and what they hide.

It is seen from c, at distance h from the axis in the plane across it. Rays touch the cylinder
where the radius makes the angle acos(r / h) with the direction to c. The line of such points does
not depend on where along the axis they are. So the outline is two straight lines, exactly, in
perspective as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from selfcal_ros.values.wireframe import across_axes, Cylinder

#: Chords shorter than this share of the object's diameter hide nothing.
_TOUCHING = 1e-6


class SolidCylinders:
    """
    The cylinders of a model.

    Parameters
    ----------
    cylinders : sequence of Cylinder
    control_points_per_line : int
    diameter_m : float
        Of the object.

    """

    def __init__(self, cylinders: Sequence[Cylinder], control_points_per_line: int,
                 diameter_m: float) -> None:
        """Keep axes and radii as arrays."""
        self._start = np.array([c.start for c in cylinders])
        self._axis = np.array([c.end for c in cylinders]) - self._start
        self._length = np.linalg.norm(self._axis, axis=1)
        self._axis = self._axis / self._length[:, None]
        self._u, self._v = np.moveaxis(np.array([across_axes(c) for c in cylinders]), 1, 0)
        self._radius = np.array([c.radius_m for c in cylinders])
        n = control_points_per_line
        self._share = (np.arange(n) + 0.5) / n
        self._owner = np.repeat(np.arange(len(cylinders)), 2 * n)
        self._touching_m = _TOUCHING * diameter_m

    def silhouettes(self, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Control points on the outlines seen from a point.

        Parameters
        ----------
        centre : ndarray, shape (3,)
            Centre of the camera, object frame.

        Returns
        -------
        points, tangents : ndarray, shape (N, 3)
            Cylinder by cylinder, first the outline where the angle about the axis is smaller.
        exist : ndarray of bool, shape (N,)
            False for a cylinder that is seen along its axis only, or from inside.

        """
        to_camera = centre - self._start
        across = np.stack([(to_camera * self._u).sum(axis=1), (to_camera * self._v).sum(axis=1)])
        distance = np.hypot(*across)
        outside = distance > self._radius * (1 + 1e-9)
        half = np.arccos(np.where(outside, self._radius / np.where(outside, distance, 1.0), 0.0))
        angle = np.arctan2(across[1], across[0])[:, None] + half[:, None] * [-1, 1]
        foot = self._start[:, None] + self._radius[:, None, None] * (
            np.cos(angle)[..., None] * self._u[:, None]
            + np.sin(angle)[..., None] * self._v[:, None])
        along = self._axis * self._length[:, None]
        points = foot[:, :, None] + self._share[:, None] * along[:, None, None]
        tangents = np.broadcast_to(self._axis[:, None, None], points.shape)
        exist = np.repeat(outside, 2 * len(self._share))
        return points.reshape(-1, 3), tangents.reshape(-1, 3), exist

    def towards_axis(self, points: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """Return unit directions (N, 3) from points on cylinders `owner` (N,) to their axes."""
        axis = self._axis[owner]
        out = self._start[owner] - points
        out = out - (out * axis).sum(axis=1, keepdims=True) * axis
        unit: np.ndarray = out / self._radius[owner, None]
        return unit

    def hidden(self, points: np.ndarray, centre: np.ndarray, own: bool = False) -> np.ndarray:
        """
        Tell which points are hidden by a cylinder.

        Parameters
        ----------
        points : ndarray, shape (N, 3)
        centre : ndarray, shape (3,)
            Object frame.
        own : bool
            The points are those of `silhouettes`: their own cylinder does not hide them.

        Returns
        -------
        ndarray of bool, shape (N,)

        """
        rays = points - centre
        start = centre - self._start
        # X(s) = c + s ray: radial part |p + s q|² <= r², axial part 0 <= m + s k <= length
        along = rays @ self._axis.T
        q = rays[:, None] - along[..., None] * self._axis
        m = (start * self._axis).sum(axis=1)
        p = start - m[:, None] * self._axis
        qq, pq = (q * q).sum(axis=2), (q * p).sum(axis=2)
        excess = (p * p).sum(axis=1) - self._radius**2
        with np.errstate(divide='ignore', invalid='ignore'):
            root = np.sqrt(pq * pq - qq * excess)
            parallel = qq < 1e-24
            enter = np.where(parallel, np.where(excess <= 0, -np.inf, np.inf), (-pq - root) / qq)
            leave = np.where(parallel, np.where(excess <= 0, np.inf, -np.inf), (-pq + root) / qq)
            caps = np.stack([-m / along, (self._length - m) / along])
        level = along == 0
        inside = (m >= 0) & (m <= self._length)
        first = np.where(level, np.where(inside, -np.inf, np.inf), caps.min(axis=0))
        last = np.where(level, np.where(inside, np.inf, -np.inf), caps.max(axis=0))
        enter, leave = np.maximum(enter, first), np.minimum(np.minimum(leave, last), 1.0)
        enter = np.maximum(enter, 0.0)
        # NaN, where the ray misses, compares as False
        chord = (leave - enter) * np.linalg.norm(rays, axis=1)[:, None]
        hides = chord > self._touching_m
        if own:
            hides &= self._owner[:, None] != np.arange(len(self._radius))
        hidden: np.ndarray = hides.any(axis=1)
        return hidden
