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
Calibration from affine structure: translated views, then rotated ones (thesis chapter 4).

Two translated views give the points up to an affine map (algorithm 4.1). Resection against them
gives every further camera, and the left halves of the cameras are the infinite homographies
(algorithm 4.2). An adjustment of the affine cameras and points in between needs no calibration. It
makes the homographies as good as the images allow, and gives their covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.calibration.affine.affine_adjustment import adjust, AffineViews
from selfcal_ros.calibration.affine.diac import InfiniteHomographies, unit_determinant
from selfcal_ros.calibration.affine.infinite_homography_calibration import (
    camera_from_homographies, ConicCalibration)
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.fundamental import PairMatches, refine_translation
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import homogeneous
from selfcal_ros.geometry.resection import resect
from selfcal_ros.geometry.robust_loss import huber_weights
from selfcal_ros.geometry.robust_scale import robust_sigma, robust_sigma_of_lengths
from selfcal_ros.geometry.triangulation import (correct_to_epipolar_line, metric_points,
                                                translated_points, triangulate)
from selfcal_ros.values.tracks import Tracks

#: A pair or a view needs at least so many points.
MIN_MATCHES = 8
#: Matches further from the pair's lines than so many robust sigmas take no part.
_OUTLIER_SIGMAS = 4.0
_HUBER_SIGMAS = 2.5
#: Points are off a common plane if it leaves so many times the noise.
_PLANE_RATIO = 3.0
#: Displacements that vary by less than this are one displacement.
_MIN_PARALLAX_PX = 1e-4
#: Upper quartile of the absolute value of a normal deviate.
_UPPER_QUARTILE = 1.1503


@dataclass(frozen=True)
class AffineReconstruction:
    """
    Cameras and points up to one affine map of space.

    Attributes
    ----------
    frames : ndarray of int, shape (V,)
        The reference first, whose camera is [I | 0].
    translated : ndarray of bool, shape (V,)
        Views that are translated against the reference, [I | e].
    cameras : ndarray, shape (V, 3, 4)
        Pixels.
    tracks : ndarray of int, shape (P,)
    points : ndarray, shape (P, 4)
        Homogeneous, (x, y, 1, inverse depth) times any factor.
    homographies : InfiniteHomographies
        Of the views that are not translated, in the order of `frames`.
    sigma_px : float
        Robust standard deviation of an image coordinate.

    """

    frames: np.ndarray
    translated: np.ndarray
    cameras: np.ndarray
    tracks: np.ndarray
    points: np.ndarray
    homographies: InfiniteHomographies
    sigma_px: float


@dataclass(frozen=True)
class AffineCalibration:
    """
    A camera from affine structure.

    Attributes
    ----------
    conic : ConicCalibration
        K, its covariance, the closed form.
    structure : AffineReconstruction

    """

    conic: ConicCalibration
    structure: AffineReconstruction

    @property
    def K(self) -> np.ndarray:
        """Calibration matrix, pixels, shape (3, 3)."""
        return self.conic.K

    def metric(self, K: ArrayLike | None = None) -> np.ndarray:
        """Euclidean points (P, 3) in the reference's frame, up to scale (2.16)."""
        return metric_points(self.K if K is None else K, self.structure.points)


