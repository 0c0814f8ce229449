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

from dataclasses import dataclass

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
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.projection.free_directions import apart_from
from selfcal_ros.rorapid.region.outline_greys import OutlineGreys
from selfcal_ros.rorapid.texture.corner_fit import CornerFit

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
_NONE = np.zeros(0, bool)


@dataclass(frozen=True)
class EdgeFit:
    """
    Attributes of one round of search and solution; rows of the C control points searched.

    Attributes
    ----------
    state : ObjectPose
    edges, measured, solved : ndarray, shape (m, m)
        Information of the edges, edgels taken as independent; the same with the corners; with
        the prior as well, the matrix of the last solution.
    pull : ndarray, shape (m,)
        measured (z - state), z being what the image says without the prior.
    view : ControlView
    at : ndarray of int, shape (C,)
        Which control points of the view.
    clutter_weight : ndarray, shape (C,)
        Weight by what runs alongside.
    rows : ndarray, shape (C, m)
    residual, contrast, weight, off : ndarray, shape (C,)
        Pixels, NaN without an edge; grey levels; Tukey's weight over the variance; and the
        squared distance over Tukey's squared limit.
    profiles : ndarray, shape (C, S)
        Grey levels along the normals, from before the last correction.

    """

    state: ObjectPose
    edges: np.ndarray
    measured: np.ndarray
    solved: np.ndarray
    pull: np.ndarray
    view: ControlView
    at: np.ndarray
    clutter_weight: np.ndarray
    rows: np.ndarray
    residual: np.ndarray
    contrast: np.ndarray
    weight: np.ndarray
    off: np.ndarray
    profiles: np.ndarray


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
        return float(fit.clutter_weight @ same / fit.clutter_weight.sum())

    def scatter(self, fit: EdgeFit):
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

    def reach(self, state, view, spread) -> int:
        """Search range from the spread (m, m) of the prediction, pixels."""
        rows = self._control.rows(state, view) @ self.basis
        sigma = np.sqrt(np.einsum('ci,ij,cj->c', rows, spread, rows).max(initial=0.0))
        options = self.options
        return int(np.clip(np.ceil(3 * sigma), options.search_least_px, options.search_most_px))

    def limits(self, reach: int, first: bool, last: bool) -> list:
        """Limits of the steps of the first, last or another round, from wide to narrow."""
        narrow = [_NARROW_PX] * (_LAST_STEPS if last else 1)
        if not first:
            return narrow
        wide = max(float(reach), _NARROW_PX)
        steps = max(self.options.steps - 1, 1)
        return [wide * (_NARROW_PX / wide)**(k / steps) for k in range(steps)] + narrow

    def score(self, image, view) -> float:
        """Strength of the edges that lie on the control points, grey levels."""
        at = np.flatnonzero(view.searched)
        if not len(at):
            return 0.0
        edgels = find_edgels(sample_normals(image, view.projected.pixels[at], view.normal[at], 3),
                             1, self.options.least_contrast)
        near = np.maximum(1 - (edgels.offset[:, 0] / 2)**2, 0)
        return float(np.nansum(near * np.minimum(np.abs(edgels.contrast[:, 0]), _STRONG)))

    def fit(self, image, view, state, predicted, prior, reach, limits, weights, matches=None,
            agree=_NONE) -> EdgeFit:
        """
        Search the edges and solve for the state, corners included.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        view : ControlView
            At `state`.
        state, predicted : ObjectPose
        prior : ndarray, shape (m, m)
            Information of the prediction.
        reach : int
            Search range to each side, pixels.
        limits : sequence of float
            Of Tukey's biweight, one for each step, pixels.
        weights : ndarray, shape (C,)
            Weights of the control points.
        matches : TextureMatches, optional
        agree : ndarray of bool, shape (N,)
            Which of the matches count.

        Returns
        -------
        EdgeFit

        """
        options = self.options
        at = np.flatnonzero(view.searched)
        m = self.basis.shape[1]
        rows = self._control.rows(state, view)[at] @ self.basis
        wanted = self.contrast[view.ids[at]]
        if len(at):
            profiles = sample_normals(image, view.projected.pixels[at], view.normal[at], reach)
            edgels = find_edgels(profiles, options.candidates, options.least_contrast, wanted)
            # the outer lanes meet a curve where it has bent away
            offset = edgels.offset - BOW_OF_LANES * view.curvature[at][:, None]
            contrast, worse = edgels.contrast, np.ones(offset.shape)
            limb = np.flatnonzero(view.primitive[at] >= view.limb)
            if len(limb):
                shift, worse[limb] = limb_shift(profiles[limb], edgels.offset[limb],
                                                contrast[limb], view.inside[at[limb]])
                offset[limb] -= shift
            further = contrast_penalty(contrast, wanted)
            if self._greys is not None:
                further += self._greys.penalty(
                    profiles, view.projected.pixels[at], view.inside[at], offset)
        else:
            offset = contrast = further = worse = np.zeros((0, options.candidates))
            profiles = np.zeros((0, 1))
        missing = ~np.isfinite(offset)
        offset = np.where(missing, 1e6, offset)
        weights = weights[at]
        corner_H, corner_g = np.zeros((m, m)), np.zeros(m)
        if agree.any():
            corner_H, corner_g = self._corners.terms(state, matches, agree,
                                                     self.share)
        back = self.basis.T @ self._control.projection.difference(state, predicted)
        q = np.zeros(m)
        line = np.arange(len(at))
        sigma: np.ndarray | float
        for step, limit in enumerate(limits):
            along = rows @ q
            distance = np.abs(offset - along[:, None]) + min(limit / 8, 1.0) * further
            best = distance.argmin(axis=1) if len(at) else line
            chosen = offset[line, best]
            residual = chosen - along
            near = distance[line, best] < limit
            if limit == limits[-1]:
                own = self._noise.sigma(contrast[line, best], view.end_px[at])
                share = fast_robust_sigma((residual / own)[near & (np.abs(residual) < 3)],
                                          _MIN_NOISE)
                sigma = share * own
                limit = np.minimum(_TUKEY * sigma, limit)
            else:
                sigma = max(limit / 3, 0.5)
            off = distance[line, best] / limit
            w = weights * tukey_weight(off, 1.0) / sigma**2
            if step + 1 == len(limits):
                # not before: from afar every edge is needed to draw the pose near
                w = w / worse[line, best]**2
            H = (rows * w[:, None]).T @ rows
            g = rows.T @ (w * np.where(near, chosen, 0.0))
            information = H + corner_H + prior
            q = np.linalg.solve(information, g + corner_g - prior @ back)
        after = self._control.projection.moved(state, self.basis @ q)
        residual = np.where(near, chosen - rows @ q, np.nan)
        free = self.basis.T @ self._control.free(after)
        if free.size:
            # the last step has turned what the shape leaves open
            keep = apart_from(free)
            H, rows = keep @ H @ keep, rows @ keep
        measured = H + corner_H
        return EdgeFit(after, H, measured, measured + prior, prior @ (back + q), view, at,
                       weights, rows, residual,
                       contrast[line, best] if len(at) else np.zeros(0), w, off * off, profiles)
