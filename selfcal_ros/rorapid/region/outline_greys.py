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
Which side of an outline is object: by grey levels, along the normals.

Inside and outside of the outline each have a histogram of grey levels. Where the object ends
along a normal is told by their likelihood: grey levels of the object up to there, of the
background beyond (the region term of Tjaden and others 2018, Stoiber and others 2022). An edge of
a pattern inside, or of clutter outside, has the same histogram on both of its sides. So the region
says which edge is the outline, and the edge says where it is; no pixel counts twice.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

#: Grey levels of a bin, as a power of two; bins.
_SHIFT, _BINS = 2, 64
#: Histograms are smoothed by this kernel: noise and slow shading carry over.
_KERNEL = np.array([1, 4, 6, 4, 1], np.float32) / 16
#: Share of the histograms that is always uniform: what was never seen may come.
_UNIFORM = 0.05
#: Pixels so near the outline are learned from neither side; the farthest that are.
_MIXED_PX, _FAR_PX = 2.0, 14.0
#: One pixel says no more than this, nats: neighbours are alike, and histograms are crude.
_MOST_NATS = 1.0
#: An edge whose place is less likely by a nat seems so much farther away, pixels; at the most.
_PX_PER_NAT, _MOST_PX = 2.0, 8.0
#: ... beyond so many nats: the mixed pixels of the edge itself are worth that.
_FREE_NATS = 4.0
#: Share of the histograms that one image renews.
_RENEWED = 0.2
#: Sectors around the object; the weight of a sector's own histogram beside that of them all.
_SECTORS, _LOCAL = 8, 0.8


class OutlineGreys:
    """
    Grey levels beside the outline.

    Shading and background differ around the object, so each sector has its own histograms.

    Attributes
    ----------
    known : bool
        Whether anything was learned.

    """

    def __init__(self) -> None:
        """Start without knowledge."""
        self.forget()

    def forget(self) -> None:
        """Forget what the object and its background look like."""
        self.known = False
        self._sides = np.zeros((2, _SECTORS, _BINS))
        self._table = np.zeros((_SECTORS, 256), np.float32)

    def learn(self, profiles: np.ndarray, pixels: np.ndarray, inside: np.ndarray,
              anew: bool = False) -> None:
        """
        Take in the grey levels beside an outline.

        Parameters
        ----------
        profiles : ndarray, shape (C, S)
            Grey levels along the normals, a pixel apart, with the outline in the middle.
        pixels : ndarray, shape (C, 2)
            Of the outline.
        inside : ndarray, shape (C,)
            1 where the normal points into the object, -1 where out of it, else 0.
        anew : bool
            Forget what was learned before.

        """
        place = np.arange(profiles.shape[1]) - profiles.shape[1] // 2
        depth = place * inside[:, None]
        far = (np.abs(depth) > _MIXED_PX) & (np.abs(depth) < _FAR_PX)
        bins = (profiles.astype(np.uint8) >> _SHIFT) + _BINS * _sector(pixels)[:, None]
        share = _RENEWED if self.known and not anew else 1.0
        for k, side in enumerate((far & (depth > 0), far & (depth < 0))):
            now = np.bincount(bins[side], minlength=_SECTORS * _BINS).reshape(_SECTORS, _BINS)
            self._sides[k] += share * (now - self._sides[k])
        self.known = self.known or bool(far.any())
        smooth = ndimage.convolve1d(self._sides, _KERNEL, axis=2, mode='constant')
        every = smooth.sum(axis=1, keepdims=True)
        every /= np.maximum(every.sum(axis=2, keepdims=True), 1e-9)
        count = smooth.sum(axis=2, keepdims=True)
        mixed = np.where(count > 0, _LOCAL, 0.0) * smooth / np.maximum(count, 1e-9)
        mixed = mixed + np.where(count > 0, 1 - _LOCAL, 1.0) * every
        inner, outer = (1 - _UNIFORM) * mixed + _UNIFORM / _BINS
        nats = np.clip(np.log(inner / outer), -_MOST_NATS, _MOST_NATS)
        self._table = np.repeat(nats, 1 << _SHIFT, axis=1).astype(np.float32)

    def penalty(self, profiles: np.ndarray, pixels: np.ndarray, inside: np.ndarray,
                offset: np.ndarray) -> np.ndarray:
        """
        Pixels by which edges seem farther away, for the outline is not likely there.

        Parameters
        ----------
        profiles : ndarray, shape (C, S)
            Along the normals, a pixel apart, from -(S - 1) / 2 on.
        pixels : ndarray, shape (C, 2)
            Of the middle of each.
        inside : ndarray, shape (C,)
            1 where the normal points into the object, -1 where out of it, 0 where no background
            is beside: there the penalty is 0.
        offset : ndarray, shape (C, K)
            Of the edges, pixels along the normal; what is not finite stays 0.

        Returns
        -------
        ndarray, shape (C, K)

        """
        if not self.known or not len(profiles):
            return np.zeros(offset.shape)
        nats = self._table[_sector(pixels)[:, None], profiles.astype(np.uint8)]
        # likelihood that the outline lies between sample k - 1 and sample k, up to a constant
        total = np.zeros((len(nats), nats.shape[1] + 1), np.float32)
        np.cumsum(-nats, axis=1, out=total[:, 1:])
        total *= inside[:, None].astype(np.float32)
        best = total.max(axis=1, keepdims=True)
        place = np.where(np.isfinite(offset), offset, 0.0) + 0.5 * nats.shape[1]
        place = np.clip(place, 0, nats.shape[1] - 1e-3)
        low = place.astype(int)
        row = np.arange(len(nats))[:, None]
        there = total[row, low] + (place - low) * (total[row, low + 1] - total[row, low])
        doubt = np.clip(_PX_PER_NAT * (best - there - _FREE_NATS), 0, _MOST_PX)
        doubtful: np.ndarray = doubt * (inside != 0)[:, None]
        return doubtful


def _sector(pixels: np.ndarray) -> np.ndarray:
    """Sector (C,) of pixels (C, 2) about their middle."""
    x, y = (pixels - 0.5 * (pixels.min(axis=0) + pixels.max(axis=0))).T
    turn = np.arctan2(y, x) / (2 * np.pi)
    sector: np.ndarray = np.floor(turn * _SECTORS).astype(int) % _SECTORS
    return sector