def translated_pair(tracks: Tracks, frames: Sequence[int] | np.ndarray,
                    ) -> tuple[int, int, np.ndarray] | NoEstimate:
    """
    Choose the two of several translated views that tell most of depth.

    Parameters
    ----------
    tracks : Tracks
        Undistorted pixels.
    frames : sequence of int
        Views related by pure translation.

    Returns
    -------
    (int, int, ndarray (3,)) or NoEstimate
        The frames and the epipole, pixels, which both share.

    """
    frames = [int(f) for f in frames]
    pairs = [(a, b) for k, a in enumerate(frames) for b in frames[k + 1:]]
    matches = [tracks.matches(a, b)[1:] for a, b in pairs]
    usable = [k for k, (a, b) in enumerate(matches) if len(a) >= MIN_MATCHES
              and (b - a).std(axis=0).max() > _MIN_PARALLAX_PX]
    if not usable:
        most = max((len(a) for a, _ in matches), default=0)
        if most >= MIN_MATCHES:
            return NoEstimate('translated_views_equal')
        return NoEstimate('too_few', what='pair of translated views', needed=MIN_MATCHES,
                          items='shared points', found=most)
    # the most parallax that many points show
    worth = [np.sqrt(len(matches[k][0])) * np.median(
        np.linalg.norm(matches[k][1] - matches[k][0], axis=1)) for k in usable]
    best = usable[int(np.argmax(worth))]
    a, b = matches[best]
    for _ in range(3):
        data = PairMatches.from_pixels([(a, b)])
        F = data.pixels_F(refine_translation(data)[0])[0]
        epipole = np.array([F[2, 1], F[0, 2], F[1, 0]])
        moved = np.abs(correct_to_epipolar_line(epipole, a, b)[2][:, 0])
        near = moved <= _OUTLIER_SIGMAS * max(robust_sigma(moved), 1e-9)
        if near.all() or near.sum() < MIN_MATCHES:
            break
        a, b = a[near], b[near]
    return (*pairs[best], epipole)


def affine_structure(tracks: Tracks, translated: Sequence[int] | np.ndarray, refine: bool = True,
                     ) -> AffineReconstruction | NoEstimate:
    """
    Affine cameras and points of all views (algorithms 4.1, 4.2).

    Parameters
    ----------
    tracks : Tracks
        Undistorted pixels; gross errors are weighed down, but should be few.
    translated : sequence of int
        Frames that are related by pure translation, two or more.
    refine : bool
        Adjust cameras and points together. False: the thesis's chain alone.

    Returns
    -------
    AffineReconstruction or NoEstimate

    """
    pair = translated_pair(tracks, translated)
    if isinstance(pair, NoEstimate):
        return pair
    tracks = tracks.with_at_least(2)
    group = {int(f) for f in translated}
    scene = _GrowingScene.of_pair(tracks, pair)
    if isinstance(scene, NoEstimate):
        return scene
    failure = scene.add_views(group, refine)
    if failure is not None and group.issuperset(scene.frames):
        return failure
    kept = scene.placed_observations()
    ids, point = np.unique(kept.track, return_inverse=True)
    is_free = ~np.isin(scene.frames, list(group))
    views = AffineViews(np.array(scene.cameras), scene.points[np.searchsorted(scene.names, ids)],
                        ~is_free, scene.view_of(kept.frame), point, kept.xy)
    adjusted = adjust(views, iterations=25 if refine else 0)
    H, slope = unit_determinant(adjusted.cameras[is_free][:, :, :3])
    n = len(H)
    covariance = np.einsum('iab,ibjc,jdc->iajd', slope,
                           adjusted.covariance.reshape(n, 9, n, 9), slope, optimize=True)
    return AffineReconstruction(np.array(scene.frames), ~is_free, adjusted.cameras, ids,
                                adjusted.points,
                                InfiniteHomographies(H, covariance.reshape(1, 9 * n, 9 * n)),
                                adjusted.sigma_px)


