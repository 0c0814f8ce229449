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
Projection of the object by four camera models, and how a small pose correction moves the image.

The correction is the thesis's q = (theta, Delta): X' = exp(theta) R Xm + T + Delta, with one more
value for zoom (the relative change of the focal length) and eight values of its own for the
affine camera. All models end in pixels, through the lens distortion of the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.lenses.model import LensImage
from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.rotation import rotation_vector

if TYPE_CHECKING:
    from selfcal_ros.rorapid.projection.row_motion import RowMotion

#: Points nearer than this (metres) count as behind the camera.
NEAREST_M = 1e-6
#: What a lens does not see is put so many focal lengths from the principal point.
_FAR = 1e3


@dataclass(frozen=True)
class ObjectPose:
    """
    What the tracker estimates.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,)
        X = R Xm + T in the camera's optical frame, metres.
    zoom : float
        Focal length as a multiple of the camera's own.
    affine : ndarray, shape (2, 4), or None
        [M t] of x = M Xm + t in normalised image coordinates, for the affine camera only; the
        pose is then the nearest one.

    """

    rotation: np.ndarray
    translation: np.ndarray
    zoom: float = 1.0
    affine: np.ndarray | None = None

    @property
    def affine_map(self) -> np.ndarray:
        """The affine camera of a pose that has one."""
        if self.affine is None:
            raise ArgumentError('This pose was not estimated with an affine camera.')
        return self.affine

    def turned_to(self, rotation: np.ndarray) -> ObjectPose:
        """Return the pose in the same place with another rotation (3, 3)."""
        affine = None if self.affine is None else np.column_stack(
            [rotation[:2] / self.translation[2], self.affine[:, 3]])
        return ObjectPose(rotation, self.translation, self.zoom, affine)


@dataclass(frozen=True)
class ProjectedPoints:
    """
    Attributes of object points seen in a state.

    Attributes
    ----------
    pixels : ndarray, shape (C, 2)
    xy : ndarray, shape (C, 2)
        Undistorted normalised coordinates.
    turned : ndarray, shape (C, 3)
        R Xm (for the affine camera Xm itself).
    inverse_depth : ndarray, shape (C,)
        1 / D; the same for all points of a weak perspective camera.

    """

    pixels: np.ndarray
    xy: np.ndarray
    turned: np.ndarray
    inverse_depth: np.ndarray


