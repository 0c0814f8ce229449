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
"""What the data and the facts make of a parameter."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal, TypeAlias

#: Found from the data; held by a fact; or determined by neither.
Status: TypeAlias = Literal['estimated', 'held', 'unobservable']


def unobservable_among(status: Mapping[str, Status], names: Iterable[str]) -> tuple[str, ...]:
    """
    Return those of some parameters that neither the data nor a fact determine.

    Parameters
    ----------
    status : mapping of str to str
    names : iterable of str
        Keys of `status`.

    Returns
    -------
    tuple of str

    """
    return tuple(name for name in names if status[name] == 'unobservable')
