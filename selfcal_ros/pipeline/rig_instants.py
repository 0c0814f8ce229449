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
The images of other cameras at the instants of a first one, by stamps or by names.

Cameras that are triggered together have images of the same instants. Of a camera with a clock of
its own the nearest image is taken, and those before and after it. With these, positions can be
moved to the instant.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from selfcal_ros.features.at_instant import ImagesBeside
from selfcal_ros.pipeline.frame_source import Frame, FrameSource
from selfcal_ros.pipeline.simultaneous import SAME_NS

#: Stamps that differ by less are equal, nanoseconds.
_EQUAL_NS = 100_000
#: Between images that are further apart a track is no smooth curve, nanoseconds.
SPAN_NS = 150_000_000


@dataclass(frozen=True)
class AtInstants:
    """
    Images of one camera at instants of the first.

    Attributes
    ----------
    images : dict of int to ndarray of uint8, shape (H, W)
        The nearest image, by the first camera's index.
    beside : dict of int to ImagesBeside
        Of a camera with a clock of its own, what lies around the instant; else empty.
    apart_ms : float
        How far the nearest images are from the instants (median); 0 without stamps.

    """

    images: dict[int, np.ndarray]
    beside: dict[int, ImagesBeside]
    apart_ms: float

    @property
    def own_clock(self) -> bool:
        """Whether the camera is not triggered with the first."""
        return bool(self.beside)


def at_instants(source: FrameSource, chosen: dict[int, tuple[int, str]], count: int | None,
                timed: bool) -> AtInstants:
    """
    Find the images of a camera at the instants of the first one.

    Parameters
    ----------
    source : FrameSource
    chosen : dict of int to (int, str)
        Stamp and name of the first camera's images, by their index.
    count : int or None
        Images of the first camera. Where names say nothing, those of as many are paired by their
        places in the folders.
    timed : bool
        Whether all cameras have stamps.

    Returns
    -------
    AtInstants

    """
    if timed:
        return _by_stamps(source, chosen)
    by_name = {Path(name).stem: index for index, (_, name) in chosen.items()}
    found = {}
    for frame in source:
        at = by_name.get(Path(frame.name).stem)
        if at is not None:
            found[at] = frame.image
    if not found and source.count == count:
        found = {frame.index: frame.image for frame in source.only(chosen)}
    return AtInstants(found, {}, 0.0)


def _by_stamps(source: FrameSource, chosen: dict[int, tuple[int, str]]) -> AtInstants:
    """Find the nearest images, and those before and after them."""
    indices = list(chosen)
    stamps = np.array([stamp for stamp, _ in chosen.values()])
    apart_ns = np.full(len(stamps), np.inf)
    nearest: dict[int, tuple[np.ndarray, ImagesBeside]] = {}
    for before, frame, after in _with_neighbours(source):
        late_ns = frame.stamp_ns - stamps
        at = int(np.argmin(np.abs(late_ns)))
        if abs(late_ns[at]) < min(apart_ns[at], SPAN_NS):
            nearest[indices[at]] = frame.image, ImagesBeside(late_ns[at] / 1e9, tuple(
                ((one.stamp_ns - stamps[at]) / 1e9, one.image) for one in (before, after)
                if one is not None and 0 < abs(one.stamp_ns - frame.stamp_ns) <= SPAN_NS
                and abs(late_ns[at]) > _EQUAL_NS))
        # another instant may be nearest to the images around this one
        apart_ns = np.minimum(apart_ns, np.abs(late_ns))
    apart_ms = float(np.median(apart_ns)) / 1e6
    if apart_ms * 1e6 <= SAME_NS:
        return AtInstants({at: image for at, (image, beside) in nearest.items()
                           if abs(beside.late_s) * 1e9 <= SAME_NS}, {}, apart_ms)
    between = {at: beside for at, (_, beside) in nearest.items()
               if any(late * beside.late_s < 0 for late, _ in beside.others)}
    images = {at: image for at, (image, beside) in nearest.items()
              if at in between or abs(beside.late_s) * 1e9 <= _EQUAL_NS}
    return AtInstants(images, between, apart_ms)


def _with_neighbours(source: FrameSource) -> Iterator[tuple[Frame | None, Frame, Frame | None]]:
    """Iterate over frames in the order of the recording, with those before and after each."""
    before = frame = None
    for after in source:
        if frame is not None:
            yield before, frame, after
        before, frame = frame, after
    if frame is not None:
        yield before, frame, None
