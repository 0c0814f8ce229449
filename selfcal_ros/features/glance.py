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
A glance at a recording: how the image moves between two successive images, cheaply.

Images are reduced to a few hundred columns, corners are followed from one to the next, and their
flow is split: u(x) = shift + [growth, -roll; roll, growth] (x - centre) + rest. The rest is what
depths and the perspective of a turn leave. All is told in image diagonals, per second.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from selfcal_ros.features.klt import corners, flow
from selfcal_ros.features.mask import ImageMask

#: Images are reduced by a whole number to about this width.
WIDTH_PX = 480
#: Corners aimed at.
CORNERS = 300
#: Fewer corners that can be followed say nothing.
LEAST = 20
#: Displacements below this, in the reduced image, are noise.
STILL_PX = 0.1
#: Cells of the image, along and across, that are counted as covered.
CELLS = (6, 4)


@dataclass(frozen=True)
class Glance:
    """
    What two successive images show.

    Attributes
    ----------
    index : int
        Of the first image in its recording.
    stamp_ns : int
        Of the first image.
    texture : int
        Corners found.
    followed : float
        Share of them that could be followed.
    covered : float
        Share of the image with followed corners.
    speed, fastest : float
        Displacement, median and 90th percentile, image diagonals a second.
    shift : (float, float)
        Mean displacement to the right and down, diagonals a second.
    roll : float
        Turn in the image, radians a second.
    growth : float
        As things that come nearer grow, 1 / s.
    parallax : float
        What else moves, root mean square without the largest tenth, diagonals a second.

    """

    index: int
    stamp_ns: int
    texture: int = 0
    followed: float = 0.0
    covered: float = 0.0
    speed: float = 0.0
    fastest: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    roll: float = 0.0
    growth: float = 0.0
    parallax: float = 0.0


def reduced(grey: np.ndarray) -> np.ndarray:
    """Make an image smaller by a whole number, to about `WIDTH_PX` columns."""
    factor = max(grey.shape[1] // WIDTH_PX, 1)
    if factor == 1:
        return grey
    size = grey.shape[1] // factor, grey.shape[0] // factor
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA)


def glance(index: int, stamp_ns: int, first: np.ndarray, second: np.ndarray, seconds: float,
           mask: ImageMask | None = None) -> Glance:
    """
    Compare two images.

    Parameters
    ----------
    index, stamp_ns : int
        Of the first image.
    first, second : ndarray of uint8, shape (H, W)
    seconds : float
        Time between them.
    mask : ImageMask, optional
        Of the size of the images; corners are looked for within.

    Returns
    -------
    Glance

    """
    before, after = reduced(first), reduced(second)
    xy = corners(before, max(8, int(np.sqrt(before.size / CORNERS))), border_px=8)
    if mask is not None and len(xy):
        scale = first.shape[1] / before.shape[1]
        xy = xy[mask.allows(xy * scale, 0.0)]
    if len(xy) < LEAST:
        return Glance(index, stamp_ns, len(xy))
    there, followed = flow(before, after, xy, 0.5)
    share = float(followed.mean())
    if followed.sum() < LEAST:
        return Glance(index, stamp_ns, len(xy), share)
    xy, motion = xy[followed], (there - xy)[followed]
    diagonal = float(np.hypot(*before.shape))
    cell = (xy / before.shape[::-1] * CELLS).astype(int)
    covered = len(np.unique(cell[:, 0] * CELLS[1] + cell[:, 1])) / (CELLS[0] * CELLS[1])
    middle = xy - np.array(before.shape[::-1]) / 2
    x, y = middle.T
    one, none = np.ones(len(xy)), np.zeros(len(xy))
    A = np.concatenate([np.stack([one, none, x, -y], axis=1), np.stack([none, one, y, x], axis=1)])
    keep = np.ones(len(xy), bool)
    for _ in range(2):
        rows = np.concatenate([keep, keep])
        p = np.linalg.lstsq(A[rows], motion.T.ravel()[rows], rcond=None)[0]
        left = np.linalg.norm((motion.T.ravel() - A @ p).reshape(2, -1), axis=0)
        keep = left <= np.quantile(left, 0.9)
    rate = 1 / max(seconds, 1e-6)
    length = np.linalg.norm(motion, axis=1)
    length[length < STILL_PX] = 0.0
    return Glance(index, stamp_ns, len(followed), share, covered,
                  float(np.quantile(length, 0.5)) / diagonal * rate,
                  float(np.quantile(length, 0.9)) / diagonal * rate,
                  (float(p[0]) / diagonal * rate, float(p[1]) / diagonal * rate),
                  float(p[3]) * rate, float(p[2]) * rate,
                  float(np.sqrt(np.mean(left[keep]**2))) / diagonal * rate)
