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
What a product of blocks offers to the adjustment.

    u(observation) = lens( path[view] · point )

One block is eliminated from the normal equations: the points of a scene, or the poses before an
object whose points are known. What remains has names (`Unknowns`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from selfcal_ros.calibration.bundle.state import StateT
from selfcal_ros.calibration.bundle.unknowns import PriorTerms, Unknowns
from selfcal_ros.geometry.schur_complement import PointBlocks

#: Depth below which a point counts as behind the camera, relative to its distance.
MINIMUM_DEPTH = 1e-6


@dataclass(frozen=True)
class Linearisation:
    """
    Residuals of every observation, and their derivatives.

    Attributes
    ----------
    residual : ndarray, shape (N, m)
        Pixels; m = 2 for points, 1 for the distance from an edge.
    ahead : ndarray of bool, shape (N,)
        False behind the camera.
    shared : ndarray, shape (N, m, g)
        By what all observations share.
    view : ndarray, shape (N, m, v)
        By the unknowns of the view, where these are not eliminated.
    eliminated : ndarray, shape (N, m, p)
        By the block that is eliminated.

    """

    residual: np.ndarray
    ahead: np.ndarray
    shared: np.ndarray
    view: np.ndarray
    eliminated: np.ndarray


@dataclass(frozen=True)
class Prediction:
    """
    Residuals of every observation; derivatives are made of what is known here, when asked for.

    Attributes
    ----------
    residual : ndarray, shape (N, m)
        See `Linearisation`.
    ahead : ndarray of bool, shape (N,)
    differentiated : callable
        (Unknowns) -> Linearisation; derivatives by fixed ones may be left at zero.
    by_points : callable, optional
        () -> derivatives (N, m, p) by the points alone, where those are eliminated.

    """

    residual: np.ndarray
    ahead: np.ndarray
    differentiated: Callable[[Unknowns], Linearisation]
    by_points: Callable[[], np.ndarray] | None = None


class Model(Protocol[StateT]):
    """
    A product of blocks.

    Attributes
    ----------
    dimension : int
        m, coordinates of a residual.
    eliminated : int
        p, unknowns of one part of the block that is eliminated.
    eliminated_freedom : int
        How many of them the images could determine at all.
    within_tracks : bool
        Whether what is eliminated belongs to one track, and absorbs part of its errors.
    has_scale_gauge : bool
        Whether one of the unknowns only scales the world.
    is_bent : bool
        Whether the cost has long bent valleys, along which steps pay that bend as they do.

    """

    @property
    def dimension(self) -> int: ...
    @property
    def eliminated(self) -> int: ...
    @property
    def eliminated_freedom(self) -> int: ...
    @property
    def within_tracks(self) -> bool: ...
    @property
    def has_scale_gauge(self) -> bool: ...
    @property
    def is_bent(self) -> bool: ...

    def unknowns(self, views: int, lens_names: tuple[str, ...]) -> Unknowns:
        """Lay out what remains, facts not yet regarded."""
        ...

    def predict(self, state: StateT, blocks: PointBlocks, xy: np.ndarray) -> Prediction:
        """Project every observation."""
        ...

    def moved(self, state: StateT, step: np.ndarray, steps: np.ndarray,
              unknowns: Unknowns) -> StateT:
        """Move a state by a step (n,) of what remains and steps (P, p) of what is eliminated."""
        ...

    def prior_terms(self, state: StateT, unknowns: Unknowns) -> PriorTerms:
        """Return cost, gradient and diagonal of what the blocks suppose themselves."""
        ...

    def couplings(self, unknowns: Unknowns) -> tuple[np.ndarray, np.ndarray] | None:
        """Return what they add to the normal equations beside it: places (k,), matrix (k, k)."""
        ...

    def prior_count(self, views: int) -> int:
        """Count the measurements that these stand for."""
        ...

    def gauge(self, state: StateT, unknowns: Unknowns) -> np.ndarray | None:
        """Return the direction (n,) that no image can determine, if there is one."""
        ...
