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
The path block of a moving camera: poses about one axis, in a plane, near it, or anywhere.

The world frame lies in the plane of motion, its z axis along the rotation axis. View i is

    X_camera = A (S(tilt_i) R_z(angle_i) Y + w (x_i, y_i, h_i)),    Y, w a homogeneous world point,

with one mount rotation A for all views. In planar motion the tilts and heights are zero. Then v ~
K A e3 and the circular points ~ K A (1, ±i, 0) are in the parameters themselves; nearly planar
motion gives tilt and height a prior, general motion leaves them free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from selfcal_ros.calibration.bundle.motion import MotionModel
from selfcal_ros.calibration.bundle.unknowns import PriorTerms, Unknowns
from selfcal_ros.geometry.rotation import (left_jacobian, pad, rotation_matrix, swing_twist,
                                           twist_matrix)

#: Unknowns that all views share: the direction of the axis in the camera, as small turns (rad).
SHARED_NAMES = ('axis_x', 'axis_y')
#: Unknowns of each view: angle about the axis (rad), place in the plane, tilt (rad), height.
VIEW_NAMES = ('angle', 'x', 'y', 'tilt_x', 'tilt_y', 'height')
_TURNS, _MOVES = ('angle', 'tilt_x', 'tilt_y'), ('x', 'y', 'height')


