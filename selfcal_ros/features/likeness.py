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
How alike two places look, and which places of two sets look alike at all.

Most places look nothing alike, and a sketch tells: the lowest frequencies of a descriptor, and the
length of what they leave. By the inequality of Cauchy and Schwarz two vectors are no more alike
than their sketches, so that whoever compares sketches first misses nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

#: Similarity (cosine of Hellinger-normalised vectors) of a runner-up where none was found.
USUAL_SIMILARITY = 0.8
#: Along an epipolar line fewer candidates compete, so that the ratio may be milder.
GUIDED_RATIO = 0.85
#: Less alike than this cannot pass the guided ratio test against the usual runner-up.
MIN_SIMILARITY = 1 - GUIDED_RATIO ** 2 * (1 - USUAL_SIMILARITY)
#: Numbers of a sketch, the length of the rest among them.
_SKETCH = 56
#: Rounding of a product of sketches, float32.
_ROUNDING = 1e-5
#: Pairs of vectors compared at a time: what stays in the cache of a processor costs a tenth.
_AT_ONCE = 512
#: Where sketches leave a larger share of two sets, the vectors are compared as a whole.
_CROWDED = 0.05
#: Places compared with all of another image at a time, for the same reason.
_ROWS = 256


def _low_frequencies() -> np.ndarray:
    """Rows (k, 128): cosines over the 4 x 4 cells, waves over the 8 directions, lowest first."""
    cell, turn = np.arange(4), np.arange(8)
    cosine = np.cos(np.pi * np.outer(cell, cell + 0.5) / 4)
    cycles = np.array([0, 1, 1, 2, 2, 3, 3, 4])
    phase = np.pi / 2 * np.array([0, 0, 1, 0, 1, 0, 1, 0])
    wave = np.cos(2 * np.pi / 8 * np.outer(cycles, turn) - phase[:, None])
    rows = np.einsum('ia,jb,kc->ijkabc', cosine, cosine, wave).reshape(128, 128)
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    # a step from direction to direction is a little smoother than one from cell to cell
    pitch = cell[:, None, None] ** 2 + cell[None, :, None] ** 2 + 0.9 * cycles ** 2
    lowest = np.argsort(pitch.ravel(), kind='stable')[:_SKETCH - 1]
    return np.asarray(rows[lowest], np.float32)


_BASIS = _low_frequencies()
_ROOTS = np.sqrt(np.arange(256, dtype=np.float32))


def look_of(sift: np.ndarray) -> np.ndarray:
    """Turn SIFT vectors (N, 128) of bytes into what is compared by its cosine, float32."""
    total = sift.sum(axis=1, dtype=np.float32, keepdims=True)
    look: np.ndarray = _ROOTS[sift]
    look /= np.sqrt(total + np.float32(1e-9))
    return look


@dataclass(frozen=True)
class Described:
    """
    Appearance of N places.

    Parameters
    ----------
    vectors : ndarray of float32, shape (N + E, 128)
        Square roots of L1-normalised SIFT vectors (Arandjelovic and Zisserman, 2012): one for
        each place, then those of E places that have a second orientation.
    second : ndarray of int, shape (E,)
        The places that have a second one, ascending.

    """

    vectors: np.ndarray
    second: np.ndarray

    @property
    def count(self) -> int:
        """Number of places."""
        return len(self.vectors) - len(self.second)

    def select(self, kept: np.ndarray) -> Described:
        """Return the appearance of the places where kept (N,) is true."""
        both = kept[self.second]
        return Described(self.vectors[np.concatenate([kept, both])],
                         (np.cumsum(kept) - 1)[self.second[both]])

    @cached_property
    def place(self) -> np.ndarray:
        """The place of every vector, shape (N + E,)."""
        return np.concatenate([np.arange(self.count), self.second])

    @cached_property
    def order(self) -> np.ndarray:
        """All places, those with two orientations first, shape (N,)."""
        once = np.ones(self.count, bool)
        once[self.second] = False
        return np.concatenate([self.second, np.flatnonzero(once)])

    @cached_property
    def arranged(self) -> np.ndarray:
        """The vectors in the order of `order`, then the second ones, (N + E, 128)."""
        return np.concatenate([self.vectors[self.order], self.vectors[self.count:]])

    @cached_property
    def sketch(self) -> np.ndarray:
        """What bounds the similarity of two vectors by its product, (N + E, `_SKETCH`)."""
        low = self.vectors @ _BASIS.T
        left = np.einsum('ij,ij->i', self.vectors, self.vectors) - np.einsum('ij,ij->i', low, low)
        return np.column_stack([low, np.sqrt(np.maximum(left, 0))])


