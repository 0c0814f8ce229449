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
"""One round of the search for edges: all control points at once, and the state they speak for."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.robust_loss import tukey_weight
from selfcal_ros.geometry.robust_scale import fast_robust_sigma
from selfcal_ros.rorapid.edges.control_points import ControlModel, ControlView
from selfcal_ros.rorapid.edges.edge_choice import (
    change_of_light, contrast_matches, contrast_penalty)
from selfcal_ros.rorapid.edges.edge_noise import (
    CommonScatter, EdgeNoise, shared_by_outline, sums_of, UNSEEN, UNSEEN_OUTLINE)
from selfcal_ros.rorapid.edges.edgels import BOW_OF_LANES, find_edgels, sample_normals
from selfcal_ros.rorapid.edges.limb import limb_shift
from selfcal_ros.rorapid.estimation.edge_fit import (
    EdgeCandidates, EdgeChoice, EdgeFit, NOWHERE_PX, PosePrior, SearchRound)
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.projection.free_directions import apart_from
from selfcal_ros.rorapid.region.outline_greys import OutlineGreys
from selfcal_ros.rorapid.texture.corner_fit import AgreeingCorners, CornerFit

#: Noise of the edges in one image against what was learned, at the least.
_MIN_NOISE = 0.7
#: Tukey's limit in sigmas, and of the last steps at the most, pixels.
_TUKEY, _NARROW_PX = 4.5, 3.0
#: Steps with the narrow limit in the last round; each leaves a third of the error before.
_LAST_STEPS = 2
#: Contrast that is strong.
_STRONG = 40.0
#: The noise of edges is learned from every so many images.
_NOISE_EVERY = 2
#: Pixels beside a guessed outline that are learned from.
_GLANCE_PX = 10
#: Standard deviation of an edge where a round part turns away before another one, over that of a
#: line: both of its sides are shaded, which draws all of them one way.
_BEFORE_PART = 3.5


class EdgeSearch:
    """
    Searches edges, and remembers what they look like and how well they are located.

    Parameters
    ----------
    control : ControlModel
    basis : ndarray, shape (size, m)
    options : TrackerOptions
    corners : CornerFit
        For the corners beside the edges.

    Attributes
    ----------
    basis : ndarray, shape (size, m)
    share : float
        Of the edges that were found in the last image accepted.
    contrast : ndarray, shape (size,)
        Remembered contrast of each control point, 0 where none is, grey levels.

    """

    def __init__(self, control: ControlModel, basis: np.ndarray, options: TrackerOptions,
                 corners: CornerFit):
        """Start without memory."""
        self.basis, self.options = basis, options
        self._corners, self._control = corners, control
        visible = control.visible_model
        round_parts = visible.outline < len(visible.kind)
        self._common = CommonScatter(UNSEEN_OUTLINE if round_parts else UNSEEN)
        self._noise = EdgeNoise()
        # lines tell themselves from clutter by polarity and texture; an outline has neither
        self._greys = OutlineGreys() if round_parts else None
        self.contrast = np.zeros(control.size)
        self._remembered = control.visible_model.remembered()
        self.forget()

    def forget(self) -> None:
        """Forget what the edges look like."""
        self.contrast[:] = 0
        self.share, self._images = 1.0, 0
        self._common.forget()
        self._noise.forget()
        if self._greys is not None:
            self._greys.forget()

    def switch(self, basis: np.ndarray) -> None:
        """Go on with another basis of corrections."""
        self.basis = basis

    def adopt(self, options: TrackerOptions, control: ControlModel, nearest: np.ndarray) -> None:
        """Go on by other settings; each control point remembers what the nearest one did."""
        self.options, self.contrast = options, self.contrast[nearest]
        self._control = control
        self._remembered = control.visible_model.remembered()

    def found_share(self, fit: EdgeFit, found: np.ndarray) -> float:
        """Share of the edges searched that were found (C,) and look as they are remembered."""
        if not len(fit.at):
            return 0.0
        wanted = self.contrast[fit.view.ids[fit.at]]
        light = change_of_light(np.where(found, fit.contrast, 0.0), wanted * found)
        # a lamp may have changed for some faces only: what looks as before counts, too
        same = found & (contrast_matches(fit.contrast, wanted)
                        | contrast_matches(fit.contrast, light * wanted))
        # in clutter the edge of one is that of another: it speaks for no line
        weight = fit.clutter_weight * fit.view.must_show[fit.at]
        return float(weight @ same / max(weight.sum(), 1e-9))

    def misfit(self, fit: EdgeFit, found: np.ndarray) -> float:
        """Median distance of lines' edges that were found (C,), in sigmas; 0 of an outline."""
        exact = self._control.projection.model in ('perspective', 'zoom')
        if self._greys is not None or not exact or not found.any():
            return 0.0
        sigma = self._noise.sigma(fit.contrast[found], fit.view.end_px[fit.at[found]])
        off = np.sort(np.abs(fit.residual[found]) / sigma)
        return float(off[len(off) // 2])

    def scatter(self, fit: EdgeFit) -> tuple[np.ndarray, np.ndarray]:
        """
        Judge how the edges of one image scatter.

        Returns
        -------
        posterior : ndarray, shape (m, m)
            Information of the state: edges with what they share, corners, prior.
        sums : ndarray, shape (4,)
            To be learned if the state is accepted.

        """
        some = np.flatnonzero(fit.weight > 0)
        sums = sums_of(fit.view.primitive[fit.at[some]], fit.rows[some], fit.weight[some],
                       fit.off[some], fit.residual[some], fit.solved)
        known = 1 / self._common.factor(sums)
        posterior = fit.solved + (known - 1) * fit.edges
        limb = some[fit.view.primitive[fit.at[some]] >= fit.view.limb]
        if self._greys is not None and len(limb):
            at = fit.at[limb]
            posterior = posterior - shared_by_outline(
                fit.rows[limb], known * fit.weight[limb], fit.view.inside[at],
                fit.view.projected.pixels[at], fit.measured + (known - 1) * fit.edges)
        return posterior, sums

    def learn(self, fit: EdgeFit, found: np.ndarray, share: float, sums: np.ndarray) -> None:
        """Take in an image that was accepted: edges found (C,), their share and scatter."""
        self.share = share
        self._common.learn(sums)
        self._images += 1
        if self._images % _NOISE_EVERY == 0:
            some = np.flatnonzero(fit.weight > 0)
            self._noise.learn(fit.contrast[some], fit.view.end_px[fit.at[some]],
                              fit.residual[some])
        if self._greys is not None:
            self._greys.learn(fit.profiles, fit.view.projected.pixels[fit.at],
                              fit.view.inside[fit.at])
        # a place on an outline is another place of the object in the next image
        found = found & self._remembered[fit.view.ids[fit.at]]
        ids, now = fit.view.ids[fit.at[found]], fit.contrast[found]
        old = self.contrast[ids]
        self.contrast[ids] = np.where(old == 0, now, 0.8 * old + 0.2 * now)

    def glance(self, image: np.ndarray, view: ControlView) -> None:
        """Learn anew what object and background look like, from a view that is only guessed."""
        at = np.flatnonzero(view.searched & view.contour)
        if len(at) and self._greys is not None:
            pixels = view.projected.pixels[at]
            profiles = sample_normals(image, pixels, view.normal[at], _GLANCE_PX)
            self._greys.learn(profiles, pixels, view.inside[at], anew=True)

    def reach(self, state: ObjectPose, view: ControlView, covariance: np.ndarray) -> int:
        """Search range from the covariance (m, m) of the prediction, pixels."""
        rows = self._control.rows(state, view) @ self.basis
        sigma = np.sqrt(np.einsum('ci,ij,cj->c', rows, covariance, rows).max(initial=0.0))
        options = self.options
        return int(np.clip(np.ceil(3 * sigma), options.search_least_px, options.search_most_px))

    def limits(self, reach: int, first: bool, last: bool) -> list[float]:
        """Limits of the steps of the first, last or another round, from wide to narrow."""
        narrow = [_NARROW_PX] * (_LAST_STEPS if last else 1)
        if not first:
            return narrow
        wide = max(float(reach), _NARROW_PX)
        steps = max(self.options.steps - 1, 1)
        return [wide * (_NARROW_PX / wide)**(k / steps) for k in range(steps)] + narrow

    def score(self, image: np.ndarray, view: ControlView) -> float:
        """Strength of the edges that lie on the control points, grey levels."""
        at = np.flatnonzero(view.searched)
        if not len(at):
            return 0.0
        edgels = find_edgels(sample_normals(image, view.projected.pixels[at], view.normal[at], 3),
                             1, self.options.least_contrast)
        near = np.maximum(1 - (edgels.offset[:, 0] / 2)**2, 0)
        return float(np.nansum(near * np.minimum(np.abs(edgels.contrast[:, 0]), _STRONG)))

    def fit(self, image: np.ndarray, prior: PosePrior, around: SearchRound,
            corners: AgreeingCorners | None = None) -> EdgeFit:
        """
        Search the edges and solve for the state, corners included.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        prior : PosePrior
        around : SearchRound
        corners : AgreeingCorners, optional

        Returns
        -------
        EdgeFit

        """
        found = self._candidates(image, around)
        rows = self._control.rows(around.state, around.view)[found.at] @ self.basis
        m = self.basis.shape[1]
        corner_H, corner_g = np.zeros((m, m)), np.zeros(m)
        if corners is not None and corners.matches is not None and corners.agree.any():
            corner_H, corner_g = self._corners.terms(around.state, corners.matches, corners.agree,
                                                     self.share)
        back = self.basis.T @ self._control.projection.difference(around.state, prior.state)
        q = np.zeros(m)
        for step, limit in enumerate(around.limits):
            choice = self._chosen(found, rows @ q, limit, limit == around.limits[-1],
                                  step + 1 == len(around.limits))
            H = (rows * choice.weight[:, None]).T @ rows
            g = rows.T @ (choice.weight * np.where(choice.near, choice.offset, 0.0))
            q = np.linalg.solve(H + corner_H + prior.information,
                                g + corner_g - prior.information @ back)
        after = self._control.projection.moved(around.state, self.basis @ q)
        residual = np.where(choice.near, choice.offset - rows @ q, np.nan)
        free = self.basis.T @ self._control.free(after)
        if free.size:
            # the last step has turned what the shape leaves open
            keep = apart_from(free)
            H, rows = keep @ H @ keep, rows @ keep
        measured = H + corner_H
        return EdgeFit(
            state=after, edges=H, measured=measured, solved=measured + prior.information,
            pull=prior.information @ (back + q), view=around.view, at=found.at,
            clutter_weight=found.weight, rows=rows, residual=residual, contrast=choice.contrast,
            weight=choice.weight, off=choice.off * choice.off, profiles=found.profiles)

    def _candidates(self, image: np.ndarray, around: SearchRound) -> EdgeCandidates:
        """Search the edges along the normals of all control points that are to be searched."""
        view, options = around.view, self.options
        at = np.flatnonzero(view.searched)
        weight, end_px = around.weights[at], view.end_px[at]
        if not len(at):
            none = np.zeros((0, options.candidates))
            return EdgeCandidates(at, none, none, none, none, weight, end_px, np.zeros((0, 1)))
        wanted, pixels = self.contrast[view.ids[at]], view.projected.pixels[at]
        profiles = sample_normals(image, pixels, view.normal[at], around.reach)
        edgels = find_edgels(profiles, options.candidates, options.least_contrast, wanted)
        # the outer lanes meet a curve where it has bent away
        offset = edgels.offset - BOW_OF_LANES * view.curvature[at][:, None]
        worse = np.ones(offset.shape)
        limb = np.flatnonzero(view.primitive[at] >= view.limb)
        if len(limb):
            shift, worse[limb] = limb_shift(profiles[limb], edgels.offset[limb],
                                            edgels.contrast[limb], view.inside[at[limb]])
            offset[limb] -= shift
        worse[~view.must_show[at]] = _BEFORE_PART
        penalty = contrast_penalty(edgels.contrast, wanted)
        if self._greys is not None:
            penalty += self._greys.penalty(profiles, pixels, view.inside[at], offset)
        offset = np.where(np.isfinite(offset), offset, NOWHERE_PX)
        return EdgeCandidates(at, offset, edgels.contrast, penalty, worse, weight, end_px,
                              profiles)

    def _chosen(self, found: EdgeCandidates, along: np.ndarray, limit: float, narrow: bool,
                last: bool) -> EdgeChoice:
        """
        Choose one edge for each control point, and weigh it.

        Parameters
        ----------
        found : EdgeCandidates
        along : ndarray, shape (C,)
            Where the correction so far puts each control point on its normal, pixels.
        limit : float
            Of Tukey's biweight, pixels.
        narrow : bool
            The correction is nearly right: the noise is known, and tells the limit.
        last : bool
            It is the last step.

        Returns
        -------
        EdgeChoice

        """
        distances = np.abs(found.offset - along[:, None]) + min(limit / 8, 1.0) * found.penalty
        line = np.arange(len(found.at))
        best = distances.argmin(axis=1) if len(line) else line
        distance, offset = distances[line, best], found.offset[line, best]
        contrast = found.contrast[line, best]
        near = distance < limit
        sigma: np.ndarray | float = max(limit / 3, 0.5)
        most: np.ndarray | float = limit
        if narrow:
            residual, own = offset - along, self._noise.sigma(contrast, found.end_px)
            sigma = own * fast_robust_sigma(
                (residual / own)[near & (np.abs(residual) < 3)], _MIN_NOISE)
            most = np.minimum(_TUKEY * sigma, limit)
        off = distance / most
        weight = found.weight * tukey_weight(off, 1.0) / sigma**2
        if last:
            # not before: from afar every edge is needed to draw the pose near
            weight = weight / found.worse[line, best]**2
        return EdgeChoice(offset, contrast, near, weight, off)
