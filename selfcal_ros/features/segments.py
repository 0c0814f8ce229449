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
Which stretches of a long recording are worth following image by image.

What a stretch says of the camera grows with how far it turns, how near things pass, and how much
of the image it covers; and the more of one kind there is, the less more of it adds. So a set S of
stretches is worth

    V(S) = sum over kinds c of w_c log(1 + A_c(S) / a_c),

with A_c the way of the image by that kind of motion times the share of the image that is covered.
The stretches are taken one after the other, each the one that adds most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.features.glance import Glance

#: Kinds of motion: their names, the amount a_c (diagonals, radians) and the weight w_c.
#: Turns to either side count by themselves: the principal point wants both.
KINDS = (('turning left', 0.125, 1.0), ('turning right', 0.125, 1.0),
         ('turning up and down', 0.25, 2.0), ('rolling', 0.25, 2.0), ('coming nearer', 0.5, 1.0),
         ('parallax', 0.15, 1.0))
#: A glance is usable where so much of the corners could be followed, over so much of the image.
LEAST_FOLLOWED, LEAST_COVERED = 0.5, 0.15
#: A stretch that adds less than this to V is not worth its time.
LEAST_GAIN = 0.3
#: Images that moved less than this in all, in diagonals, did not move.
STOOD = 0.03


@dataclass(frozen=True)
class Segment:
    """
    A stretch of a recording.

    Attributes
    ----------
    first, last : int
        Numbers of its first and last image.
    start_s, end_s : float
        Seconds from the first image of the recording.
    way : float
        How far the image moved, in diagonals.
    gain : float
        What it adds to what the stretches chosen before say.
    amounts : tuple of float
        A of each of `KINDS`.

    """

    first: int
    last: int
    start_s: float
    end_s: float
    way: float
    gain: float
    amounts: tuple[float, ...]

    @property
    def images(self) -> int:
        """Number of its images."""
        return self.last - self.first + 1

    @property
    def why(self) -> str:
        """The kinds of motion that it is worth most for."""
        worth = [weight * np.log1p(amount / scale)
                 for amount, (_, scale, weight) in zip(self.amounts, KINDS)]
        order = np.argsort(worth)[::-1]
        return ', '.join(KINDS[k][0] for k in order if worth[k] > 0.25 * max(worth))


def stood(glances: Sequence[Glance]) -> bool:
    """Tell whether nothing in the image moved, in all the time."""
    return bool(_ways([one.fastest for one in glances], glances).sum() < STOOD)


def choose_segments(glances: Sequence[Glance], images: int, longest: int, way: float,
                    most: int, began_ns: int = 0) -> list[Segment]:
    """
    Choose the stretches that say most of the camera.

    Parameters
    ----------
    glances : sequence of Glance
        Evenly spaced over the recording.
    images : int
        Images that all stretches may have.
    longest : int
        Images that a stretch may have.
    way : float
        How far the image moves in a stretch at most, in diagonals.
    most : int
        Stretches at most.
    began_ns : int
        Stamp of the first image of the recording.

    Returns
    -------
    list of Segment
        The most valuable first; empty where nothing can be followed.

    """
    if len(glances) < 2:
        return []
    index = np.array([one.index for one in glances])
    moved = _ways([one.speed for one in glances], glances)
    amounts = np.stack([_ways(rates, glances) for rates in (
        # the image moves to the right where the camera turns left
        [max(one.shift[0], 0.0) for one in glances], [max(-one.shift[0], 0.0) for one in glances],
        [abs(one.shift[1]) for one in glances],
        [abs(one.roll) for one in glances], [abs(one.growth) for one in glances],
        [one.parallax for one in glances])], axis=1)
    covered = np.array([one.covered for one in glances])
    usable = (np.array([one.followed for one in glances]) >= LEAST_FOLLOWED) & (
        covered >= LEAST_COVERED)
    sums = np.concatenate([np.zeros((1, len(KINDS))), np.cumsum(amounts * covered[:, None],
                                                                axis=0)])
    along = np.concatenate([[0.0], np.cumsum(moved)])
    # each stretch goes as far as it may: to the first glance that is unusable or too far
    broken = np.append(np.flatnonzero(~usable), len(glances))
    starts = np.flatnonzero(usable)
    ends = np.minimum(broken[np.searchsorted(broken, starts)],
                      np.searchsorted(along, along[starts] + way, side='right'))
    ends = np.minimum(ends, np.searchsorted(index, index[starts] + longest, side='right') - 1)
    good = ends > starts
    starts, ends = starts[good], ends[good]
    chosen: list[Segment] = []
    total, left = np.zeros(len(KINDS)), images
    while len(starts) and len(chosen) < most:
        inside = sums[ends] - sums[starts]
        gain = _value(total + inside) - _value(total)
        # of equal ones the shorter
        best = int(np.argmax(gain - 1e-4 * (index[ends - 1] - index[starts])))
        if gain[best] < LEAST_GAIN:
            break
        first, end = starts[best], ends[best]
        # the last glance of the recording is its end as far as anybody has looked
        last = int(index[min(end, len(index) - 1)])
        chosen.append(Segment(
            int(index[first]), last, 1e-9 * (glances[first].stamp_ns - began_ns),
            1e-9 * (glances[min(end, len(index) - 1)].stamp_ns - began_ns),
            float(along[end] - along[first]), float(gain[best]), tuple(inside[best].tolist())))
        total, left = total + inside[best], left - chosen[-1].images
        free = ((ends <= first) | (starts >= end)) & (index[np.minimum(ends, len(index) - 1)]
                                                      - index[starts] < left)
        starts, ends = starts[free], ends[free]
    return chosen


def _ways(rates: ArrayLike, glances: Sequence[Glance]) -> np.ndarray:
    """Amounts from each glance to the next of what changes at these rates."""
    stamps = 1e-9 * np.array([one.stamp_ns - glances[0].stamp_ns for one in glances])
    steps = np.diff(stamps, append=stamps[-1:])
    # a pause of the recorder is no motion
    return np.asarray(rates) * np.clip(steps, 0.0, 3 * np.median(steps[:-1] if len(steps) > 1
                                                                 else steps))


def _value(amounts: np.ndarray) -> np.ndarray:
    """Return V, over the last axis."""
    scale, weight = (np.array([kind[k] for kind in KINDS]) for k in (1, 2))
    value: np.ndarray = (weight * np.log1p(amounts / scale)).sum(axis=-1)
    return value