class Projection:
    """
    One camera model on one camera.

    Parameters
    ----------
    camera : Camera
    model : {'perspective', 'zoom', 'weak', 'affine'}
        Weak perspective takes the object's origin as its mean depth; give it points whose origin
        lies in their middle.
    row_motion : RowMotion, optional
        How the object moves while the lines of an image are read; None: all are read at once.

    Attributes
    ----------
    size : int
        Number of values in a correction: 6, 7 (zoom) or 8 (affine).

    """

    def __init__(self, camera: Camera, model: str = 'perspective',
                 row_motion: RowMotion | None = None):
        """Take the pixel map of the camera apart."""
        self.camera, self.row_motion = camera, row_motion
        self.become(model)
        self._pixel = camera.K[:2, :2].copy()
        self._centre = camera.K[:2, 2].copy()
        self._signature = (camera.K.tobytes(), camera.distortion.tobytes(), camera.model)
        self._distorted = not camera.is_pinhole
        widest = camera.lens.widest_angle(camera.distortion) if self._distorted else np.inf
        # beyond it the lens's formula leads back into the image
        self._widest = math.tan(widest) if widest < 0.5 * math.pi else np.inf

    def become(self, model: str) -> None:
        """Take another camera model."""
        self.model = model
        self.size = {'perspective': 6, 'weak': 6, 'zoom': 7, 'affine': 8}[model]

    def project(self, state: ObjectPose, points: np.ndarray) -> ProjectedPoints:
        """
        Project object points.

        Parameters
        ----------
        state : ObjectPose
        points : ndarray, shape (C, 3)
            Object frame, metres.

        Returns
        -------
        ProjectedPoints
            Points behind the camera come far outside of the image, never on the other side. So
            do points at a wider angle than the lens sees.

        """
        return self._when_read(state, points, self._at_stamp(state, points))

    @property
    def reads_rows(self) -> bool:
        """Whether points move on until their line is read."""
        return self.row_motion is not None and self.row_motion.is_moving

    def displacement(self, state: ObjectPose, points: np.ndarray) -> np.ndarray:
        """How far object points (C, 3) move in the image until their line is read, pixels."""
        still = self._at_stamp(state, points)
        moved: np.ndarray = self._when_read(state, points, still).pixels - still.pixels
        return moved

    def _when_read(self, state: ObjectPose, points: np.ndarray, still: ProjectedPoints,
                   ) -> ProjectedPoints:
        """Move object points (C, 3) on to where they are when their line is read."""
        rows = self.row_motion
        if rows is None or not rows.is_moving:
            return still
        xy = rows.displaced(still.xy, self._speed(points, still, rows.velocity), state.zoom)
        return ProjectedPoints(self.pixels(xy, state.zoom), xy, still.turned, still.inverse_depth)

    def _at_stamp(self, state: ObjectPose, points: np.ndarray) -> ProjectedPoints:
        """Project object points (C, 3) as if all lines were read at once."""
        if self.model == 'affine':
            turned, inverse = points, np.ones(len(points))
            affine = state.affine_map
            xy = points @ affine[:, :3].T + affine[:, 3]
        else:
            turned = points @ state.rotation.T
            if self.model == 'weak':
                inverse = np.full(len(points), 1 / max(state.translation[2], NEAREST_M))
            else:
                inverse = 1 / np.maximum(turned[:, 2] + state.translation[2], NEAREST_M)
            xy = (turned[:, :2] + state.translation[:2]) * inverse[:, None]
        return ProjectedPoints(self.pixels(xy, state.zoom), xy, turned, inverse)

    def is_alike(self, other: Projection) -> bool:
        """Whether both are perspective views by one camera that reads all lines at once."""
        return (self._signature == other._signature and self.model == other.model == 'perspective'
                and not self.reads_rows)

    def project_at_once(self, states: Sequence[ObjectPose], points: Sequence[np.ndarray],
                        ) -> ProjectedPoints:
        """Project points (P, C_k, 3) of objects, see `project_together`; by a perspective view."""
        counts = [one.shape[1] for one in points]
        turned = np.empty((len(points[0]), sum(counts), 3))
        end = 0
        for state, one in zip(states, points):
            begin, end = end, end + one.shape[1]
            np.matmul(one, state.rotation.T, out=turned[:, begin:end])
        away = np.repeat(np.array([state.translation for state in states]), counts, axis=0)
        inverse = 1 / np.maximum(turned[..., 2] + away[:, 2], NEAREST_M)
        xy = (turned[..., :2] + away[:, :2]) * inverse[..., None]
        return ProjectedPoints(self.pixels(xy.reshape(-1, 2), 1.0).reshape(xy.shape), xy, turned,
                               inverse)

    def pixels(self, xy: np.ndarray, zoom: float) -> np.ndarray:
        """Pixels (C, 2) of normalised coordinates, the focal length that multiple of its own."""
        image = self._lens_image(xy).xy if self._distorted else xy
        if self._widest < np.inf:
            radius = np.hypot(xy[:, 0], xy[:, 1])[:, None]
            image = np.where(radius > self._widest, xy * (_FAR / np.maximum(radius, 1e-12)), image)
        pixels: np.ndarray = image @ (zoom * self._pixel.T) + self._centre
        return pixels

    def _speed(self, points: np.ndarray, seen: ProjectedPoints, velocity: np.ndarray,
               ) -> np.ndarray:
        """How fast normalised coordinates of object points (C, 3) change, (C, 2) a second."""
        if self.model == 'affine':
            return np.asarray(points @ velocity[:6].reshape(2, 3).T + velocity[6:8])
        move = seen.turned @ cross_matrix(velocity[:3]).T + velocity[3:6]
        away = velocity[5] if self.model == 'weak' else move[:, 2:]
        return np.asarray((move[:, :2] - seen.xy * away) * seen.inverse_depth[:, None])

    def rows(self, state: ObjectPose, seen: ProjectedPoints, normal: np.ndarray) -> np.ndarray:
        """
        Motion of projected points along given directions per unit of correction.

        With the normal n at an edge of angle alpha, n = (-sin alpha, cos alpha), this is -c of
        the thesis: l' = l - rows q.

        Parameters
        ----------
        state : ObjectPose
        seen : ProjectedPoints
        normal : ndarray, shape (C, 2)
            Directions in the image (pixels).

        Returns
        -------
        ndarray, shape (C, size)

        """
        slope = normal @ (state.zoom * self._pixel)
        x, y = seen.xy[:, 0], seen.xy[:, 1]
        if self._distorted:
            bent = self._lens_image(seen.xy).by_ray()[:, :, :2]
            slope = np.einsum('ci,cij->cj', slope, bent)
        out = np.empty((len(slope), self.size))
        if self.model == 'affine':
            out[:, 0:3] = slope[:, :1] * seen.turned
            out[:, 3:6] = slope[:, 1:] * seen.turned
            out[:, 6:8] = slope
            return out
        # the image moves by w . (theta x X̂ + Delta) = (X̂ x w) . theta + w . Delta
        u, v = slope[:, 0] * seen.inverse_depth, slope[:, 1] * seen.inverse_depth
        w = -(u * x + v * y)
        X, Y, Z = seen.turned.T
        out[:, 3], out[:, 4], out[:, 5] = u, v, w
        if self.model == 'weak':
            # only the mean depth counts, which a rotation does not change
            w = 0.0
        out[:, 0] = Y * w - Z * v
        out[:, 1] = Z * u - X * w
        out[:, 2] = X * v - Y * u
        if self.model == 'zoom':
            out[:, 6] = np.einsum('ci,ci->c', normal, seen.pixels - self._centre)
        return out

    def _lens_image(self, xy: np.ndarray) -> LensImage:
        """Image, before the calibration matrix, of what a pinhole would see at xy (C, 2)."""
        rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
        return self.camera.lens.image(rays, self.camera.distortion)

    def moved(self, state: ObjectPose, correction: np.ndarray) -> ObjectPose:
        """Apply a correction (size,) to a state."""
        if self.model == 'affine':
            affine = state.affine_map.copy()
            affine[:, :3] += correction[:6].reshape(2, 3)
            affine[:, 3] += correction[6:8]
            return nearest_pose(affine, state)
        rotation = _rotation_matrix(correction[:3]) @ state.rotation
        zoom = state.zoom * float(np.exp(np.clip(correction[6], -1, 1))) \
            if self.model == 'zoom' else state.zoom
        return ObjectPose(rotation, state.translation + correction[3:6], zoom)

    def renewed(self, state: ObjectPose) -> ObjectPose:
        """Return a state without the rounding of its rotation, which grows from frame to frame."""
        rotation = state.rotation
        # one step towards the nearest rotation
        rotation = 1.5 * rotation - 0.5 * rotation @ (rotation.T @ rotation)
        return ObjectPose(rotation, state.translation, state.zoom, state.affine)

    def difference(self, there: ObjectPose, here: ObjectPose) -> np.ndarray:
        """Return the correction (size,) that takes `here` to `there`."""
        if self.model == 'affine':
            change = there.affine_map - here.affine_map
            return np.concatenate([change[:, :3].ravel(), change[:, 3]])
        out = np.empty(self.size)
        out[:3] = _rotation_vector(there.rotation @ here.rotation.T)
        out[3:6] = there.translation - here.translation
        if self.size == 7:
            out[6] = np.log(there.zoom / here.zoom)
        return out

    def from_pose(self, rotation: ArrayLike, translation: ArrayLike, zoom: float = 1.0,
                  ) -> ObjectPose:
        """Return the state of a pose."""
        rotation = np.array(rotation, float)
        translation = np.array(translation, float)
        affine = None
        if self.model == 'affine':
            scale = 1 / max(translation[2], NEAREST_M)
            affine = scale * np.column_stack([rotation[:2], translation[:2]])
        return ObjectPose(rotation, translation, zoom, affine)

    def covariance_of_pose(self, state: ObjectPose, covariance: np.ndarray) -> np.ndarray:
        """
        Carry a covariance of the correction (size, size) to the pose (theta, Delta), (6, 6).

        For the affine camera by differences of the nearest pose.
        """
        if self.model != 'affine':
            return covariance[:6, :6]
        slope = np.empty((6, 8))
        for k, step in enumerate(1e-6 * np.eye(8) * np.abs(state.affine_map[:, :3]).max()):
            other = self.moved(state, step)
            slope[:3, k] = rotation_vector(other.rotation @ state.rotation.T) / step[k]
            slope[3:, k] = (other.translation - state.translation) / step[k]
        carried: np.ndarray = slope @ covariance @ slope.T
        return carried


