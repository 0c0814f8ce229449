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
"""Named unknowns: which are free, which move together, and where they stand."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from selfcal_ros.geometry.selection_matrix import selection_matrix

#: Cost of what is supposed, and its gradient (n,) and diagonal (n,) by the unknowns.
PriorTerms = tuple[float, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Unknowns:
    """
    Layout of the unknowns that remain once one block is eliminated.

    The lens comes first, then what all views share of the path, then the unknowns of each view.
    Nothing outside this class counts columns.

    Attributes
    ----------
    lens_names, shared_names, view_names : tuple of str
        Of the lens, and of the path, for all views and of each.
    views : int
    free : ndarray of bool, shape (n,)
        False for what is fixed.
    moves_with : ndarray of int, shape (n,)
        The unknown that each is tied to; itself where it is not.
    balanced : tuple of int
        Where unknowns stand that move by nothing in sum; the last of them follows the others.

    """

    lens_names: tuple[str, ...]
    shared_names: tuple[str, ...]
    view_names: tuple[str, ...]
    views: int
    free: np.ndarray
    moves_with: np.ndarray
    balanced: tuple[int, ...] = ()

    @classmethod
    def all_free(cls, lens_names: tuple[str, ...], shared_names: tuple[str, ...] = (),
                 view_names: tuple[str, ...] = (), views: int = 0) -> Unknowns:
        """Lay out a lens, and a path with these unknowns."""
        count = len(lens_names) + len(shared_names) + views * len(view_names)
        return cls(lens_names, shared_names, view_names, views, np.ones(count, bool),
                   np.arange(count))

    def extended(self, shared: tuple[str, ...] = (), of_view: tuple[str, ...] = (),
                 balanced: str = '') -> Unknowns:
        """
        Lay out more unknowns, all free, after those that there are.

        Parameters
        ----------
        shared, of_view : tuple of str
            Of all views, and of each.
        balanced : str
            One of each view that moves by nothing in sum.

        """
        wider = Unknowns.all_free(self.lens_names, (*self.shared_names, *shared),
                                  (*self.view_names, *of_view), self.views)
        place = np.r_[:self.shared.stop, wider.by_view[:, :len(self.view_names)].ravel()]
        wider.free[place] = self.free
        wider.moves_with[place] = place[self.moves_with]
        return replace(wider, balanced=tuple(
            wider.of_views(balanced)[:, 0].tolist()) if balanced else ())

    def __len__(self) -> int:
        """Count all, the fixed ones too."""
        return len(self.free)

    @property
    def lens(self) -> slice:
        """Where the unknowns of the lens stand."""
        return slice(0, len(self.lens_names))

    @property
    def shared(self) -> slice:
        """Where the unknowns stand that every observation shares."""
        return slice(0, len(self.lens_names) + len(self.shared_names))

    @property
    def path(self) -> slice:
        """Where all unknowns of the path stand, shared and of the views."""
        return slice(len(self.lens_names), len(self.free))

    @cached_property
    def by_view(self) -> np.ndarray:
        """Where the unknowns of each view stand, shape (views, len(view_names))."""
        first = self.shared.stop
        return np.arange(first, len(self.free)).reshape(self.views, len(self.view_names))

    def of_views(self, *names: str) -> np.ndarray:
        """Where these unknowns of every view stand, shape (views, len(names))."""
        return self.by_view[:, [self.view_names.index(name) for name in names]]

    def places(self, names: Iterable[str]) -> np.ndarray:
        """Where shared unknowns stand, by name, shape (k,)."""
        every = (*self.lens_names, *self.shared_names)
        return np.array([every.index(name) for name in names], dtype=int)

    @property
    def free_lens(self) -> np.ndarray:
        """Where the free unknowns of the lens stand, shape (k,)."""
        return np.flatnonzero(self.free[self.lens])

    @property
    def free_lens_names(self) -> tuple[str, ...]:
        """Names of the free unknowns of the lens; they are the first independent ones."""
        return tuple(self.lens_names[place] for place in self.free_lens)

    @cached_property
    def members(self) -> np.ndarray:
        """Where one of each of the independent unknowns stands, shape (k,)."""
        members = np.unique(self.moves_with[self.free[self.moves_with]])
        return members[members != self.balanced[-1]] if self.balanced else members

    @cached_property
    def selection(self) -> csr_array:
        """Relate all to the independent ones: steps (n,) = selection · steps (k,)."""
        return selection_matrix(self.free, self.moves_with, self.balanced)

    @property
    def count(self) -> int:
        """Count the independent ones."""
        return int(self.selection.shape[1])
