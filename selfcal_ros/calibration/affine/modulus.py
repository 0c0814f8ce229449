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
Affine structure from four general views by the modulus constraint (thesis 4.1.2).

With a fixed camera the homography of the plane at infinity is conjugate to a rotation, so that
its eigenvalues have one modulus: each pair of views gives one equation in the three unknowns of
that plane (4.7), four views six, of which three would do. A projective reconstruction comes
first; supposed focal lengths propose planes, as the equations have many roots. In the end the
homographies are weighed by what the images tell of them, with the plane left open.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.calibration.affine.affine_adjustment import adjust, AffineViews
from selfcal_ros.calibration.affine.diac import InfiniteHomographies, unit_determinant
from selfcal_ros.calibration.affine.infinite_homography_calibration import (
    camera_from_homographies, ConicCalibration)
from selfcal_ros.calibration.affine.pair_distortion import straightened
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.fundamental import fundamental
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import completed_frame, cross_matrix, unit
from selfcal_ros.geometry.resection import resect
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.geometry.triangulation import triangulate
from selfcal_ros.values.tracks import Tracks

#: Views that the constraint needs, and points that each must share with the others.
MIN_VIEWS, MIN_POINTS = 4, 10
#: Focal lengths that propose planes at infinity, in longer image sides.
_FOCAL_SWEEP = (0.65, 1.0, 1.5, 2.2, 3.2)
#: Roots that differ by less, relative to their size, are one.
_SAME_ROOT = 1e-3
#: The plane at infinity is known by its homographies alone: it may move the cameras by so much.
_PLANE_SIGMA = 0.1
#: The plane of the modulus constraint, where all pairs weigh the same, is that of the weighed
#: camera after so many rounds more.
_ROUNDS = 2
#: Largest modulus residual (root mean square) of a root, before noise is looked at.
_MAX_RESIDUAL = 0.05


@dataclass(frozen=True)
class ModulusCalibration:
    """
    A camera from the plane at infinity of general views.

    Attributes
    ----------
    conic : ConicCalibration
    frames : ndarray of int, shape (V,)
        The reference first.
    plane : ndarray, shape (3,)
        a of the homographies M - m a^T, in pixels of the reference.
    homographies : InfiniteHomographies
        From the reference to the other frames; their covariance leaves the plane open.
    residual : float
        Root mean square of the modulus constraints, tr H - tr H^-1 for det H = 1, of the plane
        that meets them best.

    """

    conic: ConicCalibration
    frames: np.ndarray
    plane: np.ndarray
    homographies: InfiniteHomographies
    residual: float

    @property
    def K(self) -> np.ndarray:
        """Calibration matrix, pixels, shape (3, 3)."""
        return self.conic.K


def modulus_residuals(cameras: np.ndarray, plane: ArrayLike) -> np.ndarray:
    """
    Violation of the modulus constraint by all pairs of views.

    For det H = 1 equal moduli of the eigenvalues, f3 f1³ = f2³ (4.7), mean tr H = tr H^-1.

    Parameters
    ----------
    cameras : ndarray, shape (V, 3, 4)
        Projective; the first is [I | 0].
    plane : ndarray, shape (..., 3)

    Returns
    -------
    ndarray, shape (..., V (V - 1) / 2)

    """
    plane = np.asarray(plane, float)
    H = cameras[:, :, :3] - cameras[:, :, 3:] * plane[..., None, None, :]
    a, b = np.triu_indices(len(cameras), 1)
    determinant = np.linalg.det(H)
    H = H / np.cbrt(np.where(determinant == 0, 1e-300, determinant))[..., None, None]
    inverse = np.linalg.inv(H)
    there = np.einsum('...ij,...ji->...', H[..., b, :, :], inverse[..., a, :, :])
    back = np.einsum('...ij,...ji->...', H[..., a, :, :], inverse[..., b, :, :])
    violation: np.ndarray = there - back
    return violation