@dataclass(frozen=True)
class AxisPath:
    """
    Poses of all views.

    Attributes
    ----------
    mount : ndarray, shape (3, 3)
        A, camera from world rotation of a view with angle and tilt zero.
    angle : ndarray, shape (V,)
        About the axis, radians.
    tilt : ndarray, shape (V, 2)
        Out of the plane, radians.
    translation : ndarray, shape (V, 3)
        World origin in the turned frame of each view: in the plane (2), and height.

    """

    mount: np.ndarray
    angle: np.ndarray
    tilt: np.ndarray
    translation: np.ndarray

    @classmethod
    def at_origin(cls, mount: np.ndarray, angle: np.ndarray,
                  tilt: np.ndarray | None = None) -> AxisPath:
        """Return views that turn about the origin, by angles (V,) and tilts (V, 2)."""
        views = len(angle)
        return cls(mount, np.asarray(angle, float),
                   np.zeros((views, 2)) if tilt is None else np.asarray(tilt, float),
                   np.zeros((views, 3)))

    @classmethod
    def of_turns(cls, R: np.ndarray) -> AxisPath:
        """Take turns about the origin apart, world to view (V, 3, 3), for no mount."""
        return cls.at_origin(np.eye(3), *swing_twist(R))

    @classmethod
    def of_poses(cls, mount: np.ndarray, poses: np.ndarray) -> AxisPath:
        """Take poses [R | t] of every view, shape (V, 3, 4), apart for a mount (3, 3)."""
        turned = mount.T @ poses
        angle, tilt = swing_twist(turned[:, :, :3])
        return cls(mount, angle, tilt, turned[:, :, 3])

    def __len__(self) -> int:
        """Count the views."""
        return len(self.angle)

    # ------------------------------------------------------------------ what it says

    def rotations(self) -> np.ndarray:
        """Return world-to-view rotations before the mount, shape (V, 3, 3)."""
        return self._rotations

    @cached_property
    def _swings(self) -> np.ndarray:
        """Rotations by the tilts, shape (V, 3, 3)."""
        return rotation_matrix(pad(self.tilt))

    @cached_property
    def _rotations(self) -> np.ndarray:
        twists = twist_matrix(self.angle)
        turned: np.ndarray = self._swings @ twists if self.tilt.any() else twists
        return turned

    def cam_from_world(self) -> np.ndarray:
        """Return [R | t] of every view, shape (V, 3, 4)."""
        in_plane = np.concatenate([self.rotations(), self.translation[..., None]], axis=2)
        poses: np.ndarray = self.mount @ in_plane
        return poses

    def centres(self) -> np.ndarray:
        """Camera centres in the world, shape (V, 3)."""
        centres: np.ndarray = np.einsum('vji,vj->vi', self.rotations(), -self.translation)
        return centres

    def step_length(self) -> float:
        """Root mean square distance between successive camera centres; 1 where there is none."""
        if len(self.angle) < 2:
            return 1.0
        return float(np.sqrt(np.mean(np.sum(np.diff(self.centres(), axis=0)**2, axis=1)))) or 1.0

    # ------------------------------------------------------------------ others like it

    def placed_at(self, centres: np.ndarray) -> AxisPath:
        """Return the path with other camera centres (V, 3), world coordinates."""
        return replace(self, translation=-np.einsum('vij,vj->vi', self.rotations(), centres))

    def flat(self) -> AxisPath:
        """Return the path with tilts and heights zero."""
        return replace(self, tilt=np.zeros_like(self.tilt),
                       translation=self.translation * [1.0, 1.0, 0.0])

    def scaled(self, factor: float) -> AxisPath:
        """Return the path in a world that is larger by a factor."""
        return replace(self, translation=self.translation * factor)

    def of_views(self, kept: np.ndarray) -> AxisPath:
        """Return the path of some of the views."""
        return replace(self, angle=self.angle[kept], tilt=self.tilt[kept],
                       translation=self.translation[kept])

    def aligned(self, motion: MotionModel) -> AxisPath:
        """Give the views that are stated to be parallel the orientation of the first of them."""
        if not motion.parallel:
            return self
        views, first = list(motion.parallel), motion.parallel[0]
        angle, tilt = self.angle.copy(), self.tilt.copy()
        angle[views], tilt[views] = angle[first], tilt[first]
        return replace(self, angle=angle, tilt=tilt)

    def about(self, place: np.ndarray) -> AxisPath:
        """Return views with the world's origin at one place (3,), before the mount."""
        return replace(self, translation=np.broadcast_to(place, self.translation.shape).copy())

    def moved(self, shared: np.ndarray, steps: np.ndarray,
              names: tuple[str, ...] = VIEW_NAMES) -> AxisPath:
        """
        Return the path after steps of `SHARED_NAMES` (2,) and of the views.

        The latter are (V, k), by names; those that `VIEW_NAMES` lacks are none of the path's.
        """
        mount, given = self.mount, steps
        if names[:len(VIEW_NAMES)] != VIEW_NAMES:
            steps = np.zeros((len(self), len(VIEW_NAMES)))
            for k, name in enumerate(VIEW_NAMES):
                if name in names:
                    steps[:, k] = given[:, names.index(name)]
        if shared.any():
            mount = mount @ rotation_matrix(np.array([shared[0], shared[1], 0.0]))
        return AxisPath(mount, self.angle + steps[:, 0], self.tilt + steps[:, 3:5],
                        self.translation + steps[:, [1, 2, 5]])

    def steps_to(self, other: AxisPath) -> np.ndarray:
        """Return the steps of `VIEW_NAMES`, shape (V, 6), that lead to another path's views."""
        moved = other.translation - self.translation
        return np.column_stack([other.angle - self.angle, moved[:, :2],
                                other.tilt - self.tilt, moved[:, 2]])

    # ------------------------------------------------------------------ derivatives

    def by_axis(self, J: np.ndarray, placed: np.ndarray, out: np.ndarray) -> None:
        """
        Differentiate by `SHARED_NAMES`.

        Parameters
        ----------
        J : ndarray, shape (N, m, 3)
            Derivatives by the points before the mount.
        placed : ndarray, shape (N, 3)
            These points.
        out : ndarray, shape (N, m, 2 or more)
            Where the derivatives go.

        """
        x, y, z = (placed[:, k, None] for k in range(3))
        np.subtract(y * J[:, :, 2], z * J[:, :, 1], out=out[:, :, 0])
        np.subtract(z * J[:, :, 0], x * J[:, :, 2], out=out[:, :, 1])

    def by_views(self, J: np.ndarray, turned: np.ndarray, weight: np.ndarray,
                 view: np.ndarray, names: tuple[str, ...] = VIEW_NAMES) -> np.ndarray:
        """
        Differentiate by what moves the views.

        Parameters
        ----------
        J : ndarray, shape (N, m, 3)
            Derivatives by the points before the mount.
        turned : ndarray, shape (N, 3)
            The points, turned into the views' frames but not yet moved.
        weight : ndarray, shape (N, 1)
            Last coordinate of the homogeneous points.
        view : ndarray of int, shape (N,)
        names : tuple of str
            Some of `VIEW_NAMES`, in their order; others are none of the path's.

        Returns
        -------
        ndarray, shape (N, m, k)
            By those that are of the path.

        """
        names = tuple(name for name in VIEW_NAMES if name in names)
        own = np.empty((len(names), *J.shape[1::-1])).transpose(2, 1, 0)     # as J in memory
        for k, name in enumerate(_MOVES):
            if name in names:
                np.multiply(J[:, :, k], weight, out=own[:, :, names.index(name)])
        if 'tilt_x' not in names and not self.tilt.any():
            x, y = (turned[:, k, None] for k in range(2))
            np.subtract(x * J[:, :, 1], y * J[:, :, 0], out=own[:, :, 0])
            return own
        across = crossed(turned, J)
        turns = self._swings[:, :, 2:]
        if 'tilt_x' in names:
            turns = np.concatenate([turns, left_jacobian(pad(self.tilt))[:, :, :2]], axis=2)
        turns = rows_of(turns, view)
        first = names.index('tilt_x') if 'tilt_x' in names else 0
        for k, place in enumerate((0, first, first + 1)[:turns.shape[2]]):
            np.add(across[:, :, 0] * turns[:, 0, k, None] + across[:, :, 1] * turns[:, 1, k, None],
                   across[:, :, 2] * turns[:, 2, k, None], out=own[:, :, place])
        return own


