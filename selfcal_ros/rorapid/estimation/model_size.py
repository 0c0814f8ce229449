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
How large is the object, if one camera cannot tell? Two views with a known step between them can.

A model that is too large by the share s puts the object too far away by s, in exactly the same
image: K (R (1 + s) X + (1 + s) t) is the same point as K (R X + t). Perspective tells size over
distance, and nothing else. Two cameras a known distance apart, or one camera that moved by a known
distance, add metres. Each finds the object (1 + s) t_i away. So with the known motion X_2 = R X_1
+ t of points from the first camera's frame to the second's

    t_2 - R t_1 = (1 + s) t,

three equations for one unknown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.projective import cross_matrix

__all__ = ['ModelSize', 'size_of_model']

#: Beyond this many standard deviations the model has another size than the object.
_SIGMAS = 3.0


@dataclass(frozen=True)
class ModelSize:
    """
    By how much a model is too large.

    Attributes
    ----------
    share, sigma : float
        0.1: the model is 10 % larger than the object; and its standard deviation.

    """

    share: float
    sigma: float

    @property
    def wrong(self) -> bool:
        """Whether the model has another size than the object, by three sigmas."""
        return abs(self.share) > _SIGMAS * self.sigma

    def text(self) -> str:
        """Return one sentence."""
        amount = f'{100 * abs(self.share):.1f} ± {100 * self.sigma:.1f} %'
        if self.wrong:
            side = 'large' if self.share > 0 else 'small'
            return f'The model is {amount} too {side}; distances are wrong by as much.'
        return f'The model is as large as the object, within {amount}.'


def size_of_model(first: tuple[ArrayLike, ArrayLike], second: tuple[ArrayLike, ArrayLike],
                  second_from_first: ArrayLike,
                  covariances: tuple[ArrayLike, ArrayLike, ArrayLike]) -> ModelSize:
    """
    Find the size of an object that two cameras see, or one camera before and after a known move.

    Parameters
    ----------
    first, second : (ndarray (3, 3), ndarray (3,))
        Pose of the object in the two camera frames, as they were tracked.
    second_from_first : array_like, shape (3, 4)
        Takes points from the first camera's frame to the second's; metres.
    covariances : (ndarray (6, 6), ndarray (6, 6), ndarray (6, 6))
        Of both poses and of the known motion, (tx ty tz rx ry rz), as `TrackedFrame` has them:
        turns on the camera's side.

    Returns
    -------
    ModelSize
        With an infinite sigma where the camera was not displaced.

    Raises
    ------
    ArgumentError
        If the motion is no (3, 4) array.

    """
    motion = np.asarray(second_from_first, float)
    if motion.shape != (3, 4) or not np.isfinite(motion).all():
        raise ArgumentError('The motion between two cameras is a (3, 4) array of finite numbers.')
    R, t = motion[:, :3], motion[:, 3]
    near, far = np.asarray(first[1], float), np.asarray(second[1], float)
    step = far - R @ near
    one, two, known = (np.asarray(c, float) for c in covariances)
    # a turn of the known motion moves R t_1
    lever = np.hstack([np.eye(3), -cross_matrix(R @ near)])
    spread = two[:3, :3] + R @ one[:3, :3] @ R.T + lever @ known @ lever.T
    weight = np.linalg.inv(spread)
    known_by = float(t @ weight @ t)
    if known_by < 1e-12:
        return ModelSize(0.0, float('inf'))
    return ModelSize(float(t @ weight @ step) / known_by - 1, known_by**-0.5)
