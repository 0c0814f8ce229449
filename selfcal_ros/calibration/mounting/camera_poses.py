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
"""What the images say of the camera's poses and of the lens, as one Gaussian."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens, to_parameters
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.reconstruction import PosePrecision
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.camera_path import (
    camera_path, OF_AN_OBJECT, TURNING, with_shared_errors)
from selfcal_ros.calibration.structure.metric_structure import world_and_scale
from selfcal_ros.calibration.structure.path_precision import pose_precision
from selfcal_ros.geometry.distributions import chi2_sf
from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.geometry.scaled_inverse import unit_diagonal

#: Relative to the variances: keeps the factor of a covariance with dependent unknowns.
_ROUNDING = 1e-12
#: What poses tell of the lens counts from this share of what images leave open.
_TOLD = 1e-3
#: A path lies in a plane where its height over its extent is less than this.
_FLAT = 0.02


@dataclass(frozen=True)
class CameraPoses:
    """
    Poses of the camera in a world of its own, and how they move together.

    Deviations are linear in w, independent unknowns of unit variance: those of pose i are
    `roots[i] @ w`, and those of the lens's unknowns `lens_root @ w`.

    Attributes
    ----------
    frames : ndarray of int, shape (V,)
    rotation : ndarray, shape (V, 3, 3)
        World from camera.
    centre : ndarray, shape (V, 3)
        In `unit`.
    roots : ndarray, shape (V, 6, k)
        Of the centre, then of a small turn about the axes of the world.
    lens_root : ndarray, shape (n, k)
        Of the unknowns of the lens block.
    is_metric, has_path : bool
        Lengths are metres; there are lengths at all.

    """

    frames: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    roots: np.ndarray
    lens_root: np.ndarray
    is_metric: bool
    has_path: bool

    def __len__(self) -> int:
        """Count the poses."""
        return len(self.frames)

    def chosen(self, rows: np.ndarray) -> CameraPoses:
        """Keep some of the poses."""
        return replace(self, frames=self.frames[rows], rotation=self.rotation[rows],
                       centre=self.centre[rows], roots=self.roots[rows])

    def stiff(self) -> CameraPoses:
        """Take the poses as exact."""
        return replace(self, roots=self.roots[:, :, :0], lens_root=self.lens_root[:, :0])

    def gained_of_lens(self, covariance: np.ndarray) -> np.ndarray:
        """Return what w of covariance (k, k), not unity, takes off that of the lens, (n, n)."""
        L = self.lens_root
        gained: np.ndarray = L @ (np.eye(len(covariance)) - covariance) @ L.T
        return gained

    def moved(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rotation (V, 3, 3) and centre (V, 3) after deviations w (k,)."""
        steps = self.roots @ w
        return rotation_matrix(steps[:, 3:]) @ self.rotation, self.centre + steps[:, :3]


def camera_poses(calibration: Calibration) -> CameraPoses:
    """
    Take the poses of a calibration.

    Parameters
    ----------
    calibration : Calibration
        With its reconstruction.

    Returns
    -------
    CameraPoses

    Raises
    ------
    ArgumentError
        If the calibration comes without its reconstruction.

    """
    path = camera_path(calibration)
    precision = calibration.reconstructed.pose_precision
    lens = Lens.of(calibration.camera)
    if precision is None:
        # poses without a covariance count as exact; what they err is told by the misfit
        roots, lens_root = np.zeros((len(path), 6, 0)), np.zeros((len(lens), 0))
    else:
        roots, lens_root = _roots(precision, calibration.covariance, len(lens))
        if calibration.motion != OF_AN_OBJECT:
            roots = _in_a_middle_world(roots, path.centre)
    return CameraPoses(path.frames, path.rotation, path.centre, roots, lens_root,
                       calibration.motion == OF_AN_OBJECT, calibration.motion != TURNING)


def poses_of_fit(frames: np.ndarray, fit: RobustFit, spread: float) -> CameraPoses:
    """
    Take the poses of an adjustment that held its lens.

    Parameters
    ----------
    frames : ndarray of int, shape (V,)
    fit : RobustFit
    spread : float
        Variance of the poses over that with independent errors.

    Returns
    -------
    CameraPoses

    """
    poses = fit.state.path.cam_from_world()
    rotation = np.swapaxes(poses[:, :, :3], 1, 2)
    centre = -np.einsum('vij,vj->vi', rotation, poses[:, :, 3])
    world, scale = world_and_scale(poses, False)
    centre = scale * (centre - centre[0]) @ world[:, :3].T
    precision = pose_precision(fit, False)
    root = np.sqrt(spread) * _root(np.asarray(precision.covariance))
    return CameraPoses(np.asarray(frames), world[:, :3] @ rotation, centre,
                       _in_a_middle_world(_by_root(precision, root), centre),
                       np.zeros((0, root.shape[1])), False, True)


