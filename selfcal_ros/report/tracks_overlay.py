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
"""Draws tracks over their image: what the tracker sees, for a person who looks on."""

from __future__ import annotations

import cv2
import numpy as np

#: BGR, from a palette that colour-blind people can tell apart: a new point, an old one, its way.
NEW, OLD, TRAIL = (0, 159, 230), (115, 158, 0), (233, 180, 86)
#: Images after which a point counts as old, and the length of its trail.
MATURE, TRAIL_IMAGES = 30, 12
#: Bits behind the binary point of coordinates that OpenCV draws at.
_SHIFT = 4


class TracksOverlay:
    """
    Draws the points of each image, the colour telling how long they have been followed.

    One object draws one stream: it remembers where the points were in the last images.
    """

    def __init__(self) -> None:
        self._past: list[tuple[np.ndarray, np.ndarray]] = []
        self._age: dict[int, int] = {}

    def draw(self, grey: np.ndarray, ids: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """
        Return the image with its tracks.

        Parameters
        ----------
        grey : ndarray of uint8, shape (H, W)
        ids : ndarray of int, shape (N,)
            Ascending.
        xy : ndarray, shape (N, 2)
            Pixels.

        Returns
        -------
        ndarray of uint8, shape (H, W, 3)
            BGR.

        """
        self._age = {point: self._age.get(point, -1) + 1 for point in ids.tolist()}
        self._past = [*self._past[1 - TRAIL_IMAGES:], (ids, xy)]
        image = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
        thickness = max(1, round(max(grey.shape) / 800))
        for (ids_a, xy_a), (ids_b, xy_b) in zip(self._past[:-1], self._past[1:]):
            _, a, b = np.intersect1d(ids_a, ids_b, assume_unique=True, return_indices=True)
            # the ways of points that are lost by now would only hide the others
            kept = np.isin(ids_b[b], ids, assume_unique=True)
            steps = np.stack([xy_a[a], xy_b[b]], axis=1)[kept]
            cv2.polylines(image, list(_fixed(steps)), False, TRAIL, thickness, cv2.LINE_AA, _SHIFT)
        share = np.minimum([self._age[point] for point in ids.tolist()], MATURE) / MATURE
        colours = np.asarray(NEW) + np.reshape(share, (-1, 1)) * (np.subtract(OLD, NEW))
        # OpenCV draws circles one by one
        for centre, colour in zip(_fixed(xy).tolist(), colours.tolist()):
            cv2.circle(image, centre, 3 * thickness << _SHIFT, colour, -1, cv2.LINE_AA, _SHIFT)
        font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.5 * thickness
        text = f'{len(ids)} points here'
        (width, height), _ = cv2.getTextSize(text, font, scale, thickness)
        bottom = grey.shape[0] - 8
        cv2.rectangle(image, (0, bottom - height - 8), (width + 16, grey.shape[0]), (0, 0, 0), -1)
        cv2.putText(image, text, (8, bottom), font, scale, (255, 255, 255), thickness, cv2.LINE_AA)
        return image


def _fixed(xy: np.ndarray) -> np.ndarray:
    """Return coordinates in OpenCV's fixed point, (0, 0) being the centre of a pixel."""
    return np.round(np.asarray(xy) * (1 << _SHIFT)).astype(np.int32)
