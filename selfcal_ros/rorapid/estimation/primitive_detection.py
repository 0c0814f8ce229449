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
"""Robust detection: RANSAC within a primitive, case deletion over primitives (7.3.1)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np


@lru_cache(maxsize=32)
def _all_pairs(points: int) -> tuple[np.ndarray, np.ndarray]:
    first, second = np.triu_indices(points, 1)
    return first, second


def ransac_lines(xy: np.ndarray, valid: np.ndarray, support_px: float,
                 rng: np.random.Generator | None = None, most_samples: int = 200) -> np.ndarray:
    """
    Edgels of each line primitive that support its best putative line (7.3.1).

    Parameters
    ----------
    xy : ndarray, shape (P, n, 2)
        Edgels of P primitives, padded to n, pixels.
    valid : ndarray of bool, shape (P, n)
    support_px : float
        Largest distance from the line.
    rng : numpy.random.Generator, optional
        Draws the pairs where there are more than `most_samples`; otherwise all pairs are tried.
    most_samples : int

    Returns
    -------
    ndarray of bool, shape (P, n)
        The support; all False for primitives with fewer than two edgels.

    """
    first, second = _all_pairs(xy.shape[1])
    if len(first) > most_samples and rng is not None:
        pick = rng.choice(len(first), most_samples, replace=False)
        first, second = first[pick], second[pick]
    xy = np.where(valid[..., None], xy, 0.0)
    along = xy[:, second] - xy[:, first]
    length = np.sqrt(np.einsum('pmi,pmi->pm', along, along))
    usable = valid[:, first] & valid[:, second] & (length > 1e-6)
    along = along / np.maximum(length, 1e-6)[..., None]
    # distance of all edgels of a primitive from all its putative lines, (P, m, n)
    from_first = xy[:, None] - xy[:, first][:, :, None]
    distance = np.abs(from_first[..., 0] * along[:, :, None, 1]
                      - from_first[..., 1] * along[:, :, None, 0])
    return _best_support(distance, usable, valid, support_px)


def ransac_conics(xy: np.ndarray, valid: np.ndarray, support_px: float, rng: np.random.Generator,
                  most_samples: int = 60) -> np.ndarray:
    """
    Edgels of each conic primitive that support its best putative conic through five of them.

    Parameters
    ----------
    xy : ndarray, shape (P, n, 2)
        Edgels of P primitives, padded to n, pixels.
    valid : ndarray of bool, shape (P, n)
    support_px : float
        Largest (first-order) distance from the conic.
    rng : numpy.random.Generator
        Draws the samples of five.
    most_samples : int
        Per primitive.

    Returns
    -------
    ndarray of bool, shape (P, n)
        The support; all False for primitives with fewer than five edgels.

    """
    P, n = valid.shape
    if not P or n < 5:
        return np.zeros_like(valid)
    # five edgels of each primitive: the smallest of random keys, those without an edgel last
    keys = rng.random((P, most_samples, n)) + 2.0 * ~valid[:, None]
    sample = keys.argpartition(4, axis=2)[..., :5]
    usable = np.take_along_axis(np.broadcast_to(valid[:, None], keys.shape), sample,
                                2).all(axis=2)
    xy = np.where(valid[..., None], xy, 0.0)
    count = np.maximum(valid.sum(axis=1), 1)
    mean = xy.sum(axis=1) / count[:, None]
    scaled = np.where(valid[..., None], xy - mean[:, None], 0.0)
    size = np.sqrt((scaled**2).sum(axis=(1, 2)) / count) + 1e-9
    scaled = scaled / size[:, None, None]
    x, y = scaled[..., 0], scaled[..., 1]
    terms = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=2)
    picked = np.take_along_axis(terms[:, None], sample[..., None], 2)
    conic = np.linalg.svd(picked)[2][:, :, 5]                      # (P, m, 6)
    value = np.einsum('pmk,pnk->pmn', conic, terms)
    a, b, c, d, e = (conic[:, :, k, None] for k in range(5))
    slope = np.hypot(2 * a * x[:, None] + b * y[:, None] + d,
                     b * x[:, None] + 2 * c * y[:, None] + e)
    distance = np.abs(value) / np.maximum(slope, 1e-9) * size[:, None, None]
    # an ellipse, not the hyperbola that two wrong edgels make
    usable &= (4 * a * c - b * b)[..., 0] > 0
    return _best_support(distance, usable, valid, support_px)


def _best_support(distance: np.ndarray, usable: np.ndarray, valid: np.ndarray, support_px: float,
                  ) -> np.ndarray:
    """Support (P, n) of the best of m hypotheses; ties go to the smaller distances."""
    near = (distance < support_px) & valid[:, None] & usable[..., None]
    score = np.where(near, 1.0 + 0.1 * (1 - distance / support_px), 0.0).sum(axis=2)
    best = score.argmax(axis=1)
    support: np.ndarray = near[np.arange(len(valid)), best]
    return support


def case_deletion(matrices: np.ndarray, vectors: np.ndarray, squares: np.ndarray,
                  counts: np.ndarray, significant_px: float, least: int,
                  damping: np.ndarray) -> np.ndarray:
    """
    Primitives that survive case deletion (7.3.1).

    Each primitive in turn is left out of the pose correction; its projection error under the
    correction of the others tells whether it is the wrong one. The worst goes if its error is
    significant, and all is repeated.

    Parameters
    ----------
    matrices : ndarray, shape (P, m, m)
        Sum of w r rᵀ over the edgels of each primitive.
    vectors : ndarray, shape (P, m)
        Sum of w l r.
    squares : ndarray, shape (P,)
        Sum of w l².
    counts : ndarray, shape (P,)
        Sum of w.
    significant_px : float
        Root mean square projection error beyond which a primitive is wrong.
    least : int
        Primitives that must remain.
    damping : ndarray, shape (m, m)
        Small prior information that keeps every solution finite.

    Returns
    -------
    ndarray of bool, shape (P,)

    """
    alive = counts > 0
    for _ in range(len(counts)):
        at = np.flatnonzero(alive)
        if len(at) <= least:
            break
        H, g = matrices[at].sum(axis=0), vectors[at].sum(axis=0)
        q = np.linalg.solve(H - matrices[at] + damping, (g - vectors[at])[..., None])[..., 0]
        square = (squares[at] - 2 * np.einsum('pi,pi->p', q, vectors[at])
                  + np.einsum('pi,pij,pj->p', q, matrices[at], q)) / counts[at]
        error = np.sqrt(np.maximum(square, 0))
        worst = int(error.argmax())
        # while some are wrong the others' errors are wrong as well; it must stand out
        if not error[worst] > max(significant_px, 1.5 * float(np.median(error))):
            break
        alive[at[worst]] = False
    return alive


def stability(found: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Decaying average of how often a control point is found: w(t) = (found + w(t-1)) / 2."""
    middle: np.ndarray = 0.5 * (found + before)
    return middle