def project_together(projections: Sequence[Projection], states: Sequence[ObjectPose],
                     points: Sequence[np.ndarray]) -> ProjectedPoints:
    """
    Project points of several objects.

    Parameters
    ----------
    projections : sequence of Projection
    states : sequence of ObjectPose
    points : sequence of ndarray, shape (P, C_k, 3)
        Of each object, in its frame.

    Returns
    -------
    ProjectedPoints
        Of shapes (P, C, 2), (P, C, 2), (P, C, 3) and (P, C), the objects one after the other.

    """
    first = projections[0]
    if len(points) > 1 and all(one.is_alike(first) for one in projections):
        return first.project_at_once(states, points)
    found = []
    for projection, state, one in zip(projections, states, points):
        seen = projection.project(state, one.reshape(-1, 3))
        shape = one.shape[:2]
        found.append(ProjectedPoints(
            seen.pixels.reshape(*shape, 2), seen.xy.reshape(*shape, 2),
            seen.turned.reshape(*shape, 3), seen.inverse_depth.reshape(shape)))
    if len(found) == 1:
        return found[0]
    return ProjectedPoints(*(np.concatenate([getattr(seen, name) for seen in found], axis=1)
                             for name in ('pixels', 'xy', 'turned', 'inverse_depth')))


def _rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """Return `rotation_matrix` of one vector; ten times as fast as the stacked one."""
    x, y, z = (float(v) for v in vector)
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    if angle < 1e-4:
        a, b = 1 - square / 6, 0.5 - square / 24
    else:
        a, b = math.sin(angle) / angle, 2 * (math.sin(0.5 * angle) / angle)**2
    return np.array([[1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
                     [b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x],
                     [b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)]])


def _rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Return `rotation_vector` of one matrix, fast while the angle is small."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    cosine = 0.5 * (a + e + i - 1)
    if cosine < 0.5:
        return rotation_vector(rotation)
    x, y, z = 0.5 * (h - f), 0.5 * (c - g), 0.5 * (d - b)
    sine = math.sqrt(x * x + y * y + z * z)
    factor = math.asin(min(sine, 1.0)) / sine if sine > 1e-6 else 1.0
    return np.array([factor * x, factor * y, factor * z])


def nearest_pose(affine: np.ndarray, before: ObjectPose) -> ObjectPose:
    """
    Pose whose weak perspective image comes nearest to an affine camera (2, 4).

    The two rows of a scaled rotation nearest in the Frobenius norm; the scale is the mean of the
    singular values.
    """
    U, values, Vt = np.linalg.svd(affine[:, :3], full_matrices=False)
    two = U @ Vt
    rotation = np.vstack([two, np.cross(two[0], two[1])])
    depth = 1 / max(values.mean(), 1e-12)
    translation = np.array([affine[0, 3] * depth, affine[1, 3] * depth, depth])
    return ObjectPose(rotation, translation, before.zoom, affine)
