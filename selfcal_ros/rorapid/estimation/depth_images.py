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
"""What depth images of a sequence say: of each pose, and of the size of the object."""

from __future__ import annotations

import math

import numpy as np

from selfcal_ros.rorapid.edges.control_points import ControlModel
from selfcal_ros.rorapid.estimation.depth_fit import DepthFit
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement

#: Standard deviations by which model and depths may differ, images before that is said, and the
#: least share that counts.
_SIGMAS, _IMAGES, _LEAST = 3.0, 10, 0.01
#: What the share of a single image is never known better than.
_SHARE_SIGMA = 1e-4


class DepthImages:
    """
    Improves poses, and holds the size of the model against the depths.

    A model that is too large by a share s gives poses that are too far by s, and the same grey
    image. The depths are then smaller than those of the pose.

    Parameters
    ----------
    control : ControlModel
        Of the tracker.
    scale_sigma : float
        Of the one factor by which all depths of the camera err.

    """

    def __init__(self, control: ControlModel, scale_sigma: float):
        """Wait for depths."""
        self._control, self._scale_sigma = control, scale_sigma
        self._fit: DepthFit | None = None
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._weight = self._sum = 0.0
        self._images = 0

    def improved(self, measured: PoseMeasurement, depth: np.ndarray,
                 basis: np.ndarray) -> PoseMeasurement:
        """
        Improve a pose; as it is where it is open, or too little has a depth.

        Parameters
        ----------
        measured : PoseMeasurement
            By the grey image.
        depth : ndarray, shape (H, W)
            See `DepthFit.improved`.
        basis : ndarray, shape (6, m)

        Returns
        -------
        PoseMeasurement

        """
        if not measured.determined or not measured.with_prior:
            return measured
        if self._fit is None:
            self._fit = DepthFit(self._control.visible_model, self._control.centre,
                                 self._control.projection, self._scale_sigma)
        says = self._fit.improved(measured, depth, basis)
        if says is None:
            return measured
        # what the depth camera errs by is the same in all images; the rest is not
        weight = 1 / (says.sigma**2 + _SHARE_SIGMA**2)
        self._weight += weight
        self._sum += weight * says.share
        self._images += 1
        return says.measured

    def text(self) -> str:
        """Return a sentence, empty where all is well or not known yet."""
        if self._images < _IMAGES:
            return ''
        share = self._sum / self._weight
        sigma = math.hypot(self._scale_sigma, self._weight**-0.5)
        if abs(share) < max(_SIGMAS * sigma, _LEAST):
            return ''
        amount, size = 100 * abs(1 / (1 + share) - 1), 'large' if share < 0 else 'small'
        return (f'The depth images say that the model is {amount:.1f} ± {100 * sigma:.1f} % too '
                f'{size}, or that their own scale is as wrong.')
