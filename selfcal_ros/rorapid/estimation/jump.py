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
An object that is far from where it was predicted has moved in another way than before.

The prediction pulls the pose towards itself, and what it makes of the velocity puts the next one
off: a cube that jumped was tracked on, turning by itself. So its motion is forgotten, and the
image is measured again without it.

Another sign is a pose whose edges were found, but lie about it in any distance, not within their
noise: these are other edges. Such a pose is open, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from selfcal_ros.rorapid.estimation.kalman_filter import ConstantVelocityFilter
from selfcal_ros.rorapid.estimation.pose_estimator import SearchingEstimator
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.estimation.track_quality import (
    EDGES_SUFFICIENT, RECOGNISED_CORNERS)
from selfcal_ros.rorapid.projection.camera_models import ObjectPose

#: Squared sigmas of the prediction per degree of freedom; six have more in 6 of 100 images.
_FAR = 2.0
#: So much more must be found from another start, as a share.
_BETTER = 0.05
#: Edges that lie so many sigmas off in the median are others, found by chance near a wrong pose.
#: In 2200 images of sudden motions 99 of 100 right poses had less than 0.9. Of 10 tracked ones
#: that were wrong by 1.5 to 42 degrees 9 had 1.08 to 1.8.
_MISFIT = 1.1
#: With so many of the edges, as a share, it has another cause: a wrong model, which is doubted.
_MANY = 0.7


class JumpWatch:
    """Watches for jumps of one object; after one its pose is open until an image confirms it."""

    def __init__(self) -> None:
        """Expect none."""
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._is_open = False

    def look(self, method: SearchingEstimator, image: np.ndarray, measured: PoseMeasurement,
             kalman: ConstantVelocityFilter, proposed: Callable[[ObjectPose], np.ndarray],
             ) -> PoseMeasurement:
        """
        Measure an image again if the object is far from the prediction, whose motion is forgotten.

        Parameters
        ----------
        method : SearchingEstimator
        image : ndarray, shape (H, W), uint8
        measured : PoseMeasurement
            Around the prediction.
        kalman : ConstantVelocityFilter
            At the prediction. It forgets the velocity where that is wrong.
        proposed : callable
            Covariance (m, m) of a state that is only proposed.

        Returns
        -------
        PoseMeasurement
            In which most is found; as uncertain as a proposal until its lines are seen.

        """
        if kalman.innovation_share(measured.state) > _FAR:
            kalman.forget_motion()
            measured = _best_of(method, image, measured, kalman, proposed)
            self._is_open = True
        misfits = _misfits(measured)
        self._is_open |= misfits
        if not self._is_open:
            return measured
        # it may be another pose nearby, or something else where the object went away
        seen = measured.share >= EDGES_SUFFICIENT and not misfits and method.check.found(
            method.check.support(image, measured.state), measured.by_texture, method.placed)
        # corners of its texture say that it is there, and no more
        self._is_open = not seen and len(measured.texture_px) < RECOGNISED_CORNERS
        return measured if seen else replace(measured, covariance=proposed(measured.state))


def _misfits(measured: PoseMeasurement) -> bool:
    """Whether the edges found are hardly those of the pose: they lie about it in any distance."""
    details = measured.details
    # where nearly all lie so it is the model that is wrong, or another thing's edges lie beside
    return details is not None and details.misfit > _MISFIT and details.edge_share < _MANY


def _best_of(method: SearchingEstimator, image: np.ndarray, measured: PoseMeasurement,
             kalman: ConstantVelocityFilter, proposed: Callable[[ObjectPose], np.ndarray],
             ) -> PoseMeasurement:
    """Measure without the motion, and from starts around; return that in which most is found."""
    again = method.measure(image, kalman.state, kalman.pose_covariance)
    best = again if again.share >= measured.share else measured
    if best.share >= EDGES_SUFFICIENT:
        return best
    # corners of one face fit two poses; the edges know
    wide = proposed(best.state)
    other = method.measure(image, method.search.nearby(image, best.state, wide), wide)
    return other if other.share > best.share + _BETTER else best
