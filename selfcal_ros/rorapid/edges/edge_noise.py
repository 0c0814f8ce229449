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
"""How well edges are located, each by itself and all along one line together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: Memory of what was learned, per image.
_MEMORY = 0.9
#: Noise of an edge's place (pixels) and of the grey levels around it that is assumed at first, as
#: if so many edgels of such contrast had been seen; and the least noise of the place.
_USUAL_NOISE, _USUAL_CONTRAST, _USUAL_COUNT, _MIN_PLACE_PX = (0.1, 4.0), 40.0, 20.0, 0.08
#: So near the end of a line what meets it there doubles the variance, pixels.
_END_PX = 6.0
#: Freedom of what is assumed of the common scatter at first, and its bounds.
_PRIOR_FREEDOM, _COMMON = 10.0, (0.5, 25.0)
#: Variance over what the lines' residuals show of it: what neighbouring lines share, and what the
#: choice of edgels near the pose itself shares, no residual shows. Measured on rendered objects.
#: Outlines of round parts share more, for the rim is where the pose puts it.
UNSEEN, UNSEEN_OUTLINE = 1.27, 4.0
#: What shading leaves along an outline after the limb is taken off, pixels: all around, and by
#: itself in each of so many sectors. Light from a side makes one side of a part larger.
_AROUND_PX, _SECTOR_PX, _SECTORS = 0.05, 0.02, 8
#: Share of the information that is left where one line alone determines something.
_RIDGE = 0.02
#: Freedom for which what was learned from the images before counts beside one image: views differ.
_BEFORE_FREEDOM = 8.0
#: Curvature of the cost against the weights, at the least.
_MIN_CURVATURE = 0.3


class EdgeNoise:
    """
    How well single edgels are located.

    What disturbs the grey levels (noise, shading, what is behind the object) moves an edge the
    further, the weaker it is: variance = a² + (b / contrast)², both learned from the images; and
    near the end of a line the next edge disturbs.
    """

    def __init__(self) -> None:
        """Start from what is usual."""
        self.forget()

    def forget(self) -> None:
        """Forget what was learned."""
        place, grey = _USUAL_NOISE
        self.variance = np.array([place**2, grey**2])
        # weighted sums of (1, z)(1, z)' and (1, z) r², z = 1 / contrast²
        z = 1 / _USUAL_CONTRAST**2
        design = np.array([[1.0, z], [z, 3 * z * z]])
        weight = _USUAL_COUNT / (self.variance @ [1, z])**2
        self._normal, self._right = weight * design, weight * design @ self.variance

    def sigma(self, contrast: np.ndarray, end_px: np.ndarray) -> np.ndarray:
        """
        Standard deviation of edgels.

        Parameters
        ----------
        contrast : ndarray, shape (C,)
        end_px : ndarray, shape (C,)
            Distance from the end of the line.

        Returns
        -------
        ndarray, shape (C,)
            Pixels.

        """
        variance = self.variance[0] + self.variance[1] / np.maximum(contrast * contrast, 1.0)
        sigma_px: np.ndarray = np.sqrt(variance * end_factor(end_px))
        return sigma_px

    def learn(self, contrast: np.ndarray, end_px: np.ndarray, residual: np.ndarray) -> None:
        """Take in residuals (C,) of edgels that were accepted, pixels."""
        if not len(residual):
            return
        z = np.stack([np.ones(len(contrast)), 1 / np.maximum(contrast * contrast, 1.0)])
        square = residual**2 / end_factor(end_px)
        weight = 1 / (self.variance @ z)**2
        self._normal = _MEMORY * self._normal + (z * weight) @ z.T
        self._right = _MEMORY * self._right + z @ (weight * square)
        (p, q), (_, r) = self._normal
        det = max(p * r - q * q, 1e-30)
        place = (r * self._right[0] - q * self._right[1]) / det
        grey = (p * self._right[1] - q * self._right[0]) / det
        least = _MIN_PLACE_PX**2
        if place < least:
            place, grey = least, (self._right[1] - q * least) / r
        if grey < 0:
            place, grey = max(self._right[0] / p, least), 0.0
        self.variance = np.array([place, grey])


def end_factor(end_px: np.ndarray) -> np.ndarray:
    """Factor of the variance of edgels so near the end of their line (C,), pixels."""
    factor: np.ndarray = 1 + (_END_PX / np.maximum(end_px, 1.0))**2
    return factor


class CommonScatter:
    """
    How much more a pose scatters than independent edgels suggest.

    Edgels of one line share errors (shading, background, sampling). The pull of a whole line on
    the pose, gradient g of its part of the cost, shows them: over all lines the sum of g' V g, V
    the covariance of the pose from the others, has a known mean for independent edgels. And the
    cost is less curved than the weights of its edgels say. An edgel that lies off is left out,
    whichever pose it speaks for. Both ratios make the factor of the variance: the sandwich of an
    M-estimator, cluster-robust, of this image and, with a weight, of those before.
    """

    def __init__(self, unseen: float = UNSEEN):
        """Start from independent edgels; `unseen`: the factor for what no residual shows."""
        self._unseen = unseen
        self.forget()

    def forget(self) -> None:
        """Forget what was learned."""
        # square, freedom; curvature, weight: each ratio starts at 1
        self._sums = np.full(4, _PRIOR_FREEDOM)

    def factor(self, sums: np.ndarray) -> float:
        """By how much the variance of a pose grows: its image shows `sums_together`."""
        square, freedom, curvature, weight = self._sums
        scatter = (sums[0] + _BEFORE_FREEDOM * square / freedom) / (sums[1] + _BEFORE_FREEDOM)
        bend = max(curvature / weight, _MIN_CURVATURE)
        least, most = _COMMON
        return float(min(max(self._unseen * scatter / bend**2, least), most))

    def learn(self, sums: np.ndarray) -> None:
        """Take in an image that was accepted."""
        self._sums = _MEMORY * self._sums + sums + (1 - _MEMORY) * _PRIOR_FREEDOM


def sums_together(primitive: np.ndarray, rows: np.ndarray, weight: np.ndarray, off: np.ndarray,
                  residual: np.ndarray, counts: Sequence[int], information: np.ndarray,
                  ) -> np.ndarray:
    """
    Sums of `CommonScatter` over the lines of one image.

    Parameters
    ----------
    primitive : ndarray of int, shape (C,)
        Ascending; of J objects, one after the other.
    rows : ndarray, shape (C, m)
    weight : ndarray, shape (C,)
        Tukey's, over the variance.
    off : ndarray, shape (C,)
        Squared distance over Tukey's squared limit, as the weight was made of it: below 1.
    residual : ndarray, shape (C,)
    counts : sequence of int
        Rows of each object.
    information : ndarray, shape (J, m, m)
        Of the poses, all that is known.

    Returns
    -------
    ndarray, shape (J, 4)
        Sum of g' V g and its mean; curvature of the cost and what the weights say of it, both
        in units of the information.

    """
    sums = np.zeros((len(counts), 4))
    some = [k for k, count in enumerate(counts) if count]
    if not some:
        return sums
    information, ends = information[some], np.cumsum([counts[k] for k in some])
    begins = np.concatenate([[0], ends[:-1]])
    changes = np.diff(primitive, prepend=-1) != 0
    changes[begins] = True
    first = np.flatnonzero(changes)
    # the first line of each object, and the object of each line
    lines = np.searchsorted(first, begins)
    owner = np.repeat(np.arange(len(some)), np.diff(lines, append=len(first)))
    m = rows.shape[1]
    pull = rows * weight[:, None]
    V = np.linalg.inv(information)
    gradient, own = np.empty((len(first), m)), np.empty((len(first), m * m))
    products = (pull[:, :, None] * rows[:, None]).reshape(-1, m * m)
    line = np.cumsum(changes) - 1
    felt = np.empty((len(rows), m))
    for one, begin, end, top, low in zip(V, begins, ends, lines, [*lines[1:], len(first)]):
        # which rows are of which line: a product is faster than `reduceat` along columns
        within = (np.arange(top, low)[:, None] == line[begin:end]).astype(float)
        np.matmul(within * residual[begin:end], pull[begin:end], out=gradient[top:low])
        np.matmul(within, products[begin:end], out=own[top:low])
        np.matmul(pull[begin:end], one, out=felt[begin:end])
    felt = (felt * rows).sum(axis=1)
    # the fit has taken its part of each line's pull: judge it by the covariance of the rest
    rest = (1 + _RIDGE) * information[owner] - own.reshape(-1, m, m)
    squares = (gradient * np.linalg.solve(rest, gradient[:, :, None])[:, :, 0]).sum(axis=1)
    means = (own * V.reshape(-1, m * m)[owner]).sum(axis=1)
    sums[some] = np.stack([
        np.add.reduceat(squares, lines), np.add.reduceat(means, lines),
        np.add.reduceat(felt * ((1 - 5 * off) / (1 - off)), begins),
        np.add.reduceat(felt, begins)], axis=1)
    return sums


def shared_by_outline(rows: np.ndarray, weight: np.ndarray, inside: np.ndarray,
                      pixels: np.ndarray, information: np.ndarray) -> np.ndarray:
    """
    Information that an outline has too much, for what shading moves in common.

    Many places have an offset d in common, with rows J, weights w and the object on the side s. It
    moves the estimate by H^-1 g d, with g = sum w s J and H the information of the image. Its
    variance takes g (1 + g' H^-1 g)^-1 g' away, in units of the offset's sigma.

    Parameters
    ----------
    rows : ndarray, shape (C, m)
    weight, inside : ndarray, shape (C,)
        Weights; and 1 or -1, the side of the normal on which the object lies, 0 where that is
        not an outline.
    pixels : ndarray, shape (C, 2)
    information : ndarray, shape (m, m)
        Of the image.

    Returns
    -------
    ndarray, shape (m, m)

    """
    pull = (weight * inside)[:, None] * rows
    x, y = (pixels - pixels.mean(axis=0)).T
    sector = ((np.arctan2(y, x) / (2 * np.pi) + 0.5) * _SECTORS).astype(int) % _SECTORS
    g = np.zeros((_SECTORS + 1, rows.shape[1]))
    np.add.at(g, sector, _SECTOR_PX * pull)
    g[-1] = _AROUND_PX * pull.sum(axis=0)
    floor = 1e-9 * np.diag(np.diagonal(information)) + 1e-12 * np.eye(len(information))
    felt = np.eye(len(g)) + g @ np.linalg.solve(information + floor, g.T)
    less: np.ndarray = g.T @ np.linalg.solve(felt, g)
    return less
