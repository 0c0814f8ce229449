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
"""When a recording is long, and how much of it is followed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from selfcal_ros.pipeline.calibrate_input import CalibrationSettings
    from selfcal_ros.pipeline.frame_source import FrameSource

#: Motions whose images may come from anywhere in the recording.
_MOTIONS = ('auto', 'planar', 'general', 'rotation')


@dataclass(frozen=True)
class LongRecordings:
    """
    When a recording is long, and what is followed of it.

    Attributes
    ----------
    least_images : int
        Shorter recordings are followed image by image.
    glances : int
        Pairs of images that are compared, evenly spaced.
    images : int
        Images that are followed at most.
    longest : int
        Images of a segment at most.
    way : float
        How far the image moves in a segment at most, in its diagonals.
    segments : int
        Segments at most.
    whole : int
        Where no segment calibrates, recordings of so many images are followed from end to end.

    """

    least_images: int = 1500
    glances: int = 1200
    images: int = 1500
    longest: int = 600
    way: float = 2.0
    segments: int = 3
    whole: int = 5000

    def concern(self, source: FrameSource, settings: CalibrationSettings) -> bool:
        """Tell whether a recording is long, and may be looked through in parts."""
        return (source.kind != 'tracks' and source.count is not None
                and source.count > self.least_images and settings.excerpt.every == 1
                and settings.motion in _MOTIONS and settings.mode != 'wide'
                and settings.views is None and settings.translation_frames is None
                and settings.facts.focal != 'varying')