def similarity(first: Described, some: np.ndarray, second: Described) -> np.ndarray:
    """
    Cosine between the best fitting descriptors of places of the first and all of the second.

    Parameters
    ----------
    first, second : Described
    some : ndarray of int, shape (n,)
        Places of the first, ascending.

    Returns
    -------
    ndarray of float32, shape (n, N)
        The columns are the places `second.order`.

    """
    double = len(second.second)
    vectors = second.arranged

    def best(rows: np.ndarray) -> np.ndarray:
        product: np.ndarray = rows @ vectors.T
        np.maximum(product[:, :double], product[:, second.count:], out=product[:, :double])
        return product[:, :second.count]

    result: np.ndarray = best(first.vectors[some])
    at = np.searchsorted(first.second, some)
    twice = np.flatnonzero(at < len(first.second))
    twice = twice[first.second[at[twice]] == some[twice]]
    if len(twice):
        result[twice] = np.maximum(result[twice], best(first.vectors[first.count + at[twice]]))
    return result


def most_alike(first: Described, some: np.ndarray, second: Described) -> np.ndarray:
    """
    Find how alike any place of the second is to places of the first.

    Parameters
    ----------
    first, second : Described
    some : ndarray of int, shape (n,)
        Places of the first, in any order.

    Returns
    -------
    ndarray of float32, shape (n,)
        -1 where the second has no place.

    """
    found = np.full(len(some), -1, np.float32)
    if second.count:
        order = np.argsort(some, kind='stable')
        found[order] = similarity(first, some[order], second).max(axis=1)
    return found