def projective_structure(tracks: Tracks, size: tuple[int, int],
                         ) -> tuple[np.ndarray, AffineViews, float] | NoEstimate:
    """
    Projective cameras and points of a few views that share points.

    Parameters
    ----------
    tracks : Tracks
        Undistorted pixels; gross errors should be few.
    size : (int, int)
        Width and height, pixels.

    Returns
    -------
    (frames (V,), AffineViews, sigma_px) or NoEstimate
        Cameras in pixels, the first [I | 0], and points in one projective frame.

    """
    tracks = tracks.with_at_least(2)
    frames = tracks.frames
    a, b = np.triu_indices(len(frames), 1)
    shared = [tracks.matches(frames[i], frames[j]) for i, j in zip(a, b)]
    # the pair with many points and a wide baseline
    worth = [np.sqrt(len(m[0])) * np.median(np.linalg.norm(m[2] - m[1], axis=1))
             if len(m[0]) >= MIN_POINTS else 0.0 for m in shared]
    if not len(worth) or max(worth) == 0:
        return NoEstimate('too_few_shared', views=2, needed=MIN_POINTS, items='points')
    k = int(np.argmax(worth))
    _, xy_a, xy_b = shared[k]
    pair = fundamental(xy_a, xy_b)
    if isinstance(pair, NoEstimate):
        return pair
    epipole = np.linalg.svd(pair.F.T)[2][-1]
    scale = float(max(size))
    standing = [int(frames[a[k]]), int(frames[b[k]])]
    second = np.column_stack([cross_matrix(epipole) @ pair.F, epipole])
    # of the order of a homography of pixels
    cameras = [np.eye(3, 4), second / np.linalg.norm(second) * scale]
    names, track = np.unique(tracks.track, return_inverse=True)
    points = np.full((len(names), 4), np.nan)
    for frame in [None, *(int(f) for f in frames if int(f) not in standing)]:
        if frame is not None:
            known = np.isfinite(points).all(axis=1)
            seen = np.flatnonzero((tracks.frame == frame) & known[track])
            if len(seen) < MIN_POINTS:
                continue
            found = resect(points[track[seen]], tracks.xy[seen], huber_sigmas=2.5)
            if isinstance(found, NoEstimate):
                return found
            standing.append(frame)
            cameras.append(found.P)
        order = np.argsort(standing)
        mask = np.isin(tracks.frame, standing)
        mask &= np.bincount(track[mask], minlength=len(names))[track] >= 2
        rows, index = np.unique(track[mask], return_inverse=True)
        view = order[np.searchsorted(np.array(standing)[order], tracks.frame[mask])]
        points[rows] = triangulate(np.array(cameras), view, index, tracks.xy[mask])
    first = np.arange(len(standing)) == 0
    views = AffineViews(np.array(cameras), points[rows], first, view, index, tracks.xy[mask])
    adjusted = adjust(views)
    return (np.array(standing), replace(views, cameras=adjusted.cameras, points=adjusted.points),
            adjusted.sigma_px)


def _proposed_planes(cameras: np.ndarray, aspect: float) -> np.ndarray:
    """Planes at infinity that supposed cameras imply, for each view against the first, (n, 3)."""
    planes = []
    for focal in _FOCAL_SWEEP:
        K = np.diag([focal, focal * aspect, 1.0])
        inverse = np.linalg.inv(K)
        for camera in cameras[1:]:
            # K^-1 M K - (K^-1 m)(K^T a)^T is a scaled rotation: two of its rows are given
            m = inverse @ camera[:, 3]
            turn = completed_frame(unit(m)).T
            rows = turn @ inverse @ camera[:, :3] @ K
            size = np.sqrt(np.linalg.norm(rows[1]) * np.linalg.norm(rows[2]))
            for scale in (size, -size):
                q = (rows[0] - np.cross(rows[1], rows[2]) / scale) / np.linalg.norm(m)
                planes.append(inverse.T @ q)
    return np.array(planes)


def calibrate_modulus(tracks: Tracks, size: tuple[int, int], facts: CameraFacts | None = None,
                      ) -> ModulusCalibration | NoEstimate:
    """
    Calibrate from four or more general views, none of them translated (4.1.2).

    Parameters
    ----------
    tracks : Tracks
        Undistorted pixels; gross errors should be few.
    size : (int, int)
        Width and height, pixels.
    facts : CameraFacts, optional

    Returns
    -------
    ModulusCalibration or NoEstimate

    """
    found = _unweighted(tracks, size, facts)
    if isinstance(found, NoEstimate):
        return found
    views, guess = found
    plane = guess.plane
    homographies = _with_covariance(views, plane)
    conic = camera_from_homographies(homographies, size, facts)
    for _ in range(_ROUNDS):
        if isinstance(conic, NoEstimate):
            break
        plane = _plane_of(views.cameras, conic, _to_unit(size))
        homographies = _with_covariance(views, plane)
        conic = camera_from_homographies(homographies, size, facts)
    if isinstance(conic, NoEstimate):
        return conic
    return replace(guess, plane=plane, homographies=homographies, conic=replace(
        conic, linear_K=guess.conic.linear_K, closed_form=guess.conic.closed_form))


def _to_unit(size: tuple[int, int]) -> np.ndarray:
    """Similarity from pixels to coordinates of the order of one about the image's middle."""
    scale, middle = float(max(size)), (np.array(size, float) - 1) / 2
    return np.array([[1 / scale, 0, -middle[0] / scale], [0, 1 / scale, -middle[1] / scale],
                     [0, 0, 1]])


