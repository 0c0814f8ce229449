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
"""Images of several cameras, brought together by their stamps; what is missing is left out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from selfcal_ros.pipeline.file_sources import natural_key
from selfcal_ros.pipeline.frame_source import Frame, FrameSource
from selfcal_ros.pipeline.stamp_order import stamp_order, StampOrder

#: Stamps of one instant differ by no more than this, nanoseconds.
SAME_NS = 3_000_000
#: An image may come so much later than that of another camera, nanoseconds.
WAIT_NS = 100_000_000
#: So many instants wait at most, whatever their stamps say: `WAIT_NS` at 300 Hz.
MOST_WAITING = 30


class StampGroups:
    """
    Gathers what cameras send, whichever comes first.

    An instant waits until all have sent, or the newest image is `WAIT_NS` younger. No more than
    `MOST_WAITING` wait. A camera that is `_GONE` images behind is not waited for. What is older
    than an instant that is done is dropped.

    Parameters
    ----------
    count : int
        Number of cameras.

    Attributes
    ----------
    late : int
        Images that were dropped.

    """

    #: After so many instants without an image nobody waits for a camera.
    _GONE = 3

    def __init__(self, count: int) -> None:
        """Start with nothing."""
        self._count = count
        self.late = 0
        self.forget()

    def forget(self) -> None:
        """Begin anew, as when time jumps back."""
        self._waiting: list[tuple[int, list[Any]]] = []
        self._done_ns: int | None = None
        self._missed = [0] * self._count

    def add(self, which: int, stamp_ns: int, image: Any) -> list[tuple[int, list[Any]]]:
        """
        Take an image.

        Parameters
        ----------
        which : int
            Number of the camera.
        stamp_ns : int
        image : object

        Returns
        -------
        list of (int, list)
            What is complete now, or waited long enough, in the order of time: the first stamp,
            and an image or None of each camera.

        """
        order = stamp_order(stamp_ns, self._done_ns)
        if order is StampOrder.JUMPED_BACK:
            self.forget()
        elif order is StampOrder.OVERTAKEN or stamp_ns == self._done_ns:
            self.late += 1
            return []
        group = next((images for stamp, images in self._waiting
                      if abs(stamp - stamp_ns) <= SAME_NS and images[which] is None), None)
        if group is None:
            group = [None] * self._count
            self._waiting.append((stamp_ns, group))
            self._waiting.sort(key=lambda one: one[0])
        group[which] = image
        self._missed[which] = 0
        done = []
        while self._waiting and self._is_ready():
            stamp, images = self._waiting.pop(0)
            self._done_ns = stamp
            for k, one in enumerate(images):
                self._missed[k] += one is None
            done.append((stamp, images))
        return done

    def _is_ready(self) -> bool:
        """Whether the oldest instant is complete, or no longer waited for."""
        images = self._waiting[0][1]
        if (self._waiting[-1][0] - self._waiting[0][0] >= WAIT_NS
                or len(self._waiting) > MOST_WAITING):
            return True
        later = [any(other[k] is not None for _, other in self._waiting[1:])
                 for k in range(self._count)]
        return all(one is not None or again or missed >= self._GONE
                   for one, again, missed in zip(images, later, self._missed))


def simultaneous(sources: Sequence[FrameSource]) -> Iterator[list[Frame | None]]:
    """
    Iterate over the instants of several recordings.

    Recordings with stamps are merged by them. Images of folders belong together by their names,
    or by their places where names say nothing.

    Parameters
    ----------
    sources : sequence of FrameSource

    Yields
    ------
    list of Frame or None
        Of each source; None where it has no image of this instant.

    """
    if any(source.clock == 'nominal' for source in sources):
        yield from _by_name(sources)
        return
    streams = [iter(source) for source in sources]
    heads: list[Frame | None] = [next(stream, None) for stream in streams]
    while any(head is not None for head in heads):
        first = min(head.stamp_ns for head in heads if head is not None)
        now = [head if head is not None and head.stamp_ns - first <= SAME_NS else None
               for head in heads]
        yield now
        heads = [head if one is None else next(stream, None)
                 for head, one, stream in zip(heads, now, streams)]


def _by_name(sources: Sequence[FrameSource]) -> Iterator[list[Frame | None]]:
    """Images of one name are of one instant; without any such name those of one place."""
    streams = [iter(source) for source in sources]
    heads: list[Frame | None] = [next(stream, None) for stream in streams]
    named = bool(set.intersection(*(
        {Path(name).stem for name in source.names} for source in sources)))
    while any(head is not None for head in heads):
        now = list(heads)
        if named:
            # folders are in the order of numbers: frame9 before frame10
            first = min((Path(head.name).stem for head in heads if head is not None),
                        key=natural_key)
            now = [head if head is not None and Path(head.name).stem == first else None
                   for head in heads]
        yield now
        heads = [head if one is None else next(stream, None)
                 for head, one, stream in zip(heads, now, streams)]
