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
Do the edges hold a pose along what they know least? A pose is fitted to the edges next to it.

So an image says too much for the pose that was expected, most of all along the one turn that moves
the edges least. Every third image is asked again: from a pose that is some sigmas away along that
turn, by its edges alone. Edges that know lead back. Where they stay elsewhere, and as much of the
outline is seen there, the pose may be either, and its covariance says so. Where clearly more of it
is seen, that is the pose.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.rorapid.estimation.pose_estimator import SearchingEstimator
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement

#: An image is asked again so many images after the last one.
_EVERY = 3
#: It is asked from so many sigmas away, but from so many radians at the least and at the most.
_SIGMAS, _LEAST_RAD, _MOST_RAD = 3.0, np.deg2rad(3.0), np.deg2rad(20.0)
#: An answer is as good if no more than this share of the outline is seen less; it is better if so
#: much more is.
_AS_GOOD, _BETTER = 0.04, 0.05
#: An answer within this squared number of sigmas is the same.
_SAME = 4.0


class SecondOpinion:
    """Asks one object's images again, and remembers the last answers from either side."""

    def __init__(self) -> None:
        """Wait for a start."""
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._images, self._side = 0, 0
        self._answers = np.zeros((2, 6))

    def ask(self, method: SearchingEstimator, image: np.ndarray, measured: PoseMeasurement,
            seen: float, wide: np.ndarray) -> PoseMeasurement | None:
        """
        Ask an image again, if that is due.

        Parameters
        ----------
        method : SearchingEstimator
        image : ndarray, shape (H, W), uint8
        measured : PoseMeasurement
        seen : float
            Share of the length of its outline that is seen.
        wide : ndarray, shape (m, m)
            Covariance of a pose that is only proposed.

        Returns
        -------
        PoseMeasurement or None
            A better pose.

        """
        self._images += 1
        projection, basis = method.search.control.projection, method.search.basis
        if self._images % _EVERY or projection.model != 'perspective':
            return None
        self._side = 1 - self._side
        covariance = basis @ measured.covariance @ basis.T
        if not np.isfinite(covariance).all():
            return None
        values, vectors = np.linalg.eigh(covariance[:3, :3])
        if values[-1] <= 0:
            return None
        way = np.clip(_SIGMAS * np.sqrt(values[-1]), _LEAST_RAD, _MOST_RAD) / values[-1] * (
            covariance[:, :3] @ vectors[:, -1])
        there = projection.moved(measured.state, (1 - 2 * self._side) * way)
        answer = method.measured_by_edges(image, there, wide, near=True)
        self._answers[self._side] = 0
        its_share = method.check.seen(image, answer.view).length
        if not answer.determined or its_share < seen - _AS_GOOD:
            return None
        apart = projection.difference(answer.state, measured.state)
        along = basis.T @ apart
        square = float(along @ np.linalg.solve(measured.covariance, along))
        if square > _SAME:
            if its_share > seen + _BETTER:
                self._answers[:] = 0
                return answer
            self._answers[self._side] = np.sqrt(1 - _SAME / square) * apart
        return None

    def covariance(self) -> np.ndarray:
        """Covariance (6, 6) of (theta, Delta) that the last answers add."""
        return self._answers.T @ self._answers
