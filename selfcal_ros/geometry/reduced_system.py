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
"""Normal equations once the points are eliminated, and by what the points follow."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg.blas import dger
from scipy.sparse import csr_array

from selfcal_ros.geometry.chain_matrix import ChainMatrix

if TYPE_CHECKING:
    from selfcal_ros.geometry.schur_complement import PointBlocks


@dataclass(frozen=True)
class Elimination:
    """
    By what the eliminated points follow the rest: all that their covariance needs.

    Attributes
    ----------
    inverse_root : ndarray, shape (P, p, p)
        Inverse Cholesky factors of the points' blocks.
    factors : list of (ndarray, ndarray, ndarray)
        Groups of points: which, the coupling divided by the root of their blocks, and the
        independent unknowns of the rest that it concerns.
    size : int
        k, independent unknowns of the rest.

    """

    inverse_root: np.ndarray
    factors: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
    size: int

    def point_form(self, form: np.ndarray) -> tuple[np.ndarray, float]:
        """
        Express a linear form of the points' steps by those of the rest.

        Parameters
        ----------
        form : ndarray, shape (P, p)

        Returns
        -------
        ndarray, shape (k,)
            Its coefficients by the rest, where the points follow.
        float
            Its variance with the rest held.

        """
        half = np.einsum('pij,pj->pi', self.inverse_root, form)
        carried = np.zeros(self.size)
        for members, M, columns in self.factors:
            # most forms are of a few points
            if half[members].any():
                carried[columns] -= M.T @ half[members].ravel()
        return carried, float(np.sum(half**2))


@dataclass(frozen=True)
class FurtherUnknowns:
    """
    Normal equations of further unknowns beside a system, the points eliminated.

    Attributes
    ----------
    columns : ndarray, shape (N, m, q)
        Derivatives of every residual.
    coupling : ndarray, shape (n, q)
        Products with the unknowns of the system.
    own : ndarray, shape (q, q)
    gradient : ndarray, shape (q,)
    through : ndarray, shape (P, p, q)
        By what the points follow, divided by the root of their blocks.

    """

    columns: np.ndarray
    coupling: np.ndarray
    own: np.ndarray
    gradient: np.ndarray
    through: np.ndarray

    def first(self, count: int) -> FurtherUnknowns:
        """Return the first of them alone."""
        return FurtherUnknowns(self.columns[:, :, :count], self.coupling[:, :count],
                               self.own[:count, :count], self.gradient[:count],
                               self.through[:, :, :count])

    def influence(self, system: ReducedSystem, rows: np.ndarray) -> np.ndarray:
        """Add to `ReducedSystem.influence` what rows (k, q) of these unknowns do: (N, k)."""
        moved = self.columns @ rows.T
        effect = np.einsum('nmk,nm->nk', moved, system.residual)
        effect -= np.einsum('ni,nik->nk', system.pulls_on_points(),
                            (self.through @ rows.T)[system.blocks.point])
        influence: np.ndarray = -effect
        return influence


@dataclass
class ReducedSystem:
    """
    Normal equations after the points are eliminated: matrix · step = -gradient.

    Attributes
    ----------
    matrix : ndarray or ChainMatrix, shape (n, n)
    diagonal : ndarray, shape (n,)
        Diagonal before the elimination, which scales the damping.
    residual : ndarray, shape (N, m)
    jac_rest, jac_point : ndarray, shape (N, m, g + v), (N, m, p)
    gradient : ndarray, shape (n,)
    half_b : ndarray, shape (P, p)
        The points' share of the right-hand side, divided by the root of their blocks.
    inverse_root : ndarray, shape (P, p, p)
        Inverse Cholesky factors of the points' blocks.

    """

    blocks: PointBlocks
    matrix: np.ndarray | ChainMatrix
    diagonal: np.ndarray
    residual: np.ndarray
    jac_rest: np.ndarray
    jac_point: np.ndarray
    inverse_root: np.ndarray
    _factors: list[tuple[np.ndarray, np.ndarray, slice | np.ndarray]]
    _shared: int
    gradient: np.ndarray = field(default_factory=lambda: np.empty(0))
    half_b: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))

    def add_diagonal(self, at: np.ndarray, values: np.ndarray) -> None:
        """Add values (k,) on the diagonal of the matrix, at these rows (k,)."""
        if isinstance(self.matrix, ChainMatrix):
            self.matrix.add_diagonal(at, values)
        else:
            self.matrix[at, at] += values

    def add_block(self, at: np.ndarray, block: np.ndarray) -> None:
        """Add a symmetric block (k, k) to the matrix, at these rows (k,)."""
        if isinstance(self.matrix, ChainMatrix):
            if self.matrix.add_block(at, block):
                return
            self.matrix = np.asarray(self.matrix)
        self.matrix[np.ix_(at, at)] += block

    def add_gauge(self, weight: float, direction: np.ndarray) -> None:
        """Hold a direction (n,) of unit length that no measurement determines."""
        if isinstance(self.matrix, ChainMatrix):
            self.matrix.add_gauge(weight, direction)
        else:
            # in place, for the rows of a symmetric matrix are its columns
            self.matrix = dger(weight, direction, direction, a=self.matrix.T, overwrite_a=1).T

    def columns(self, places: np.ndarray) -> np.ndarray:
        """Return some columns of the matrix, shape (n, k)."""
        if isinstance(self.matrix, ChainMatrix):
            return self.matrix.columns(places)
        return self.matrix[:, places]

    def _by_shared(self) -> np.ndarray:
        """Derivatives of all rows by what is shared, (N m, g); no copy."""
        return self.jac_rest.reshape(-1, self.jac_rest.shape[2])[:, :self._shared]

    def _by_view(self, residual: np.ndarray) -> np.ndarray:
        """Products of residuals (N, m) and derivatives by the unknowns of the view, (N, v)."""
        by_view: np.ndarray = np.einsum('nmk,nm->nk', self.jac_rest[:, :, self._shared:], residual)
        return by_view

    def right_hand_side(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Eliminate the points from Jᵀ r.

        Parameters
        ----------
        residual : ndarray, shape (N, m)

        Returns
        -------
        gradient : ndarray, shape (n,)
        half_b : ndarray, shape (P, p)

        """
        g = self._shared
        gradient = np.empty(len(self.matrix))
        gradient[:g] = residual.ravel() @ self._by_shared()
        if len(gradient) > g:
            gradient[g:] = self.blocks.sum_over_views(self._by_view(residual)).ravel()
        b = self.blocks.sum_over_points(np.einsum('nmk,nm->nk', self.jac_point, residual))
        half_b = np.einsum('pij,pj->pi', self.inverse_root, b)
        for members, M, own in self._factors:
            part = M.T @ half_b[members].ravel()
            gradient[:g] -= part[:g]
            gradient[own] -= part[g:]
        return gradient, half_b

    def point_steps(self, step: np.ndarray, half_b: np.ndarray | None = None) -> np.ndarray:
        """Back-substitute: steps (P, p) of the points for a step (n,) of the rest."""
        half = np.array(self.half_b if half_b is None else half_b)
        for members, M, own in self._factors:
            local = np.concatenate([step[:self._shared], step[own]])
            half[members] += (M @ local).reshape(len(members), -1)
        steps: np.ndarray = -np.einsum('pji,pj->pi', self.inverse_root, half)
        return steps

    def point_rows(self, half: np.ndarray) -> np.ndarray:
        """
        Tell how a linear form of every point follows the rest.

        Parameters
        ----------
        half : ndarray, shape (P, p)
            `inverse_root` times the forms.

        Returns
        -------
        ndarray, shape (P, n)
            Change of each form by a step of the rest, the points following.

        """
        rows = np.zeros((len(half), len(self.gradient)))
        for members, M, own in self._factors:
            by_rest = -np.einsum('mi,min->mn', half[members],
                                 M.reshape(len(members), half.shape[1], -1))
            columns = np.r_[:self._shared, np.arange(len(self.gradient))[own]]
            rows[members[:, None], columns] = by_rest
        return rows

    def pulls_on_points(self) -> np.ndarray:
        """Return what each residual pulls its point by, over the root of its block, (N, p)."""
        own_points = np.einsum('nmk,nm->nk', self.jac_point, self.residual)
        pulls: np.ndarray = np.einsum('nij,nj->ni', self.inverse_root[self.blocks.point],
                                      own_points)
        return pulls

    def influence(self, rows: np.ndarray) -> np.ndarray:
        """
        First-order effect of every observation's residual on linear forms of the unknowns.

        Parameters
        ----------
        rows : ndarray, shape (k, n)
            Linear forms times the inverse of `matrix`.

        Returns
        -------
        ndarray, shape (N, k)
            Their sum over the observations is the step -rows · gradient.

        """
        g = self._shared
        # of every row first: there are fewer forms than shared unknowns
        moved = (self._by_shared() @ rows[:, :g].T).reshape(*self.residual.shape, len(rows))
        effect = np.einsum('nmk,nm->nk', moved, self.residual)
        if self.jac_rest.shape[2] > g:
            by_view = rows[:, g:].reshape(len(rows), self.blocks.view_count, -1)
            effect += np.einsum('nv,nvk->nk', self._by_view(self.residual),
                                by_view.transpose(1, 2, 0)[self.blocks.view])
        through_points = np.empty((*self.half_b.shape, len(rows)))
        for members, M, own in self._factors:
            local = np.concatenate([rows[:, :g], rows[:, own]], axis=1)
            through_points[members] = (M @ local.T).reshape(len(members), -1, len(rows))
        effect -= np.einsum('ni,nik->nk', self.pulls_on_points(),
                            through_points[self.blocks.point])
        influence: np.ndarray = -effect
        return influence

    def of_views(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Eliminate the points from the equations of one further unknown of every view.

        Parameters
        ----------
        columns : ndarray, shape (N, m)
            Derivative of every residual by that of its view, weighed as those are.

        Returns
        -------
        coupling : ndarray, shape (n, V)
            Products with the unknowns that are here.
        own : ndarray, shape (V, V)
        gradient : ndarray, shape (V,)

        """
        g, blocks, n = self._shared, self.blocks, len(self.gradient)
        by_rest = blocks.sum_over_views(np.einsum('nmk,nm->nk', self.jac_rest, columns))
        coupling = np.zeros((n, blocks.view_count))
        coupling[:g] = by_rest[:, :g].T
        each = np.arange(blocks.view_count)
        coupling[g:].reshape(blocks.view_count, -1, blocks.view_count)[each, :, each] = (
            by_rest[:, g:])
        square = np.stack([np.sum(columns**2, axis=1), np.sum(columns * self.residual, axis=1)], 1)
        diagonal, gradient = blocks.sum_over_views(square).T
        own = np.diag(diagonal)
        cross = blocks.sum_over_cells(np.einsum('nmk,nm->nk', self.jac_point, columns))
        for group, (members, M, rows) in zip(blocks.groups, self._factors):
            W = np.zeros((len(members), cross.shape[1], len(group.window)))
            W[group.slot, :, group.column] = cross[group.rows]
            W = (self.inverse_root[members] @ W).reshape(len(M), -1)
            views = group.window if blocks.chain is None else blocks.chain.order[group.window]
            product = M.T @ W
            coupling[:g, views] -= product[:g]
            coupling[np.arange(n)[rows][:, None], views] -= product[g:]
            own[views[:, None], views] -= W.T @ W
            gradient[views] -= W.T @ self.half_b[members].ravel()
        return coupling, own, gradient

    def beside(self, columns: np.ndarray) -> FurtherUnknowns:
        """
        Eliminate the points from the equations of further unknowns that all views share.

        Parameters
        ----------
        columns : ndarray, shape (N, m, q)
            Derivatives of every residual by them, weighed as those are.

        Returns
        -------
        FurtherUnknowns

        """
        g, blocks, count = self._shared, self.blocks, columns.shape[2]
        flat = columns.reshape(-1, count)
        coupling = np.empty((len(self.gradient), count))
        coupling[:g] = self._by_shared().T @ flat
        if len(coupling) > g:
            coupling[g:] = blocks.products_by_views(
                self.jac_rest[:, :, g:], columns).reshape(-1, count)
        through = self.inverse_root @ blocks.products_by_points(self.jac_point, columns)
        for members, M, own in self._factors:
            product = M.T @ through[members].reshape(len(M), count)
            coupling[:g] -= product[:g]
            coupling[own] -= product[g:]
        spread = through.reshape(-1, count)
        return FurtherUnknowns(columns, coupling, flat.T @ flat - spread.T @ spread,
                               flat.T @ self.residual.ravel() - spread.T @ self.half_b.ravel(),
                               through)

    def elimination(self, selection: csr_array) -> Elimination:
        """
        Tell by what the points follow the independent unknowns of the rest.

        Parameters
        ----------
        selection : csr_array, shape (n, k)
            Of `selection_matrix`.

        Returns
        -------
        Elimination

        """
        factors, g = [], self._shared
        for members, M, own in self._factors:
            every = np.arange(selection.shape[0])
            rows = selection[np.r_[:g, every[own]]]
            columns = np.unique(rows.indices)
            factors.append((members, M @ rows[:, columns], columns))
        return Elimination(self.inverse_root, factors, selection.shape[1])

    def predict(self, step: np.ndarray, point_steps: np.ndarray) -> np.ndarray:
        """Change J · step of the residuals (N, m) to first order."""
        g = self._shared
        change: np.ndarray = (
            (self._by_shared() @ step[:g]).reshape(self.residual.shape)
            + np.einsum('nmk,nk->nm', self.jac_point,
                        np.take(point_steps, self.blocks.point, axis=0)))
        if len(step) > g:
            per_view = np.take(step[g:].reshape(self.blocks.view_count, -1), self.blocks.view,
                               axis=0)
            change += np.einsum('nmk,nk->nm', self.jac_rest[:, :, g:], per_view)
        return change
