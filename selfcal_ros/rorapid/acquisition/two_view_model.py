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
A wireframe model from two images between which a known camera moved without turning (7.3.4).

Points seen in both give the epipole, which is all there is to find: F = [e]x. The structure of [I
| 0] and [I | e] is affine (lemma 4.1), and the known K makes it metric (2.16), up to a scale. One
known length supplies that, or the way that the camera went.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.fundamental import fundamental
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.polygon import newell_normal
from selfcal_ros.geometry.triangulation import metric_points, translated_points
from selfcal_ros.rorapid.acquisition.point_covariance import (blocks, point_jacobian,
                                                              shape_covariances)
from selfcal_ros.values.wireframe import Conic, Polygon, WireframeModel

#: Worse than this share of the distance, a depth is of no use for a model.
WORST_DEPTH = 0.2
#: Residuals above this many sigmas are not noise.
_TOO_FAR = 4.0
#: Noise of image points that is assumed where nothing else is known, pixels.
SIGMA_PX = 0.5


@dataclass(frozen=True)
class TwoViewPoints:
    """
    Points reconstructed from two translated views.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        Metres, optical frame of the first view.
    covariances : ndarray, shape (N, 3, 3)
        Of the points, from the noise of the image points; the scale is taken as exact.
    shape_covariances : ndarray, shape (N, 3, 3)
        Of the points among each other: what is left of their errors where turn and shift of all
        of them together do not count. This is what a model suffers from.
    moved : ndarray, shape (3,)
        What is added to the points from the first view to the second, metres.
    noise_px : float
        Standard deviation of an image coordinate that the residuals show.
    sigma_px : float
        The one that the covariances suppose.

    """

    points: np.ndarray
    covariances: np.ndarray
    shape_covariances: np.ndarray
    moved: np.ndarray
    noise_px: float
    sigma_px: float


@dataclass(frozen=True)
class AcquiredModel:
    """
    A model, and how it lay before the camera.

    Parameters
    ----------
    model : WireframeModel
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,)
        Pose object -> camera in the first view.
    structure : TwoViewPoints
        Vertices in the first view's frame.

    """

    model: WireframeModel
    rotation: np.ndarray
    translation: np.ndarray
    structure: TwoViewPoints


def points_from_translation(first_px: ArrayLike, second_px: ArrayLike, camera: Camera,
                            baseline_m: float | None = None,
                            known_length: tuple[int, int, float] | None = None,
                            sigma_px: float = SIGMA_PX) -> TwoViewPoints | NoEstimate:
    """
    Reconstruct points seen before and after a pure translation of the camera or the object.

    Parameters
    ----------
    first_px, second_px : array_like, shape (N, 2)
        The same points in both images, N at least 4; lens distortion is taken care of.
    camera : Camera
    baseline_m : float, optional
        How far the camera went.
    known_length : (int, int, float), optional
        Two points and their distance in metres; this or `baseline_m` is needed.
    sigma_px : float
        Noise of the image points, as far as is known beforehand.

    Returns
    -------
    TwoViewPoints or NoEstimate
        No estimate where the points contradict a translation, moved too little or lie behind
        the camera.

    Raises
    ------
    ArgumentError
        If the points do not match in number, or the scale is not given once.

    """
    first, second = (np.asarray(p, float).reshape(-1, 2) for p in (first_px, second_px))
    if first.shape != second.shape:
        raise ArgumentError(f'There must be as many points in the second image as in the first, '
                            f'not {len(second)} and {len(first)}.')
    scale = _scale_fact(len(first), baseline_m, known_length)
    if len(first) < 4:
        return NoEstimate('too_few', what='model from two translated views', needed=4,
                          items='points', found=len(first))
    K = camera.K
    a, b = (camera.normalised(p) @ K[:2, :2].T + K[:2, 2] for p in (first, second))
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return NoEstimate('points_outside_lens')
    found = fundamental(a, b, 'translation')
    if isinstance(found, NoEstimate):
        return found
    noise = found.noise_px
    if noise > _TOO_FAR * sigma_px:
        return NoEstimate('points_miss_translation', noise_px=float(noise), sigma_px=sigma_px)
    e = np.array([found.F[2, 1], found.F[0, 2], found.F[1, 0]])
    if np.median(metric_points(K, translated_points(e, a, b))[:, 2]) < 0:
        e = -e
    points = metric_points(K, translated_points(e, a, b))
    if not (np.isfinite(points).all() and (points[:, 2] > 0).all()):
        return NoEstimate('points_behind_camera')
    jacobian = point_jacobian(K, e, a, b)
    covariances = sigma_px**2 * blocks(jacobian @ jacobian.T)
    depth_sigma = np.sqrt(covariances[:, 2, 2]) / points[:, 2]
    if np.median(depth_sigma) > WORST_DEPTH:
        return NoEstimate('depths_uncertain', share=float(np.median(depth_sigma)))
    moved = np.linalg.solve(K, e)
    size = scale(points, moved)
    if not (np.isfinite(size) and size > 0):
        return NoEstimate('known_length_zero')
    points = size * points
    ends = None if known_length is None else known_length[:2]
    return TwoViewPoints(points, size**2 * covariances,
                         shape_covariances(points, sigma_px * size * jacobian, ends),
                         size * moved, noise, sigma_px)


