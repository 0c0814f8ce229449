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
Has the camera changed? A sequential test of new evidence against the calibration in force.

Model: the camera in force errs by what its covariance says; window after window of keyframes tells
it again, each with its own error (`window_score`). Against that stands, for every moment at which
it might have happened, a change of focal length and principal point, or of the focal length
alone. Twice the logarithm of the generalised likelihood ratio is a chi-square with three degrees
of freedom, or one; the less probable of both counts, as one of three. Over the moments it is
maximised, and the threshold bounds the rate at which an unchanged camera exceeds it
(docs/monitoring.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens, to_intrinsics
from selfcal_ros.calibration.monitoring.camera_change import CameraChange, CHANGES, MonitorSettings
from selfcal_ros.calibration.monitoring.window_scatter import WindowScatter
from selfcal_ros.calibration.monitoring.window_score import WindowScore
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.chances import chi2_limit

#: What remains of the statistic without its strongest window must be improbable, too: one window
#: alone, with a moving object in it, proves nothing.
WITHOUT_STRONGEST = float(chi2_limit(1e-4, len(CHANGES)))
#: The newest windows are kept one by one; older ones are merged in pairs, as many of each size.
SINGLE_WINDOWS, OF_EACH_SIZE = 12, 4
#: Share of the windows' scatter, as a variance, that a change has to exceed.
SHARED_SCATTER = 0.25
#: A window does not fit where noise that the epipolar geometry lacks exceeds the usual by this
#: factor, or where tracks agree with themselves alone, by the factors of misfit and dependence.
UNUSUAL_NOISE, UNUSUAL_MISFIT, UNUSUAL_DEPENDENCE = 1.3, 1.2, 1.5
#: The same where less than this share of the tracks stands still.
MOSTLY_STILL = 0.9
#: A score is exact to first order: so much of the step that it tells is its own uncertainty.
CURVATURE = 0.1


@dataclass
class _Block:
    """Sum of the evidence of successive windows, relative to the camera in force."""

    information: np.ndarray
    shift: np.ndarray           # information times step
    windows: int
    first_frame: int
    last_frame: int
    score: WindowScore | None = None

    def merged(self, other: _Block) -> _Block:
        return _Block(self.information + other.information, self.shift + other.shift,
                      self.windows + other.windows, self.first_frame, other.last_frame)


class ChangeMonitor:
    """
    Compares windows with a calibration, and with one another.

    Parameters
    ----------
    calibration : Calibration
        In force. Its camera has an image size.
    settings : MonitorSettings, optional

    Attributes
    ----------
    calibration : Calibration
    free : tuple of str
        Those unknowns of the lens that `window_score` has to differentiate by.
    in_force : ndarray, shape (k,)
        These parameters of the camera in force.
    camera : Camera
        That the next window is to be scored against: the one in force, or after an alarm the one
        that there seems to be, since a score is exact to first order only.
    change : CameraChange or None
        The alarm. It stays once it is raised, and what it states improves with every window.
    windows, discarded : int
        Windows that were taken, and those of them that agreed with nothing before or after.
    unexplained : int
        Windows, up to the newest, that no camera explains: they are not taken.
    statistic, threshold : float
        Of the newest test.

    """

    def __init__(self, calibration: Calibration, settings: MonitorSettings = MonitorSettings()):
        self.settings, self.calibration = settings, calibration
        self.camera = calibration.camera
        covariance = _intrinsic_covariance(calibration)
        lens = Lens.of(self.camera)
        self.free = tuple(name for name, variance in zip(lens.names, np.diag(covariance))
                          if variance > 0 or name in CHANGES)
        places = lens.places(self.free)
        self.in_force = lens.take(self.free)
        self._changes = [self.free.index(name) for name in CHANGES]
        size = np.hypot(self.camera.width, self.camera.height)
        focal = self.camera.K[0, 0]
        # displacement half a diagonal from the middle: of a focal length, and of the middle
        reach = 2 * focal / size
        self._least = np.square(settings.tolerance_px * np.array([reach, 1, 1]))
        prior = covariance[np.ix_(places, places)]
        self._prior = self._stated = prior + np.diag(self._along(0.01 * self._least))
        self._old: list[_Block] = []
        self._new: list[_Block] = []
        self._scatter = WindowScatter(self._least)
        self._of_windows = self._of_changes = self._least
        self.change: CameraChange | None = None
        self.windows = self.discarded = self.unexplained = 0
        self.statistic, self.threshold = 0.0, self._threshold(1)

    def _along(self, values) -> np.ndarray:
        """Spread values (3,) of what may change over the free parameters, (k,)."""
        result = np.zeros(len(self.free))
        result[self._changes] = values
        return result

    def _threshold(self, moments: int) -> float:
        """Bound the rate: the tests of all moments together (Bonferroni), window by window."""
        chance = (self.settings.keyframes - 1) / self.settings.false_alarm_keyframes
        return float(chi2_limit(chance / moments, len(CHANGES)))

    def learn(self, score: WindowScore) -> None:
        """
        Take the score of a window of those keyframes that the calibration was made from.

        It is no evidence, but tells how well windows agree with this calibration.
        """
        mean = self._along(self._remember(score))
        # by so much all windows may disagree with the calibration
        self._prior = self._stated + np.outer(mean, mean)

    def add(self, score: WindowScore) -> CameraChange | None:
        """
        Take the score of the next window.

        Parameters
        ----------
        score : WindowScore
            Of `free`, against `camera` or against the one in force.

        Returns
        -------
        CameraChange or None
            The alarm, as long as it stands.

        """
        if not self.explains(score):
            self.unexplained += 1
            return self.change
        self.windows += 1
        self.unexplained = 0
        step = score.at + score.step - self.in_force
        information = score.information / self._scatter.inflation(score.dependence)
        # every scene has its own small error, however much it tells
        own = np.diag(self._along(self._of_windows
                                  + np.square(CURVATURE * score.step[self._changes])))
        weight = np.linalg.inv(np.eye(len(self.free)) + information @ own)
        self._new.append(_Block(_symmetric(weight @ information), weight @ information @ step, 1,
                                score.frames[0], score.frames[-1], score))
        self._test()
        if len(self._new) > SINGLE_WINDOWS:
            self._retire()
        return self.change

    def explains(self, score: WindowScore) -> bool:
        """
        Tell whether some camera before a still scene explains a window.

        What moves by itself, or a shutter that shakes, leaves more than the usual noise. Where
        pairs of images show that noise as well, and tracks are independent, it is noise.
        """
        usual = self._scatter.usual(self.calibration.noise_sigma_px)
        return (score.noise_px < UNUSUAL_NOISE * usual.noise_px
                or score.misfit < UNUSUAL_MISFIT * usual.misfit
                and score.dependence < UNUSUAL_DEPENDENCE * usual.dependence
                and score.still > MOSTLY_STILL)

    # ------------------------------------------------------------------ the test

    def _sums(self, blocks) -> tuple[np.ndarray, np.ndarray]:
        """Information (n, k, k) and shift (n, k) of the last 1, 2, ... n blocks together."""
        return (np.cumsum([block.information for block in reversed(blocks)], axis=0),
                np.cumsum([block.shift for block in reversed(blocks)], axis=0))

    def _ratios(self, before: np.ndarray, before_shift, after, after_shift):
        """
        Statistics of changes between evidence before and after, batches of n.

        Returns
        -------
        statistic : ndarray, shape (n,)
            As one of three degrees of freedom.
        change : ndarray, shape (n, 3)
        covariance : ndarray, shape (n, 3, 3)
            Tolerance included.

        """
        total = before + after
        along = after[:, :, self._changes]                       # (n, k, 3)
        # the common camera, which both sides measure, is eliminated
        solved = np.linalg.solve(total, np.concatenate(
            [along, (before_shift + after_shift)[..., None]], axis=2))
        information = along[:, self._changes] - np.swapaxes(along, 1, 2) @ solved[..., :3]
        right = after_shift[:, self._changes] - np.einsum('nki,nk->ni', along, solved[..., 3])
        # tolerance T: covariance I⁻¹ + T, without inverting an I that may be singular
        eased = np.eye(3) + information * self._of_changes
        weight = np.linalg.solve(eased, information)             # (I⁻¹ + T)⁻¹
        values, vectors = np.linalg.eigh(_symmetric(information))
        floor = np.maximum(values, 1e-12 * np.maximum(values[:, -1:], 1e-12))
        inverse = (vectors / floor[:, None]) @ np.swapaxes(vectors, 1, 2)
        change = np.einsum('nij,nj->ni', inverse, right)
        together = np.einsum('ni,nij,nj->n', change, weight, change)
        covariance = inverse + np.diag(self._of_changes)
        # a zoom, a new focus or warmth move the focal length and nothing else
        own = np.maximum(information[:, 0, 0], floor[:, 0])
        zoomed = right[:, 0] / own
        alone = zoomed**2 / (1 / own + self._of_changes[0])
        statistic, is_alone = _less_probable(together, alone)
        change[is_alone] = 0
        covariance[is_alone] = np.diag(self._of_changes)
        change[is_alone, 0] = zoomed[is_alone]
        covariance[is_alone, 0, 0] += 1 / own[is_alone]
        return statistic, change, covariance

    def _test(self) -> None:
        """Test every moment that the blocks leave, and judge the most likely one."""
        blocks = self._old + self._new
        after, after_shift = self._sums(blocks)
        before = after[-1] - after + np.linalg.inv(self._prior)
        statistic, change, covariance = self._ratios(before, after_shift[-1] - after_shift,
                                                     after, after_shift)
        best = int(np.argmax(statistic))
        self.statistic, self.threshold = float(statistic[best]), self._threshold(len(blocks))
        if best == 0 or self.statistic < self.threshold:
            return
        if self.change is None and not self._holds_without_strongest(
                best + 1, before[best], after_shift[-1] - after_shift[best],
                after[best], after_shift[best]):
            return
        # the camera may have changed within the first of the windows that differ: it is a mixture
        # of two cameras, and counts with neither
        _, change, covariance = self._ratios(
            before[best:best + 1], (after_shift[-1] - after_shift[best])[None],
            after[best - 1:best], after_shift[best - 1:best])
        first = blocks[-1 - best]
        self.change = CameraChange(
            change[0], covariance[0], float(self.in_force[0]), first.first_frame,
            first.last_frame, blocks[-1].last_frame, self.statistic, self.threshold)
        self.camera = self._changed(change[0])

    def _changed(self, change) -> Camera:
        """Return the camera in force after a change (3,), within reason."""
        camera = self.calibration.camera
        lens, reach = Lens.of(camera), 0.25 * np.hypot(camera.width, camera.height)
        focal, *point = (lens[name] for name in CHANGES)
        point = np.asarray(point) + np.clip(change[1:], -reach, reach)
        focal *= np.clip(1 + change[0] / focal, 0.5, 2.0)
        return lens.with_values(dict(zip(CHANGES, (focal, *point)))).camera(camera.width,
                                                                            camera.height)

    def _holds_without_strongest(self, count, before, before_shift, after, after_shift) -> bool:
        """Tell whether the change is seen without any one of its newest windows, too."""
        single = self._new[-count:]
        others = np.stack([after - block.information for block in single])
        other_shifts = np.stack([after_shift - block.shift for block in single])
        statistic, *_ = self._ratios(np.repeat(before[None], len(single), axis=0),
                                     np.repeat(before_shift[None], len(single), axis=0),
                                     others, other_shifts)
        return bool(statistic.min() > WITHOUT_STRONGEST)

    # ------------------------------------------------------------------ memory

    def _remember(self, score: WindowScore) -> np.ndarray:
        """Learn how large the errors of windows are; returns their mean, shape (3,)."""
        spread = _inverse(score.information) * self._scatter.inflation(score.dependence)
        step = (score.at + score.step - self.in_force)[self._changes]
        self._scatter.remember(score, step, spread[np.ix_(self._changes, self._changes)])
        self._of_windows, mean = self._scatter.tolerance()
        # neighbouring windows share a scene, so that their mean scatters, too
        self._of_changes = np.maximum(self._least, SHARED_SCATTER * self._of_windows)
        return mean

    def _retire(self) -> None:
        """Move the oldest single window to the merged ones, unless it agrees with nothing."""
        block = self._new.pop(0)
        # not before: after a change, windows scatter about another camera
        if self.change is None and block.score is not None:
            self._remember(block.score)
            block.score = None
        others = self._old + self._new
        information = np.linalg.inv(self._prior) + np.sum([b.information for b in others], axis=0)
        shift = np.sum([b.shift for b in others], axis=0)
        statistic, *_ = self._ratios(information[None], shift[None],
                                     block.information[None], block.shift[None])
        if statistic[0] > self._threshold(1):
            self.discarded += 1
            return
        self._old.append(block)
        for size in (2**k for k in range(60)):
            same = [k for k, b in enumerate(self._old) if size <= b.windows < 2 * size]
            if len(same) <= OF_EACH_SIZE:
                break
            first = same[0]
            self._old[first:first + 2] = [self._old[first].merged(self._old[first + 1])]


def _intrinsic_covariance(calibration: Calibration) -> np.ndarray:
    """Covariance of the unknowns of the lens from that of the parameters, (k, k)."""
    lens = Lens.of(calibration.camera)
    covariance = to_intrinsics(calibration.covariance, lens)
    # an aspect ratio that a fact fixes has no variance but that of rounding
    aspect = lens.names.index('aspect')
    if covariance[aspect, aspect] < 1e-14:
        covariance[aspect] = covariance[:, aspect] = 0
    return covariance


def _less_probable(together: np.ndarray, alone: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Choose between chi-squares of three and of one degree of freedom.

    Returns
    -------
    ndarray, shape (n,)
        Chi-square with three that is exceeded as rarely as the rarer one, twice as often for
        having had the choice; far out, where both tails are known.
    ndarray of bool, shape (n,)
        Where that of one is the rarer.

    """
    # tails: sqrt(2 s / pi) exp(-s/2) of three, sqrt(2 / (pi s)) exp(-s/2) of one
    like_three = alone + 2 * np.log(np.maximum(alone, 1.0))
    chosen = np.maximum(np.maximum(together, like_three) - 2 * np.log(2), 0.0)
    return chosen, like_three > together


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return (matrix + np.swapaxes(matrix, -1, -2)) / 2


def _inverse(information: np.ndarray) -> np.ndarray:
    """Invert by way of unit diagonals: parameters differ in scale."""
    scale = np.sqrt(np.diag(information))
    return np.linalg.pinv(information / np.outer(scale, scale),
                          hermitian=True) / np.outer(scale, scale)
