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
Starts for a scene that is one plane: a floor that a vehicle looks down upon, a wall.

There the fundamental matrix is open. But under a supposed calibration every homography between
two views decomposes into rotation, translation over distance, and the plane's normal. It does so
in two ways (Ma et al. 2004, theorem 5.19); the normal that all views agree on tells which.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.centres import points_from_centres
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.scene_model import rescaled
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.initialisation.rotation_homographies import rotation_homographies
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.division import DivisionModel
from selfcal_ros.geometry.rotation import align_z, rotation_vector, swing_twist
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.values.tracks import Tracks


@dataclass(frozen=True)
class FlatScene:
    """
    Homographies of all views of a plane.

    Attributes
    ----------
    homographies : ndarray, shape (V, 3, 3)
        From one of the views, whose own is the identity, in pixels without the lens's bend.

    """

    homographies: np.ndarray

    @classmethod
    def of(cls, tracks: Tracks, frames: np.ndarray,
           lens: DivisionModel | None = None) -> FlatScene | None:
        """Chain homographies between the frames; None where they do not connect all of them."""
        if lens is not None:
            xy = lens.straightened(tracks.xy)
            ahead = np.isfinite(xy).all(axis=1)
            tracks = replace(tracks, xy=np.where(ahead[:, None], xy, 0.0)).select(ahead)
        order, chained, _ = rotation_homographies(tracks)
        if set(order.tolist()) != {int(frame) for frame in frames}:
            return None
        H = np.concatenate([np.eye(3)[None], chained.H])
        return cls(H[np.argsort(order)])

    def of_views(self, first: int, last: int) -> FlatScene:
        """Return the homographies of a stretch of the views."""
        return FlatScene(self.homographies[first:last])

    def start(self, blocks: PointBlocks, xy: np.ndarray, camera: Camera,
              exact: bool) -> SceneState | None:
        """
        Start under a supposed calibration.

        Parameters
        ----------
        blocks : PointBlocks
        xy : ndarray, shape (N, 2)
            Pixels of the observations in `blocks`.
        camera : Camera
        exact : bool
            Whether the motion is exactly planar.

        Returns
        -------
        SceneState or None
            None where the calibration cannot be.

        """
        K = camera.K
        rays = camera.rays(xy)
        if not np.isfinite(rays).all():
            return None
        R, t = separate(np.linalg.inv(K) @ self.homographies @ K)
        # from the first view's camera instead of the reference's
        centres = np.einsum('ij,vj->vi', R[0], _centres(R, t) - _centres(R, t)[0])
        R = R @ R[0].T
        turns = rotation_vector(R)
        mount = align_z(np.linalg.eigh(turns.T @ turns)[1][:, -1])
        twist, swing = swing_twist(mount.T @ R @ mount)
        centres = centres @ mount
        if exact:
            swing, centres = 0 * swing, centres * [1, 1, 0]
        path = AxisPath.at_origin(mount, np.unwrap(twist), swing).placed_at(centres)
        directions = np.einsum('nji,nj->ni', (mount @ path.rotations())[blocks.view], rays)
        return rescaled(SceneState(Lens.of(camera), path,
                                   points_from_centres(blocks, directions, centres)))


def separate(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Split homographies of one plane, between calibrated views, into rotation and translation.

    Parameters
    ----------
    matrices : ndarray, shape (V, 3, 3)
        From one view to all, R + t nᵀ up to scale, n the plane's normal over its distance.

    Returns
    -------
    R : ndarray, shape (V, 3, 3)
    t : ndarray, shape (V, 3)
        In units of the plane's distance from the common view.

    """
    U, s, Vt = np.linalg.svd(matrices)
    M = matrices / s[:, 1, None, None] * np.sign(np.linalg.det(matrices))[:, None, None]
    s = s / s[:, 1:2]
    v1, v2, v3 = Vt[:, 0], Vt[:, 1], Vt[:, 2]
    apart = np.sqrt(np.maximum(s[:, 0]**2 - s[:, 2]**2, 1e-300))[:, None]
    first = np.sqrt(np.maximum(1 - s[:, 2]**2, 0))[:, None] * v1 / apart
    third = np.sqrt(np.maximum(s[:, 0]**2 - 1, 0))[:, None] * v3 / apart
    u = np.stack([first + third, first - third])                      # (2, V, 3)
    normal = np.cross(v2, u)
    moved = np.einsum('vij,svj->svi', M, u)
    middle = np.broadcast_to(np.einsum('vij,vj->vi', M, v2), u.shape)
    after = np.stack([middle, moved, np.cross(middle, moved)], axis=-1)
    before = np.stack([np.broadcast_to(v2, u.shape), u, normal], axis=-1)
    R = after @ np.swapaxes(before, -1, -2)
    # the plane lies before the common view; views that hardly moved know little of it
    weight = apart[:, 0] * (apart[:, 0] > 1e-6)
    flat = normal.reshape(-1, 3)
    agreement = np.abs(np.einsum('ki,svi->ksv', flat, normal)).max(axis=1) @ weight
    common = flat[np.argmax(agreement)]
    common = common * (np.sign(common[2]) or 1.0)
    chosen = np.argmax(np.abs(normal @ common), axis=0)
    R = np.take_along_axis(R, chosen[None, :, None, None], axis=0)[0]
    still = weight == 0
    R[still] = M[still]
    t = np.einsum('vij,j->vi', M - R, common)
    return R, t


def _centres(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    centres: np.ndarray = -np.einsum('vji,vj->vi', R, t)
    return centres
