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
Do the cameras agree? What a wrong transform, a knocked camera or a wrong size leaves behind.

The place t of a camera may be wrong by a small shift and turn (tau, w). Then it puts an object at
c elsewhere, by d = (w, tau + w x (c - t)). A model that is too large by a share s moves it by s (c
- t) along each camera's own rays. So two cameras differ by s (t' - t). The differences of each
camera from all others are summed over the images, weighed by what is known of them. Errors of
neighbouring images are alike, which counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.scaled_inverse import scaled_pseudo_inverse, squared_distance

#: Memory of the sums; images that count as one, for their errors are alike.
_MEMORY, _ALIKE = 0.97, 4.0
#: Squared differences (6 degrees of freedom) that stand out: in one image and in the sums. What
#: was said stands until less than this share is left.
CONFLICT, _STANDS_OUT, _LEFT = 60.0, 50.0, 0.5
#: Squared difference from the mean of the images before that is another place of the camera.
_ANOTHER = 240.0
#: Images at the least, and the least differences that matter: radians, share of the distance.
_LEAST_IMAGES, _LEAST_RAD, _LEAST_SHARE = 5, 0.001, 0.0005
#: The size of the model is named where what it does not explain is noise: squared differences, and
#: the share of them.
_NOISE, _UNEXPLAINED = 20.0, 0.02


@dataclass(frozen=True)
class Disagreement:
    """
    What a camera says otherwise than the rest.

    Attributes
    ----------
    which : int
        Number of the camera.
    difference : ndarray, shape (6,)
        Of the object's pose (theta, Delta), as this camera alone sees it, from the rest.
    sigma : tuple of 2 floats
        Standard deviations of turn (radians) and place (metres).
    size : (float, float) or None
        Share by which the model is too large, and its sigma, where that explains it.
    square : float
        The squared difference over its covariance.

    """

    which: int
    difference: np.ndarray
    sigma: tuple[float, float]
    size: tuple[float, float] | None
    square: float

    def text(self, names: list[str]) -> str:
        """Return one sentence; `names` are those of the cameras."""
        if self.size is not None:
            share, sigma = self.size
            side = 'large' if share > 0 else 'small'
            return (f'The model is {100 * abs(share):.1f} ± {100 * sigma:.1f} % too {side} for '
                    'the distances between the cameras, or those are as wrong.')
        turn = np.rad2deg(np.linalg.norm(self.difference[:3]))
        place = 1000 * np.linalg.norm(self.difference[3:])
        who = (f'The cameras {names[0]} and {names[1]} contradict each other' if len(names) == 2
               else f'The camera {names[self.which]} contradicts the others')
        return (f'{who} by {turn:.2f} ± {np.rad2deg(self.sigma[0]):.2f}° and {place:.1f} ± '
                f'{1000 * self.sigma[1]:.1f} mm of the pose: its place, a calibration, a stamp or '
                'the model is wrong.')


class Agreement:
    """
    Gathers what the cameras of a rig say otherwise than each other.

    Parameters
    ----------
    places : ndarray, shape (N, 3)
        Of the cameras in the rig, metres.

    """

    def __init__(self, places: np.ndarray):
        """Begin."""
        self._places = places
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        count = len(self._places)
        self._information, self._score = np.zeros((count, 6, 6)), np.zeros((count, 6))
        self._size = np.zeros((count, 2))
        self._images = np.zeros(count, int)
        self._newest, self._misplaced = np.zeros((2, count, 6, 6))
        self.found: Disagreement | None = None

    def add(self, which: int, others: list[int], difference: np.ndarray, weight: np.ndarray,
            misplaced: np.ndarray, middle: np.ndarray) -> None:
        """
        Take in how a camera differs from others in one image.

        Parameters
        ----------
        which : int
        others : list of int
        difference : ndarray, shape (6,)
        weight : ndarray, shape (6, 6)
            Inverse of the covariance of the difference, but for where the cameras sit.
        misplaced : ndarray, shape (6, 6)
            Its covariance for what is not known of where they sit: the same in all images.
        middle : ndarray, shape (3,)
            Of the object in the rig.

        """
        lever = np.zeros((6, 6))
        lever[:3, 3:] = np.eye(3)
        lever[3:, :3] = np.eye(3)
        lever[3:, 3:] = -cross_matrix(middle - self._places[which])
        if self._images[which]:
            change = difference - lever @ self._mean(which)[0]
            if change @ weight @ change > _ANOTHER:
                # a camera was knocked just now, or put back: what was before is of another place
                for sums in (self._information, self._score, self._size, self._images):
                    sums[which] = 0
        apart = np.r_[np.zeros(3), self._places[others].mean(axis=0) - self._places[which]]
        keep = _MEMORY
        self._information[which] = keep * self._information[which] + lever.T @ weight @ lever
        self._score[which] = keep * self._score[which] + lever.T @ weight @ difference
        self._size[which] = keep * self._size[which] + [apart @ weight @ apart,
                                                        apart @ weight @ difference]
        self._newest[which], self._misplaced[which] = lever, misplaced
        self._images[which] += 1

    def judge(self, distance_m: float) -> Disagreement | None:
        """Say what stands out, if anything does; the object is so far away."""
        found = [self._of(k) for k in range(len(self._places))
                 if self._images[k] >= _LEAST_IMAGES]
        # while it stands, the same camera is named
        bar = _STANDS_OUT * (1.0 if self.found is None else _LEFT)
        out = [one for one in found if one.square > bar and self._matters(one, distance_m)]
        self.found = max(out, key=lambda one: one.square, default=None)
        return self.found

    def _mean(self, which: int) -> tuple[np.ndarray, np.ndarray]:
        """Shift and turn (6,) of a camera that explain its differences, and the covariance."""
        information = self._information[which] / _ALIKE
        # a turn and a shift of the camera are alike for an object that stays where it is
        covariance = scaled_pseudo_inverse(information, 1e-9)
        return covariance @ self._score[which] / _ALIKE, covariance

    def _of(self, which: int) -> Disagreement:
        mean, covariance = self._mean(which)
        score, lever = self._score[which] / _ALIKE, self._newest[which]
        difference = lever @ mean
        spread = lever @ covariance @ lever.T + self._misplaced[which]
        square = squared_distance(difference, spread, 1e-9)
        known, pulled = self._size[which] / _ALIKE
        size = None
        total = float(score @ mean)
        if known > 0 and total - pulled**2 / known < max(_NOISE, _UNEXPLAINED * total):
            size = float(pulled / known), float(known**-0.5)
        return Disagreement(which, difference,
                            (float(np.trace(spread[:3, :3]))**0.5,
                             float(np.trace(spread[3:, 3:]))**0.5), size, square)

    def _matters(self, one: Disagreement, distance_m: float) -> bool:
        d = one.difference
        return bool(np.linalg.norm(d[:3]) > _LEAST_RAD
                    or np.linalg.norm(d[3:]) > _LEAST_SHARE * distance_m)
