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
"""The maximum-likelihood estimate of a mount from the poses of camera and body."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.mount import mount_angles, mount_rotation, MountFacts, NAMES
from selfcal_ros.calibration.mounting.body_track import BodyTrack
from selfcal_ros.calibration.mounting.camera_poses import CameraPoses
from selfcal_ros.calibration.mounting.model import (
    COUNT, LAG, METRE, OFFSET, predict, Prediction, SCALE, State, T, TURN, WORLD_PLACE, WORLD_TURN)
from selfcal_ros.calibration.mounting.optimum import Optimum
from selfcal_ros.calibration.mounting.pose_errors import PoseErrors
from selfcal_ros.calibration.mounting.wrong_poses import agreeing, FALSE_ALARM, LEAST_SPARE
from selfcal_ros.geometry.distributions import f_isf
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.geometry.scaled_inverse import scaled_inverse

#: Metres, radians, a factor's logarithm, seconds: what is not known at all is not known better.
#: Open directions get these sigmas in covariances, far beyond what counts as known.
VAGUE_M, VAGUE_RAD, VAGUE_LOG, VAGUE_S = 10.0, 2.0, 2.0, 1.0
#: Where the place of the camera is open, it stays as near to the body's origin as this.
NEAR_M = 0.3
#: A fact that holds is as sharp as this (metres, radians, ...).
HELD = 1e-9
#: Of an angle. Its slopes turn with the camera: a tighter one would reject every step that bends.
HELD_RAD = 1e-5
#: Rounds of estimating errors, and steps of a descent.
_ROUNDS, _STEPS = 20, 30
#: Variances that change by less (relative) are found; a cost that falls by less is least.
_SETTLED, _LEVEL = 1e-2, 1e-6
#: Degrees of freedom of the wide-tailed law by which wrong poses are found first. Of odometry it
#: is Cauchy's: of more, three slips in twenty steps pass for the rule.
_TAIL, _ODOMETRY_TAIL = 3.0, 1.0


class Adjustment:
    """
    The joint adjustment of images, poses of the body and facts.

    Parameters
    ----------
    camera : CameraPoses
        Of images that have a pose of the body.
    track : BodyTrack
    rows : ndarray of int, shape (V,)
        Of these images in `track`.
    facts : MountFacts

    """

    def __init__(self, camera: CameraPoses, track: BodyTrack, rows: np.ndarray,
                 facts: MountFacts):
        self._open = np.zeros((0, 3))
        self._camera, self._track, self._rows = camera, track, rows
        self._stated = facts.stated
        # of what a pose in a plane does not measure there is no misfit
        self._measured = np.isin(np.arange(6), (0, 1, 5)) if track.flat else np.ones(6, bool)
        self._size = int(self._measured.sum())
        self._tail = _ODOMETRY_TAIL if track.odometry else _TAIL
        k = camera.roots.shape[2]
        free = np.ones(COUNT + k, bool)
        if not camera.has_path:
            free[T], free[SCALE], free[WORLD_PLACE] = False, False, False
        if camera.is_metric:
            free[SCALE] = False
        if track.odometry:
            free[WORLD_TURN], free[WORLD_PLACE] = False, False
        free[OFFSET] = track.timed
        free[LAG] = False
        free[METRE] = 'scale' in self._stated and self._stated['scale'][1] > 0
        self._free = free
        self._vague = np.zeros(COUNT + k)
        for columns, limit in ((T, VAGUE_M), (TURN, VAGUE_RAD), (SCALE, VAGUE_LOG),
                               (OFFSET, VAGUE_S), (LAG, VAGUE_S), (METRE, VAGUE_LOG)):
            self._vague[columns] = 1 / limit**2

    @property
    def free(self) -> np.ndarray:
        """Which unknowns are free, shape (16 + k,)."""
        return self._free

    @property
    def track(self) -> BodyTrack:
        """Poses of the body, as they are interpolated here."""
        return self._track

    def held_along(self, directions: np.ndarray) -> Adjustment:
        """
        Return the same of a camera that stays near the body's origin along directions (n, 3).

        Where the motion does not show the place of the camera, it would follow noise.
        """
        other = copy(self)
        other._open = directions
        return other

    def anchored(self, offset: float) -> Adjustment:
        """Return the same with poses interpolated at an offset of the clocks, seconds."""
        other = copy(self)
        other._track = self._track.anchored(offset)
        return other

    def with_lag(self) -> Adjustment:
        """Return the same where the places of the poses may be late beside their turns."""
        other = copy(self)
        other._free = self._free.copy()
        other._free[LAG] = True
        return other

    def predict(self, state: State) -> Prediction:
        """Return the residuals of a state against the poses, and their derivatives."""
        body = self._track.at(state.offset, self._rows)
        return predict(state, self._camera, body, self._track.odometry)

    def with_facts(self, state: State) -> State:
        """Return a state that obeys held angles, and the facts on the metre and the clocks."""
        step = np.zeros(COUNT + len(state.w))
        if 'scale' in self._stated:
            step[METRE] = np.log(self._stated['scale'][0]) - state.log_metre
            if not self._camera.is_metric:
                step[SCALE] = step[METRE]
        if 'time_offset' in self._stated and self._track.timed:
            step[OFFSET] = self._stated['time_offset'][0] - state.offset
        angles = dict(zip(NAMES[3:], mount_angles(state.turn)))
        angles.update({name: value for name, (value, sigma) in self._stated.items()
                       if name in angles and not sigma})
        return replace(state.moved(step), turn=mount_rotation(*angles.values()))

    def _priors(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return misfits (f,) of the facts in sigmas, and slopes (f, 16) of what they say."""
        names = [name for name in self._stated
                 if name != 'time_offset' or self._track.timed]
        values = np.zeros(len(names))
        slopes = np.zeros((len(names), COUNT))
        angles = np.array(mount_angles(state.turn))
        for row, name in enumerate(names):
            value, sigma = self._stated[name]
            index = NAMES.index(name)
            if name == 'scale':
                if not self._free[METRE]:
                    continue
                values[row], sigma = np.log(value) - state.log_metre, sigma / value
                slopes[row, METRE] = 1
            elif name == 'time_offset':
                values[row], slopes[row, OFFSET] = value - state.offset, 1
            elif index < 3:
                values[row], slopes[row, index] = value - state.place[index], 1
            else:
                off = value - angles[index - 3]
                values[row] = (off + np.pi) % (2 * np.pi) - np.pi
                step = 1e-6
                for axis in range(3):
                    turned = rotation_matrix(step * np.eye(3)[axis]) @ state.turn
                    slopes[row, TURN.start + axis] = (
                        mount_angles(turned)[index - 3] - angles[index - 3]) / step
            sigma = max(sigma, HELD_RAD if 3 <= index < 6 else HELD)
            values[row] /= sigma
            slopes[row] /= sigma
        held = np.zeros((len(self._open), COUNT))
        held[:, T] = self._open / NEAR_M
        return (np.concatenate([values, -held[:, T] @ state.place]),
                np.concatenate([slopes, held]))

    def _system(self, state: State, prediction: Prediction, errors: PoseErrors,
                weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the information matrix and minus the gradient, of all unknowns."""
        H, g = self._of_poses(state, prediction, errors, weights)
        values, slopes = self._priors(state)
        H[:COUNT, :COUNT] += slopes.T @ slopes
        g[:COUNT] += slopes.T @ values
        return H, g

    def _of_poses(self, state: State, prediction: Prediction, errors: PoseErrors,
                  weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return information and minus the gradient without the facts."""
        counted = weights > 0
        roots = errors.whitening[counted] * np.sqrt(weights[counted])[:, None, None]
        S = errors.independent(roots @ prediction.slopes[counted])
        r = errors.independent(roots @ prediction.residual[counted][:, :, None])
        S, r = S.reshape(-1, S.shape[2]), r.ravel()
        H, g = S.T @ S, S.T @ r
        own = np.arange(COUNT, len(g))
        H[own, own] += 1
        g[own] -= state.w
        return H, g

    def _distances(self, prediction: Prediction, errors: PoseErrors) -> np.ndarray:
        """Return squared misfits in sigmas, shape (m,)."""
        r = prediction.residual
        squares: np.ndarray = np.einsum('mi,mij,mj->m', r, errors.precisions, r)
        return squares

    def distances(self, state: State, errors: PoseErrors) -> np.ndarray:
        """Return squared misfits of a state in sigmas, shape (m,)."""
        return self._distances(self.predict(state), errors)

    def of_poses(self, state: State, errors: PoseErrors, keep: np.ndarray,
                 ) -> tuple[np.ndarray, np.ndarray, float]:
        """
        Return what poses and images say without the facts.

        Returns
        -------
        information : ndarray, shape (16 + k, 16 + k)
        gradient : ndarray, shape (16 + k,)
            Minus that of half the square.
        square : float
            Of the misfits that count, in sigmas.

        """
        prediction = self.predict(state)
        weights = keep.astype(float)
        H, g = self._of_poses(state, prediction, errors, weights)
        return H, g, float(weights @ self._distances(prediction, errors) + state.w @ state.w)

    def misfit(self, optimum: Optimum, keep: np.ndarray) -> float:
        """Return minus twice the log-likelihood of an optimum, but for a constant."""
        prediction, errors = self.predict(optimum.state), optimum.errors
        squares = float(self._distances(prediction, errors)[keep].sum())
        sizes = float(np.linalg.slogdet(errors.covariances[keep])[1].sum())
        facts, w = self._priors(optimum.state)[0], optimum.state.w
        return squares + sizes + float(w @ w + facts @ facts)

    def descend(self, state: State, errors: PoseErrors,
                keep: np.ndarray | None = None) -> tuple[State, float]:
        """
        Refine a state while the variances are held.

        Levenberg-Marquardt in a loop of its own, which ends at a share of the cost:
        `levenberg_marquardt.minimise` ends at a fixed amount, in units of sigma².

        Parameters
        ----------
        state : State
        errors : PoseErrors
        keep : ndarray of bool, shape (m,), optional
            Which misfits count, as normal ones. By default all do, with wide tails.

        Returns
        -------
        state : State
        cost : float

        """
        free = self._free

        def cost_of(one: State, prediction: Prediction) -> float:
            squares = self._distances(prediction, errors)
            facts = self._priors(one)[0]
            if keep is None:
                poses = (self._tail + self._size) * np.log1p(squares / self._tail).sum()
            else:
                poses = (errors.independent(errors.whitening[keep]
                                            @ prediction.residual[keep][:, :, None])**2).sum()
            return float(poses + one.w @ one.w + facts @ facts)
        prediction = self.predict(state)
        cost, damping = cost_of(state, prediction), 1e-6
        system = None
        for _ in range(_STEPS):
            if system is None:
                weights = (self._tail_weights(prediction, errors) if keep is None
                           else keep.astype(float))
                H, g = self._system(state, prediction, errors, weights)
                system = H[np.ix_(free, free)], g[free]
            inner, right = system
            damped = inner + np.diag(damping * np.diag(inner) + self._vague[free])
            step = np.zeros(len(free))
            step[free] = np.linalg.solve(damped, right)
            new = state.moved(step)
            ahead = self.predict(new)
            new_cost = cost_of(new, ahead)
            if not new_cost <= cost:
                damping = max(10 * damping, 1e-6)
                if damping > 1e6:
                    break
                continue
            fall, state, prediction, cost = cost - new_cost, new, ahead, new_cost
            system, damping = None, damping / 10
            if fall < _LEVEL * max(1.0, cost):
                break
        return state, cost

    def optimum(self, state: State, errors: PoseErrors) -> Optimum:
        """
        Estimate everything, the errors of the poses and which are wrong among it.

        Parameters
        ----------
        state : State
            Near.
        errors : PoseErrors
            No smaller than they are: estimates of them come down from above. From below, the
            images would bend to poses that are thought exact.

        Returns
        -------
        Optimum

        """
        if self._track.odometry:
            state, errors, cost = self._with_wide_tails(state, errors)
        else:
            # starts compare by it, and each comes with errors of its own
            cost = self.descend(state, errors)[1] + float(
                np.linalg.slogdet(errors.covariances)[1].sum())
        keep, least = self._first_verdicts(state, errors)
        freedom = np.full(len(errors.variances), np.inf)
        for turn in range(_ROUNDS):
            state, _ = self.descend(state, errors, keep)
            prediction = self.predict(state)
            information, covariance, spread = self._spread(state, prediction, errors,
                                                           keep.astype(float))
            before = errors
            errors, freedom = errors.refined(prediction.residual, spread, keep)
            if not self._track.odometry:
                errors = errors.in_a_row(prediction.residual, keep)
            near = agreeing(before, prediction.residual, spread, keep, self._measured)
            if near.sum() < least:
                # no mount is made of so few
                return Optimum(state, covariance, information, errors, errors, freedom,
                               np.zeros_like(keep), cost, prediction)
            settled = bool((np.abs(np.log(errors.variances / before.variances)) < _SETTLED).all()
                           and np.allclose(errors.shared, before.shared, atol=1e-2)
                           and (near == keep).all())
            # late changes of mind would go round in a circle: doubt is no contradiction
            keep = near if turn < _ROUNDS // 2 else keep | near
            if settled:
                break
        cautious = errors.cautious(spread, keep)
        information, covariance, _ = self._spread(state, prediction, cautious, keep.astype(float))
        return Optimum(state, covariance, information, errors, cautious, freedom, keep, cost,
                       prediction)

    def _first_verdicts(self, state: State, errors: PoseErrors) -> tuple[np.ndarray, float]:
        """Return which poses count at first, and how many must, so that anything is tested."""
        distances = self._distances(self.predict(state), errors)
        count, unknown = len(distances), int(self._free[:COUNT].sum())
        spare = max(self._size * count - unknown, 1)
        keep = distances < self._size * float(f_isf(FALSE_ALARM / count, self._size, spare))
        least = min(1 + (unknown + LEAST_SPARE) / self._size, count)
        # fewer would fit anything
        return (keep if keep.sum() >= least else np.ones(count, bool)), least

    def _with_wide_tails(self, state: State,
                         errors: PoseErrors) -> tuple[State, PoseErrors, float]:
        """
        Estimate state and errors by a law with wide tails, in which no few poses pass for many.

        Slips are many times the errors of other steps. Poses of an arm err more alike: there the
        law costs up to a tenth of the accuracy.

        Returns
        -------
        state : State
        errors : PoseErrors
            Somewhat larger than those of poses that are not wrong.
        cost : float
            Minus twice the log-likelihood, but for a constant: starts compare by it.

        """
        every = np.ones(len(errors.covariances), bool)
        for _ in range(_ROUNDS):
            state, cost = self.descend(state, errors)
            prediction, before = self.predict(state), errors
            weights = self._tail_weights(prediction, errors)
            spread = self._spread(state, prediction, errors, weights)[2]
            errors = errors.refined(prediction.residual, spread, every, weights)[0].at_most(before)
            if (np.abs(np.log(errors.variances / before.variances)) < _SETTLED).all():
                break
        return state, errors, cost + float(np.linalg.slogdet(errors.covariances)[1].sum())

    def _tail_weights(self, prediction: Prediction, errors: PoseErrors) -> np.ndarray:
        """Return the weights of misfits (m,) under the law with wide tails."""
        squares = self._distances(prediction, errors)
        return np.asarray((self._tail + self._size) / (self._tail + squares))

    def _spread(self, state: State, prediction: Prediction, errors: PoseErrors,
                weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return information and covariance of all unknowns, and covariances of misfits."""
        information, _ = self._system(state, prediction, errors, weights)
        covariance = self._inverse(information)
        S = prediction.slopes
        return information, covariance, S @ covariance @ np.swapaxes(S, 1, 2)

    def lag(self, optimum: Optimum) -> tuple[float, float]:
        """
        Estimate how late the places of the poses are behind their turns, and the sigma (s).

        One step from an optimum that has not allowed for it (Rao's score test).
        """
        H, g = self._system(optimum.state, optimum.prediction, optimum.cautious,
                            optimum.keep.astype(float))
        tied = np.where(self._free, H[:, LAG], 0.0)
        through = optimum.covariance @ tied
        own = H[LAG, LAG] - tied @ through
        if not own > 1 / VAGUE_S**2:
            return 0.0, np.inf
        return float((g[LAG] - through @ g) / own), float(1 / np.sqrt(own))

    def _inverse(self, information: np.ndarray) -> np.ndarray:
        """Return the covariance of all unknowns; see `Optimum`."""
        free = self._free
        H = (information + np.diag(self._vague))[np.ix_(free, free)]
        covariance = np.zeros_like(information)
        covariance[np.ix_(free, free)] = scaled_inverse(H)
        return covariance
