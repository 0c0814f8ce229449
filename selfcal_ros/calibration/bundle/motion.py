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
"""Kinds of motion: how far views may leave a plane, and what they share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.view_effects import ViewEffects
from selfcal_ros.calibration.bundle.zoom import ZoomModel


@dataclass(frozen=True)
class MotionModel:
    """
    What may change from view to view: how far the motion may leave the plane, and the zoom.

    Attributes
    ----------
    tilt_sigma_rad, height_sigma : float
        Standard deviations of the out-of-plane rotation and translation of each view, the latter
        in units of the root mean square distance between successive views. 0: exactly planar;
        infinity: general motion.
    parallel : tuple of int
        Views that are stated to share one orientation: related by pure translation.
    fixed_centre : bool
        The camera only turns; the points are directions.
    fixed_pivot : bool
        The camera turns about a fixed point that is not its centre, such as the axes of a
        pan-tilt head: all views share one translation, from that point to the camera.
    zoom : ZoomModel, optional
        How the focal length varies; None: it is constant.
    shift : ViewEffects, optional
        How far images are shifted, each by itself (`image_shift`); None: they are not.

    """

    tilt_sigma_rad: float = 0.0
    height_sigma: float = 0.0
    parallel: tuple[int, ...] = ()
    fixed_centre: bool = False
    fixed_pivot: bool = False
    zoom: ZoomModel | None = None
    shift: ViewEffects | None = None

    def of_views(self, views: np.ndarray) -> MotionModel:
        """Return the model for some of the views, which become 0, 1, 2, ..."""
        place = {int(view): k for k, view in enumerate(views)}
        return replace(self, parallel=tuple(place[v] for v in self.parallel if v in place),
                       zoom=self.zoom and self.zoom.of_views(views))

    def with_images_of(self, other: MotionModel) -> MotionModel:
        """Return this motion of a camera whose images vary as those of another model."""
        return replace(self, zoom=other.zoom, shift=other.shift)

    @property
    def keeps_plane(self) -> bool:
        """Tell whether there is a plane of motion at all, exact or not."""
        return bool(np.isfinite(self.tilt_sigma_rad))

    @property
    def goes_anywhere(self) -> bool:
        """Tell whether the camera's centre has a path, along which depths show."""
        return not (self.fixed_centre or self.fixed_pivot)

    def is_more_uneven_than(self, other: MotionModel) -> bool:
        """Tell whether it lets the camera leave the plane further."""
        return (self.tilt_sigma_rad > other.tilt_sigma_rad
                or self.height_sigma > other.height_sigma)


#: Exactly in one plane.
PLANAR = MotionModel()
#: How far a vehicle may leave the plane, before it is told apart from an exact plane: one
#: degree, and two hundredths of the distance between views.
NEARLY_PLANAR = MotionModel(np.radians(1.0), 0.02)
#: Motion that leaves the plane freely.
GENERAL = MotionModel(np.inf, np.inf)
#: A camera that only turns.
ROTATION = MotionModel(np.inf, np.inf, fixed_centre=True)
#: A camera that turns about a fixed point beside it.
PIVOT = MotionModel(np.inf, np.inf, fixed_pivot=True)
