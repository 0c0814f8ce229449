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
What a depth image says of a pose that the grey image gave.

Places on the faces are seen at a depth. The distance of what is measured there from the face,
along its normal n, is one equation for the correction (θ, Δ) of the pose,

    n · (Y - X) = (X' x n) · θ + n · Δ,

with X the place, X' the same without the translation, and Y the point measured at its pixel (the
point-to-plane distance of Chen and Medioni, 1992). A depth camera also errs by one factor for all
pixels. It is estimated beside, with its own sigma. Where that factor is much larger, the model has
another size than the object, which no grey image tells.

Plane faces are seen from both sides, and files wind them in any way. So the normal is the one that
looks at the camera, and a place counts where nothing of the object is before it. The normals of a
mesh lead outward.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.geometry.robust_loss import tukey_weight
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.visibility.visible_geometry import VisibleGeometry
from selfcal_ros.values.wireframe import across_axes, WireframeModel

#: Places on the surface, and on each side of the grid whose cells err alike.
_PLACES, _CELLS = 600, 6
#: Places that must be seen, and share of those that should be.
_LEAST, _LEAST_SHARE = 30, 0.25
#: Faces seen under a flatter angle than this do not count, cosine.
_FLAT = 0.25
#: Limit of what belongs to the object: sigmas, and shares of its size at first and at the most.
_TUKEY, _FIRST = 4.0, 0.12
#: Noise of a depth at the least, share of it. Steps of the estimate.
_NOISE, _STEPS = 3e-4, 4


@dataclass(frozen=True)
class DepthSays:
    """
    What a depth image said.

    Attributes
    ----------
    measured : PoseMeasurement
        Of both images.
    share : float
        By how much the depths are larger than those of the pose by the grey image alone.
    sigma : float
        Of the share, without the error of the depth camera's own scale.
    places : int
        That were seen.

    """

    measured: PoseMeasurement
    share: float
    sigma: float
    places: int


