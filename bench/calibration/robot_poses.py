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
What a robot's own poses say of its camera: a truth that does not rest on a flat board.

Nothing of the package takes part. OpenCV finds the points of the board. SciPy adjusts the camera,
where it sits, what each pose is off by, and every point of the board by itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from bench.inputs import image_files, truth_of
import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

#: What poses may be off by: milliradians and millimetres.
POSE_SIGMA = 1.0
POINT_SIGMA_PX = 0.1
#: A view that leaves more has mistaken points for each other.
WRONG_PX = 1.0
#: Unknowns that all points share: fx, fy, cx, cy; k1, k2, p1, p2, k3; turn and place of camera.
SHARED = (4, 5, 3, 3)
#: Turns smaller than this tell nothing of how the camera is turned on the flange.
LEAST_TURN_RAD = 0.05
DOTS, DOT_SPACING_M = (10, 10), 0.0254
#: Every third column and second row of a chessboard with 28 columns.
COLUMNS, THINNED = 28, (3, 2)


@dataclass(frozen=True)
class CameraByPoses:
    """fx, fy, cx, cy with sigmas; rms of what is left, pixels; how far the board is from flat."""

    intrinsics: np.ndarray
    sigma: np.ndarray
    left_px: float
    flat_mm: float


@dataclass(frozen=True)
class _Views:
    """Poses of the flange in the base, and the points of the board that they see (V, N, 2)."""

    R: Rotation
    t: np.ndarray
    xy: np.ndarray

    def without(self, view: int) -> _Views:
        kept = np.arange(len(self.t)) != view
        return _Views(self.R[kept], self.t[kept], self.xy[kept])


@cache
def camera_by_poses(folder: Path) -> CameraByPoses:
    """Return the camera of a recorded arm by its poses and by the points of its board."""
    truth = truth_of(folder)
    T = np.array([_pose(pose) for pose in truth['base_T_flange']])
    corners = folder / 'corners.npz'
    if corners.is_file():
        board, xy, seen = _chessboard(corners)
    else:
        board, xy, seen = _dots(image_files(folder))
    views = _Views(Rotation.from_matrix(T[seen, :3, :3]), T[seen, :3, 3], xy)
    while True:
        found, left_px = _adjusted(views, board, truth['K'], truth['dist'])
        if left_px.max() < WRONG_PX:
            return found
        views = views.without(int(left_px.argmax()))


def _pose(stated) -> np.ndarray:
    """Return a pose (4, 4) from a matrix or from a place and a quaternion."""
    if not isinstance(stated, dict):
        return np.array(stated)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([stated[name] for name in ('qx', 'qy', 'qz', 'qw')]).as_matrix()
    T[:3, 3] = [stated[name] for name in 'xyz']
    return T


def _chessboard(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return some corners as they are printed (N, 3), as they are seen (V, N, 2), and by whom."""
    with np.load(path) as stored:
        board, xy = stored['object'].astype(float), stored['image'].astype(float)
    row, column = np.divmod(np.arange(len(board)), COLUMNS)
    some = (column % THINNED[0] == 0) & (row % THINNED[1] == 0)
    return board[some], xy.reshape(len(xy), -1, 2)[:, some], np.arange(len(xy))


def _dots(files: list[Path]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the dots of a grid, like `_chessboard`."""
    wanted = cv2.SimpleBlobDetector_Params()
    wanted.minThreshold, wanted.maxThreshold, wanted.minArea, wanted.maxArea = 20, 220, 25, 5000
    wanted.filterByInertia = wanted.filterByCircularity = False
    wanted.filterByConvexity, wanted.minConvexity = True, 0.9
    found = [cv2.findCirclesGrid(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), DOTS,
                                 flags=cv2.CALIB_CB_SYMMETRIC_GRID,
                                 blobDetector=cv2.SimpleBlobDetector_create(wanted))
             for path in files]
    seen = np.array([k for k, (whole, _) in enumerate(found) if whole])
    xy = np.array([found[k][1].reshape(-1, 2) for k in seen], float)
    column, row = np.meshgrid(np.arange(DOTS[0]), np.arange(DOTS[1]))
    return DOT_SPACING_M * np.stack([column, row, 0 * row], -1).reshape(-1, 3), xy, seen


def _adjusted(views: _Views, board: np.ndarray, K: np.ndarray, dist: np.ndarray,
              ) -> tuple[CameraByPoses, np.ndarray]:
    """Adjust everything; also returns what each view leaves, pixels rms."""
    count, n = views.xy.shape[:2]
    parts = np.cumsum([*SHARED, 3 * n])

    def residuals(values: np.ndarray) -> np.ndarray:
        inner, lens, turn, place, points, slips = np.split(values, parts)
        slips = slips.reshape(count, 6)
        flange = views.R * Rotation.from_rotvec(1e-3 * slips[:, :3])
        centre = views.t + 1e-3 * slips[:, 3:] + flange.apply(place)
        camera = (flange * Rotation.from_rotvec(turn)).as_matrix()
        pixels = _projected(inner, lens, (points.reshape(1, n, 3) - centre[:, None]) @ camera)
        return np.concatenate([((pixels - views.xy) / POINT_SIGMA_PX).ravel(),
                               slips.ravel() / POSE_SIGMA])

    start = np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], dist,
                            *_mounted(views, board, K, dist), np.zeros(6 * count)])
    found = least_squares(residuals, start, x_scale='jac', loss='soft_l1', f_scale=3.0)
    left = POINT_SIGMA_PX * residuals(found.x)[:2 * n * count].reshape(count, n, 2)
    points = np.split(found.x, parts)[4].reshape(n, 3)
    flat = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] / np.sqrt(n)
    sigma = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)))[:4]
    return (CameraByPoses(found.x[:4], sigma, float(np.sqrt(np.mean(left**2))), float(1e3 * flat)),
            np.sqrt((left**2).sum(axis=2).mean(axis=1)))


def _projected(inner: np.ndarray, lens: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Project points (..., 3) by fx, fy, cx, cy and OpenCV's k1, k2, p1, p2, k3."""
    k1, k2, p1, p2, k3 = lens
    x, y = local[..., 0] / local[..., 2], local[..., 1] / local[..., 2]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack([inner[0] * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + inner[2],
                     inner[1] * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + inner[3]],
                    axis=-1)


def _mounted(views: _Views, board: np.ndarray, K: np.ndarray, dist: np.ndarray,
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start of the camera's turn and place on the flange, and of the points: a flat board."""
    solved = [cv2.solvePnP(board, np.ascontiguousarray(one), K, dist)[1:] for one in views.xy]
    turns = Rotation.from_rotvec([turn.ravel() for turn, _ in solved])
    places = np.array([place.ravel() for _, place in solved])
    first, second = np.triu_indices(len(views.t), 1)
    by_robot = (views.R[second].inv() * views.R[first]).as_rotvec()
    by_board = (turns[second] * turns[first].inv()).as_rotvec()
    large = np.linalg.norm(by_robot, axis=1) > LEAST_TURN_RAD
    turn = Rotation.align_vectors(by_robot[large], by_board[large])[0]
    # the board does not move: R (turn places + place) + t is the same for all
    known = (views.R * turn).apply(places) + views.t
    columns = np.concatenate([views.R.as_matrix(), np.tile(-np.eye(3), (len(known), 1, 1))], 2)
    place = np.linalg.lstsq(columns.reshape(-1, 6), -known.ravel(), rcond=None)[0][:3]
    points = views.R[0].apply(turn.apply(turns[0].apply(board) + places[0]) + place) + views.t[0]
    return turn.as_rotvec(), place, points.ravel()
