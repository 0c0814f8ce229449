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
"""One-dimensional edge search along the normals of many control points at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

#: Half length of the derivative filter, and its sigma, pixels.
_HALF, _SIGMA = 3, 1.0
#: Samples beyond the search range, to each side.
MARGIN_PX = _HALF + 1
#: Mean distance of a curve of unit curvature from its tangent over the three lanes, pixels.
BOW_OF_LANES = 1 / 3


@dataclass(frozen=True)
class Edgels:
    """
    Attributes of the edges found along the normals.

    Attributes
    ----------
    offset : ndarray, shape (C, K)
        Signed distance along the normal, pixels; NaN where there is no such edge. The strongest
        edge comes first.
    contrast : ndarray, shape (C, K)
        Grey levels by which the image rises along the normal; 0 where there is no edge.

    """

    offset: np.ndarray
    contrast: np.ndarray


@lru_cache(maxsize=64)
def _derivative(samples: int) -> np.ndarray:
    """Return the matrix (samples, samples - 2 HALF) of the derivative of a Gaussian."""
    at = np.arange(-_HALF, _HALF + 1)
    kernel = at * np.exp(-0.5 * (at / _SIGMA)**2)
    kernel = kernel / kernel[at > 0].sum()    # a step of one grey level answers with one
    matrix = np.zeros((samples, samples - 2 * _HALF), np.float32)
    for k in range(samples - 2 * _HALF):
        matrix[k:k + 2 * _HALF + 1, k] = kernel
    return matrix


@lru_cache(maxsize=64)
def _stations(reach: int) -> np.ndarray:
    return np.arange(-reach - MARGIN_PX, reach + MARGIN_PX + 1, dtype=np.float32)


def sample_normals(image: np.ndarray, pixels: np.ndarray, normal: np.ndarray, reach_px: int,
                   lanes: int = 3) -> np.ndarray:
    """
    Grey levels along the normals, averaged over parallel lanes a pixel apart.

    Parameters
    ----------
    image : ndarray, shape (H, W), uint8
    pixels, normal : ndarray, shape (C, 2)
    reach_px : int
        Search range to each side.
    lanes : int
        1 or 3.

    Returns
    -------
    ndarray, shape (C, S), float32
        At distances -reach - 4 ... reach + 4, a pixel apart; beyond the image its border.

    """
    stations = _stations(int(reach_px))
    centre, normal = pixels.astype(np.float32), normal.astype(np.float32)
    x = centre[:, :1] + normal[:, :1] * stations
    y = centre[:, 1:] + normal[:, 1:] * stations
    if lanes == 1:
        values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return values.astype(np.float32)
    x = np.concatenate([x - normal[:, 1:], x, x + normal[:, 1:]])
    y = np.concatenate([y + normal[:, :1], y, y - normal[:, :1]])
    values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = values.reshape(3, len(centre), -1).astype(np.float32)
    grey: np.ndarray = (values[0] + values[1] + values[2]) * np.float32(1 / 3)
    return grey


def find_edgels(profiles: np.ndarray, candidates: int = 1, least_contrast: float = 4.0,
                wanted: np.ndarray | None = None, reach_px: np.ndarray | None = None) -> Edgels:
    """
    Strongest local maxima of the derivative along each profile, to a fraction of a pixel.

    Parameters
    ----------
    profiles : ndarray, shape (C, S)
        From `sample_normals`.
    candidates : int
        Edges to keep for each profile.
    least_contrast : float
        Weaker edges do not count, grey levels.
    wanted : ndarray, shape (C,), optional
        Contrast that the edge had when it was last found (0: unknown): edges of the other sign
        count for half their strength.
    reach_px : ndarray of int, shape (C,), optional
        Edges beyond it do not count, where it is less than that of the profiles.

    Returns
    -------
    Edgels

    """
    slope = profiles @ _derivative(profiles.shape[1])
    size = np.abs(slope)
    centre = size[:, 1:-1]
    peak = (centre >= size[:, :-2]) & (centre > size[:, 2:]) & (centre > least_contrast)
    score = np.where(peak, centre, np.float32(0))
    if wanted is not None:
        score = np.where(slope[:, 1:-1] * wanted[:, None].astype(np.float32) < 0, 0.5 * score,
                         score)
    reach = (centre.shape[1] - 1) // 2
    if reach_px is not None:
        score *= np.abs(np.arange(-reach, reach + 1)) <= reach_px[:, None]
    if candidates == 1:
        best = score.argmax(axis=1)[:, None]
    else:
        best = np.argsort(score, axis=1)[:, :-candidates - 1:-1]
    row = np.arange(len(profiles))[:, None]
    # `take` is several times as fast as a pair of indices
    found = score.take(best + row * score.shape[1]) > 0
    at = best + row * size.shape[1]
    left, middle, right = size.take(at), size.take(at + 1), size.take(at + 2)
    bend = left - 2 * middle + right
    with np.errstate(divide='ignore', invalid='ignore'):
        shift = np.where(bend < 0, 0.5 * (left - right) / bend, 0.0)
    return Edgels(np.where(found, best - reach + shift, np.nan).astype(float),
                  np.where(found, slope.take(at + 1), 0.0).astype(float))
