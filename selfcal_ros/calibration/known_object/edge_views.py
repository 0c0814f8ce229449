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
"""Edgels of an object with known edges, as they were found in several images."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.edge_rows import EdgeRows
from selfcal_ros.calibration.bundle.object_model import KnownEdges
from selfcal_ros.calibration.bundle.priors import Priors
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.errors import InputError

#: A view keeps its pose only with so many edgels of so many primitives.
MIN_EDGELS, MIN_PRIMITIVES = 12, 4


@dataclass(frozen=True)
class EdgeViews:
    """
    Edgels of an object with known edges in several images.

    Parameters
    ----------
    frame : array_like of int, shape (N,)
        Image of each edgel, ascending.
    point, primitive : array_like of int, shape (N,)
        Control point and primitive that it belongs to, the same in all images.
    points, tangents : array_like, shape (N, 3)
        The control point and the direction of its edge, object coordinates, metres.
    xy : array_like, shape (N, 2)
        Where the edgel was found, pixels.
    cam_from_object : array_like, shape (V, 3, 4)
        Approximate pose in each image, in the order of the frames.
    image_size : (int, int)
    rows : EdgeRows, optional
        How far the edges move until they are read; without, `xy` is when the middle line is read.

    Raises
    ------
    InputError
        If shapes differ or a number is not finite.

    """

    frame: np.ndarray
    point: np.ndarray
    primitive: np.ndarray
    points: np.ndarray
    tangents: np.ndarray
    xy: np.ndarray
    cam_from_object: np.ndarray
    image_size: tuple[int, int]
    rows: EdgeRows | None = None

    def __post_init__(self) -> None:
        """Check the arrays."""
        for name in ('frame', 'point', 'primitive'):
            object.__setattr__(self, name, np.asarray(getattr(self, name), np.int64).ravel())
        for name, width in (('points', 3), ('tangents', 3), ('xy', 2)):
            object.__setattr__(self, name,
                               np.asarray(getattr(self, name), float).reshape(-1, width))
        poses = np.asarray(self.cam_from_object, float).reshape(-1, 3, 4)
        object.__setattr__(self, 'cam_from_object', poses)
        lengths = {len(getattr(self, name)) for name in ('frame', 'point', 'primitive', 'points',
                                                         'tangents', 'xy')}
        if len(lengths) != 1 or len(np.unique(self.frame)) != len(poses) or \
                (np.diff(self.frame) < 0).any():
            raise InputError('Edge views need arrays of one length, frames in ascending order, '
                             'and one pose a frame.')
        if not all(np.isfinite(array).all() for array in (self.points, self.tangents, self.xy,
                                                          poses)):
            raise InputError('Edge views hold a number that is not finite.')

    def __len__(self) -> int:
        """Count the edgels."""
        return len(self.frame)

    @property
    def frames(self) -> np.ndarray:
        """The images, ascending."""
        return np.unique(self.frame)

    def select(self, mask: np.ndarray) -> EdgeViews:
        """Keep the edgels in mask, of images that keep enough of them."""
        frames, view = np.unique(self.frame, return_inverse=True)
        counts = np.bincount(view[mask], minlength=len(frames))
        pairs = np.unique(np.column_stack([view[mask], self.primitive[mask]]), axis=0)
        kinds = np.bincount(pairs[:, 0], minlength=len(frames)) if len(pairs) else counts
        good = (counts >= MIN_EDGELS) & (kinds >= MIN_PRIMITIVES)
        mask = mask & good[view]
        return replace(self, cam_from_object=self.cam_from_object[good],
                       rows=self.rows and self.rows.select(mask),
                       **{name: getattr(self, name)[mask] for name in (
                           'frame', 'point', 'primitive', 'points', 'tangents', 'xy')})

    def read_with(self, line_delay_s: float) -> EdgeViews:
        """Return the edgels where the edges were when the middle line was read."""
        if self.rows is None:
            return self
        return replace(self, xy=self.rows.back(self.xy, line_delay_s), rows=None)

    def bundle(self, priors: Priors, sigma_px: float) -> Bundle[ObjectState]:
        """Return the adjustment of these edgels; sigma_px is that of a distance from an edge."""
        _, view = np.unique(self.frame, return_inverse=True)
        return Bundle(KnownEdges(self.points, self.tangents, self.rows), view, view, self.xy,
                      priors=priors, sigma_px=sigma_px)
