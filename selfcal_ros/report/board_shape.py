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
"""What a calibration says of the shape of its board, for programs and for the figure."""

from __future__ import annotations

from typing import Any

from selfcal_ros.calibration.bundle.object_bend import BEND_NAMES
from selfcal_ros.calibration.result import Calibration

#: Findings that tell the shape of a board.
SHAPES = ('board_bent', 'board_flat')


def board_shape(result: Calibration) -> dict[str, Any] | None:
    """
    Return what was found of a board's shape.

    Parameters
    ----------
    result : Calibration

    Returns
    -------
    dict or None
        'bent' (whether the images show it), 'bend_m' (from the lowest to the highest point, with
        its 'value' and 'sigma'), 'unknowns_m' (by `BEND_NAMES`: 'value' and 'sigma') and, of a
        flat board, 'limit_m', the bend that would have shown. None where no board was free to
        bend.

    """
    found = next((one for one in result.findings if one.kind in SHAPES), None)
    if found is None:
        return None
    told = found.values
    shape = {'bent': found.kind == 'board_bent',
             'bend_m': {name: value / 1e3 for name, value in told['bend_mm'].items()},
             'unknowns_m': {name: {'value': value, 'sigma': sigma} for name, value, sigma in zip(
                 BEND_NAMES, told['unknowns_m'], told['sigmas_m'])}}
    return shape | ({'limit_m': told['limit_mm'] / 1e3} if 'limit_mm' in told else {})