@dataclass
class _GrowingScene:
    """
    An affine scene to which views are added one by one, the one that sees most of it first.

    Attributes
    ----------
    tracks : Tracks
    names : ndarray of int, shape (P,)
        Track identities of the points.
    track : ndarray of int, shape (N,)
        Point of every observation.
    points : ndarray, shape (P, 4)
        NaN where a point is not placed yet.
    frames : list of int
        Of the views that have a camera; the reference first.
    cameras : list of ndarray, shape (3, 4)

    """

    tracks: Tracks
    names: np.ndarray
    track: np.ndarray
    points: np.ndarray
    frames: list[int]
    cameras: list[np.ndarray]

    @classmethod
    def of_pair(cls, tracks: Tracks, pair: tuple[int, int, np.ndarray],
                ) -> _GrowingScene | NoEstimate:
        """Place the points of two translated views with an epipole (algorithm 4.1)."""
        first, second, epipole = pair
        names, track = np.unique(tracks.track, return_inverse=True)
        track_ids, xy_a, xy_b = tracks.matches(first, second)
        row = np.searchsorted(names, track_ids)
        points = np.full((len(names), 4), np.nan)
        points[row] = translated_points(epipole, xy_a, xy_b)
        # inverse depths of the order of one
        size = np.median(np.abs(points[row, 3]))
        ratio = _plane_ratio(points[row], epipole, xy_a, xy_b)
        if not (size > 0 and ratio > _PLANE_RATIO):
            return NoEstimate('translated_scene_flat', first=first, second=second,
                              ratio=float(ratio))
        points[row, 3] /= size
        return cls(tracks, names, track, points, [first, second],
                   [np.eye(3, 4), np.column_stack([np.eye(3), epipole * size])])

    @property
    def is_placed(self) -> np.ndarray:
        """Mark the points that have a place, shape (P,)."""
        placed: np.ndarray = np.isfinite(self.points).all(axis=1)
        return placed

    def view_of(self, frame: np.ndarray) -> np.ndarray:
        """Return the views of frames (n,) that have a camera."""
        frames = np.array(self.frames)
        order = np.argsort(frames)
        view: np.ndarray = order[np.searchsorted(frames[order], frame)]
        return view

    def _seen_twice(self, mask: np.ndarray) -> np.ndarray:
        """Mark observations (N,) of a mask, of placed views, whose points have two or more."""
        mask = np.isin(self.tracks.frame, self.frames) & mask
        twice: np.ndarray = mask & (np.bincount(self.track[mask],
                                                minlength=len(self.names))[self.track] >= 2)
        return twice

    def placed_observations(self) -> Tracks:
        """Return what the views see of placed points, each by two views at least."""
        return self.tracks.select(self._seen_twice(self.is_placed[self.track]))

    def add_views(self, translated: set[int], grows: bool) -> NoEstimate | None:
        """
        Resect against the scene all views that see enough of it (algorithm 4.2).

        Parameters
        ----------
        translated : set of int
            Frames whose camera is [I | e].
        grows : bool
            Whether new views place further points.

        Returns
        -------
        NoEstimate or None
            Why the last view that failed has no camera.

        """
        failure: NoEstimate | None = None
        waiting = [int(f) for f in self.tracks.frames if f not in self.frames]
        while waiting:
            placed = self.is_placed
            seen = [int(np.sum(placed[self.track[self.tracks.frame == f]])) for f in waiting]
            k = int(np.argmax(seen))
            if seen[k] < MIN_MATCHES:
                break
            frame = waiting.pop(k)
            rows = np.flatnonzero((self.tracks.frame == frame) & placed[self.track])
            points, xy = self.points[self.track[rows]], self.tracks.xy[rows]
            camera: np.ndarray | None
            if frame in translated:
                camera = _translated_camera(points, xy)
            else:
                found = resect(points, xy, huber_sigmas=_HUBER_SIGMAS)
                camera = None if isinstance(found, NoEstimate) else found.P
                failure = found if isinstance(found, NoEstimate) else failure
            if camera is None:
                continue
            self.frames.append(frame)
            self.cameras.append(camera)
            if grows and not placed.all():
                self._add_points()
        return failure

    def _add_points(self) -> None:
        """Triangulate points that views see at least twice and that are not placed yet."""
        mask = self._seen_twice(~self.is_placed[self.track])
        if mask.any():
            rows, index = np.unique(self.track[mask], return_inverse=True)
            self.points[rows] = triangulate(np.array(self.cameras),
                                            self.view_of(self.tracks.frame[mask]), index,
                                            self.tracks.xy[mask])


