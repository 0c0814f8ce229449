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
"""Numbers that count or name something: 0.5 and NaN would become others without a word."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import InputError


def whole_numbers(numbers: ArrayLike, what: str) -> np.ndarray:
    """
    Return numbers as integers.

    Parameters
    ----------
    numbers : array_like
        Flattened; below 2^62 in size.
    what : str
        What they are, for the message, in the plural.

    Returns
    -------
    ndarray of int64, shape (N,)

    Raises
    ------
    InputError
        If one of them is not whole.

    """
    try:
        given = np.asarray(numbers).ravel()
        with np.errstate(invalid='ignore'):
            kept = given.astype(np.int64) if given.dtype.kind in 'iuf' else None
    except (TypeError, ValueError):
        kept = None
    if kept is not None and given.size == 0:
        return kept
    with np.errstate(invalid='ignore'):
        same = kept is not None and (kept == given) & (np.abs(given) < 2.0**62)
    if kept is None or not np.all(same):
        odd = '' if kept is None else f', not {given[np.argmin(same)]}'
        raise InputError(f'The {what} must be whole numbers{odd}.')
    return kept
