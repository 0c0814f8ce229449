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
"""Memory that is freed goes back to the system, so that stages do not add up."""

from __future__ import annotations

from contextlib import suppress
import ctypes

#: Setting of `mallopt` (malloc.h of glibc): how many stocks of freed memory threads may keep.
_ARENA_MAX, _ARENAS = -8, 2


def return_freed_memory() -> None:
    """
    Let the C library return what was freed, where it can be told to.

    By itself glibc keeps it for later use, in a stock for every few threads: hundreds of megabytes
    after the features of some hundred images.
    """
    with suppress(AttributeError, OSError):
        library = ctypes.CDLL(None)
        library.mallopt(_ARENA_MAX, _ARENAS)
        library.malloc_trim(0)