def _plane_ratio(points: np.ndarray, epipole: np.ndarray, xy_a: np.ndarray, xy_b: np.ndarray,
                 ) -> float:
    """What the best plane leaves of the displacements, in units of their noise; robust."""
    moved = correct_to_epipolar_line(epipole, xy_a, xy_b)[2]
    noise = robust_sigma(moved[:, 0] - moved[:, 1]) + 1e-9
    reach = np.linalg.norm(epipole[:2] - epipole[2] * xy_b, axis=1)
    weight = reach.copy()
    # the inverse depths of a plane are linear in x and y
    for _ in range(5):
        A = points[:, :3] * weight[:, None]
        plane = np.linalg.lstsq(A / np.abs(A).max(axis=0), points[:, 3] * weight, rcond=None)[0]
        left = np.abs(points[:, 3] - points[:, :3] / np.abs(A).max(axis=0) @ plane) * reach
        spread = 3 * np.median(left) + 1e-300
        weight = reach / np.sqrt(1 + (left / spread)**2)
    # a share of the points off the plane is enough: the upper quartile
    return float(np.percentile(left, 75) / _UPPER_QUARTILE / noise)


def _translated_camera(points: np.ndarray, xy: np.ndarray) -> np.ndarray | None:
    """Camera [I | e] of a further translated view, by least squares, gross errors weighed."""
    x = homogeneous(xy)
    ahead = points[:, :3]
    scale = np.abs(xy).max()
    e, weight = np.zeros(3), np.ones(len(x))
    for _ in range(6):
        # x' ~ X + r e: two equations linear in e, divided by the depth of the last round
        depth = ahead[:, 2] + points[:, 3] * e[2]
        depth = np.where(np.abs(depth) > 1e-9, depth, 1e-9)
        rows = np.zeros((len(x), 2, 3))
        rows[:, 0, 0] = rows[:, 1, 1] = points[:, 3]
        rows[:, :, 2] = -points[:, 3:] * xy * 1.0
        right = ahead[:, 2:] * xy - ahead[:, :2]
        factor = (np.sqrt(weight) / np.abs(depth))[:, None]
        A = (rows * factor[..., None]).reshape(-1, 3) * [1, 1, 1 / scale]
        e = np.linalg.lstsq(A, (right * factor).ravel(), rcond=None)[0] * [1, 1, 1 / scale]
        image = ahead + points[:, 3:] * e
        depth = np.where(np.abs(image[:, 2:]) > 1e-9, image[:, 2:], 1e-9)
        distance = np.linalg.norm(image[:, :2] / depth - xy, axis=1)
        limit = _HUBER_SIGMAS * max(robust_sigma_of_lengths(distance), 1e-9)
        weight = huber_weights(distance, limit)
    return np.column_stack([np.eye(3), e]) if np.isfinite(e).all() else None


def calibrate_affine(tracks: Tracks, translated: Sequence[int] | np.ndarray, size: tuple[int, int],
                     facts: CameraFacts | None = None, refine: bool = True,
                     ) -> AffineCalibration | NoEstimate:
    """
    Calibrate from views of which some are related by pure translation (chapter 4).

    Parameters
    ----------
    tracks : Tracks
        Undistorted pixels.
    translated : sequence of int
        Frames that are related by pure translation, two or more.
    size : (int, int)
        Width and height of the image, pixels.
    facts : CameraFacts, optional
        Needed where all rotations share one axis: zero skew (4.9) or the aspect ratio.
    refine : bool
        Adjust the affine structure before the conic is found.

    Returns
    -------
    AffineCalibration or NoEstimate
        Where the rotations leave parameters open, its values have their `status`.

    """
    facts = CameraFacts() if facts is None else facts
    if len(tracks.frames) < 3:
        return NoEstimate('two_views_only', open_directions=('everything',), status=dict.fromkeys(
            ('fx', 'fy', 'cx', 'cy', 'skew', 'aspect_ratio'), 'unobservable'))
    structure = affine_structure(tracks, translated, refine)
    if isinstance(structure, NoEstimate):
        return structure
    conic = camera_from_homographies(structure.homographies, size, facts)
    return conic if isinstance(conic, NoEstimate) else AffineCalibration(conic, structure)
