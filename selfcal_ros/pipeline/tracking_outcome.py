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
"""The summary of tracking an object through a recording, as numbers and as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
import math

import numpy as np

from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState

#: Of several remarks of one kind, so many are told.
MAX_REMARKS = 3


@dataclass
class TrackingRun:
    """
    What a recording gave.

    Attributes
    ----------
    images : int
    by_state : dict of str to int
    stretches : list of (int, int, str)
        Where the object was lost: first image, last image, reason.
    doubts : list of (int, str)
        What seemed wrong with the model, the camera or the start, and from which image on.
    remarks : list of str
        Images, or depth images, that were passed over, and why.
    squares, edgels : float, int
        Squared distances (px²) of the edgels that support the poses, over all images.
    seconds : float
        Time of the tracker alone.
    last_state : str
    description : str
    size_m : tuple of float
        Extents of the model along its axes, metres, where they alone tell distances.
    cameras : dict of str to int
        Of several cameras: in how many images each saw the object.

    """

    images: int = 0
    by_state: dict[str, int] = field(default_factory=dict)
    stretches: list[tuple[int, int, str]] = field(default_factory=list)
    doubts: list[tuple[int, str]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    squares: float = 0.0
    edgels: int = 0
    seconds: float = 0.0
    last_state: str = ''
    description: str = ''
    size_m: tuple[float, ...] = ()
    cameras: dict[str, int] = field(default_factory=dict)

    @property
    def rms_px(self) -> float:
        """Of the edgels that support the poses, pixels."""
        return math.sqrt(self.squares / self.edgels) if self.edgels else math.nan

    @property
    def followed(self) -> bool:
        """Whether the object was still followed at the end."""
        return self.last_state in ('tracking', 'degraded')

    def text(self) -> str:
        """Return the outcome for a person."""
        if not self.images:
            lines = ['Not tracked: none of the images could be used.']
        else:
            seen = sum(self.by_state.get(state, 0) for state in ('tracking', 'degraded'))
            head = (f'Tracked in {seen} of {self.images} images' if self.followed else
                    f'Lost at the end, after {seen} of {self.images} images were tracked')
            states = ', '.join(f'{count} {state}' for state, count in self.by_state.items())
            lines = [f'{head} ({states}).']
            if math.isfinite(self.rms_px):
                lines.append(f'Edges lie {self.rms_px:.2f} px rms from the model; '
                             f'{1000 * self.seconds / self.images:.2f} ms an image.')
            if seen and self.size_m:
                size = ' x '.join(f'{extent:.3g}' for extent in self.size_m)
                lines.append(f'Distances are as true as the size of the model, {size} m: one '
                             'camera cannot tell a larger object farther away.')
        if self.cameras and self.images:
            seen_by = ', '.join(f'{name} in {count}' for name, count in self.cameras.items())
            lines.append(f'The object was seen by {seen_by}.')
        lines += [(f'Lost in image {first}: {reason}' if first == last else
                   f'Lost from image {first} to {last}: {reason}')
                  for first, last, reason in self.stretches[:MAX_REMARKS]]
        if len(self.stretches) > MAX_REMARKS:
            lines.append(f'... and {len(self.stretches) - MAX_REMARKS} times more.')
        lines += [f'From image {first}: {doubt}' for first, doubt in self.doubts[:MAX_REMARKS]]
        lines += self.remarks[:MAX_REMARKS]
        if len(self.remarks) > MAX_REMARKS:
            lines.append(f'... and {len(self.remarks) - MAX_REMARKS} more such images.')
        return '\n'.join(lines)

    def count(self, index: int, tracked: TrackedFrame, sees: Sequence[bool] = ()) -> None:
        """
        Note how an image went, or an instant of several cameras.

        Parameters
        ----------
        index : int
        tracked : TrackedFrame
        sees : sequence of bool
            Which of several cameras see the object.

        """
        for camera, seen in zip(self.cameras, sees):
            self.cameras[camera] += seen
        was_lost = self.last_state == TrackerState.LOST.value
        self.images += 1
        self.squares += float(np.sum(tracked.edge_px[tracked.found]**2))
        self.edgels += int(np.count_nonzero(tracked.found))
        self.last_state = tracked.state.value
        self.by_state[self.last_state] = self.by_state.get(self.last_state, 0) + 1
        if tracked.doubt:
            # the amount is known better and better: the newest sentence of each kind stands
            kind = tracked.doubt.partition(' seems ')[0]
            if self.doubts and self.doubts[-1][1].startswith(kind):
                self.doubts[-1] = self.doubts[-1][0], tracked.doubt
            else:
                self.doubts.append((index, tracked.doubt))
        if tracked.state is TrackerState.LOST:
            # images may be left out on purpose: the one before is the last that was counted
            if was_lost:
                self.stretches[-1] = (self.stretches[-1][0], index, self.stretches[-1][2])
            else:
                self.stretches.append((index, index, tracked.reason))
