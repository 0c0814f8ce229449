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
"""What the images of one instant gave, of all cameras of a rig."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.rorapid.tracked_frame import TrackedFrame


@dataclass(frozen=True)
class RigFrame:
    """
    What the images of one instant gave.

    Attributes
    ----------
    tracked : TrackedFrame
        Pose and covariance in the frame of the rig, which is that of the first camera. What it
        says of control points is of the first camera that had an image.
    views : tuple of TrackedFrame or None
        Of each camera, in its own frame and by itself; None without an image.
    sees : tuple of bool
        Which cameras the pose is from.

    """

    tracked: TrackedFrame
    views: tuple[TrackedFrame | None, ...]
    sees: tuple[bool, ...]


def unseen(frame: TrackedFrame) -> TrackedFrame:
    """Return a frame as if nothing had been looked for."""
    nothing = np.zeros_like(frame.found)
    return replace(frame, edge_px=np.full_like(frame.edge_px, np.nan), found=nothing,
                   rejected=nothing, hidden=~nothing, texture_px=frame.texture_px[:0],
                   rms_px=float('nan'), share_found=0.0, innovation=float('nan'))
