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
"""Images are announced before their tracks; of both messages the first is answered."""

from __future__ import annotations

from collections import deque

#: So many images wait for their other message at most.
_MOST = 60


def announcements_of(tracks: str) -> str:
    """Return the topic that tells of images whose points will follow on the topic of tracks."""
    return f'{tracks}/announced'


class OncePerImage:
    """
    Tells which of two messages of an image came first, whatever order they come in.

    Images are known by their stamps, which need not differ: a driver without a clock sends zeros.

    Examples
    --------
    >>> messages = OncePerImage()
    >>> messages.is_first('announced', 10), messages.is_first('tracks', 10)
    (True, False)
    >>> messages.is_first('tracks', 20), messages.is_first('announced', 20)
    (True, False)
    >>> messages.is_first('tracks', 0), messages.is_first('tracks', 0)
    (True, True)

    """

    def __init__(self) -> None:
        self._alone: deque[tuple[str, int]] = deque(maxlen=_MOST)

    def is_first(self, kind: str, stamp_ns: int) -> bool:
        """Take note of a message; tell whether none of the other kind waited for it."""
        for other in self._alone:
            if other[1] == stamp_ns and other[0] != kind:
                self._alone.remove(other)
                return False
        self._alone.append((kind, stamp_ns))
        return True
