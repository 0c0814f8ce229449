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
Does the outline of a mesh still lie where the pose says? A pose may slide without losing edges.

A pose is fitted to the edges near it, so most of them agree even where it is wrong. The whole
outline is looked at anew, as that of a start is. Where much less of it is seen than usual, poses
that are turned are tried. One that is seen better is taken. Where none is, something hides the
outline or the pose is wrong, and that is said.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.rorapid.estimation.edge_fit import PosePrior
from selfcal_ros.rorapid.estimation.pose_estimator import SearchingEstimator
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.estimation.second_opinion import SecondOpinion

#: Other poses are tried no sooner than after so many images.
_RESTS = 6
#: What is usual falls by this factor from image to image.
_FADES = 0.995
#: Other poses are tried below this share of what is usual; below the second one it is said.
_LITTLE, _SAID = 0.8, 0.65
#: Another pose is taken if so much more of its length is seen, and so much of what is usual: what
#: is hidden is no reason to turn.
_BETTER, _WHOLE = 0.08, 0.9


class OutlineWatch:
    """
    Watches one object that is known by its outline.

    Attributes
    ----------
    seen : float
        Share of the length of the outline that was seen at the last look.
    opinion : SecondOpinion

    """

    def __init__(self) -> None:
        """Wait for a start."""
        self.opinion = SecondOpinion()
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self.seen = 1.0
        self.opinion.forget()
        self._usual, self._rests = 0.0, 0

    def look(self, method: SearchingEstimator, image: np.ndarray, measured: PoseMeasurement,
             prior: PosePrior, wide: np.ndarray) -> tuple[PoseMeasurement, bool]:
        """
        Look at a pose that was measured, and at others where little of its outline is seen.

        Parameters
        ----------
        method : SearchingEstimator
        image : ndarray, shape (H, W), uint8
        measured : PoseMeasurement
        prior : PosePrior
            What it was measured from.
        wide : ndarray, shape (m, m)
            Covariance of a pose that is only proposed.

        Returns
        -------
        measured : PoseMeasurement
            Of the better pose.
        other : bool
            Whether this is another pose than the one that came in.

        """
        self.seen = method.check.seen(image, measured.view).length
        self._usual = max(self.seen, _FADES * self._usual)
        self._rests = max(self._rests - 1, 0)
        if self.seen >= _LITTLE * self._usual:
            other = self.opinion.ask(method, image, measured, self.seen, wide)
            return (measured, False) if other is None else (other, True)
        if len(measured.texture_px):
            # corners on a round part may lie where it ends, or in a highlight
            by_edges = method.measured_by_edges(image, prior.state, prior.covariance)
            if self._is_better(method, image, by_edges):
                return by_edges, False
        if self._rests:
            return measured, False
        self._rests = _RESTS
        here = method.check.support(image, measured.state).length
        state, support = method.search.rivals(image, measured.state, measured.state, wide)[0]
        if support.length < max(here + _BETTER, _WHOLE * self._usual):
            return measured, False
        for measure in (method.measured_anew, method.measured_by_edges):
            better = measure(image, state, wide)
            if better.determined and self._is_better(method, image, better):
                return better, True
        return measured, False

    def _is_better(self, method: SearchingEstimator, image: np.ndarray,
                   other: PoseMeasurement) -> bool:
        """Take note of another pose, if more of its outline is seen."""
        seen = method.check.seen(image, other.view).length
        if seen < self.seen + _BETTER:
            return False
        self.seen = seen
        return True

    def text(self) -> str:
        """Say that little of the outline is seen; empty where enough is."""
        if self.seen >= _SAID * self._usual:
            return ''
        return (f'Only {100 * self.seen:.0f} % of the outline is seen along its length: something '
                'hides it, or the pose is wrong.')
