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
Where the limb of a round part is: the shading beside it draws its edge inwards.

Near the limb the surface turns away as the root of the distance from it, and so does its shading:
I(x) = I(0) + b sqrt(x). A blurred step with such a ramp is steepest inside of the step. How far
inside follows from how much the grey rises beside it, in parts of the step.
"""

from __future__ import annotations

import numpy as np

#: Depths behind the edge between which the rise is taken, pixels; the root of the depth, and so
#: the grey, is half-way at the third.
_NEAR_PX, _FAR_PX, _HALF_WAY_PX = 2.0, 4.0, 2.9
#: The half-way grey may be off by this share of the rise, and by so many grey levels.
_BENT, _NOISE = 0.25, 3.0
#: An edge beside which the grey changes by as much as its step scatters so many times more. On
#: rendered round parts, plain and before blobs, twice at 0.2, three to four times at 0.5.
_WORSE = 4.0
#: Rise over step, and the shift inwards in pixels: computed from the model above, seen by square
#: pixels and the derivative of `edgels`. A blur of 0.7 px more changes it by 0.05 px at the most.
_RISE = np.array([-0.217, -0.112, -0.069, 0.0, 0.054, 0.096, 0.130, 0.180, 0.229, 0.267, 0.308,
                  0.344])
_SHIFT_PX = np.array([-0.202, -0.114, -0.074, 0.0, 0.066, 0.124, 0.175, 0.261, 0.361, 0.455,
                      0.573, 0.705])


def limb_shift(profiles: np.ndarray, offset: np.ndarray, contrast: np.ndarray,
               inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Distance by which edges seem to lie along the normal from the limb, and how it scatters.

    Beside many edges the grey goes on changing: another edge is near, of the pattern or of what
    is behind, and the two are seen as one that lies between. The more it changes, in parts of the
    step, the worse the edge is located.

    Parameters
    ----------
    profiles : ndarray, shape (C, S)
        Grey levels along the normals, a pixel apart, from -(S - 1) / 2 on.
    offset, contrast : ndarray, shape (C, K)
        Of the edges, from `edgels.find_edgels`; NaN where there is none.
    inside : ndarray, shape (C,)
        1 where the normal points into the object, else -1.

    Returns
    -------
    shift : ndarray, shape (C, K)
        To be taken off the offsets, pixels; 0 where the grey beside does not go as the root.
    worse : ndarray, shape (C, K)
        Standard deviation of the edge over that of one between level greys, from 1 on.

    """
    row, inside = np.arange(len(profiles))[:, None], inside[:, None]
    last = profiles.shape[1] - 1

    def grey(depth: float) -> np.ndarray:
        place = np.where(np.isfinite(offset), offset, 0.0) + inside * depth + 0.5 * last
        place = np.clip(place, 0, last - 1e-3)
        low = place.astype(int)
        a, b = profiles[row, low], profiles[row, low + 1]
        grey_there: np.ndarray = a + (place - low) * (b - a)
        return grey_there

    near, middle, far = (grey(depth) for depth in (_NEAR_PX, _HALF_WAY_PX, _FAR_PX))
    rise = far - near
    bent = np.abs(middle - 0.5 * (near + far)) > _BENT * np.abs(rise) + _NOISE
    step = inside * contrast
    share = np.where(bent | (step == 0), 0.0, rise / np.where(step == 0, 1.0, step))
    share = np.where((share < _RISE[0]) | (share > _RISE[-1]), 0.0, share)
    outer = np.abs(grey(-_NEAR_PX) - grey(-_FAR_PX))
    uneven = np.maximum(outer, np.abs(rise)) / np.maximum(np.abs(step), 1.0)
    return (inside * np.interp(share, _RISE, _SHIFT_PX),
            1 + _WORSE * np.minimum(uneven, 1.0))
