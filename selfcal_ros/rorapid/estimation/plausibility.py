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
"""Is it plausible? Whether the model, its size, or the object itself may be another."""

from __future__ import annotations

import numpy as np

from selfcal_ros.rorapid.edges.control_points import ControlModel
from selfcal_ros.rorapid.estimation.depth_images import DepthImages
from selfcal_ros.rorapid.estimation.model_doubt import ModelDoubt
from selfcal_ros.rorapid.estimation.outline_watch import OutlineWatch
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.estimation.size_check import SizeCheck
from selfcal_ros.rorapid.estimation.start_check import StartCheck
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose


class PlausibilityChecks:
    """
    Gathers what speaks against an object.

    Parameters
    ----------
    control : ControlModel
    basis : ndarray, shape (size, m)
    options : TrackerOptions

    Attributes
    ----------
    depths : DepthImages
    outline : OutlineWatch or None
        Of a mesh, where poses are tested.

    """

    def __init__(self, control: ControlModel, basis: np.ndarray, options: TrackerOptions):
        """Wait for a start."""
        self._sure, self._size = True, SizeCheck(1.0, None)
        self.adopt(control, basis, options)

    def adopt(self, control: ControlModel, basis: np.ndarray, options: TrackerOptions) -> None:
        """Go on by other settings, or another camera model; what was found is found anew."""
        # plane faces before a perspective camera let wrong proportions be seen
        shown = (control.projection.model == 'perspective'
                 and control.visible_model.faceted is not None)
        self._model = ModelDoubt(control, basis, options.least_contrast) if (
            options.verifies and shown) else None
        self.depths = DepthImages(control, options.depth_scale_sigma)
        self.outline = OutlineWatch() if options.verifies and control.is_outlined else None

    def begin(self, distance_m: float, sigma_m: float | None, sure: bool) -> None:
        """
        Begin with a start.

        Parameters
        ----------
        distance_m : float
            That the start says.
        sigma_m : float or None
            Its standard deviation, where it was measured.
        sure : bool
            Nobody asks whether it is another object.

        """
        self._size, self._sure = SizeCheck(distance_m, sigma_m), sure
        self.depths.forget()
        if self.outline is not None:
            self.outline.forget()
        if self._model is not None:
            self._model.forget()

    def confirmed(self, sure: bool, distance_m: float, sigma_m: float) -> None:
        """
        Take a start that was confirmed.

        Parameters
        ----------
        sure : bool
            It is the object without doubt.
        distance_m, sigma_m : float
            At which it was found, and how well that is known.

        """
        self._sure = sure
        self._size.measure(distance_m, sigma_m)

    def look(self, image: np.ndarray, measured: PoseMeasurement, check: StartCheck) -> None:
        """Look, now and then, whether this is the object."""
        due = self._model is None or self._model.due()
        if self._model is not None and due:
            self._model.look(image, measured.state, measured.view)
        if due and not self._sure:
            self._sure = check.sure(check.support(image, measured.state))

    def text(self) -> str:
        """Say what seems wrong with the model, the camera or the start; empty if nothing does."""
        if self._model is not None and self._model.doubt is not None:
            return self._model.doubt.text()
        if not self._sure:
            return ('Some lines of the model are not seen: something hides them, or it is another '
                    'object.')
        outline = '' if self.outline is None else self.outline.text()
        return outline or self.depths.text() or self._size.text()

    def covariance(self, state: ObjectPose, basis: np.ndarray) -> np.ndarray:
        """Covariance (6, 6) of (theta, Delta) that a doubt may add to a pose."""
        added = np.zeros((6, 6))
        bias = None if self._model is None else self._model.bias()
        if bias is not None:
            moved = basis[:6] @ bias
            added += np.outer(moved, moved)
        if self._size.share:
            away = np.r_[np.zeros(3), self._size.share * state.translation]
            added += np.outer(away, away)
        if self.outline is not None:
            added += self.outline.opinion.covariance()
        return added
