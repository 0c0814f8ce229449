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
"""The thesis's own trackers: RAPiD (algorithm 7.1), RoRAPiD (7.2); one correction a frame."""

from __future__ import annotations

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.robust_scale import fast_robust_sigma
from selfcal_ros.geometry.scaled_inverse import is_regular
from selfcal_ros.rorapid.edges.control_points import ControlModel, ControlView
from selfcal_ros.rorapid.edges.edgels import find_edgels, sample_normals
from selfcal_ros.rorapid.estimation.joint_search import Measuring
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.estimation.primitive_detection import (case_deletion, ransac_conics,
                                                                ransac_lines, stability)
from selfcal_ros.rorapid.estimation.track_quality import RANK_TOLERANCE
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose

#: Edgels are not known better than this, pixels.
_MIN_SIGMA_PX = 0.3


class RapidTracker:
    """
    One measurement per image by the thesis's algorithms.

    Parameters
    ----------
    control : ControlModel
    basis : ndarray, shape (size, m)
        Of the motion model.
    options : TrackerOptions
    rng : numpy.random.Generator

    """

    def __init__(self, control: ControlModel, basis: np.ndarray, options: TrackerOptions,
                 rng: np.random.Generator) -> None:
        """Start with full weights and the nearest search; it widens where nothing is found."""
        self.basis, self.rng = basis, rng
        self._lay_out(options, control)
        self.reset()

    def _lay_out(self, options: TrackerOptions, control: ControlModel) -> None:
        """Number the control points, and read the settings."""
        self.options, self.control = options, control
        self.robust = options.method == 'rorapid'
        primitives = len(control.is_conic)
        self._least = np.where(control.is_conic, options.least_per_conic, options.least_per_line)
        # place of each control point in its primitive
        # a crease of a mesh has as many as it is long
        counts = control.visible_model.counts
        first = np.concatenate([[0], np.cumsum(counts)[:-1]])
        self._primitive = np.repeat(np.arange(primitives), counts)
        self._place = np.arange(control.size) - first[self._primitive]
        self._most = int(counts.max())

    def reset(self) -> None:
        """Forget weights and ranges."""
        self._weight = np.ones(self.control.size)
        self._reach = np.full(len(self._least), float(self.options.search_least_px))

    def switch(self, basis: np.ndarray, camera_model: str) -> None:
        """Go on with another basis of corrections, or another camera model."""
        self.basis = basis
        self.control.projection.become(camera_model)

    def adopt(self, options: TrackerOptions, control: ControlModel) -> None:
        """Go on by other settings, and with control points that may lie elsewhere."""
        nearest = control.visible_model.nearest_in(self.control.visible_model)
        self._lay_out(options, control)
        self._weight = self._weight[nearest]
        self._reach = self._reach.clip(options.search_least_px, options.search_most_px)

    def initialise(self, image: np.ndarray, guess: ObjectPose,
                   covariance: np.ndarray | None = None) -> PoseMeasurement:
        """Measure from a first guess as from a prediction."""
        return self.measure(image, guess, covariance)

    #: The thesis's trackers neither test a pose nor search for a lost object.
    placed, verifier, seeker = True, None, None

    def seek(self) -> None:
        """Refuse to begin without a place to search around."""
        raise ArgumentError('A start without a pose needs the method modern.')

    def remember(self, measured: PoseMeasurement, confirmed: bool) -> None:
        """Learn nothing of the object's appearance."""

    def measure(self, image: np.ndarray, predicted: ObjectPose,
                covariance: np.ndarray | None = None) -> PoseMeasurement:
        """Search from the predicted state and correct it once."""
        options, control = self.options, self.control
        view = control.view(predicted)
        # RAPiD has no adaptive range: the smaller bound, where fewest wrong edges are
        reach = self._reach if self.robust else np.full_like(
            self._reach, options.search_least_px)
        at = np.flatnonzero(view.searched)
        offset = np.full(len(view.ids), np.nan)
        if len(at):
            most = int(np.ceil(reach[view.primitive[at]].max()))
            profiles = sample_normals(image, view.projected.pixels[at], view.normal[at], most,
                                      lanes=1)
            offset[at] = find_edgels(profiles, 1, options.least_contrast).offset[:, 0]
            offset[np.abs(offset) > reach[view.primitive]] = np.nan
        found = np.isfinite(offset)
        if self.robust:
            found = self._support(view, offset, found)
            weight = self._weight[view.ids]
        else:
            weight = np.ones(len(offset))
        rows = control.projection.rows(predicted, view.projected, view.normal) @ self.basis
        if self.robust:
            found = self._without_wrong(view, rows, offset, weight, found)
        result = self._solve(predicted, view, rows, offset, weight, found)
        if self.robust:
            self._remember(view, offset, found)
        return result

    def measuring(self, image: np.ndarray, predicted: ObjectPose,
                  covariance: np.ndarray) -> Measuring:
        """Measure; nothing is searched together with others."""
        yield from ()
        return self.measure(image, predicted, covariance)

    def _support(self, view: ControlView, offset: np.ndarray, found: np.ndarray) -> np.ndarray:
        """RANSAC within each primitive; primitives with too few edgels are not found."""
        xy = view.projected.pixels + np.where(found, offset, 0.0)[:, None] * view.normal
        primitives = np.unique(view.primitive)
        row = np.searchsorted(primitives, view.primitive)
        place = self._place[view.ids]
        padded = np.zeros((len(primitives), self._most, 2))
        valid = np.zeros((len(primitives), self._most), bool)
        padded[row, place], valid[row, place] = xy, found
        support = np.zeros_like(valid)
        conic = self.control.is_conic[primitives]
        support[~conic] = ransac_lines(padded[~conic], valid[~conic], self.options.support_px,
                                       self.rng)
        support[conic] = ransac_conics(padded[conic], valid[conic], self.options.support_px,
                                       self.rng)
        support[support.sum(axis=1) < self._least[primitives]] = False
        within: np.ndarray = support[row, place]
        return within

    def _without_wrong(self, view: ControlView, rows: np.ndarray, offset: np.ndarray,
                       weight: np.ndarray, found: np.ndarray) -> np.ndarray:
        """Case deletion over the primitives."""
        primitives = len(self._least)
        m = rows.shape[1]
        w = np.where(found, weight, 0.0)
        length = np.where(found, offset, 0.0)
        owner = view.primitive
        matrices = np.zeros((primitives, m, m))
        np.add.at(matrices, owner, (w[:, None] * rows)[:, :, None] * rows[:, None])
        vectors = np.zeros((primitives, m))
        np.add.at(vectors, owner, (w * length)[:, None] * rows)
        squares = np.bincount(owner, w * length**2, primitives)
        counts = np.bincount(owner, w, primitives)
        damping = 1e-6 * np.diag(np.diagonal(matrices.sum(axis=0)) + 1e-12)
        least = int(np.ceil(m / 2))
        alive = case_deletion(matrices, vectors, squares, counts, 2 * self.options.support_px,
                              least, damping)
        kept: np.ndarray = found & alive[owner]
        return kept

    def _solve(self, predicted: ObjectPose, view: ControlView, rows: np.ndarray,
               offset: np.ndarray, weight: np.ndarray, found: np.ndarray) -> PoseMeasurement:
        """Return the weighted pose correction (7.12)."""
        w = np.where(found, weight, 0.0)
        length = np.where(found, offset, 0.0)
        H = (rows * w[:, None]).T @ rows
        g = rows.T @ (w * length)
        determined = (found.sum() >= rows.shape[1]
                      and is_regular(H, RANK_TOLERANCE))
        searched = max(int(view.searched.sum()), 1)
        share = float(found.sum() / searched)
        if not determined:
            return PoseMeasurement(
                state=predicted, covariance=np.eye(len(g)), with_prior=False, view=view,
                edge_px=offset, found=found, texture_px=np.zeros((0, 2)), share=share,
                determined=False, focal_sigma=np.inf,
                reason='The edges found do not determine the pose.')
        q = np.linalg.solve(H, g)
        control = self.control
        state = control.projection.moved(predicted, self.basis @ q)
        after = control.again(view, state)
        residual = offset - rows @ q
        sigma = fast_robust_sigma(residual[found], _MIN_SIGMA_PX)
        # weights are confidence, not precision: the spread is that of the weighted mean
        inverse = np.linalg.inv(H)
        covariance = sigma**2 * inverse @ ((rows * (w * w)[:, None]).T @ rows) @ inverse
        focal = np.sqrt((self.basis @ covariance @ self.basis.T)[6, 6]) if (
            control.projection.model == 'zoom') else 0.0
        return PoseMeasurement(
            state=state, covariance=covariance, with_prior=False, view=after, edge_px=residual,
            found=found, texture_px=np.zeros((0, 2)), share=share, determined=True,
            recognised=share >= self.options.tracking_share, focal_sigma=float(focal))

    def _remember(self, view: ControlView, offset: np.ndarray, found: np.ndarray) -> None:
        """Stability weights, and the search range of each primitive (8 to 24 px)."""
        seen = view.ids[view.searched]
        self._weight[seen] = stability(found[view.searched], self._weight[seen])
        low, high = self.options.search_least_px, self.options.search_most_px
        count = np.bincount(view.primitive, found, len(self._reach))
        largest = np.zeros(len(self._reach))
        np.maximum.at(largest, view.primitive, np.where(found, np.abs(offset), 0.0))
        there = np.bincount(view.primitive, view.searched, len(self._reach)) > 0
        ok = count >= self._least
        wider = np.minimum(self._reach * 1.5, high)
        nearer = np.where(largest < 0.4 * self._reach, np.maximum(self._reach * 0.8, low),
                          self._reach)
        self._reach = np.where(there, np.where(ok, nearer, wider), self._reach)
