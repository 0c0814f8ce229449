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
"""The path of the camera and the points of the scene, and what is measured in them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from selfcal_ros.geometry.chain_inverse import ChainInverse
    from selfcal_ros.geometry.reduced_system import Elimination


@dataclass(frozen=True)
class Measured:
    """
    A value and its standard deviation, in the same unit.

    Examples
    --------
    >>> from selfcal_ros import Measured
    >>> Measured(value=2.0, sigma=0.01)
    Measured(value=2.0, sigma=0.01)

    """

    value: float
    sigma: float


@dataclass(frozen=True)
class StructurePrecision:
    """
    What the sigma of a length or an angle follows from.

    Attributes
    ----------
    camera : Camera
        Of the adjustment.
    points : ndarray, shape (P, 4)
        Where it put the points, unit homogeneous coordinates.
    lens : tuple of str
        Unknowns of the lens that were estimated.
    covariance : ndarray or ChainInverse, shape (k, k)
        Of the independent unknowns of lens and path, for independent noise; those of `lens` come
        first.
    elimination : Elimination
        By what the points follow these unknowns.
    noise_factor : float
        Variance of the noise over that which `elimination` supposes.

    """

    camera: Camera
    points: np.ndarray
    lens: tuple[str, ...]
    covariance: np.ndarray | ChainInverse
    elimination: Elimination
    noise_factor: float


@dataclass(frozen=True)
class PosePrecision:
    """
    What the covariance of every pose follows from, to first order.

    A small change of a pose is that of the camera's centre, then a small turn of the camera about
    the axes of the world: x, y, z, rotX, rotY, rotZ of REP 103. The world and its unit are those
    of `selfcal_ros.calibration.structure.camera_path`.

    Attributes
    ----------
    camera : Camera
        Of the adjustment.
    lens : tuple of str
        Unknowns of the lens that were estimated.
    by_unknowns : csr_array, shape (6 V, k)
        Changes of the poses by the independent unknowns of the adjustment; those of `lens` come
        first.
    covariance : ndarray or ChainInverse, shape (k, k)
        Of these unknowns, for independent noise.
    own : ndarray, shape (V, 6, 6), optional
        Covariance of the poses while these unknowns are held, where poses are none of them.

    """

    camera: Camera
    lens: tuple[str, ...]
    by_unknowns: csr_array
    covariance: np.ndarray | ChainInverse
    own: np.ndarray | None = None


@dataclass(frozen=True)
class RowMotion:
    """
    How the camera moved while each view was read, line by line.

    Attributes
    ----------
    by_powers : ndarray, shape (V, 3, 6)
        Turn (rotation vector, rad) and move of the camera since its middle line, in its own frame
        there, by the first three powers of the line: -1/2 is the first and 1/2 the last.
    lines : int
        Rows of the image, or columns.
    axis : int
        The pixel coordinate that tells the line: 1 of rows, 0 of columns.

    """

    by_powers: np.ndarray
    lines: int
    axis: int = 1

    def when_read(self, X: np.ndarray, weight: np.ndarray, view: np.ndarray, xy: np.ndarray,
                  ) -> np.ndarray:
        """
        Carry points to the frame of the camera at the instant when their line is read.

        Parameters
        ----------
        X : ndarray, shape (N, 3)
            In the frame of the view: its middle line.
        weight : ndarray, shape (N,)
            Their last homogeneous coordinate; zero at infinity.
        view : ndarray of int, shape (N,)
        xy : ndarray, shape (N, 2)
            Pixels, which tell the line.

        Returns
        -------
        ndarray, shape (N, 3)

        """
        line = (xy[:, self.axis] - (self.lines - 1) / 2) / self.lines
        moved = np.einsum('np,npk->nk', line[:, None]**np.arange(1, 4), self.by_powers[view])
        there: np.ndarray = np.einsum('nij,nj->ni', rotation_matrix(moved[:, :3]),
                                      X - weight[:, None] * moved[:, 3:])
        return there


@dataclass(frozen=True)
class Reconstruction:
    """
    Camera path and structure, up to scale, in a world frame whose z axis is the rotation axis.

    Attributes
    ----------
    frames : ndarray of int, shape (V,)
    cam_from_world : ndarray, shape (V, 3, 4)
        [R | t] of each frame.
    tracks : ndarray of int, shape (P,)
    points : ndarray, shape (P, 4)
        Homogeneous world points; the last entry may be zero (at infinity).
    precision : StructurePrecision, optional
        Of the points, in the same order; lengths and angles of the structure get their sigmas
        from it.
    pose_precision : PosePrecision, optional
        Of the poses; see `selfcal_ros.calibration.structure.camera_path`.
    row_motion : RowMotion, optional
        How the camera moved while each view was read, where that was allowed for; the poses are
        those of the middle lines.
    shift_px : ndarray, shape (V, 2), optional
        How far a stabiliser shifted each image, where that was allowed for.

    """

    frames: np.ndarray
    cam_from_world: np.ndarray
    tracks: np.ndarray
    points: np.ndarray
    precision: StructurePrecision | None = field(default=None, repr=False, compare=False)
    pose_precision: PosePrecision | None = field(default=None, repr=False, compare=False)
    row_motion: RowMotion | None = field(default=None, repr=False, compare=False)
    shift_px: np.ndarray | None = field(default=None, repr=False, compare=False)

    def places_of(self, frame: np.ndarray, track: np.ndarray,
                  ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Find the observations of reconstructed points in reconstructed views.

        Parameters
        ----------
        frame, track : ndarray of int, shape (N,)

        Returns
        -------
        rows : ndarray of int, shape (M,)
            Which observations they are.
        view, point : ndarray of int, shape (M,)
            Their places among `frames` and `tracks`.

        """
        view, seen = _places(self.frames, frame)
        point, known = _places(self.tracks, track)
        rows = np.flatnonzero(seen & known)
        return rows, view[rows], point[rows]

    def when_seen(self, view: np.ndarray, point: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """
        Return points in the frame of the camera that saw them, when it read their line.

        Parameters
        ----------
        view, point : ndarray of int, shape (N,)
            Places among `frames` and `tracks`.
        xy : ndarray, shape (N, 2)
            Pixels, which tell the line.

        Returns
        -------
        ndarray, shape (N, 3)
            Times the last homogeneous coordinate of the point, whose sign is arbitrary.

        """
        X: np.ndarray = np.einsum('nij,nj->ni', self.cam_from_world[view], self.points[point])
        if self.row_motion is None:
            return X
        return self.row_motion.when_read(X, self.points[point, 3], view, xy)


def _places(keys: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find values among keys: their places, and whether they are there at all."""
    keys = np.asarray(keys)
    if not len(keys):
        return np.zeros(len(wanted), int), np.zeros(len(wanted), bool)
    order = np.argsort(keys)
    place = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)]
    return place, keys[place] == wanted


@dataclass(frozen=True)
class StructureSample:
    """
    Two typical measurements in the structure, and how good they are.

    Attributes
    ----------
    length_ratio : Measured
        Length of the segment `first` over that of `second`.
    first, second : (int, int)
        Tracks of the points that each segment connects.
    angle_deg : Measured
        Angle at the middle one of three points.
    corner : (int, int, int)
        Their tracks.

    """

    length_ratio: Measured
    first: tuple[int, int]
    second: tuple[int, int]
    angle_deg: Measured
    corner: tuple[int, int, int]
