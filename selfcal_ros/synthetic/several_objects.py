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
"""Several objects that move beside each other before one camera, with exact truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from selfcal_ros.synthetic.object_shapes import SolidObject

from selfcal_ros.synthetic.objects import ObjectRecording, tracked_object
from selfcal_ros.synthetic.render import quantise, Renderer, Scene

#: Objects are seen so much smaller than an only one, and stand so far apart, in their diameters.
_FARTHER, _APART = 1.5, 1.25


@dataclass(frozen=True)
class ObjectsRecording:
    """
    Recordings of single objects, put before one wall.

    Attributes
    ----------
    objects : tuple of ObjectRecording
        With the true poses; the wall and the camera are those of the first.

    """

    objects: tuple[ObjectRecording, ...]

    def frames(self) -> list[np.ndarray]:
        """Render all images, (height, width) uint8."""
        first, wall = self.objects[0], len(self.objects)
        surfaces = [replace(surface, body=wall if surface.body else body)
                    for body, one in enumerate(self.objects) for surface in one.surfaces
                    if body == 0 or not surface.body]
        renderer = Renderer(Scene(surfaces), first.camera, first.supersampling)
        images = []
        for k in range(len(first.cam_from_world)):
            poses = [one.cam_from_world[k] for one in self.objects] + [first.poses(k)[1]]
            grey = renderer.intensity(np.stack(poses))
            images.append(quantise(grey, np.random.default_rng([first.seed, k]),
                                   first.noise_sigma))
        return images


def objects_beside(shapes: Sequence[str | SolidObject], views: int, **kwargs: Any,
                   ) -> ObjectsRecording:
    """
    Move objects beside each other before a fixed camera.

    Parameters
    ----------
    shapes : sequence of str or SolidObject
        See `tracked_object`.
    views : int
    **kwargs
        Of `tracked_object`, of all of them.

    Returns
    -------
    ObjectsRecording

    """
    made = [tracked_object(views, shape, **kwargs) for shape in shapes]
    aside = np.arange(len(made)) - (len(made) - 1) / 2
    across_m = max(one.model.diameter_m for one in made if one.model is not None)
    placed = []
    for one, place in zip(made, aside):
        poses = one.cam_from_world.copy()
        poses[:, 2, 3] *= _FARTHER
        poses[:, 0, 3] += _APART * place * across_m
        placed.append(replace(one, cam_from_world=poses))
    return ObjectsRecording(tuple(placed))
