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
"""What is remembered of an object's texture: pictures of plane faces, or views of a surface."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.region.region_of_interest import Region
from selfcal_ros.rorapid.texture.surface_views import SurfaceViews
from selfcal_ros.rorapid.texture.texture_memory import TextureMatches, TextureMemory
from selfcal_ros.rorapid.visibility.visible_geometry import VisibleGeometry


class AppearanceModel(Protocol):
    """What an object looked like, as far as its texture tells."""

    @property
    def known(self) -> bool:
        """Whether anything is remembered."""

    @property
    def patterned(self) -> bool:
        """Whether there are corners by which the object is known."""

    def forget(self) -> None:
        """Drop all that was remembered."""

    def follow(self, region: Region, state: ObjectPose, levels: int = 3,
               much_hidden: bool = False) -> TextureMatches | None:
        """Follow remembered corners into an image, from a predicted pose; None without any."""

    def judge(self, matches: TextureMatches, agree: np.ndarray) -> None:
        """Remember which corners agreed (N,) with a pose that is recognised."""

    def learn(self, region: Region, state: ObjectPose, confirmed: bool,
              covariance: np.ndarray) -> None:
        """Take what an image shows at a measured pose of covariance (6, 6) (theta, Delta)."""

    def glance(self, region: Region, state: ObjectPose, covariance: np.ndarray) -> None:
        """Take what an image shows at a pose that is not confirmed, if nothing is known yet."""

    def disown(self) -> None:
        """Drop what was taken at poses that were not confirmed."""


def appearance_of(visible: VisibleGeometry, centre: np.ndarray, projection: Projection,
                  most_points: int) -> AppearanceModel:
    """
    Return a memory, still empty, for the texture of a model.

    Parameters
    ----------
    visible : VisibleGeometry
    centre : ndarray, shape (3,)
        Origin of the tracker's object frame.
    projection : Projection
        Of a camera without distortion.
    most_points : int
        Corners to follow at a time.

    Returns
    -------
    AppearanceModel

    """
    if visible.surface is not None:
        return SurfaceViews(visible.surface, centre, projection, most_points)
    return TextureMemory(visible, centre, projection, most_points)