def _plane_of(cameras: np.ndarray, conic: ConicCalibration, T: np.ndarray) -> np.ndarray:
    """Plane at infinity (3,) that a camera and its rotations imply: M - m a^T ~ K R K^-1."""
    back = np.linalg.inv(T)
    scaled = T @ cameras[1:]
    M, m = scaled[:, :, :3] @ back, scaled[:, :, 3]
    weight = 1 / np.linalg.norm(M, axis=(1, 2))
    K = T @ conic.K
    H = K @ rotation_matrix(conic.rotations) @ np.linalg.inv(K)
    count = len(M)
    # unknowns are a, and the scale of each view
    A = np.zeros((count, 9, 3 + count))
    for k in range(count):
        A[k, :, :3] = np.kron(m[k][:, None], np.eye(3)) * weight[k]
        A[k, :, 3 + k] = H[k].ravel()
    right = (M * weight[:, None, None]).ravel()
    plane: np.ndarray = np.linalg.lstsq(A.reshape(-1, 3 + count), right, rcond=None)[0][:3] @ T
    return plane


def _with_covariance(views: AffineViews, plane: np.ndarray) -> InfiniteHomographies:
    """Homographies of a plane at infinity, and what they and the plane are uncertain by."""
    cameras, points = views.cameras.copy(), views.points.copy()
    # the frame in which the plane is at infinity
    cameras[:, :, :3] -= cameras[:, :, 3:] * plane
    points[:, 3] += points[:, :3] @ plane
    adjusted = adjust(replace(views, cameras=cameras, points=points), 0, _PLANE_SIGMA)
    H, slope = unit_determinant(adjusted.cameras[1:, :, :3])
    n = len(H)
    covariance = np.einsum('iab,ibjc,jdc->iajd', slope,
                           adjusted.covariance.reshape(n, 9, n, 9), slope, optimize=True)
    return InfiniteHomographies(H, covariance.reshape(1, 9 * n, 9 * n))


def _unweighted(tracks: Tracks, size: tuple[int, int], facts: CameraFacts | None,
                ) -> tuple[AffineViews, ModulusCalibration] | NoEstimate:
    """Find the plane that meets the constraint best, and a camera that weighs all alike."""
    facts = CameraFacts() if facts is None else facts
    if len(tracks.frames) < MIN_VIEWS:
        return NoEstimate('too_few', what='camera from the modulus constraint', needed=MIN_VIEWS,
                          items='views', found=len(tracks.frames))
    structure = projective_structure(tracks, size)
    if isinstance(structure, NoEstimate):
        return structure
    frames, views, _ = structure
    cameras = views.cameras
    if len(frames) < MIN_VIEWS:
        return NoEstimate('too_few', what='camera from the modulus constraint', needed=MIN_VIEWS,
                          items=f'views that share {MIN_POINTS} points', found=len(frames))
    T = _to_unit(size)
    frame = np.eye(4)
    frame[:3, :3] = np.linalg.inv(T)
    scaled = T @ cameras @ frame
    determinants = np.cbrt(np.linalg.det(scaled[:, :, :3]))
    scaled[1:] /= np.where(np.abs(determinants[1:]) > 1e-6, determinants[1:], 1.0)[:, None, None]
    # loaded by the few that need it
    from scipy.optimize import least_squares
    best, last = None, None
    roots: list[np.ndarray] = []
    for start in _proposed_planes(scaled, facts.aspect_ratio or 1.0):
        root = least_squares(lambda a: modulus_residuals(scaled, a), start, method='lm',
                             max_nfev=80, x_scale='jac')
        plane, residual = root.x, float(np.sqrt(np.mean(root.fun**2)))
        if not residual < _MAX_RESIDUAL or any(
                np.linalg.norm(plane - r) < _SAME_ROOT * (1 + np.linalg.norm(r)) for r in roots):
            continue
        roots.append(plane)
        pixels = T.T @ plane
        H = unit_determinant(cameras[1:, :, :3] - cameras[1:, :, 3:] * pixels)[0]
        homographies = InfiniteHomographies(H, np.zeros((len(H), 9, 9)))
        conic = camera_from_homographies(homographies, size, facts)
        if isinstance(conic, NoEstimate):
            last = conic
        elif best is None or conic.misfit < best.conic.misfit:
            best = ModulusCalibration(conic, frames, pixels, homographies, residual)
    if best is None:
        return last or NoEstimate('no_plane_at_infinity')
    return views, best


def propose_camera(tracks: Tracks, size: tuple[int, int],
                   facts: CameraFacts | None = None) -> list[Camera]:
    """
    Propose a camera for the adjustment of few general views.

    Parameters
    ----------
    tracks : Tracks
        Pixels as they are; a radial distortion that their epipolar geometry shows is undone.
    size : (int, int)
        Width and height, pixels.
    facts : CameraFacts, optional

    Returns
    -------
    list of Camera
        Without distortion; empty where the constraint finds none.

    """
    found = _unweighted(straightened(tracks, size), size, facts)
    if isinstance(found, NoEstimate):
        return []
    K = np.triu(found[1].K)
    return [Camera(K / K[2, 2], width=size[0], height=size[1])]
