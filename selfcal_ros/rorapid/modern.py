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
"""Our cycle: texture first, then edges with several candidates, all in one robust estimate."""

from __future__ import annotations

import numpy as np

from selfcal_ros.rorapid.confirmation import CERTAIN, confirmation, EDGES_DO
from selfcal_ros.rorapid.control import ControlModel, Measured
from selfcal_ros.rorapid.corner_fit import AGREE_PX, CornerFit, LEAST_TEXTURE
from selfcal_ros.rorapid.edge_choice import alike, handicap, uncrowded
from selfcal_ros.rorapid.edge_noise import CommonScatter, EdgeNoise
from selfcal_ros.rorapid.edgels import BOW_OF_LANES, find_edgels, sample_normals
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection import ObjectState, Projection
from selfcal_ros.rorapid.recovery import ViewMemory
from selfcal_ros.rorapid.region import region_of_interest, Undistorter
from selfcal_ros.rorapid.robust import robust_sigma, tukey_weight
from selfcal_ros.rorapid.texture import TextureMemory

#: Noise of the edges in one image against what was learned, at the least.
_LEAST_NOISE = 0.7
#: With fewer of the corners agreeing much is hidden.
_MUCH_HIDDEN = 0.5
#: Limit of the last steps, pixels, and search range once the object is nearly there.
_NARROW_PX, _NEAR_REACH_PX = 3.0, 5
#: Steps with the narrow limit in the last round; each leaves a third of the error before.
_LAST_STEPS = 2
#: An edgel agrees within this, and Tukey's limit in sigmas.
_FOUND_PX, _TUKEY = 1.75, 4.5
#: Levels of the pyramid on which corners are followed, and whether in the image at half scale
#: (which a blurred image asks for): at first, and if that fails.
_ATTEMPTS = ((1, False), (3, False), (2, True))
#: After a sudden motion the object is sought so far around, pixels.
_SEEK_PX = 120.0
#: Rounds of the search from each start around a first guess, and contrast that is strong.
_SETTLE_ROUNDS, _STRONG = 4, 40.0
#: The common scatter is learned from every so many images.
_SCATTER_EVERY = 2
#: While lost, edges alone are searched in every so many images.
_EDGE_SEARCH_EVERY = 3


