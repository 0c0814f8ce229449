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
"""Stamps of a stream: in order, overtaken on the way, or of another run of the stream."""

from __future__ import annotations

from enum import Enum

#: A stamp this much before the newest one is a jump, not a message that was overtaken.
BACKWARD_JUMP_NS = 200_000_000


class StampOrder(Enum):
    """How a stamp follows the newest one before it."""

    #: Not before the newest one, or the first of all.
    IN_ORDER = 'in order'
    #: A little older: the message was overtaken by another, and comes too late.
    OVERTAKEN = 'overtaken'
    #: Much older: time jumped back, as when a bag is played again; tracks begin anew.
    JUMPED_BACK = 'jumped back'


def stamp_order(stamp_ns: int, newest_ns: int | None) -> StampOrder:
    """
    Tell how a stamp follows the newest one.

    Parameters
    ----------
    stamp_ns : int
        Acquisition time of what has come.
    newest_ns : int or None
        The newest stamp before it; None where there was none.

    Returns
    -------
    StampOrder

    """
    if newest_ns is None or stamp_ns >= newest_ns:
        return StampOrder.IN_ORDER
    if newest_ns - stamp_ns < BACKWARD_JUMP_NS:
        return StampOrder.OVERTAKEN
    return StampOrder.JUMPED_BACK