class DepthFit:
    """
    Improves poses by depth images.

    Parameters
    ----------
    visible : VisibleGeometry
        The model.
    centre : ndarray, shape (3,)
        Origin of the tracker's object frame.
    projection : Projection
        Of the camera; the depth image is registered to it.
    scale_sigma : float
        Of the one factor of all depths.

    """

    def __init__(self, visible: VisibleGeometry, centre: np.ndarray, projection: Projection,
                 scale_sigma: float):
        """Spread places over the faces."""
        self._visible, self._centre = visible, centre
        self._points, self._normals = surface_places(visible.model, _PLACES)
        self._points = self._points - centre
        self._size = float(np.ptp(visible.model.extent, axis=0).max())
        self._projection, self._scale_sigma = projection, scale_sigma

    def improved(self, measured: PoseMeasurement, depth: np.ndarray,
                 basis: np.ndarray) -> DepthSays | None:
        """
        Improve a pose.

        Parameters
        ----------
        measured : PoseMeasurement
        depth : ndarray, shape (H, W)
            Metres along the optical axis; 0, NaN and infinity where there is none.
        basis : ndarray, shape (6, m)

        Returns
        -------
        DepthSays or None
            None where too little of the object has a depth.

        """
        prior = np.linalg.inv(measured.covariance)
        state, first = measured.state, measured.state
        limit, share = _FIRST * self._size, None
        unhidden = self._unhidden(state)
        for _ in range(_STEPS):
            seen = self._seen(state, depth, unhidden)
            if seen is None:
                return None
            turned, place, normal, ratio = seen
            if share is None:
                # whatever hides the object is nearer; a model of another size is all farther
                share = float(np.median(ratio)) - 1
            # n · (Y - X) with Y = ratio X, as far as no common factor explains it
            along = np.einsum('ni,ni->n', normal, place)
            left = (ratio - 1 - share) * along
            near = np.abs(left) < limit
            if near.sum() < max(_LEAST, _LEAST_SHARE * len(left)):
                return None
            sigma = max(robust_sigma(left[near]), _NOISE * float(np.median(place[:, 2])))
            weight = tukey_weight(left, _TUKEY * sigma) / sigma**2
            rows = np.column_stack([np.concatenate([np.cross(turned, normal), normal], axis=1)
                                    @ basis, along])
            alike = _alike(rows, weight, left, place)
            H = (rows * weight[:, None]).T @ rows / alike
            g = rows.T @ (weight * left) / alike
            H[:-1, :-1] += prior
            g[:-1] -= prior @ (basis.T @ self._projection.difference(state, first))
            # the factor by itself: whatever is known of the depth camera
            free = np.linalg.inv(H)
            alone = share + float(free[-1] @ g)
            H[-1, -1] += self._scale_sigma**-2
            g[-1] -= share * self._scale_sigma**-2
            q = np.linalg.solve(H, g)
            state, share = self._projection.moved(state, basis @ q[:-1]), share + float(q[-1])
            limit = min(limit, max(3 * _TUKEY * sigma, 0.02 * self._size))
        covariance = np.linalg.inv(H)[:-1, :-1]
        return DepthSays(replace(measured, state=state, covariance=covariance), alone,
                         float(free[-1, -1])**0.5, int((weight > 0).sum()))

    def _unhidden(self, state: ObjectPose) -> np.ndarray:
        """Which places no face hides, (N,) bool; of a mesh all, for its normals tell enough."""
        if self._visible.surface is not None:
            return np.ones(len(self._points), bool)
        shown: np.ndarray = ~self._visible.behind(
            self._points + self._centre, state.rotation,
            state.translation - state.rotation @ self._centre)
        return shown

    def _seen(self, state: ObjectPose, depth: np.ndarray, unhidden: np.ndarray,
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
        """Return the places that have a depth: without translation, in space, normals, ratios."""
        turned = self._points @ state.rotation.T
        place, normal = turned + state.translation, self._normals @ state.rotation.T
        away, along = np.linalg.norm(place, axis=1), np.einsum('ni,ni->n', normal, place)
        if self._visible.surface is None:
            normal = np.where(along[:, None] > 0, -normal, normal)
            along = -np.abs(along)
        pixels = self._projection.project(state, self._points).pixels
        column, row = np.rint(np.nan_to_num(pixels, nan=-1.0, posinf=-1.0, neginf=-1.0)).T
        height, width = depth.shape
        shown = (unhidden & (along < -_FLAT * away) & (place[:, 2] > 0)
                 & (column >= 0) & (row >= 0) & (column < width) & (row < height))
        at = np.flatnonzero(shown)
        there = depth[row[at].astype(int), column[at].astype(int)]
        known = np.isfinite(there) & (there > 0)
        if known.sum() < max(_LEAST, _LEAST_SHARE * len(at)):
            return None
        at = at[known]
        return turned[at], place[at], normal[at], there[known] / place[at, 2]


def surface_places(model: WireframeModel, count: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Spread places evenly over the faces of a model, and the sides of its cylinders.

    Parameters
    ----------
    model : WireframeModel
    count : int

    Returns
    -------
    points : ndarray, shape (N, 3)
        Metres, in the frame of the model.
    normals : ndarray, shape (N, 3)
        Of unit length, outward; of plane faces to the side that their winding tells.

    """
    corners = model.vertices[model.triangles].reshape(-1, 3, 3)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(across, axis=1)
    areas = [size / 2]
    lengths = [np.linalg.norm(one.end - one.start) for one in model.cylinders]
    areas.append(np.array([2 * np.pi * one.radius_m * length
                           for one, length in zip(model.cylinders, lengths)]))
    area = np.cumsum(np.concatenate(areas))
    if not len(area) or not area[-1] > 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    which = np.searchsorted(area, (np.arange(count) + 0.5) / count * area[-1])
    # a sequence of points that fill a square evenly (Roberts 2018)
    u, v = (np.outer([0.7548776662466927, 0.5698402909980532], np.arange(1, count + 1)) % 1.0)
    flat = which < len(corners)
    chosen = corners[which[flat]]
    root = np.sqrt(u[flat])[:, None]
    a, b = 1 - root, root * (1 - v[flat, None])
    points = [a * chosen[:, 0] + b * chosen[:, 1] + (1 - a - b) * chosen[:, 2]]
    normals = [across[which[flat]] / size[which[flat], None]]
    for k, cylinder in enumerate(model.cylinders):
        own = which == len(corners) + k
        one, other = across_axes(cylinder)
        angle = 2 * np.pi * u[own, None]
        out = np.cos(angle) * one + np.sin(angle) * other
        normals.append(out)
        points.append(cylinder.start + v[own, None] * (cylinder.end - cylinder.start)
                      + cylinder.radius_m * out)
    return np.concatenate(points), np.concatenate(normals)


def _alike(rows: np.ndarray, weight: np.ndarray, left: np.ndarray, place: np.ndarray) -> float:
    """
    By how much information is less because neighbours err alike, at least 1.

    The scatter of sums over cells of a grid before the camera, over that of independent errors.
    """
    xy = place[:, :2] / place[:, 2:]
    low, span = xy.min(axis=0), np.maximum(np.ptp(xy, axis=0), 1e-9)
    cell = np.minimum((_CELLS * (xy - low) / span).astype(int), _CELLS - 1)
    own = cell[:, 0] * _CELLS + cell[:, 1]
    pulls = rows * (weight * left)[:, None]
    sums = np.array([np.bincount(own, column, _CELLS**2) for column in pulls.T]).T
    alone = np.einsum('ni,ni->i', pulls, pulls)
    return max(1.0, float(np.mean(np.einsum('ci,ci->i', sums, sums) / np.maximum(alone, 1e-300))))
