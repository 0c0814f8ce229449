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
"""Which edge is the right one: polarity, strength, memory, and what runs alongside."""

from __future__ import annotations

import numpy as np

#: Control points with another primitive so close alongside count little.
_CROWD_PX, _CROWD_LENGTH_PX, _CROWDED = 5.0, 15.0, 0.1
#: The contrast of an edge changes by this factor at the most while it is the same edge.
_CHANGE = 2.5
#: Memory of the common errors of edges, freedom of what is assumed at first, and bounds.
_COMMON_MEMORY, _PRIOR_FREEDOM, _COMMON = 0.95, 20.0, (0.5, 25.0)
#: A weaker edge than the strongest of a control point seems up to so much further away, pixels.
_WEAK_PX = 5.0
#: An edge of the wrong polarity seems so much further away, pixels.
_WRONG_SIGN_PX = 3.0


class CommonScatter:
    """
    How much larger the errors of whole edges are than those of single edgels suggest.

    A pose feels how edges are displaced and turned as wholes. Edgels of one edge share errors
    (shading, background, sampling), so that this part of the residuals may scatter more than
    the scatter of the edgels over their root. Each line has two such values, the pose takes six
    of them away; the mean square of the rest, averaged over images, is the variance of an edgel as
    far as the pose is concerned.

    Parameters
    ----------
    primitive : ndarray of int, shape (N,)
        Primitive of each control point of the model, in order.
    straight : ndarray of bool, shape (P,)
        Which primitives are lines.

    """

    def __init__(self, primitive: np.ndarray, straight: np.ndarray):
        """Lay out membership and place along the line."""
        lines = np.flatnonzero(straight)
        self._member = (primitive == lines[:, None]).astype(float)
        count = np.maximum(self._member.sum(axis=1), 1)
        first = np.array([np.argmax(row) for row in self._member], int)
        which = self._member.argmax(axis=0) if len(lines) else np.zeros(len(primitive), int)
        self._along = np.zeros(len(primitive))
        if len(lines):
            self._along = 2 * (np.arange(len(primitive)) - first[which] + 0.5) / count[which] - 1
        self.forget()

    def forget(self) -> None:
        """Start anew, from independent edgels."""
        self._square = self._freedom = 0.0

    def factor(self, sigma: float) -> float:
        """By how much the variance of a pose from edgels of `sigma` pixels grows."""
        own = self._square / sigma**2 + _PRIOR_FREEDOM
        return float(np.clip(own / (self._freedom + _PRIOR_FREEDOM), *_COMMON))

    def sums(self, ids: np.ndarray, residual: np.ndarray) -> tuple[float, float]:
        """
        Squares and degrees of freedom of the displacements of edges in one image.

        Parameters
        ----------
        ids : ndarray of int, shape (C,)
            Control points that count.
        residual : ndarray, shape (C,)
            Pixels.

        Returns
        -------
        square : float
            Pixels squared.
        freedom : float

        """
        along = self._along[ids]
        sums = self._member[:, ids] @ np.stack(
            [np.ones(len(ids)), along, along * along, residual, along * residual], axis=1)
        n, t, tt, r, rt = sums[sums[:, 0] > 2].T
        det = n * tt - t * t
        square = float(((tt * r * r - 2 * t * r * rt + n * rt * rt) / det).sum())
        freedom = 2 * len(n) - 6.0
        return (square, freedom) if freedom > 0 else (0.0, 0.0)

    def learn(self, square: float, freedom: float) -> None:
        """Take in the sums of an image that was accepted."""
        self._square = _COMMON_MEMORY * self._square + square
        self._freedom = _COMMON_MEMORY * self._freedom + freedom


def handicap(contrast: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """
    Pixels by which an edge seems further away than it is, for it does not look right.

    Parameters
    ----------
    contrast : ndarray, shape (C, K)
    wanted : ndarray, shape (C,)
        Remembered contrast, 0 where none is: then the strongest edge is preferred.

    Returns
    -------
    ndarray, shape (C, K)

    """
    size = np.abs(contrast)
    strongest = np.maximum(size.max(axis=1, keepdims=True, initial=0.0), 1e-6)
    weak = np.where(wanted[:, None] == 0, _WEAK_PX * (1 - size / strongest), 0.0)
    return np.where(contrast * wanted[:, None] < 0, _WRONG_SIGN_PX, weak)


def alike(contrast: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Whether edges look as they are remembered, (C,); what is not remembered may be anything."""
    ratio = contrast / np.where(wanted == 0, 1.0, wanted)
    return (wanted == 0) | ((ratio > 1 / _CHANGE) & (ratio < _CHANGE))


def uncrowded(view, at: np.ndarray) -> np.ndarray:
    """
    Weight of control points by how near other primitives run alongside, (len(at),).

    Where lines of a face seen from its edge crowd together, an edgel may be that of the next.
    """
    pixels = view.projected.pixels[at].astype(np.float32)
    normal = view.normal[at].astype(np.float32)
    across = pixels @ normal.T - np.einsum('ci,ci->c', pixels, normal)
    along = pixels @ np.stack([-normal[:, 1], normal[:, 0]])
    along -= np.einsum('cc->c', along)
    primitive = view.primitive[at]
    crowd = np.abs(across) < _CROWD_PX
    crowd &= primitive[:, None] != primitive
    crowd &= np.abs(along) < _CROWD_LENGTH_PX
    crowd &= np.abs(normal @ normal.T) > 0.94
    return np.where(crowd.any(axis=0), _CROWDED, 1.0)
