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
The zoom block: a focal length that differs from view to view (thesis 3.1.7).

    u = c + exp(z_i) (lens(X) - c),    Σ z_i = 0

The image of view i is that of the lens, magnified about the principal point c. The distortion
goes with it: as a function of the ray's angle it stays what it is. That is exact where the image
plane moves, and the usual approximation where groups of lenses do. The mean of z over the views
is zero, so that f of the lens block is the geometric mean of the views' focal lengths: of all
instants the one that the images determine best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens, Projection
from selfcal_ros.calibration.bundle.unknowns import PriorTerms, Unknowns

#: Unknown of all views: change of log f from the first to the last, where it grows steadily.
RATE_NAME = 'focal_rate'
#: Unknown of each view: log of its focal length over the mean.
VIEW_NAME = 'log_focal'


@dataclass(frozen=True)
class ZoomModel:
    """
    How the focal length may vary.

    Attributes
    ----------
    instants : tuple of float
        When each view was taken, in any unit: its frame number will do.
    sigma : float
        Standard deviation of the change of log f between successive views a mean interval
        apart: a random walk. 0: it grows steadily; infinity: every view has its own.

    """

    instants: tuple[float, ...]
    sigma: float = np.inf

    @property
    def is_steady(self) -> bool:
        """Tell whether one unknown describes it."""
        return self.sigma == 0

    @property
    def course(self) -> np.ndarray:
        """Instants from -1/2 to 1/2 or so, their mean zero, shape (V,)."""
        instants = np.asarray(self.instants, float)
        course: np.ndarray = (instants - instants.mean()) / max(float(np.ptp(instants)), 1e-300)
        return course

    @property
    def variances(self) -> np.ndarray:
        """Variance of each step of the random walk, shape (V - 1,)."""
        gaps = np.abs(np.diff(np.asarray(self.instants, float)))
        shares: np.ndarray = np.maximum(gaps / max(float(gaps.mean()), 1e-300), 1e-2)
        return self.sigma**2 * shares

    def rate_of(self, log_focal: np.ndarray) -> float:
        """Return the steady growth that is nearest to values (V,)."""
        return float(self.course @ log_focal / (self.course @ self.course))

    def of_views(self, views: np.ndarray) -> ZoomModel:
        """Return the model for some of the views."""
        return replace(self, instants=tuple(self.instants[int(view)] for view in views))


@dataclass(frozen=True)
class Zoom:
    """
    Values of the zoom block.

    Attributes
    ----------
    log_focal : ndarray, shape (V,)
        z, the log of each view's focal length over that of the lens block.

    """

    log_focal: np.ndarray

    @classmethod
    def constant(cls, views: int) -> Zoom:
        """Return views of one focal length."""
        return cls(np.zeros(views))

    def __len__(self) -> int:
        """Count the views."""
        return len(self.log_focal)

    @property
    def scale(self) -> np.ndarray:
        """Magnification of each view, shape (V,)."""
        with np.errstate(over='ignore'):  # a step too far has an infinite cost, and is not taken
            scale: np.ndarray = np.exp(self.log_focal)
        return scale

    def of_views(self, kept: np.ndarray) -> Zoom:
        """Return the zoom of some of the views; their mean need not be zero."""
        return Zoom(self.log_focal[kept])

    def unzoomed(self, xy: np.ndarray, view: np.ndarray, lens: Lens) -> np.ndarray:
        """Return pixels (N, 2) as the camera of the mean focal length would see them."""
        centre = lens.values[2:4]
        plain: np.ndarray = centre + (xy - centre) / self.scale[view][:, None]
        return plain

    def moved(self, steps: np.ndarray) -> Zoom:
        """Return the zoom after steps of `VIEW_NAME` (V,)."""
        return Zoom(self.log_focal + steps)

    def grown(self, rate: float, model: ZoomModel) -> Zoom:
        """Return the zoom after a step of `RATE_NAME`."""
        return Zoom(self.log_focal + rate * model.course)


