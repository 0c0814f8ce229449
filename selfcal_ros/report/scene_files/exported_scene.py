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
"""What other programs go on from: cameras, points, and who saw which where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.camera_path import camera_path, CameraPath, OF_AN_OBJECT
from selfcal_ros.calibration.structure.metric_structure import metric_structure
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.observations import observations
from selfcal_ros.values.tracks import Tracks


@dataclass(frozen=True)
class ExportedScene:
    """
    Path and structure in one world, with the observations that tie them together.

    Attributes
    ----------
    path : CameraPath
    camera : Camera
    cameras : tuple of Camera
        One for every view where the focal length varies; else empty.
    tracks : ndarray of int, shape (P,)
        Identities of the points.
    points : ndarray, shape (P, 3)
    sigma : ndarray, shape (P,)
        Largest standard deviation of each point; zero of known ones.
    view : ndarray of int, shape (N,)
        Of each observation, an index into the path; ascending.
    point : ndarray of int, shape (N,)
        Index of the point that it is of; -1 for outliers, and for points that are left out.
    xy : ndarray, shape (N, 2)
        Pixels, as measured.
    error : ndarray, shape (N,)
        Distance of the point's image from there, pixels.

    """

    path: CameraPath
    camera: Camera
    cameras: tuple[Camera, ...]
    tracks: np.ndarray
    points: np.ndarray
    sigma: np.ndarray
    view: np.ndarray
    point: np.ndarray
    xy: np.ndarray
    error: np.ndarray

    @property
    def cam_from_world(self) -> np.ndarray:
        """[R | t] of every view, shape (V, 3, 4)."""
        R = np.swapaxes(self.path.rotation, 1, 2)
        t = -np.einsum('vij,vj->vi', R, self.path.centre)
        return np.concatenate([R, t[:, :, None]], axis=2)

    def camera_of(self, view: int) -> Camera:
        """Return the camera of a view."""
        return self.cameras[view] if self.cameras else self.camera

    def rows_of(self, view: int) -> slice:
        """Return where the observations of a view stand."""
        first, last = np.searchsorted(self.view, (view, view + 1))
        return slice(int(first), int(last))


def exported_scene(result: Calibration, tracks: Tracks) -> ExportedScene:
    """
    Gather what there is.

    Parameters
    ----------
    result : Calibration
        Of a camera that moved, or before a known object.
    tracks : Tracks
        Those that were calibrated from.

    Returns
    -------
    ExportedScene
        With the points that are known well, as `metric_structure` has them, and two views of
        each at least.

    """
    path, shape = camera_path(result), result.reconstructed
    if result.motion == OF_AN_OBJECT:
        known = np.asarray(shape.points, float)
        ids, points = np.asarray(shape.tracks), known[:, :3] / known[:, 3:]
        sigma = np.zeros(len(ids))
    else:
        structure = metric_structure(result, tracks)
        ids, points = structure.tracks, structure.points
        sigma = np.sqrt(np.linalg.eigvalsh(structure.covariance)[:, -1].clip(0))
    table = observations(result, tracks)
    names = np.sort(ids)
    place = np.minimum(np.searchsorted(names, table.track), max(len(names) - 1, 0))
    tied = table.used & (names[place] == table.track) if len(names) else np.zeros_like(table.used)
    point = np.where(tied, np.argsort(ids)[place] if len(names) else -1, -1)
    seen = np.bincount(point[point >= 0], minlength=len(ids)) >= 2
    point = np.where((point >= 0) & np.append(seen, False)[point], np.append(
        np.cumsum(seen) - 1, -1)[point], -1)
    order = np.lexsort((table.track, table.view))
    cameras = tuple(result.camera_of(int(frame)) for frame in path.frames) if (
        result.focal is not None) else ()
    return ExportedScene(path, result.camera, cameras, ids[seen], points[seen], sigma[seen],
                         table.view[order], point[order], table.xy[order],
                         np.linalg.norm(table.residual, axis=1)[order])
