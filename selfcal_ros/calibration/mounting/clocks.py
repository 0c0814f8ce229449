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
"""A start for the offset of the clocks: by how much body and camera turned and moved, and when."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from selfcal_ros.calibration.mounting.body_track import BodyTrack
from selfcal_ros.calibration.mounting.camera_poses import CameraPoses
from selfcal_ros.calibration.mounting.starts import pairs_of

#: Clocks that differ by more are not the same clock: seconds to both sides.
REACH_S = 0.5
#: Steps of the search, seconds.
STEP_S = 0.01
#: So many of the best minima are refined.
_MINIMA = 3
#: Fewer images than this tell nothing of clocks.
LEAST_IMAGES = 4
#: A drive that has only begun fits several clocks.
LEAST_TIMED = 10
#: Clocks that are not the same are looked for so far to both sides, in such steps, seconds.
FAR_S, FAR_STEP_S = 30.0, 0.2
#: Offsets this far from each other, seconds, whose turns and steps differ by a factor of e at
#: most, are asked whether they explain all as well; the likeliest so many.
APART_S, NEARLY, MOST_ASKED = 0.1, 1.0, 2


@dataclass(frozen=True)
class Clocks:
    """
    How well turns and steps of a body and a camera agree, by the offset between their clocks.

    Attributes
    ----------
    camera : CameraPoses
    track : BodyTrack
        Of the same images.
    middle : float
        About which offsets are tried, seconds.

    """

    camera: CameraPoses
    track: BodyTrack
    middle: float = 0.0

    @cached_property
    def _profile(self) -> tuple[np.ndarray, np.ndarray]:
        """Offsets, and how much body and camera differ at each; both empty without poses."""
        tried = self.middle + np.arange(-REACH_S, REACH_S + STEP_S / 2, STEP_S)
        rows = np.flatnonzero(self.track.known(self.middle, REACH_S))
        if len(rows) < LEAST_IMAGES:
            rows = np.flatnonzero(self.track.known(self.middle))
            tried = tried[[self.track.known(offset)[rows].all() for offset in tried]]
        if len(rows) < LEAST_IMAGES or not len(tried):
            return np.zeros(0), np.zeros(0)
        part = self.camera.chosen(rows)
        return tried, np.array([_disagreement(part, self.track, one, rows) for one in tried])

    def offsets(self) -> list[float]:
        """
        Return offsets at which body and camera turned and moved alike, the best first.

        The angle of a relative rotation is the same for both, wherever the camera sits; lengths
        of steps are in proportion, nearly.

        Returns
        -------
        list of float
            Seconds; empty where too few images have poses.

        """
        if not self.track.timed:
            return [0.0]
        tried, cost = self._profile
        return [float(tried[k]) for k in _minima(cost)[:_MINIMA]]

    def alike(self, found: float) -> list[float]:
        """
        Return offsets far from the one found at which turns and steps agree nearly as well.

        Where the robot turns evenly, a later instant looks like an earlier one. Errors of the
        poses choose among them then, and the curvature of the misfit knows nothing of the others.

        Parameters
        ----------
        found : float
            Seconds.

        Returns
        -------
        list of float
            Seconds, the best first, `APART_S` from each other.

        """
        tried, cost = self._profile
        chosen: list[float] = []
        for k in _minima(cost):
            if cost[k] < cost.min() + NEARLY and all(
                    abs(tried[k] - one) > APART_S for one in (found, *chosen)):
                chosen.append(float(tried[k]))
        return chosen[:MOST_ASKED]

    def far_offset(self) -> float | None:
        """
        Return the likeliest offset beyond `REACH_S`, for telling that the clocks differ.

        Returns
        -------
        float or None
            Seconds; None where no other offset leaves half of the images with poses.

        """
        images = np.count_nonzero(self.track.known(self.middle))
        least = max(LEAST_TIMED, images / 2)

        def best(tried: np.ndarray) -> float | None:
            cost = {}
            for offset in tried[np.abs(tried - self.middle) > REACH_S]:
                rows = np.flatnonzero(self.track.known(offset))
                if len(rows) >= least:
                    cost[float(offset)] = _disagreement(self.camera.chosen(rows), self.track,
                                                        float(offset), rows)
            return min(cost, key=cost.__getitem__) if cost else None
        rough = best(self.middle + np.arange(-FAR_S, FAR_S + FAR_STEP_S / 2, FAR_STEP_S))
        if rough is None:
            return None
        return best(rough + np.arange(-FAR_STEP_S, FAR_STEP_S + STEP_S / 2, STEP_S))


def _minima(cost: np.ndarray) -> np.ndarray:
    """Return where a profile (n,) has its minima, the lowest first."""
    padded = np.concatenate([[np.inf], cost, [np.inf]])
    lowest = np.flatnonzero((cost <= padded[:-2]) & (cost <= padded[2:]))
    sorted_ones: np.ndarray = lowest[np.argsort(cost[lowest], kind='stable')]
    return sorted_ones


def _disagreement(camera: CameraPoses, track: BodyTrack, offset: float,
                  rows: np.ndarray) -> float:
    """Return how much turns and steps of body and camera differ, as logarithms."""
    pairs = pairs_of(camera, track.at(offset, rows))
    turns = np.linalg.norm(pairs.camera_turn, axis=1) - np.linalg.norm(pairs.body_turn, axis=1)
    total = np.log(np.mean(np.abs(turns)) + 1e-6)
    if camera.has_path:
        ours = np.linalg.norm(pairs.camera_move, axis=1)
        theirs = np.linalg.norm(pairs.body_move, axis=1)
        unit = np.median(theirs / np.maximum(ours, 1e-9))
        total += np.log(np.mean(np.abs(theirs - unit * ours)) + 1e-6)
    return float(total)
