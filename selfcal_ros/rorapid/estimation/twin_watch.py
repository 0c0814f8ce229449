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
Is what was found the object that was lost, or an equal one that stood beside it before?

No image of an object tells it from its twin. But an image in which the object was followed shows
what else was there. What is found where an equal thing was seen then, is that one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from selfcal_ros.rorapid.estimation.pose_estimator import SearchingEstimator
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.projection.camera_models import ObjectPose

#: Of every so many images that confirm the object one is kept.
_EVERY = 2
#: Two poses are of one place where their middles are nearer than this share of the object's size.
_ONE_PLACE = 0.5
#: Something is seen as well as another thing if no more than this share of its length is missing.
_ALIKE = 0.05
#: A twin that is not seen for more images is not followed any more.
_FORGOTTEN = 3
#: What is said where nothing but twins is found.
TWIN = 'What looks like the object was seen beside it before: it is an equal one.'


class TwinWatch:
    """Keeps an image of one object, with what was beside it."""

    def __init__(self) -> None:
        """Wait for the first."""
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._images = 0
        self._kept: tuple[np.ndarray, ObjectPose] | None = None
        #: Where twins were seen, and in which image while the object is sought.
        self._seen: list[tuple[ObjectPose, int]] = []
        self._sought_images = 0

    def remember(self, image: np.ndarray, state: ObjectPose) -> None:
        """Take in an image (H, W) that confirms a state; it may be used otherwise afterwards."""
        if self._images % _EVERY == 0:
            self._kept = image.copy(), state
        self._images += 1
        self._seen = []

    def next_sought(self) -> None:
        """Go on to the next image in which the object is sought."""
        self._sought_images += 1
        self._seen = [one for one in self._seen if self._sought_images - one[1] <= _FORGOTTEN]

    def is_twin(self, method: SearchingEstimator, image: np.ndarray, found: PoseMeasurement,
                wide: Callable[[ObjectPose], np.ndarray]) -> bool:
        """
        Whether something as like the object was there while the object was elsewhere.

        Parameters
        ----------
        method : SearchingEstimator
        image : ndarray, shape (H, W), uint8
        found : PoseMeasurement
            In this image.
        wide : callable
            Covariance (m, m) of a state that is proposed.

        Returns
        -------
        bool

        """
        if self._kept is None or self._kept[0].shape != image.shape:
            return False
        before, own = self._kept
        if self.is_known(method, found.state):
            return True
        twin = self._was_beside(method, image, found.state, before, own, wide)
        if twin:
            self._seen.append((found.state, self._sought_images))
        return twin

    def is_known(self, method: SearchingEstimator, state: ObjectPose) -> bool:
        """Whether a twin was just seen there; it is followed on, for it may move far away."""
        near = [one for one in self._seen if _is_one_place(method, one[0], state)]
        if near:
            self._seen = [one for one in self._seen if one not in near]
            self._seen.append((state, self._sought_images))
        return bool(near)

    @staticmethod
    def _was_beside(method: SearchingEstimator, image: np.ndarray, found: ObjectPose,
                    before: np.ndarray, own: ObjectPose,
                    wide: Callable[[ObjectPose], np.ndarray]) -> bool:
        """Whether as much of something was seen about there before, beside the object itself."""
        if _is_one_place(method, own, found):
            return False
        check, now = method.check, method.check.support(image, found)
        # it may have moved since, as the object may
        for there in (found, method.search.nearby(before, found, wide(found))):
            then = check.support(before, there)
            if check.fair(then) and then.length >= now.length - _ALIKE and not _is_one_place(
                    method, own, there):
                # what was seen better than what was followed was the object, the other was not
                return check.support(before, own).length >= then.length - _ALIKE
        return False


def _is_one_place(method: SearchingEstimator, one: ObjectPose, other: ObjectPose) -> bool:
    """Whether two states lie over each other in the image."""
    control = method.search.control
    middle = np.zeros((1, 3))
    a, b = (control.projection.project(state, middle).pixels[0] for state in (one, other))
    focal, size = float(control.projection.camera.K[0, 0]), control.visible_model.model.diameter_m
    across = one.zoom * focal * size / max(one.translation[2], 1e-9)
    return bool(np.linalg.norm(a - b) < _ONE_PLACE * across)
