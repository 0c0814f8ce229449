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
"""Corners of boards to a fraction of a pixel, and how far they scatter."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

#: Image smoothing before the corners are located, pixels: none, and as noise and hard edges need.
SMOOTHING_PX = (0.0, 1.0, 1.5, 2.0)
#: Smoothing beyond this share of the distance between corners mixes their edges.
MOST_SMOOTHING = 0.1
#: Corners located in a later way must scatter by so much less to be taken: the least of many
#: numbers is partly chance.
CLEARLY_LESS = 0.9
#: A corner this share of the usual distance away from where its neighbours say is misplaced.
MISPLACED = 0.15
#: Share of the corners that a detector may misplace.
MOST_MISPLACED = 0.1
#: Share of the distance between corners in which there are a corner's own edges only.
CLEAR_SHARE = 0.4


def nothing() -> tuple[np.ndarray, np.ndarray]:
    """Return no points: identities (0,) and places (0, 2)."""
    return np.empty(0, dtype=np.int64), np.empty((0, 2))


def plane(columns: int, rows: int, pitch: float) -> np.ndarray:
    """Points of a board row by row, z = 0, shape (P, 3)."""
    y, x = np.mgrid[:rows, :columns].reshape(2, -1) * pitch
    return np.column_stack([x, y, np.zeros(x.size)])


def refined(image: np.ndarray, corners: np.ndarray, clear_px: float) -> np.ndarray:
    """
    Bring corners to sub-pixel accuracy.

    OpenCV's own of ChArUco are half a pixel off in 4.6. Those of the sector-based detector scatter
    two to three times as much as these.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, W)
    corners : ndarray, n places of any shape
    clear_px : float
        How far from a corner there is nothing but its own edges, pixels.

    Returns
    -------
    ndarray, shape (n, 2)

    """
    half = int(np.clip(clear_px, 2, 11))
    corners = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(
        image, corners.copy(), (half, half), (-1, -1),
        (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    ).reshape(-1, 2).astype(float)


def spacing(xy: np.ndarray, columns: int, rows: int) -> float:
    """Return the least distance of neighbours among the corners (P, 2) of a board, pixels."""
    grid = xy.reshape(rows, columns, 2)
    return min(float(np.linalg.norm(np.diff(grid, axis=k), axis=2).min()) for k in (0, 1))


def scatter(xy: np.ndarray, columns: int, rows: int) -> float:
    """
    Estimate the noise of the corners of a whole board from themselves.

    Third differences along rows and columns, once a homography is taken off: perspective and
    lens leave little there, noise 20 times its variance. Where the lens bends much they leave
    more; the same to every way of locating these corners, so that the least is still the best.

    Parameters
    ----------
    xy : ndarray, shape (columns · rows, 2)
        Pixels, row by row.
    columns, rows : int

    Returns
    -------
    float
        Standard deviation of a coordinate, pixels; infinite where they are no board.

    """
    left = _off_homography(xy, columns, rows)
    if left is None:
        return np.inf
    bends = [np.diff(left, 3, axis=k).ravel() for k, n in enumerate((rows, columns)) if n > 3]
    if not bends:
        return np.inf
    value = float(np.sqrt(np.mean(np.concatenate(bends)**2) / 20))
    return value if np.isfinite(value) else np.inf


def _off_homography(xy: np.ndarray, columns: int, rows: int, method: int = 0,
                    ) -> np.ndarray | None:
    """Return how far corners (P, 2) are from their homography, (rows, columns, 2)."""
    flat = plane(columns, rows, 1.0)[:, :2]
    H = cv2.findHomography(flat, xy, method)[0] if np.isfinite(xy).all() else None
    if H is None:
        return None
    mapped = np.column_stack([flat, np.ones(len(flat))]) @ H.T
    with np.errstate(divide='ignore', invalid='ignore'):
        left = (xy - mapped[:, :2] / mapped[:, 2:]).reshape(rows, columns, 2)
    return left if np.isfinite(left).all() else None


def mended(xy: np.ndarray, columns: int, rows: int) -> list[np.ndarray]:
    """
    Put corners that a detector misplaced to where their neighbours say.

    Parameters
    ----------
    xy : ndarray, shape (columns · rows, 2)
        Pixels, row by row.
    columns, rows : int

    Returns
    -------
    list of ndarray, shape (columns · rows, 2)
        One, or none where no corner or too many seem misplaced.

    """
    left = _off_homography(xy, columns, rows, cv2.LMEDS)
    if left is None:
        return []
    padded = np.pad(left, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    around = np.stack([padded[1 + i:1 + i + rows, 1 + j:1 + j + columns]
                       for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j])
    off = (left - np.nanmedian(around, axis=0)).reshape(-1, 2)
    misplaced = np.linalg.norm(off, axis=1) > MISPLACED * np.median(
        np.linalg.norm(np.diff(xy.reshape(rows, columns, 2), axis=1), axis=2))
    # beyond it is a lens that bends, not single corners
    if not 0 < misplaced.mean() < MOST_MISPLACED:
        return []
    return [np.where(misplaced[:, None], xy - off, xy)]


def best_corners(image: np.ndarray, starts: Iterable[np.ndarray], columns: int, rows: int,
                 ) -> tuple[np.ndarray, float]:
    """
    Locate the corners of a whole board in several ways, and take those that scatter least.

    The first way, without smoothing, stands unless another is clearly better.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, W)
    starts : iterable of ndarray, shape (columns · rows, 2)
        Where detectors saw them, pixels; each counts as it is, too.
    columns, rows : int

    Returns
    -------
    xy : ndarray, shape (columns · rows, 2)
    scatter_px : float
        See `scatter`.

    """
    smoothed, candidates = {0.0: image}, []
    for start in (one for start in starts for one in (start, *mended(start, columns, rows))):
        apart = spacing(start, columns, rows)
        for blur in SMOOTHING_PX:
            if blur > MOST_SMOOTHING * apart:
                continue
            if blur not in smoothed:
                smoothed[blur] = cv2.GaussianBlur(image, (0, 0), blur)
            candidates.append(refined(smoothed[blur], start, CLEAR_SHARE * apart))
        candidates.append(start)
    best, least = candidates[0], np.inf
    for xy in candidates:
        value = scatter(xy, columns, rows)
        if value < CLEARLY_LESS * least:
            best, least = xy, value
    return best, least
