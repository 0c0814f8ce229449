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
Unknowns of the motion-constrained bundle adjustment, and what is known of them beforehand.

The world frame lies in the plane of motion, its z axis along the rotation axis. View i is

    X_camera = A (S(tilt_i) R_z(angle_i) Y + w (p_i, h_i)),    Y, w a homogeneous world point,

with one mount rotation A for all views. In planar motion the tilts and heights are zero, so that
v ~ K A e3 and the circular points ~ K A (1, ±i, 0) are in the parameters themselves; nearly
planar motion gives tilt and height a prior, general motion leaves them free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.geometry.camera import Camera, CameraFacts, DISTORTION_MODELS, PARAMETER_NAMES
from selfcal_ros.geometry.rotation import pad, rotation_matrix, twist_matrix

#: Internal parameters: focal length f, aspect ratio ζ = fy / fx, and the rest.
INTRINSIC_NAMES = ('f', 'aspect', 'cx', 'cy', 'skew', 'k1', 'k2', 'p1', 'p2')
F, ASPECT, CX, CY, SKEW, K1, K2, P1, P2 = range(9)
SHARED = 11      # nine intrinsics and two of the axis direction
PER_VIEW = 6     # angle, p1, p2, tilt1, tilt2, height
ROTATION = (0, 3, 4)


@dataclass(frozen=True)
class MotionModel:
    """
    How far the motion may leave the plane.

    Attributes
    ----------
    tilt_sigma_rad, height_sigma : float
        Standard deviations of the out-of-plane rotation and translation of each view, the latter
        in units of the root mean square distance between successive views. 0: exactly planar;
        infinity: general motion.
    parallel : tuple of int
        Views that are stated to share one orientation: related by pure translation.

    """

    tilt_sigma_rad: float = 0.0
    height_sigma: float = 0.0
    parallel: tuple[int, ...] = ()

    def of_views(self, views: np.ndarray) -> MotionModel:
        """Return the model for some of the views, which become 0, 1, 2, ..."""
        place = {int(view): k for k, view in enumerate(views)}
        return replace(self, parallel=tuple(place[v] for v in self.parallel if v in place))

    @property
    def keeps_plane(self) -> bool:
        """Tell whether there is a plane of motion at all, exact or not."""
        return bool(np.isfinite(self.tilt_sigma_rad))


@dataclass(frozen=True)
class BundleState:
    """
    A point in the space of the unknowns.

    Attributes
    ----------
    intrinsics : ndarray, shape (9,)
        `INTRINSIC_NAMES`.
    mount : ndarray, shape (3, 3)
        A, camera from world rotation of a view with angle and tilt zero.
    views : ndarray, shape (V, 6)
        Angle (rad), in-plane translation (2), tilt (2, rad), height.
    points : ndarray, shape (P, 4)
        Unit homogeneous world points.

    """

    intrinsics: np.ndarray
    mount: np.ndarray
    views: np.ndarray
    points: np.ndarray

    def camera(self, width=0, height=0) -> Camera:
        """Return the camera."""
        f, aspect, *rest = self.intrinsics
        return Camera.from_parameters([f, aspect * f, *rest], width, height)

    def rotations(self) -> np.ndarray:
        """Return world-to-view rotations before the mount, shape (V, 3, 3)."""
        return rotation_matrix(pad(self.views[:, 3:5])) @ twist_matrix(self.views[:, 0])

    def cam_from_world(self) -> np.ndarray:
        """Return [R | t] of every view, shape (V, 3, 4)."""
        translations = self.views[:, [1, 2, 5]]
        poses = np.concatenate([self.rotations(), translations[..., None]], axis=2)
        return self.mount @ poses

    def step_length(self) -> float:
        """Root mean square distance between the camera centres of successive views."""
        R = self.rotations()
        centres = -np.einsum('vji,vj->vi', R, self.views[:, [1, 2, 5]])
        return float(np.sqrt(np.mean(np.sum(np.diff(centres, axis=0)**2, axis=1)))) or 1.0


@dataclass(frozen=True)
class Prior:
    """One measurement of an internal parameter: value and sigma (0: held)."""

    value: float
    sigma: float


def priors_from_facts(facts: CameraFacts) -> dict[int, Prior]:
    """
    Translate facts to measurements of the internal parameters; sigma 0 holds one.

    A distortion model that is not chosen yet ('auto') counts as 'radial2'.
    """
    free = DISTORTION_MODELS.get(facts.distortion, DISTORTION_MODELS['radial2'])
    priors = {}
    if facts.aspect_ratio is not None:
        priors[ASPECT] = Prior(facts.aspect_ratio, facts.aspect_ratio_sigma)
    if facts.skew is not None:
        priors[SKEW] = Prior(facts.skew, facts.skew_sigma_px)
    if facts.principal_point is not None:
        priors[CX] = Prior(facts.principal_point[0], facts.principal_point_sigma_px)
        priors[CY] = Prior(facts.principal_point[1], facts.principal_point_sigma_px)
    for name in ('k1', 'k2', 'p1', 'p2'):
        if name not in free:
            priors[PARAMETER_NAMES.index(name)] = Prior(0.0, 0.0)
    return priors


def holding(state, priors: dict[int, Prior]):
    """Put held parameters of a state, of points or of objects, at the values that hold them."""
    intrinsics = state.intrinsics.copy()
    for index, prior in priors.items():
        if prior.sigma == 0:
            intrinsics[index] = prior.value
    return replace(state, intrinsics=intrinsics)


def aligned(state: BundleState, motion: MotionModel) -> BundleState:
    """Give the views that are stated to be parallel the orientation of the first of them."""
    if not motion.parallel:
        return state
    views = state.views.copy()
    views[np.ix_(motion.parallel, ROTATION)] = views[motion.parallel[0], ROTATION]
    return replace(state, views=views)


def rescale(state: BundleState) -> BundleState:
    """Scale the world so that successive views are one unit apart (root mean square)."""
    factor = 1 / state.step_length()
    views = state.views.copy()
    views[:, [1, 2, 5]] *= factor
    points = state.points * np.array([factor, factor, factor, 1])
    return replace(state, views=views,
                   points=points / np.linalg.norm(points, axis=1, keepdims=True))


def parameter_covariance(covariance: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """
    Carry the covariance of the internal parameters to `PARAMETER_NAMES`.

    Parameters
    ----------
    covariance : ndarray, shape (n, n), n >= 9
        Its first nine rows belong to `INTRINSIC_NAMES`.
    intrinsics : ndarray, shape (9,)

    Returns
    -------
    ndarray, shape (9, 9)

    """
    J = np.eye(9)
    J[1, F], J[1, ASPECT] = intrinsics[ASPECT], intrinsics[F]     # fy = ζ f
    return J @ covariance[:9, :9] @ J.T


def intrinsic_covariance(covariance: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """
    Carry a covariance of `PARAMETER_NAMES` to `INTRINSIC_NAMES`: `parameter_covariance` undone.

    Parameters
    ----------
    covariance : ndarray, shape (9, 9)
    intrinsics : ndarray, shape (9,)

    Returns
    -------
    ndarray, shape (9, 9)

    """
    J = np.eye(9)
    J[ASPECT, 0], J[ASPECT, 1] = -intrinsics[ASPECT] / intrinsics[F], 1 / intrinsics[F]
    return J @ covariance @ J.T
