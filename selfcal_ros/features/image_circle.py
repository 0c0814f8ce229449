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
"""The circle in which a fisheye lens draws its image, found in the images themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from selfcal_ros.features.first_images import FirstImages
from selfcal_ros.features.mask import ImageMask
from selfcal_ros.findings.finding import Finding

#: The search runs on images of at most this many pixels along the longer side.
_WORK_PX = 800
#: The rim is blurred: what is nearer to it, as a share of the radius, is not used.
_RIM_SHARE, _RIM_PX = 0.015, 3.0
#: A corner of the image brighter than this is not beyond a circle, grey levels.
_BLACKEST = 48.0
#: What lies beyond the circle may reach this far from black to bright, being stray light.
_STRAY = 0.3
#: The rim is where so much of the light just within is left.
_LEFT = 0.15
#: A ray tells of the rim where the scene is at least so bright, from black to bright.
_LEAST_CONTRAST = 0.2
#: The rays from the centre along which the rim is measured.
_RAYS = 720


@dataclass(frozen=True)
class ImageCircle:
    """
    A circle, pixels; the image lies within.

    Attributes
    ----------
    x_px, y_px : float
        Its centre.
    radius_px : float
        Where hardly any light is left.

    """

    x_px: float
    y_px: float
    radius_px: float

    def mask(self, size: tuple[int, int]) -> ImageMask:
        """Return what lies well within, for images of a width and height in pixels."""
        y, x = np.ogrid[:size[1], :size[0]]
        within = self.radius_px - max(_RIM_PX, _RIM_SHARE * self.radius_px)
        return ImageMask(np.hypot(x - self.x_px, y - self.y_px) <= within, 'The image circle')


def find_circle(images: Sequence[np.ndarray]) -> ImageCircle | None:
    """
    Find the circle beyond which all images are black.

    Ordinary images have none. Demanded are: black corners, also after the brightest image; a rim
    that is a circle to within a few pixels where it crosses the image; and nothing but faint
    stray light beyond, the same in all images.

    Parameters
    ----------
    images : sequence of ndarray of uint8, shape (H, W)

    Returns
    -------
    ImageCircle or None

    """
    if not len(images):
        return None
    scale = max(1.0, max(images[0].shape) / _WORK_PX)
    small = [_small(image, scale) for image in images]
    brightest = np.max(small, axis=0)
    black, bright = _levels(brightest)
    if black > _BLACKEST or bright - black < 40:
        return None
    start = _rough_circle(brightest > black + _STRAY * (bright - black))
    circle = start if start is None else _refined(brightest, start, black, bright)
    if circle is None or not _is_clear(small, brightest, circle, black, bright):
        return None
    # the centre of a shrunk pixel lies at the centre of those that it covers
    x, y = scale * (circle[:2] + 0.5) - 0.5
    return ImageCircle(float(x), float(y), float(scale * circle[2]))


def within_circle(images: Sequence[np.ndarray], mask: ImageMask | None,
                  ) -> tuple[ImageMask | None, list[Finding]]:
    """
    Narrow a mask to the circle of the images, where they have one.

    Parameters
    ----------
    images : sequence of ndarray of uint8, shape (H, W)
    mask : ImageMask or None
        What the user allows.

    Returns
    -------
    mask : ImageMask or None
    findings : list of Finding
        One, if there is a circle.

    """
    watch = CircleWatch(len(images))
    findings = [finding for finding in map(watch.see, images) if finding is not None]
    return watch.narrowed(mask), findings


class CircleWatch:
    """
    Looks for the circle in the first images of a stream, and once more where their size changes.

    Parameters
    ----------
    images : int
        So many are looked at together.
    every : int
        Of so many images one is looked at: neighbours in a video show nearly the same.

    """

    def __init__(self, images: int = 6, every: int = 1):
        self._first = FirstImages(images, every)
        self._circle: ImageMask | None = None
        self._narrowed: tuple[ImageMask | None, ImageMask | None, ImageMask | None] = (
            None, None, None)

    def see(self, image: np.ndarray) -> Finding | None:
        """
        Look at the next image (H, W), uint8.

        Returns
        -------
        Finding or None
            The circle, with the image in which it is found; None with every other.

        """
        if image.shape != self._first.shape:
            self._circle = None
        images = self._first.take(image)
        circle = find_circle(images) if images else None
        if circle is None:
            return None
        self._circle = circle.mask((image.shape[1], image.shape[0]))
        return Finding('image_circle', x_px=circle.x_px, y_px=circle.y_px,
                       radius_px=circle.radius_px)

    def narrowed(self, mask: ImageMask | None) -> ImageMask | None:
        """Return a mask narrowed to the circle, or as it is where that leaves nothing."""
        if self._circle is None:
            return mask
        if self._narrowed[0] is not self._circle or self._narrowed[1] is not mask:
            leaves = mask is None or (mask.usable & self._circle.usable).any()
            self._narrowed = (self._circle, mask, self._circle & mask if leaves else mask)
        return self._narrowed[2]


def _small(image: np.ndarray, scale: float) -> np.ndarray:
    """Shrink an image, and take away single bright pixels."""
    if scale > 1:
        size = tuple(int(round(side / scale)) for side in image.shape[::-1])
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return cv2.medianBlur(image, 5)


def _levels(brightest: np.ndarray) -> tuple[float, float]:
    """Return the levels of the darker corners and of the scene."""
    side = max(4, min(brightest.shape) // 40)
    corners = sorted(float(np.median(brightest[rows, columns]))
                     for rows in (slice(side), slice(-side, None))
                     for columns in (slice(side), slice(-side, None)))
    # one corner may hold stray light, or the date
    return corners[2], float(np.percentile(brightest, 75))


def _rough_circle(lit: np.ndarray) -> np.ndarray | None:
    """Fit a circle to the outline of the largest lit part; None if few of its points fit one."""
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(lit.astype(np.uint8))
    if count < 2:
        return None
    largest = 1 + int(statistics[1:, cv2.CC_STAT_AREA].argmax())
    outlines, _ = cv2.findContours((labels == largest).astype(np.uint8), cv2.RETR_EXTERNAL,
                                   cv2.CHAIN_APPROX_NONE)
    points = np.concatenate(outlines).reshape(-1, 2).astype(float)
    limit = np.array(lit.shape[::-1]) - 1
    points = points[((points > 2) & (points < limit - 2)).all(axis=1)]
    if len(points) < 60:
        return None
    circle, share = _consensus(points, 0.01 * min(lit.shape))
    return circle if share > 0.25 else None


def _consensus(points: np.ndarray, tolerance_px: float) -> tuple[np.ndarray | None, float]:
    """Return the circle (x, y, r) on which most of some points (N, 2) lie, and their share."""
    # triples spread over the outline take the place of chance
    some = points[np.linspace(0, len(points) - 1, 22).astype(int)]
    a, b, c = some[np.array(list(combinations(range(len(some)), 3)))].swapaxes(0, 1)
    ab, ac = b - a, c - a
    twice = 2 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    sound = np.abs(twice) > 1e-6
    if not sound.any():
        return None, 0.0
    a, ab, ac, twice = a[sound], ab[sound], ac[sound], twice[sound]
    bb, cc = (ab ** 2).sum(axis=1), (ac ** 2).sum(axis=1)
    centre = np.stack([ac[:, 1] * bb - ab[:, 1] * cc,
                       ab[:, 0] * cc - ac[:, 0] * bb], axis=1) / twice[:, None]
    circles = np.column_stack([a + centre, np.linalg.norm(centre, axis=1)])
    thin = points[::max(1, len(points) // 200)]
    distance = np.abs(np.linalg.norm(thin[None] - circles[:, None, :2], axis=2) - circles[:, 2:])
    fitting = (distance < tolerance_px).mean(axis=1)
    best = int(fitting.argmax())
    return circles[best], float(fitting[best])


def _rim(brightest: np.ndarray, circle: np.ndarray, black: float, bright: float) -> np.ndarray:
    """
    Measure along rays around a circle where hardly any light is left, shape (N, 2).

    Rays that leave the image, or come from a dark part of the scene, are left out.
    """
    angle = np.arange(_RAYS) * 2 * np.pi / _RAYS
    ray = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    reach = max(8.0, 0.07 * circle[2])
    radius = circle[2] + np.arange(-reach, reach + 0.5)
    at = circle[:2] + radius[None, :, None] * ray[:, None]
    limit = np.array(brightest.shape[::-1]) - 1
    inside = ((at >= 0) & (at <= limit)).all(axis=(1, 2))
    at, ray = at[inside], ray[inside]
    if not len(at):
        return np.empty((0, 2))
    smooth = cv2.GaussianBlur(brightest.astype(np.float32), (0, 0), 1.0)
    profile = cv2.remap(smooth, at[:, :, 0].astype(np.float32), at[:, :, 1].astype(np.float32),
                        cv2.INTER_LINEAR)
    most = profile[:, :len(radius) // 2].max(axis=1)
    level = black + _LEFT * (most - black)
    lit = profile > level[:, None]
    last = profile.shape[1] - 1 - lit[:, ::-1].argmax(axis=1)
    measured = (most - black > _LEAST_CONTRAST * (bright - black)) & (last < len(radius) - 3)
    last, row = last[measured], np.flatnonzero(measured)
    upper, lower = profile[row, last], profile[row, last + 1]
    crossing = radius[last] + (upper - level[row]) / np.maximum(upper - lower, 1e-6)
    rim: np.ndarray = circle[:2] + crossing[:, None] * ray[row]
    return rim


def _refined(brightest: np.ndarray, circle: np.ndarray, black: float, bright: float,
             ) -> np.ndarray | None:
    """Fit a circle to the rim, twice, since the first sets the rays; None without a rim."""
    # loaded by the few that need it
    from scipy.optimize import least_squares
    for _ in range(2):
        xy = _rim(brightest, circle, black, bright)
        if len(xy) < 0.15 * _RAYS:
            return None
        # where the scene is dark at the rim the light ends early: many points lie within
        fitted, _ = _consensus(xy, 2.0)
        if fitted is None:
            return None
        near = xy[np.abs(np.linalg.norm(xy - fitted[:2], axis=1) - fitted[2]) < 4.0]
        circle = least_squares(lambda c: np.linalg.norm(near - c[:2], axis=1) - c[2], fitted,
                               loss='soft_l1', f_scale=0.5).x
    return circle


def _is_clear(images: Sequence[np.ndarray], brightest: np.ndarray, circle: np.ndarray,
              black: float, bright: float) -> bool:
    """Tell whether this is the circle of a lens, and no chance."""
    height, width = brightest.shape
    y, x = np.ogrid[:height, :width]
    distance = np.hypot(x - circle[0], y - circle[1])
    beyond = distance > circle[2] + max(3.0, 0.02 * circle[2])
    if beyond.mean() < 0.01 or circle[2] < 0.25 * min(height, width):
        return False
    dark = brightest[beyond] < black + _STRAY * (bright - black)
    # what flickers is scene, however dark; stray light may change a little
    steady = np.std([image[beyond] for image in images], axis=0) < 12
    if (dark & steady).mean() < 0.97:
        return False
    # a cone of light fades, and so does vignetting; at the rim of a lens light is cut off
    middle = np.median(brightest[distance < 0.7 * circle[2]])
    edge = np.median(brightest[(distance > 0.93 * circle[2]) & (distance < 0.96 * circle[2])])
    if edge - black < 0.3 * (middle - black):
        return False
    xy = _rim(brightest, circle, black, bright)
    if len(xy) < 0.15 * _RAYS:
        return False
    offset = xy - circle[:2]
    fits = np.abs(np.linalg.norm(offset, axis=1) - circle[2]) < max(2.0, 0.01 * circle[2])
    quadrant = (offset[:, 0] > 0) + 2 * (offset[:, 1] > 0)
    sides = np.bincount(quadrant[fits], minlength=4) >= 0.02 * _RAYS
    return bool(fits.mean() > 0.6 and sides.sum() >= 3)