def rows_of(values: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Take rows (N, ...) of an array (n, ...), each number of them in a row in memory."""
    numbers = np.ascontiguousarray(values.reshape(len(values), -1).T)
    taken = np.take(numbers, which, axis=1).reshape(*values.shape[1:], len(which))
    rows: np.ndarray = np.moveaxis(taken, -1, 0)
    return rows


def crossed(vector: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Cross vectors (N, 3) with the rows of J (N, m, 3): J (a × vector) is this times a."""
    x, y, z = (vector[:, k, None] for k in range(3))
    crossed = np.empty_like(J)      # in the order in memory of J
    crossed[..., 0] = y * J[..., 2] - z * J[..., 1]
    crossed[..., 1] = z * J[..., 0] - x * J[..., 2]
    crossed[..., 2] = x * J[..., 1] - y * J[..., 0]
    return crossed


# ---------------------------------------------------------------------- the motion as constraint

def path_unknowns(motion: MotionModel, views: int, lens_names: tuple[str, ...]) -> Unknowns:
    """
    Lay out the unknowns of a kind of motion: what is gauge, fixed, or shared by views.

    Parameters
    ----------
    motion : MotionModel
    views : int
    lens_names : tuple of str

    Returns
    -------
    Unknowns
        Those of the lens are all free. What no view of such a motion has is none of them.

    """
    names = _moving(motion)
    unknowns = Unknowns.all_free(lens_names, SHARED_NAMES, names, views)
    free, axis = unknowns.free, unknowns.places(SHARED_NAMES)
    moves, turns = (unknowns.of_views(*(name for name in some if name in names))
                    for some in (_MOVES, _TURNS))
    # the world frame is that of the first view
    free[unknowns.of_views('angle')[0]] = free[moves[0]] = False
    if not motion.keeps_plane:
        # no plane: the world's directions are gauge, too
        free[turns[0]] = False
        free[axis] = False
    if motion.fixed_pivot:
        # the world's origin is the point that stays
        free[moves[0]] = True
        unknowns.moves_with[moves] = moves[0]
    if motion.parallel:
        unknowns.moves_with[turns[list(motion.parallel)]] = turns[motion.parallel[0]]
    return unknowns


def _moving(motion: MotionModel) -> tuple[str, ...]:
    """Name the unknowns of a view that a kind of motion has: what is always zero is none."""
    fixed = {'tilt_x': not motion.tilt_sigma_rad, 'tilt_y': not motion.tilt_sigma_rad,
             'height': not motion.height_sigma, **dict.fromkeys(
                 _MOVES if motion.fixed_centre else (), True)}
    return tuple(name for name in VIEW_NAMES if not fixed.get(name))


def path_prior(path: AxisPath, motion: MotionModel, unknowns: Unknowns) -> PriorTerms:
    """
    Cost of the path's distance from its plane, which is measured like anything else.

    Returns
    -------
    cost : float
    gradient, diagonal : ndarray, shape (n,)
        Of all unknowns, in 1 / sigma².

    """
    gradient, diagonal = np.zeros(len(unknowns)), np.zeros(len(unknowns))
    cost = 0.0
    scale = path.step_length() if 0 < motion.height_sigma < np.inf else 1.0
    for name, values, sigma in (('tilt_x', path.tilt[:, 0], motion.tilt_sigma_rad),
                                ('tilt_y', path.tilt[:, 1], motion.tilt_sigma_rad),
                                ('height', path.translation[:, 2], motion.height_sigma * scale)):
        if 0 < sigma < np.inf:
            place = unknowns.of_views(name)[:, 0]
            cost += 0.5 * float(np.sum((values / sigma)**2))
            gradient[place] += values / sigma**2
            diagonal[place] += 1 / sigma**2
    return cost, gradient, diagonal


def path_prior_count(motion: MotionModel, views: int) -> int:
    """Count the measurements that `path_prior` stands for."""
    return (2 * views * (0 < motion.tilt_sigma_rad < np.inf)
            # the first view is where the plane is
            + (views - 1) * (0 < motion.height_sigma < np.inf))


def scale_gauge(path: AxisPath, unknowns: Unknowns) -> np.ndarray:
    """Return the direction in the unknowns that only scales the world, unit length, (n,)."""
    direction = np.zeros(len(unknowns))
    for name, values in zip(_MOVES, path.translation.T):
        if name in unknowns.view_names:
            direction[unknowns.of_views(name)[:, 0]] = values
    direction[~unknowns.free] = 0
    direction /= max(float(np.linalg.norm(direction)), 1e-300)
    return direction