class ModernCycle:
    """
    One measurement per image by our method.

    Parameters
    ----------
    control : ControlModel
    basis : ndarray, shape (size, m)
    options : TrackerOptions
    rng : numpy.random.Generator

    """

    def __init__(self, control: ControlModel, basis: np.ndarray, options: TrackerOptions, rng):
        """Start without memory."""
        self.control, self.basis, self.options, self.rng = control, basis, options, rng
        self.projection = control.projection
        model = control.visible_model.model
        faces = [model.vertices[list(face.indices)] - control.centre for face in model.faces]
        corners = model.vertices[model.triangles] - control.centre
        # texture lives in parts of the image without distortion; edges in the image as it is
        self._lens = Undistorter(self.projection.camera)
        self._pinhole = Projection(self._lens.pinhole, self.projection.model)
        self.texture = TextureMemory(faces, corners, self._pinhole, options.texture_points)
        self._distorted = bool(self.projection.camera.distortion.any())
        self._use_texture = options.texture and options.camera_model != 'affine'
        self._contrast = np.zeros(control.size)
        self._turn, self._images, self._edge_share = 0, 0, 1.0
        self._common, self._noise = CommonScatter(), EdgeNoise()
        self._outline = np.asarray(model.extent, float) - control.centre
        self._corners = CornerFit(self._pinhole, basis, rng)
        self._views = ViewMemory(self._pinhole, self._outline, rng)

    def reset(self) -> None:
        """Forget what the object looks like."""
        self._contrast[:] = 0
        self._edge_share = 1.0
        self._common.forget()
        self._noise.forget()
        self.texture.forget()
        self._views.forget()

    def switch(self, basis: np.ndarray, camera_model: str) -> None:
        """Go on with another basis of corrections, or another camera model."""
        self.basis = self._corners.basis = basis
        self.projection.become(camera_model)
        self._pinhole.become(camera_model)

    def proposals(self, image: np.ndarray, state: ObjectState, everywhere: bool, spread):
        """
        Propose other states, one at a time, the cheapest first.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        state : ObjectState
            Expected.
        everywhere : bool
            Search the whole image, not only around the expected state.
        spread : ndarray, shape (m, m)
            Covariance of where it may be.

        Yields
        ------
        ObjectState

        """
        if self.options.camera_model == 'affine':
            return
        if everywhere:
            place = np.array([[0, 0], image.shape[::-1]], float)
            region = region_of_interest(image, place, 0.0, self._lens)
        else:
            outline = self._pinhole.project(state, self._outline).pixels
            region = region_of_interest(image, outline, _SEEK_PX, self._lens)
        if region is not None:
            yield from self._views.shifted(region, state)
        if everywhere:
            size = np.array(image.shape[::-1])
            yield from self._views.recognised(self._lens.part(image, 0 * size, size))
            # without texture there are the edges alone; a slow search, and not in every image
            self._turn += 1
            if self._turn % _EDGE_SEARCH_EVERY == 0:
                yield self._best_start(image, state, spread)

    def measure(self, image: np.ndarray, predicted: ObjectState, spread: np.ndarray) -> Measured:
        """
        Find the object near a predicted state.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        predicted : ObjectState
        spread : ndarray, shape (m, m)
            Covariance of the prediction.

        Returns
        -------
        Measured

        """
        prior = np.linalg.inv(spread)
        state = predicted
        outline = self._pinhole.project(predicted, self._outline).pixels
        region = region_of_interest(image, outline, 40.0, self._lens)
        matches, agree = None, np.zeros(0, bool)
        if region is not None and self._use_texture and self.texture.known:
            state, matches, agree = self._by_texture(region, predicted, prior)
        count = int(agree.sum())
        led = count >= LEAST_TEXTURE
        measured = self._search(image, region, predicted, spread, prior, state, matches, agree,
                                led)
        if led and (count < CERTAIN or count < 0.6 * matches.followed.sum()):
            # few corners may agree on a wrong pose by chance; the edges decide
            near = self._corners.near(predicted, matches)
            alone = self._search(image, region, predicted, spread, prior, predicted, matches,
                                 near, False)
            if (alone.evidence[-1], alone.share) > (measured.evidence[-1], measured.share):
                measured = alone
        return measured

    def _search(self, image, region, predicted, spread, prior, state, matches, agree, led):
        """Search the edges about a state, in some rounds, and conclude."""
        view = self.control.view(state)
        alone = uncrowded(view)
        if led:
            reach = int(np.ceil(self.options.search_least_px))
        else:
            reach = self._reach(state, view, spread)
        result = None
        for turn in range(self.options.rounds):
            if turn:
                view = self.control.again(view, state)
                reach = _NEAR_REACH_PX
                if not led and matches is not None:
                    agree = self._corners.near(state, matches)
            first = turn == 0 and not led
            limits = self._limits(reach, first, turn + 1 == self.options.rounds)
            result = self._by_edges(image, view, state, predicted, prior, reach, matches, agree,
                                    limits, alone)
            state = result[0]
        return self._conclude(region, state, result, matches, agree)

    def _reach(self, state, view, spread):
        """Search range from the spread of the prediction."""
        rows = self.projection.rows(state, view.projected, view.normal) @ self.basis
        sigma = np.sqrt(np.einsum('ci,ij,cj->c', rows, spread, rows).max(initial=0.0))
        options = self.options
        return int(np.clip(np.ceil(3 * sigma), options.search_least_px, options.search_most_px))

    def _by_texture(self, region, predicted, prior):
        """
        Follow the texture's corners and find the pose on which most of them agree.

        First from close by, where what is before the object disturbs least; then from further.
        """
        best = predicted, None, np.zeros(0, bool)
        for levels, reduced in _ATTEMPTS:
            if reduced and best[1].followed.mean() < 0.5:
                break                 # not blurred but hidden
            matches = self.texture.follow(region.halved() if reduced else region, predicted,
                                          levels)
            if matches is None:
                break
            near = AGREE_PX * (1.5 if reduced else 1.0)
            state, agree = self._corners.agreement(matches, predicted, prior, near)
            gain = 1.5 if reduced else 1.0
            if best[1] is None or agree @ matches.score > gain * (best[2] @ best[1].score):
                best = state, matches, agree
            if agree.mean() > 0.4:
                break
        self.texture.hidden = best[1] is not None and best[2].mean() < _MUCH_HIDDEN
        return best

    def _by_edges(self, image, view, state, predicted, prior, reach, matches, agree, limits,
                  alone):
        """Search the edges and solve for the state, corners included."""
        options = self.options
        at = np.flatnonzero(view.searched)
        m = self.basis.shape[1]
        rows = self.projection.rows(state, view.projected, view.normal)[at] @ self.basis
        wanted = self._contrast[view.ids[at]]
        if len(at):
            profiles = sample_normals(image, view.projected.pixels[at], view.normal[at], reach)
            edgels = find_edgels(profiles, options.candidates, options.least_contrast, wanted)
            # the outer lanes meet a curve where it has bent away
            offset = edgels.offset - BOW_OF_LANES * view.curvature[at][:, None]
            contrast = edgels.contrast
        else:
            offset = contrast = np.zeros((0, options.candidates))
        missing = ~np.isfinite(offset)
        offset = np.where(missing, 1e6, offset)
        further = handicap(contrast, wanted)
        alone = alone[at]
        corner_H, corner_g = np.zeros((m, m)), np.zeros(m)
        if agree.any():
            corner_H, corner_g = self._corners.terms(state, matches, agree,
                                                     self._edge_share)
        back = self.basis.T @ self.projection.difference(state, predicted)
        q = np.zeros(m)
        line = np.arange(len(at))
        for limit in limits:
            along = rows @ q
            distance = np.abs(offset - along[:, None]) + min(limit / 8, 1.0) * further
            best = distance.argmin(axis=1) if len(at) else line
            chosen = offset[line, best]
            residual = chosen - along
            near = distance[line, best] < limit
            if limit == limits[-1]:
                own = self._noise.sigma(contrast[line, best], view.end_px[at])
                share = robust_sigma((residual / own)[near & (np.abs(residual) < 3)],
                                     _LEAST_NOISE)
                sigma = share * own
                limit = np.minimum(_TUKEY * sigma, limit)
            else:
                sigma = max(limit / 3, 0.5)
            w = alone * tukey_weight(distance[line, best], limit) / sigma**2
            H = (rows * w[:, None]).T @ rows
            g = rows.T @ (w * np.where(near, chosen, 0.0))
            information = H + corner_H + prior
            q = np.linalg.solve(information, g + corner_g - prior @ back)
        after = self.projection.moved(state, self.basis @ q)
        residual = np.where(near, chosen - rows @ q, np.nan)
        information = H / self._common.factor + corner_H + prior
        contrast = contrast[line, best] if len(at) else np.zeros(0)
        return (after, information, view, at, residual, contrast, H + corner_H,
                (rows, w, (residual / limit)**2, residual, H + corner_H + prior), alone)

    def settle(self, image: np.ndarray, guess: ObjectState, spread: np.ndarray) -> Measured:
        """
        Find the object from a guess: from many starts around it, the one with the best edges.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        guess : ObjectState
        spread : ndarray, shape (m, m)
            Covariance of the guess.

        Returns
        -------
        Measured

        """
        return self.measure(image, self._best_start(image, guess, spread), spread)

    def _best_start(self, image, guess, spread) -> ObjectState:
        """Try starts around a guess; return the state with the strongest edges."""
        values, vectors = np.linalg.eigh(spread)
        shifts = vectors * np.sqrt(values)
        starts = np.concatenate([np.zeros((1, len(spread))), shifts.T, -shifts.T])
        prior = np.linalg.inv(spread)
        reach = int(np.ceil(self.options.search_most_px))
        best, best_score = guess, -1.0
        for start in starts:
            state = self.projection.moved(guess, self.basis @ start)
            view = self.control.view(state)
            for turn in range(_SETTLE_ROUNDS):
                wide = turn < 2
                state = self._by_edges(image, view, state, guess, prior, reach if wide else 8,
                                       None, np.zeros(0, bool),
                                       self._limits(reach, wide, not wide),
                                       uncrowded(view))[0]
                view = self.control.view(state)
            score = self._edge_score(image, view)
            if score > best_score:
                best, best_score = state, score
        return best

    def _edge_score(self, image, view) -> float:
        """Strength of the edges that lie on the control points, grey levels."""
        at = np.flatnonzero(view.searched)
        if not len(at):
            return 0.0
        edgels = find_edgels(sample_normals(image, view.projected.pixels[at], view.normal[at], 3),
                             1, self.options.least_contrast)
        near = np.maximum(1 - (edgels.offset[:, 0] / 2)**2, 0)
        return float(np.nansum(near * np.minimum(np.abs(edgels.contrast[:, 0]), _STRONG)))

    def _limits(self, reach, first, last):
        """Tukey limits of the steps, from wide to narrow."""
        narrow = [_NARROW_PX] * (_LAST_STEPS if last else 1)
        if not first:
            return narrow
        wide = max(float(reach), _NARROW_PX)
        steps = max(self.options.steps - 1, 1)
        return [wide * (_NARROW_PX / wide)**(k / steps) for k in range(steps)] + narrow

    def _conclude(self, region, state, result, matches, agree):
        """Count what confirms the state, and remember what it looks like."""
        _, posterior, view, at, residual, contrast, information, used, alone = result
        covariance = np.linalg.inv(posterior)
        after = self.control.again(view, state)
        edge_px = np.full(len(view.ids), np.nan)
        edge_px[at] = residual
        found = np.abs(edge_px) < _FOUND_PX
        same = found[at] & alike(contrast, self._contrast[view.ids[at]])
        # in a crowd the edge of one is that of another: it speaks for no line
        edges = float(alone @ same / alone.sum()) if len(at) else 0.0
        share, certain = confirmation(self.options, edges, matches, agree)
        determined = self._determined(information)
        texture_px = np.zeros((0, 2)) if matches is None else matches.pixels[agree]
        if self._distorted and len(texture_px):
            texture_px = self.projection.camera.pixels(self._lens.pinhole.normalised(texture_px))
        return Measured(state, covariance, True, after, edge_px, found, texture_px, share,
                        determined, certain, self._focal_sigma(information, determined),
                        evidence=(region, at, found, contrast, view, matches, agree,
                                  used, edges))

    def _determined(self, information) -> bool:
        """Whether one image determines the pose; the focal length may stay open."""
        if self.projection.model == 'zoom':
            information = (self.basis @ information @ self.basis.T)[:6, :6]
        scale = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
        return bool(np.linalg.eigvalsh(information / np.outer(scale, scale))[0] > 1e-6)

    def _focal_sigma(self, information, determined) -> float:
        """Relative standard deviation of the focal length from one image."""
        if self.projection.model != 'zoom':
            return 0.0
        if not determined:
            return float('inf')
        row = self.basis[6]
        floor = np.diag(1e-9 * np.diagonal(information) + 1e-12)
        return float(np.sqrt(row @ np.linalg.solve(information + floor, row)))

    def remember(self, measured: Measured, confirmed: bool) -> None:
        """Take over contrasts and pictures of a state that was accepted."""
        region, at, found, contrast, view, matches, agree, used, edges = measured.evidence
        ids, ok = view.ids[at], found[at]
        self._edge_share = edges
        rows, weight, off, residual, whole = used
        some = np.flatnonzero(weight > 0)
        self._images += 1
        if self._images % _SCATTER_EVERY == 0:
            self._common.learn(view.primitive[at[some]], rows[some], weight[some], off[some],
                               residual[some], whole)
        self._noise.learn(contrast[some], view.end_px[at[some]], residual[some])
        old = self._contrast[ids[ok]]
        self._contrast[ids[ok]] = np.where(old == 0, contrast[ok], 0.8 * old + 0.2 * contrast[ok])
        if region is not None and self._use_texture:
            if measured.certain and matches is not None:
                self.texture.judge(matches, agree)
            if measured.certain or (edges > EDGES_DO and measured.share > EDGES_DO):
                self.texture.learn(region, measured.state, confirmed)
        if region is not None and confirmed:
            self._views.remember(region, measured.state)
