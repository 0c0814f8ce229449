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
"""Which corrections motion and camera model allow a pose: a plane learned, a zoom given up."""

from __future__ import annotations

import numpy as np

from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.projection.motion_models import completed, motion_basis, PlaneLearner

#: The plane of motion is learned when its normal is known so well, from so many poses.
_PLANE_RAD, _PLANE_POSES = 0.005, 30
#: Zoom is left when so many images in a row leave the focal length open by this share.
_ZOOM_OPEN, _ZOOM_FRAMES = 0.1, 10


class AllowedMotion:
    """
    The basis of corrections q = basis p.

    Parameters
    ----------
    projection : Projection
        Its camera model may change; then `lay` again.
    options : TrackerOptions

    Attributes
    ----------
    basis : ndarray, shape (size, m)
    free : int
        The object moves in the first so many; the others are found out, but stay as they are.

    """

    def __init__(self, projection: Projection, options: TrackerOptions):
        """Lay out the corrections."""
        self._projection, self._options = projection, options
        self._plane = PlaneLearner()
        self._axis: tuple[float, ...] | np.ndarray | None = options.plane_axis
        self._open_zooms = 0
        self.lay()

    def reset(self) -> None:
        """Forget the plane, and what images said of the zoom."""
        self._plane.reset()
        self._axis = self._options.plane_axis
        self.begin()

    def begin(self) -> None:
        """Take a start: images have said nothing of the zoom yet."""
        self._open_zooms = 0

    def lay(self) -> None:
        """Lay out the corrections anew."""
        motion = self._options.motion
        if motion == 'planar' and self._axis is None:
            motion = 'general'                # until the plane is learned
        self.basis = motion_basis(motion, self._projection.size, self._axis)
        self.free = self.basis.shape[1]
        if self._options.method == 'modern':
            # what the motion does not change is estimated all the same, from all images
            self.basis = completed(self.basis)

    def learns(self, state: ObjectPose, covariance: np.ndarray) -> bool:
        """
        Learn the plane of motion from a pose.

        Parameters
        ----------
        state : ObjectPose
        covariance : ndarray, shape (m, m)

        Returns
        -------
        bool
            Whether the plane is known from now on: `lay` again.

        """
        if self._options.motion != 'planar' or self._axis is not None:
            return False
        B = self.basis
        self._plane.add(state.rotation, state.translation, (B @ covariance @ B.T)[:6, :6])
        plane = self._plane.plane()
        if plane.sigma_rad < _PLANE_RAD and self._plane.count >= _PLANE_POSES:
            self._axis = plane.axis
            return True
        return False

    def leaves_zoom(self, focal_sigma: float) -> bool:
        """
        Whether the zoom is to be given up: too many images in a row left the focal length open.

        Parameters
        ----------
        focal_sigma : float
            Relative standard deviation of the focal length from the last image.

        """
        if self._projection.model != 'zoom':
            return False
        self._open_zooms = self._open_zooms + 1 if focal_sigma > _ZOOM_OPEN else 0
        return self._open_zooms >= _ZOOM_FRAMES