class ZoomedProjection(Projection):
    """
    Pixels of points in views of different focal lengths.

    Parameters
    ----------
    lens : Lens
    X : ndarray, shape (N, 3)
    scale : ndarray, shape (N,)
        Magnification of the view of each.

    """

    def __init__(self, lens: Lens, X: np.ndarray, scale: np.ndarray):
        super().__init__(lens, X)
        self._scale = scale[:, None, None]
        self.by_log_focal = (self.uv - lens.values[2:4]) * scale[:, None]
        self.uv = lens.values[2:4] + self.by_log_focal

    def by_points(self) -> np.ndarray:
        """Differentiate by the points; shape (N, 2, 3)."""
        by_points: np.ndarray = super().by_points() * self._scale
        return by_points

    def by_intrinsics(self, free: np.ndarray | None = None, columns: int = 0) -> np.ndarray:
        """Differentiate by the unknowns of the lens; see `Projection.by_intrinsics`."""
        J = super().by_intrinsics(free, columns)
        centre = J[:, :, 2:4].copy()
        J *= self._scale
        J[:, :, 2:4] = centre
        return J


def projection(lens: Lens, X: np.ndarray, zoom: Zoom | None, view: np.ndarray) -> Projection:
    """Project points (N, 3) of the camera frames of views (N,)."""
    return Projection(lens, X) if zoom is None else ZoomedProjection(lens, X, zoom.scale[view])


def with_zoom(unknowns: Unknowns, model: ZoomModel) -> Unknowns:
    """Add the unknowns of the block to those of lens and path."""
    if model.is_steady:
        return unknowns.extended(shared=(RATE_NAME,))
    return unknowns.extended(of_view=(VIEW_NAME,), balanced=VIEW_NAME)


def differentiate(pixels: Projection, model: ZoomModel, view: np.ndarray, shared: np.ndarray,
                  own: np.ndarray) -> np.ndarray:
    """
    Differentiate by the unknowns of the block.

    Parameters
    ----------
    pixels : Projection
    model : ZoomModel
    view : ndarray of int, shape (N,)
    shared : ndarray, shape (N, 2, g)
        By what all views share; its last column is filled in where the growth is steady.
    own : ndarray, shape (N, 2, v)
        By the unknowns of each view but this block's.

    Returns
    -------
    ndarray, shape (N, 2, v) or (N, 2, v + 1)
        By the unknowns of each view.

    """
    slope = (pixels.by_log_focal if isinstance(pixels, ZoomedProjection)
             else pixels.uv - pixels.lens.values[2:4])
    if model.is_steady:
        shared[:, :, -1] = slope * model.course[view][:, None]
        return own
    return np.concatenate([own, slope[:, :, None]], axis=2)


def walk_information(model: ZoomModel) -> np.ndarray:
    """Information (V, V) about `log_focal` that the random walk is."""
    difference = np.diff(np.eye(len(model.instants)), axis=0)
    matrix: np.ndarray = difference.T @ (difference / model.variances[:, None])
    return matrix


def couplings(model: ZoomModel | None, unknowns: Unknowns,
              ) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Return what the random walk adds to the normal equations beside their diagonal.

    Returns
    -------
    places : ndarray of int, shape (V,)
        Of `VIEW_NAME` among the unknowns.
    matrix : ndarray, shape (V, V)
        Its diagonal is zero.

    None where there is no such prior.

    """
    if model is None or not 0 < model.sigma < np.inf:
        return None
    matrix = walk_information(model)
    return unknowns.of_views(VIEW_NAME)[:, 0], matrix - np.diag(np.diag(matrix))


def with_walk(terms: PriorTerms, zoom: Zoom | None, model: ZoomModel | None,
              unknowns: Unknowns) -> PriorTerms:
    """Add the random walk to cost, gradient (n,) and diagonal (n,) of other priors."""
    if model is None or not 0 < model.sigma < np.inf:
        return terms
    cost, gradient, diagonal = terms
    matrix, places = walk_information(model), unknowns.of_views(VIEW_NAME)[:, 0]
    diagonal[places] += np.diag(matrix)
    if zoom is not None:
        slope = matrix @ zoom.log_focal
        cost += 0.5 * float(zoom.log_focal @ slope)
        gradient[places] += slope
    return cost, gradient, diagonal


def walk_count(model: ZoomModel | None) -> int:
    """Count the measurements that the random walk stands for."""
    return (len(model.instants) - 1
            if model is not None and 0 < model.sigma < np.inf else 0)
