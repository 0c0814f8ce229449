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
"""What is seen at one instant of a recording, by one camera or by several."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.pipeline.frame_source import Frame


@dataclass(frozen=True)
class Instant:
    """
    The images of one instant.

    Attributes
    ----------
    index : int
        Count in the recording, from 0.
    frames : tuple of Frame or None
        Of each camera; at least one is there.
    stamp_ns : int or None
        None where images have no clock.
    depth : ndarray, shape (H, W), or None
        Of a single camera: metres along the optical axis, registered to the image.

    """

    index: int
    frames: tuple[Frame | None, ...]
    stamp_ns: int | None
    depth: np.ndarray | None = None

    @property
    def first(self) -> Frame:
        """The image of the first camera that has one."""
        return next(frame for frame in self.frames if frame is not None)
