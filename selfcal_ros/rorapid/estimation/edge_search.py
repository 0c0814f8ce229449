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

from collections.abc import Sequence
import math

import numpy as np

from selfcal_ros.rorapid.edges.control_points import ControlModel, ControlView, joined
from selfcal_ros.rorapid.edges.edge_choice import change_of_light, contrast_matches
from selfcal_ros.rorapid.edges.edge_noise import (
    CommonScatter, EdgeNoise, shared_by_outline, sums_together, UNSEEN, UNSEEN_OUTLINE)
from selfcal_ros.rorapid.edges.edgels import find_edgels, sample_normals
from selfcal_ros.rorapid.estimation.edge_fit import EdgeFit
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.region.outline_greys import OutlineGreys
from selfcal_ros.rorapid.texture.corner_fit import CornerFit

#: Tukey's limit of the last steps at the most, pixels.
_NARROW_PX = 3.0
#: Steps with the narrow limit in the last round; each leaves a third of the error before.
_LAST_STEPS = 2
#: Contrast that is strong.
_STRONG = 40.0
#: The noise of edges is learned from every so many images.
_NOISE_EVERY = 2
#: Pixels beside a guessed outline that are learned from.
_GLANCE_PX = 10


class EdgeSearch:
    """
    Remembers what edges look like and how well they are located, and judges those of an image.

    They are searched, and poses fitted to them, by `joint_fit`.

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
    noise : EdgeNoise
    greys : OutlineGreys or None
        Of round parts.
    corners : CornerFit
    control : ControlModel
    options : TrackerOptions

    """

    def __init__(self, control: ControlModel, basis: np.ndarray, options: TrackerOptions,
                 corners: CornerFit):
        """Start without memory."""
        self.basis, self.options = basis, options
        self.corners, self.control = corners, control
        visible = control.visible_model
        round_parts = visible.outline < len(visible.kind)
        #: Whether there are rims or limbs, which images show otherwise than lines.
        self.is_round = min(visible.outline, visible.limb) < len(visible.kind)
        self._common = CommonScatter(UNSEEN_OUTLINE if round_parts else UNSEEN)
        self.noise = EdgeNoise()
        # lines tell themselves from clutter by polarity and texture; an outline has neither
        self.greys = OutlineGreys() if round_parts else None
        self.contrast = np.zeros(control.size)
        self._remembered = control.visible_model.remembered()
        self.forget()

    def forget(self) -> None:
        """Forget what the edges look like."""
        self.contrast[:] = 0
        self.share, self._images = 1.0, 0
        self._common.forget()
        self.noise.forget()
        if self.greys is not None:
            self.greys.forget()

    def switch(self, basis: np.ndarray) -> None:
        """Go on with another basis of corrections."""
        self.basis = basis

    def adopt(self, options: TrackerOptions, control: ControlModel, nearest: np.ndarray) -> None:
        """Go on by other settings; each control point remembers what the nearest one did."""
        self.options, self.contrast = options, self.contrast[nearest]
        self.control = control
        self._remembered = control.visible_model.remembered()

    def is_alike(self, other: EdgeSearch) -> bool:
        """Whether both can be fitted at once: by one camera, in the same unknowns."""
        return (
            self.control.projection.is_alike(other.control.projection)
            and self.basis.shape == other.basis.shape
            and self.options.candidates == other.options.candidates
            and self.options.least_contrast == other.options.least_contrast)

    def found_share(self, fit: EdgeFit, found: np.ndarray) -> float:
        """Share of the edges searched that were found (C,) and look as they are remembered."""
        if not len(fit.at):
            return 0.0
        wanted = self.contrast[fit.view.ids[fit.at]]
        light = change_of_light(np.where(found, fit.contrast, 0.0), wanted * found)
        # a lamp may have changed for some faces only: what looks as before counts, too
        same = contrast_matches(fit.contrast, wanted)
        if light != 1:
            same |= contrast_matches(fit.contrast, light * wanted)
        same &= found
        # in clutter the edge of one is that of another: it speaks for no line
        weight = fit.clutter_weight * fit.view.must_show[fit.at]
        return float(weight @ same / max(weight.sum(), 1e-9))

    def misfit(self, fit: EdgeFit, found: np.ndarray) -> float:
        """Median distance of lines' edges that were found (C,), in sigmas; 0 of an outline."""
        exact = self.control.projection.model in ('perspective', 'zoom')
        if self.greys is not None or not exact or not found.any():
            return 0.0
        sigma = self.noise.sigma(fit.contrast[found], fit.view.end_px[fit.at[found]])
        off = np.sort(np.abs(fit.residual[found]) / sigma)
        return float(off[len(off) // 2])

    def posterior(self, fit: EdgeFit, sums: np.ndarray) -> np.ndarray:
        """Information (m, m) of a state: edges with what they share, by `sums`, corners, prior."""
        known = 1 / self._common.factor(sums)
        posterior: np.ndarray = fit.solved + (known - 1) * fit.edges
        if self.greys is None:
            return posterior
        some = np.flatnonzero(fit.weight > 0)
        limb = some[fit.view.primitive[fit.at[some]] >= fit.view.limb]
        if len(limb):
            at = fit.at[limb]
            posterior = posterior - shared_by_outline(
                fit.rows[limb], known * fit.weight[limb], fit.view.inside[at],
                fit.view.projected.pixels[at], fit.measured + (known - 1) * fit.edges)
        return posterior

    def learn(self, fit: EdgeFit, found: np.ndarray, share: float, sums: np.ndarray) -> None:
        """Take in an image that was accepted: edges found (C,), their share and scatter."""
        self.share = share
        self._common.learn(sums)
        self._images += 1
        if self._images % _NOISE_EVERY == 0:
            some = np.flatnonzero(fit.weight > 0)
            self.noise.learn(fit.contrast[some], fit.view.end_px[fit.at[some]],
                             fit.residual[some])
        if self.greys is not None:
            self.greys.learn(fit.profiles, fit.view.projected.pixels[fit.at],
                             fit.view.inside[fit.at])
        # a place on an outline is another place of the object in the next image
        found = found & self._remembered[fit.view.ids[fit.at]]
        ids, now = fit.view.ids[fit.at[found]], fit.contrast[found]
        old = self.contrast[ids]
        self.contrast[ids] = np.where(old == 0, now, 0.8 * old + 0.2 * now)

    def glance(self, image: np.ndarray, view: ControlView) -> None:
        """Learn anew what object and background look like, from a view that is only guessed."""
        at = np.flatnonzero(view.searched & view.contour)
        if len(at) and self.greys is not None:
            pixels = view.projected.pixels[at]
            profiles = sample_normals(image, pixels, view.normal[at], _GLANCE_PX)
            self.greys.learn(profiles, pixels, view.inside[at], anew=True)

    def reach(self, state: ObjectPose, view: ControlView, covariance: np.ndarray) -> int:
        """Search range from the covariance (m, m) of the prediction, pixels."""
        rows = self.control.rows(state, view) @ self.basis
        sigma = float(((rows @ covariance) * rows).sum(axis=1).max(initial=0.0))**0.5
        options = self.options
        return int(min(max(math.ceil(3 * sigma), options.search_least_px),
                       options.search_most_px))

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


def scattered_together(fits: Sequence[EdgeFit]) -> np.ndarray:
    """
    Judge how the edges of fits in the same unknowns scatter.

    Parameters
    ----------
    fits : sequence of EdgeFit

    Returns
    -------
    ndarray, shape (J, 4)
        Of each, to be learned if its state is accepted.

    """
    some = [np.flatnonzero(fit.weight > 0) for fit in fits]

    def of_some(name: str) -> np.ndarray:
        return joined([getattr(fit, name)[one] for fit, one in zip(fits, some)])

    primitive = joined([fit.view.primitive[fit.at[one]] for fit, one in zip(fits, some)])
    return sums_together(primitive, of_some('rows'), of_some('weight'), of_some('off'),
                         of_some('residual'), [len(one) for one in some],
                         np.array([fit.solved for fit in fits]))