def _scale_fact(count: int, baseline_m: float | None, known_length: tuple[int, int, float] | None,
                ) -> Callable[[np.ndarray, np.ndarray], np.floating[Any]]:
    """Return the function of (points, moved) that gives metres per unit."""
    if (baseline_m is None) == (known_length is None):
        raise ArgumentError('Give either baseline_m, how far the camera went, or known_length, '
                            'the distance between two points.')
    if baseline_m is not None:
        if not 0 < baseline_m < np.inf:
            raise ArgumentError(f'baseline_m must be positive, not {baseline_m!r}.')
        return lambda points, moved: baseline_m / np.linalg.norm(moved)
    assert known_length is not None
    i, j, length = known_length
    if not (0 <= i < count and 0 <= j < count and i != j and 0 < length < np.inf):
        raise ArgumentError('known_length must be two different points and a positive length.')
    with np.errstate(divide='ignore'):
        return lambda points, moved: np.float64(length) / np.linalg.norm(points[i] - points[j])


def acquire_model(first_px: ArrayLike, second_px: ArrayLike, camera: Camera,
                  lines: Sequence[tuple[int, int]] = (), faces: Sequence[Sequence[int]] = (),
                  conics: Sequence[tuple[int, ArrayLike]] = (),
                  frame: tuple[int, int, int] | None = None, name: str = 'acquired', *,
                  baseline_m: float | None = None,
                  known_length: tuple[int, int, float] | None = None,
                  sigma_px: float = SIGMA_PX) -> AcquiredModel | NoEstimate:
    """
    Make a model of an object whose vertices were found in two translated views.

    Parameters
    ----------
    first_px, second_px : array_like, shape (N, 2)
        Its vertices in both images.
    camera : Camera
    lines : sequence of (int, int)
        Lines between vertices; borders of faces need not be named.
    faces : sequence of sequence of int
        Opaque faces, by their vertices in order.
    conics : sequence of (int, array_like (M, 2))
        Ellipses on faces: the face, and five or more of its points in the first image.
    frame : (int, int, int), optional
        Three vertices: the origin, one on the x axis, one on the x-y plane. Default: the
        middle of the object, with the axes of the first view.
    name : str
    baseline_m, known_length, sigma_px
        As for `points_from_translation`.

    Returns
    -------
    AcquiredModel or NoEstimate

    Raises
    ------
    ArgumentError
        If an index names no vertex, or a face or ellipse cannot be.

    """
    structure = points_from_translation(first_px, second_px, camera, baseline_m, known_length,
                                        sigma_px)
    if isinstance(structure, NoEstimate):
        return structure
    points = structure.points
    R, t = _object_frame(points, frame)
    vertices = (points - t) @ R
    polygons = [Polygon(tuple(face)) for face in faces]
    bare = WireframeModel.build(vertices, lines, polygons, name=name)
    ellipses = tuple(_conic_on_face(vertices[list(bare.faces[face].indices)], pixels, camera, R,
                                    t) for face, pixels in conics)
    model = WireframeModel(bare.vertices, bare.lines, bare.faces, ellipses, name=name)
    return AcquiredModel(model, R, t, structure)


def _object_frame(points: np.ndarray, frame: tuple[int, int, int] | None,
                  ) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation object -> first view."""
    if frame is None:
        return np.eye(3), 0.5 * (points.min(axis=0) + points.max(axis=0))
    if len(set(frame)) != 3 or not all(0 <= k < len(points) for k in frame):
        raise ArgumentError('The frame must be three different vertices.')
    origin, on_x, on_plane = (points[k] for k in frame)
    z = np.cross(on_x - origin, on_plane - origin)
    if not np.linalg.norm(z) > 1e-9 * np.linalg.norm(on_x - origin)**2:
        raise ArgumentError('The three vertices of the frame lie on one line.')
    x = (on_x - origin) / np.linalg.norm(on_x - origin)
    z = z / np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z]), origin


def _conic_on_face(corners: np.ndarray, pixels: ArrayLike, camera: Camera, R: np.ndarray,
                   t: np.ndarray) -> Conic:
    """Fit an ellipse to pixels of the first view, on the plane of a face (object frame)."""
    pixels = np.asarray(pixels, float).reshape(-1, 2)
    if len(pixels) < 5:
        raise ArgumentError(f'An ellipse needs five points or more, not {len(pixels)}.')
    normal = newell_normal(corners)
    normal = normal / np.linalg.norm(normal)
    rays = np.column_stack([camera.normalised(pixels), np.ones(len(pixels))]) @ R
    eye = -t @ R
    reach = (corners.mean(axis=0) - eye) @ normal / (rays @ normal)
    on_plane = eye + reach[:, None] * rays
    across = corners[1] - corners[0]
    across = across - (across @ normal) * normal
    across /= np.linalg.norm(across)
    axes = np.column_stack([across, np.cross(normal, across)])
    flat = (on_plane - corners[0]) @ axes
    scale = np.ptp(flat, axis=0).max()
    if not (np.isfinite(flat).all() and scale > 0):
        raise ArgumentError('The points of an ellipse do not lie on its face.')
    # single precision: far from the origin the fit would lose its figures
    middle = flat.mean(axis=0)
    (x, y), (long, short), angle = cv2.fitEllipseDirect(
        (100 * (flat - middle) / scale).astype(np.float32))
    turn = np.deg2rad(angle)
    u = axes @ [np.cos(turn), np.sin(turn)]
    v = axes @ [-np.sin(turn), np.cos(turn)]
    centre = corners[0] + axes @ (middle + scale * np.array([x, y]) / 100)
    return Conic(centre, scale * long / 200 * u, scale * short / 200 * v)