def _roots(precision: PosePrecision, stated: np.ndarray,
           count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return roots of the poses (V, 6, k) and of the lens (n, k)."""
    root = _root(with_shared_errors(precision, stated))
    known, places = len(precision.lens), Lens.of(precision.camera).places(precision.lens)
    roots = _by_root(precision, root)
    views = len(roots)
    lens_root = np.zeros((count, root.shape[1]))
    lens_root[places] = root[:known]
    if precision.own is not None:
        own = np.zeros((views, 6, views, 6))
        own[np.arange(views), :, np.arange(views)] = [_root(one) for one in precision.own]
        roots = np.concatenate([roots, own.reshape(views, 6, 6 * views)], axis=2)
        lens_root = np.concatenate([lens_root, np.zeros((count, 6 * views))], axis=1)
    return roots, lens_root


def _by_root(precision: PosePrecision, root: np.ndarray) -> np.ndarray:
    """Return roots (V, 6, m) of the poses by those of the unknowns (k, m)."""
    roots: np.ndarray = (precision.by_unknowns @ root).reshape(-1, 6, root.shape[1])
    return roots


def _in_a_middle_world(roots: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """
    Return roots in a world that turns and moves with the mean of the poses.

    The world is free anyway. One that goes with the first view lets a small error there move
    what is far away by much, and bend the linear law. A path in a plane takes its plane along: a
    plane that tilted would lift views whose places along it are hardly known.
    """
    turned = roots[:, 3:].mean(axis=0)
    middle = centre - centre.mean(axis=0)
    if np.ptp(middle[:, 2]) < _FLAT * np.ptp(middle[:, :2], axis=0).max():
        # what it takes for the heights (g x c)_z to stay
        lifted = roots[:, 2] - roots[:, 2].mean(axis=0) + (cross_matrix(middle) @ turned)[:, 2]
        turned[:2] += np.linalg.lstsq(middle[:, 1::-1] * [1.0, -1.0], lifted, rcond=None)[0]
    moved = roots[:, :3] + cross_matrix(centre) @ turned
    return np.concatenate([moved - moved.mean(axis=0), roots[:, 3:] - turned], axis=1)


def _root(covariance: np.ndarray) -> np.ndarray:
    """Return L (k, k) with L Lᵀ the covariance, its negative part left out."""
    scaled, scale = unit_diagonal(covariance)
    scaled = (scaled + scaled.T) / 2
    try:
        root = np.linalg.cholesky(scaled + _ROUNDING * np.eye(len(scaled)))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(scaled)
        root = vectors * np.sqrt(values.clip(0))
    return scale[:, None] * root


def chance_of_pull(poses: CameraPoses, w: np.ndarray, covariance: np.ndarray) -> float:
    """
    Return the chance that deviations pull the lens by more than they do, if the body is right.

    Parameters
    ----------
    poses : CameraPoses
    w : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
        Of w; the images alone have that of unity.

    Returns
    -------
    float
        Little where poses of the body and images disagree about the lens.

    """
    L, gained = poses.lens_root, poses.gained_of_lens(covariance)
    size = np.sqrt(np.maximum(np.diag(gained), 0))
    free = size > _TOLD * np.sqrt(np.sum(L**2, axis=1))
    if not free.any():
        return 1.0
    pull = (L @ w)[free] / size[free]
    values, vectors = np.linalg.eigh(unit_diagonal(gained[np.ix_(free, free)])[0])
    known = values > _TOLD
    return float(chi2_sf(np.sum((pull @ vectors[:, known])**2 / values[known]), known.sum()))


def with_lens(calibration: Calibration, poses: CameraPoses, w: np.ndarray,
              covariance: np.ndarray) -> Calibration:
    """
    Return the calibration with the lens that deviations of the poses pull along.

    Parameters
    ----------
    calibration : Calibration
    poses : CameraPoses
    w : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
        Of w.

    Returns
    -------
    Calibration
        Its camera and covariance are those of images and body together.

    """
    camera = calibration.camera
    lens = Lens.of(camera).moved(poses.lens_root @ w)
    if not len(w) or not lens.is_possible:
        return calibration
    gained = to_parameters(poses.gained_of_lens(covariance), Lens.of(camera))
    narrowed = calibration.covariance - gained
    return replace(calibration, camera=lens.camera(camera.width, camera.height),
                   covariance=(narrowed + narrowed.T) / 2)
