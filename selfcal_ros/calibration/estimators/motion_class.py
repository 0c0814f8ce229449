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
"""Tells which motion it was: none, rotation, translation, planar, circular or general."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.values.motion import Motion

#: With less rotation than this in all it is tested whether there is any (radians): without, a
#: small sigma would be an accident of a wrong optimum.
DOUBTFUL_ROTATION_RAD = np.radians(6.0)
#: A motion that leaves the plane by more than this is not planar (radians, root mean square).
MAX_TILT_RAD = np.radians(5.0)
#: A path is circular when the axis keeps its place in the camera to this share of its distance.
CIRCULAR_FRACTION = 0.01
#: The horizon counts as level when it is within this angle of the image's x axis (radians).
LEVEL_RAD = np.radians(5.0)


@dataclass(frozen=True)
class PathDescription:
    """
    The motion of an optimum.

    Attributes
    ----------
    motion : str
    rotation_rad : float
        Largest angle between two views.
    refusal : NoEstimate or None
        Why no calibration can come from such motion.
    findings : tuple of Finding
    roll_rad : float
        Angle of the horizon against the image's x axis.

    """

    motion: Motion
    rotation_rad: float
    refusal: NoEstimate | None
    findings: tuple[Finding, ...]
    roll_rad: float

    def explain(self, missing: tuple[str, ...], facts: CameraFacts) -> NoEstimate:
        """Tell why the parameters in `missing` cannot be determined."""
        if self.refusal is not None:
            return self.refusal
        turned_deg = float(np.degrees(self.rotation_rad))
        if self.rotation_rad < DOUBTFUL_ROTATION_RAD / 3:
            return NoEstimate('rotation_too_small', turned_deg=turned_deg, missing=missing)
        if facts.aspect_ratio is None and facts.principal_point is None:
            if facts.skew is None:
                return NoEstimate('fact_missing', missing=missing)
            if abs(self.roll_rad) < LEVEL_RAD:
                return NoEstimate('horizon_level', missing=missing,
                                  roll_deg=float(np.degrees(abs(self.roll_rad))))
        if self.motion == 'circular' and facts.principal_point is None:
            return NoEstimate('circle_undetermined', missing=missing, turned_deg=turned_deg)
        return NoEstimate('parameters_undetermined', missing=missing, turned_deg=turned_deg,
                          path=self.motion)


def out_of_plane_rad(path: AxisPath) -> float:
    """Root mean square angle of the views out of the plane of motion."""
    return float(np.sqrt(np.mean(np.sum(path.tilt**2, axis=1))))


def not_planar(tilt_rad: float) -> NoEstimate:
    """Refuse views that are tilted so far out of the plane."""
    return NoEstimate('not_planar', tilt_deg=float(np.degrees(tilt_rad)), motion='general')


def largest_turn_rad(path: AxisPath, keeps_plane: bool) -> float:
    """Largest angle between a view and the first."""
    R = path.rotations()
    turn = float(np.linalg.norm(rotation_vector(R @ R[0].T), axis=1).max())
    # in a plane the way round may exceed half a turn
    return max(turn, float(np.ptp(path.angle))) if keeps_plane else turn


def widest_turn_rad(R: np.ndarray) -> float:
    """Largest angle between any two of the rotations (V, 3, 3), at most half a turn."""
    R = np.asarray(R, float).reshape(-1, 9)
    # trace of R_i R_j^T = 1 + 2 cos(angle)
    return float(np.arccos(np.clip(((R @ R.T).min() - 1) / 2, -1, 1)))


def describe_path(path: AxisPath, exact: bool, keeps_plane: bool = True,
                  turned: bool = True, pivots: bool = False) -> PathDescription:
    """
    Classify the motion of an optimum of the bundle adjustment.

    Parameters
    ----------
    path : AxisPath
    exact : bool
        Whether the motion is exactly planar as far as the data can tell.
    keeps_plane : bool
        False: the motion was estimated without a plane.
    turned : bool
        Whether the images show a rotation at all.
    pivots : bool
        Whether the camera was supposed to turn about a fixed point.

    Returns
    -------
    PathDescription

    """
    rotation = largest_turn_rad(path, keeps_plane)
    tilt = out_of_plane_rad(path)
    axis = path.mount[:, 2]
    # horizon ~ K^-T axis; its direction in the image is across (axis_x, axis_y)
    roll = float(np.arctan2(axis[0], abs(axis[1])))
    findings = []
    motion: Motion = 'planar' if keeps_plane else 'pivot' if pivots else 'general'
    refusal = None
    if not turned:
        motion = 'translation'
        refusal = NoEstimate('no_rotation')
    elif keeps_plane and tilt > MAX_TILT_RAD:
        motion = 'general'
        refusal = not_planar(tilt)
    elif keeps_plane and axis_place(path) is not None:
        motion = 'circular'
        findings.append(Finding('circular_motion'))
    if motion in ('planar', 'circular') and not exact:
        findings.append(Finding('not_exactly_planar', tilt_deg=float(np.degrees(tilt))))
    return PathDescription(motion, rotation, refusal, tuple(findings), roll)


def axis_place(path: AxisPath) -> np.ndarray | None:
    """Place (2,) that one world axis keeps in all views: R_i c + p_i = constant; None if none."""
    R = path.rotations()[:, :2, :2]
    p = path.translation[:, :2]
    views = len(p)
    matrix = np.concatenate([R, np.broadcast_to(-np.eye(2), (views, 2, 2))], axis=2)
    solution, *_ = np.linalg.lstsq(matrix.reshape(-1, 4), -p.ravel(), rcond=None)
    error = (matrix.reshape(-1, 4) @ solution + p.ravel()).reshape(-1, 2)
    radius = np.linalg.norm(solution[2:])
    span = np.ptp(path.centres()[:, :2], axis=0).max()
    keeps = (np.sqrt(np.mean(np.sum(error**2, axis=1)))
             < CIRCULAR_FRACTION * min(radius, 5 * span))
    return solution[2:] if keeps else None