def mutual_nearest(first: Described, second: Described,
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Find the places that are most alike to each other, blocks of rows at a time.

    Parameters
    ----------
    first, second : Described

    Returns
    -------
    a, b : ndarray of int, shape (n,)
        Places that may match.
    best : ndarray of float32, shape (n,)
        Their similarity.
    runner_up : ndarray of float32, shape (n,)
        Similarity of either to any other place, -1 where there is none.

    """
    count = first.count if second.count else 0
    column = np.zeros(count, int)
    best, runner_up = np.full((2, count), -1, np.float32)
    left = np.full(second.count, -1, np.float32)
    for begin in range(0, count, _ROWS):
        rows = np.arange(begin, min(begin + _ROWS, count))
        product = similarity(first, rows, second)
        column[rows] = at = product.argmax(axis=1)
        line = rows - begin
        best[rows] = product[line, at]
        product[line, at] = -1
        runner_up[rows] = product.max(axis=1)
        np.maximum(left, product.max(axis=0), out=left)
    most = left.copy()
    np.maximum.at(most, column, best)
    mutual = (best > MIN_SIMILARITY) & (best >= most[column])
    np.maximum.at(left, column[~mutual], best[~mutual])
    a, at = np.flatnonzero(mutual), column[mutual]
    return a, second.order[at], best[a], np.maximum(runner_up[a], left[at])


def perhaps_alike(sketch: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of sketches (N, k) and (M, k) that may be alike enough to match; no others are."""
    product = sketch @ other.T
    return np.divmod(np.flatnonzero(product > MIN_SIMILARITY - _ROUNDING), product.shape[1])


def alike_within(whole: Described) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """
    Find which vectors of one image are alike, some of them at a time.

    Parameters
    ----------
    whole : Described

    Yields
    ------
    rows, columns : ndarray of int, shape (m,)
        Vectors. The place of a row comes before that of its column, or is the same.
    similarity : ndarray of float32, shape (m,)

    """
    order, crowded = np.argsort(whole.place, kind='stable'), False
    for begin in range(0, len(order), _ROWS):
        some, others = order[begin:begin + _ROWS], order[begin:]
        if not crowded:
            row, column = perhaps_alike(whole.sketch[some], whole.sketch[others])
            crowded = len(row) > _CROWDED * len(some) * len(others)
        if crowded:
            # the squares of a chessboard: one product costs less than so many single ones
            product = whole.vectors[some] @ whole.vectors[others].T
            row, column = np.divmod(np.flatnonzero(product > MIN_SIMILARITY), len(others))
            rows, columns, alike = some[row], others[column], product[row, column]
        else:
            rows, columns = some[row], others[column]
            alike = _similarities(whole, whole, rows, columns)
        once = (alike > MIN_SIMILARITY) & (whole.place[rows] <= whole.place[columns])
        yield rows[once], columns[once], alike[once]


def _similarities(first: Described, second: Described, rows: np.ndarray, columns: np.ndarray,
                  ) -> np.ndarray:
    """Cosines of vectors, row by row, shape (n,)."""
    alike = np.empty(len(rows), np.float32)
    for begin in range(0, len(rows), _AT_ONCE):
        some = slice(begin, begin + _AT_ONCE)
        np.einsum('ij,ij->i', first.vectors[rows[some]], second.vectors[columns[some]],
                  out=alike[some])
    return alike


def alike_among(first: Described, second: Described, rows: np.ndarray, columns: np.ndarray,
                ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Keep what may match, and tell how much it is alike.

    Parameters
    ----------
    first, second : Described
    rows, columns : ndarray of int, shape (n,)
        Vectors that may be alike.

    Returns
    -------
    a, b : ndarray of int, shape (m,)
        Their places, every two once, in order of a and then b.
    similarity : ndarray of float32, shape (m,)

    """
    alike = _similarities(first, second, rows, columns)
    good = alike > MIN_SIMILARITY
    return of_places(first, second, rows[good], columns[good], alike[good])


def of_places(first: Described, second: Described, rows: np.ndarray, columns: np.ndarray,
              alike: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Turn vectors that are alike into places: one with two orientations is like the better one.

    Parameters
    ----------
    first, second : Described
    rows, columns : ndarray of int, shape (n,)
        Vectors.
    alike : ndarray of float32, shape (n,)
        Their similarities.

    Returns
    -------
    a, b : ndarray of int, shape (m,)
        Their places, every two once, in order of a and then b.
    similarity : ndarray of float32, shape (m,)

    """
    pair = first.place[rows] * second.count + second.place[columns]
    # pairs come nearly in order, which a stable sort makes use of
    order = np.argsort(pair, kind='stable')
    pair, alike = pair[order], alike[order]
    once = np.flatnonzero(np.diff(pair, prepend=-1))
    if len(once) < len(pair):
        pair, alike = pair[once], np.maximum.reduceat(alike, once)
    a, b = np.divmod(pair, max(second.count, 1))
    return a, b, alike


def best_and_second(key: np.ndarray, score: np.ndarray, count: int,
                    ) -> tuple[np.ndarray, np.ndarray]:
    """
    Find the best candidate of every place, and how alike the runner-up is.

    Parameters
    ----------
    key : ndarray of int, shape (n,)
        Place of each candidate.
    score : ndarray, shape (n,)
    count : int
        Number of places.

    Returns
    -------
    top : ndarray of int, shape (count,)
        The candidate, -1 where there is none.
    second_score : ndarray, shape (count,)
        `USUAL_SIMILARITY` where there is no other.

    """
    order = np.lexsort((-score, key))
    place = np.searchsorted(key[order], np.arange(count + 1))
    top = np.full(count, -1)
    second_score = np.full(count, USUAL_SIMILARITY)
    some = place[1:] > place[:-1]
    two = place[1:] > place[:-1] + 1
    top[some] = order[place[:-1][some]]
    second_score[two] = score[order[place[:-1][two] + 1]]
    return top, second_score
