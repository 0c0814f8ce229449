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
"""The lens models of ROS, and the coefficients that a message or a file may have."""

from __future__ import annotations

import numpy as np

from selfcal_ros.errors import ArgumentError

#: Lens models of ROS's CameraInfo, and how many coefficients a message or a file may have.
ROS_COEFFICIENTS = {'plumb_bob': (1, 2, 3, 4, 5), 'rational_polynomial': (8,), 'equidistant': (4,)}


def ros_distortion(model: str, values: np.ndarray) -> np.ndarray:
    """
    Check the distortion of a CameraInfo or of a camera file of ROS.

    Parameters
    ----------
    model : str
    values : ndarray, shape (k,)
        None at all means no distortion; zeros after the model's own are dropped.

    Returns
    -------
    ndarray

    Raises
    ------
    ArgumentError
        If ROS has no such model, or not with so many coefficients.

    """
    if model not in ROS_COEFFICIENTS:
        raise ArgumentError(f'The distortion model {model!r:.40} is not supported; '
                            f'{", ".join(ROS_COEFFICIENTS)} are.')
    counts = ROS_COEFFICIENTS[model]
    if model == 'rational_polynomial' and values.size < 8:
        # a rational polynomial whose denominator is 1 is a plumb bob
        counts = (*ROS_COEFFICIENTS['plumb_bob'], *counts)
    kept = values[:max(counts)]
    if values.size and kept.size not in counts and kept.any() or values[len(kept):].any():
        raise ArgumentError(f'The distortion model {model} has {counts[-1]} coefficients, not '
                            f'{values.size}.')
    return kept
