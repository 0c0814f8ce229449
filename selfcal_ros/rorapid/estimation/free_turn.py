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
Turns that a shape leaves open: a body of revolution looks the same, however it turns on its axis.

Where no texture tells such a turn, it is held: the pose goes on turned as it was. Texture turns
the pose along. But shading looks like texture, and does not turn with the object: so the
covariance says of either that the object may be turned in any way.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.rorapid.estimation.kalman_filter import ConstantVelocityFilter
from selfcal_ros.rorapid.projection.free_directions import apart_from

#: A turn is held if the images tell it worse than this, radians; how firmly from image to image;
#: and the sigma that is told of one that may be any.
_OPEN_RAD, _HELD_RAD, _ANY_RAD = 0.5, 0.05, np.pi / np.sqrt(3)
#: How well a turn is known where the texture was learned: it is counted from there, so that this
#: says only how well corners tell it.
_COUNTED_RAD = 0.05


def hold_free(kalman: ConstantVelocityFilter, free: np.ndarray, information: np.ndarray) -> None:
    """
    Hold free turns, unless an image tells them.

    Parameters
    ----------
    kalman : ConstantVelocityFilter
    free : ndarray, shape (size, k)
        Corrections that the shape leaves open.
    information : ndarray, shape (m, m)
        Of the image, without the prediction.

    """
    along = kalman.basis.T @ free
    if free.size and np.linalg.eigvalsh(along.T @ information @ along)[0] < _OPEN_RAD**-2:
        kalman.hold(free, _HELD_RAD)


def with_any_turn(covariance: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return a covariance (size, size) of a pose that is turned anyhow by free turns (size, k)."""
    return _apart(covariance, free, _ANY_RAD)


def with_turn_counted(covariance: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return the covariance (size, size) of a pose from which free turns (size, k) are counted."""
    return _apart(covariance, free, _COUNTED_RAD)


def without_free(covariance: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return a covariance (size, size) of all but the free turns (size, k)."""
    return _apart(covariance, free, 0.0)


def _apart(covariance: np.ndarray, free: np.ndarray, sigma: float) -> np.ndarray:
    if not free.size:
        return covariance
    keep = apart_from(free)
    result: np.ndarray = keep @ covariance @ keep.T + sigma**2 * free @ free.T
    return result
