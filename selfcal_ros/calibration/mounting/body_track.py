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
"""Poses of the body at the instants of the images: matched by frame, or interpolated in time."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.mounting.pose_jumps import jumps_of, MOST_RESTARTS, without_jumps
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.values.body_poses import BodyPoses, ODOMETRY

#: Poses that are farther apart than so many of their usual steps are not interpolated between.
GAP_STEPS = 5.0
#: Poses count as those of motion in a plane where their heights and tilts differ by less.
FLAT_M, FLAT_RAD = 1e-6, 1e-6
#: Rates are taken over so many usual steps to both sides at least. Noise must not pass for speed:
#: that of odometry adds up, however short its steps are, and asks for so many seconds.
_RATE_STEPS, _LONGEST_RATE_S = 2.5, 0.4
#: Of absolute poses, noise may make this share of the rates; longer windows blur the motion.
_NOISE_SHARE = 0.1
#: The third difference of white noise, in its sigmas.
_THIRD = 20**0.5


@dataclass(frozen=True)
class BodyAt:
    """
    The body at some instants.

    Attributes
    ----------
    rotation : ndarray, shape (V, 3, 3)
        World from body.
    position : ndarray, shape (V, 3)
    turning : ndarray, shape (V, 3)
        Angular velocity about the axes of the world, rad/s; zero for poses by frame.
    velocity : ndarray, shape (V, 3)
        Metres per second.

    """

    rotation: np.ndarray
    position: np.ndarray
    turning: np.ndarray
    velocity: np.ndarray


class BodyTrack:
    """
    Poses of the body that can be asked for at the images.

    Parameters
    ----------
    poses : BodyPoses
    frames : ndarray of int, shape (V,)
        Of the images.
    stamps_ns : mapping of int to int, optional
        Instants of the frames by the camera's clock.

    Attributes
    ----------
    timed : bool
        Poses belong to instants, not to images.
    flat : bool
        Poses are those of motion in a plane: they say nothing of height and tilt.
    odometry : bool
    begun_anew : int
        How often odometry jumped; what lies on both sides of a jump was joined.

    """

    def __init__(self, poses: BodyPoses, frames: np.ndarray,
                 stamps_ns: Mapping[int, int] | None = None):
        self._poses = poses
        self.timed = poses.frames is None
        self.odometry = poses.kind == ODOMETRY
        self.begun_anew = 0
        self._anchor: float | None = None
        self._kept: tuple[np.ndarray, BodyAt] | None = None
        up = poses.rotation[:, :, 2]
        self.flat = bool(len(poses) and (np.ptp(poses.position[:, 2]) < FLAT_M)
                         and bool(np.all(np.ptp(up, axis=0) < FLAT_RAD))
                         and up[0, 2] > 1 - FLAT_RAD)
        self._rows = np.zeros(len(frames), int)
        self._instants = np.zeros(len(frames))
        self._times = np.arange(len(poses), dtype=float)
        if poses.frames is not None:
            rows = np.searchsorted(poses.frames, frames).clip(max=len(poses) - 1)
            self._rows, self._known = rows, poses.frames[rows] == frames
        elif poses.stamps_ns is not None:
            stamps = {} if stamps_ns is None else stamps_ns
            self._known = np.array([int(frame) in stamps for frame in frames], dtype=bool)
            start = int(poses.stamps_ns[0])
            self._times = (poses.stamps_ns - start) * 1e-9
            self._instants = np.array([(int(stamps[int(frame)]) - start) * 1e-9 if known else 0.0
                                       for frame, known in zip(frames, self._known)])
        steps = np.diff(self._times)
        self._usual = float(np.median(steps)) if len(steps) else 1.0
        self._gap = GAP_STEPS * self._usual
        self._jumps = np.zeros(len(steps), bool)
        if self.timed:
            self._jumps = jumps_of(poses)
            if self.odometry and 0 < self._jumps.sum() <= MOST_RESTARTS:
                self.begun_anew = int(self._jumps.sum())
                self._poses = without_jumps(poses, self._jumps)
                self._jumps = np.zeros(len(steps), bool)
        # nothing is interpolated across gaps and jumps
        self._torn = (steps > self._gap) | self._jumps
        self._rate_step = _RATE_STEPS * self._usual
        self._noise = np.zeros(6)
        if self.odometry:
            self._rate_step = max(self._rate_step, _LONGEST_RATE_S)
        elif self.timed:
            self._noise = self._white_noise()
            self._rate_step = self._rate_window()

    @property
    def instants(self) -> np.ndarray:
        """Instants of the images, seconds from the first pose by the camera's clock, (V,)."""
        return self._instants

    def anchored(self, offset: float) -> BodyTrack:
        """
        Return the same poses, interpolated at one offset of the clocks, in seconds.

        To other offsets they are moved on from there at their rates. An offset that went along
        the noise of the poses would fit it.
        """
        other = copy(self)
        other._anchor, other._kept = offset, None
        return other

    def known(self, offset: float = 0.0, margin: float = 0.0) -> np.ndarray:
        """Tell which images have a pose, and keep it if the offset moves by a margin; (V,)."""
        if not self.timed:
            known: np.ndarray = self._known
            return known
        inside: np.ndarray = self._known.copy()
        for shift in (-margin, 0.0, margin):
            when = self._instants - offset + shift
            k = np.searchsorted(self._times, when, side='right').clip(1, len(self._times) - 1)
            edge = 1e-5
            inside &= (when >= self._times[0] - edge) & (when <= self._times[-1] + edge)
            inside &= ~self._torn[k - 1]
        return inside

    def at(self, offset: float, rows: np.ndarray) -> BodyAt:
        """
        Return the body at images.

        Parameters
        ----------
        offset : float
            Camera clock minus body clock, seconds.
        rows : ndarray of int, shape (V,)
            Which of the images; all are among `known`.

        Returns
        -------
        BodyAt

        """
        if not self.timed:
            at, still = self._rows[rows], np.zeros((len(rows), 3))
            return BodyAt(self._poses.rotation[at], self._poses.position[at], still, still)
        anchor = offset if self._anchor is None else self._anchor
        near = self._near(anchor, rows)
        ahead = anchor - offset
        return BodyAt(rotation_matrix(ahead * near.turning) @ near.rotation,
                      near.position + ahead * near.velocity, near.turning, near.velocity)

    def _near(self, anchor: float, rows: np.ndarray) -> BodyAt:
        """Interpolate at an offset; where one is the anchor, an estimate asks again and again."""
        if self._anchor is None:
            return self._at(anchor, rows)
        if self._kept is None or not np.array_equal(self._kept[0], rows):
            self._kept = rows.copy(), self._at(anchor, rows)
        return self._kept[1]

    def _at(self, offset: float, rows: np.ndarray) -> BodyAt:
        """Interpolate at an offset of the clocks."""
        when, step = self._instants[rows] - offset, self._rate_step
        rotation, position = self._interpolated(when)
        # of what lies between the jumps before and after
        cuts, count = np.flatnonzero(self._jumps), len(self._times)
        after_jump = np.searchsorted(self._times[cuts + 1], when, side='right')
        earlier = np.maximum(when - step, self._times[np.r_[0, cuts + 1][after_jump]])
        later = np.minimum(when + step, self._times[np.r_[cuts, count - 1][after_jump]])
        before, after = self._interpolated(earlier), self._interpolated(later)
        lasting = (later - earlier)[:, None]
        turning = rotation_vector(after[0] @ np.swapaxes(before[0], 1, 2)) / lasting
        return BodyAt(rotation, position, turning, (after[1] - before[1]) / lasting)

    def of_neighbours(self, rows: np.ndarray, step: int) -> tuple[np.ndarray, BodyAt]:
        """
        Return the poses by frame that stand so many before or after those of the images.

        Parameters
        ----------
        rows : ndarray of int, shape (V,)
            Of the images.
        step : int

        Returns
        -------
        known : ndarray of bool, shape (V,)
            Which images have one: none where poses are by instants.
        body : BodyAt
            Of these.

        """
        at = self._rows[rows] + step
        known = (at >= 0) & (at < len(self._poses)) & (not self.timed)
        at, still = at[known], np.zeros((int(known.sum()), 3))
        return known, BodyAt(self._poses.rotation[at], self._poses.position[at], still, still)

    def _interpolated(self, when: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Interpolate through the two poses before and the two after each instant.

        Cubic polynomials of the four neighbours (Lagrange); of rotations, in the tangent space
        of the pose before.
        """
        times, count = self._times, len(self._times)
        k = (np.searchsorted(times, when, side='right') - 1).clip(0, max(count - 2, 0))
        width = min(4, count)
        first = (k - 1).clip(0, count - width)
        nodes = first[:, None] + np.arange(width)
        at = (times[nodes] - times[k][:, None]) / self._usual
        asked = (when - times[k]) / self._usual
        # a gap among the four would bend the curve: the two that enclose the instant remain
        uneven = np.asarray(self._torn[nodes[:, :-1]].any(axis=1))
        weights = np.ones((len(when), width))
        for a in range(width):
            for b in range(width):
                if a != b:
                    weights[:, a] *= (asked - at[:, b]) / (at[:, a] - at[:, b])
        if uneven.any():
            share = asked * self._usual / (times[(k + 1).clip(max=count - 1)] - times[k])
            straight = (np.where(nodes == k[:, None], 1 - share[:, None], 0)
                        + np.where(nodes == k[:, None] + 1, share[:, None], 0))
            weights = np.where(uneven[:, None], straight, weights)
        position = np.einsum('vn,vni->vi', weights, self._poses.position[nodes])
        base = self._poses.rotation[k]
        turns = rotation_vector(np.swapaxes(base, 1, 2)[:, None] @ self._poses.rotation[nodes])
        return base @ rotation_matrix(np.einsum('vn,vni->vi', weights, turns)), position

    def _white_noise(self) -> np.ndarray:
        """Return sigmas of each pose's own error, (6,): no motion shows in third differences."""
        steps = np.diff(self._times)
        even = np.abs(steps - self._usual) < self._usual / 2
        run = even[:-2] & even[1:-1] & even[2:]
        if len(self._times) < 4 or not run.any():
            return np.zeros(6)
        R = self._poses.rotation
        turns = rotation_vector(np.swapaxes(R[:-1], 1, 2) @ R[1:])
        steps = np.concatenate([np.diff(self._poses.position, axis=0), turns], axis=1)
        third = np.diff(steps, n=2, axis=0)[run]
        sizes: np.ndarray = robust_sigma(third, axis=0) / _THIRD
        return sizes

    def _rate_window(self) -> float:
        """Return the shortest window to one side, in seconds, in which noise is little speed."""
        window = _RATE_STEPS * self._usual
        longest = max(window, _LONGEST_RATE_S)
        R, p = self._poses.rotation, self._poses.position
        while window < longest:
            apart = int(np.ceil(2 * window / self._usual))
            if apart >= len(self._times):
                break
            moved = ((p[apart:] - p[:-apart])**2).mean(axis=0).sum()
            turned = (rotation_vector(np.swapaxes(R[:-apart], 1, 2) @ R[apart:])**2).mean(
                axis=0).sum()
            noise = 2 * self._noise**2
            if all(by_noise <= _NOISE_SHARE**2 * max(whole - by_noise, 0) for by_noise, whole in (
                    (noise[:3].sum(), moved), (noise[3:].sum(), turned))):
                break
            window *= 1.25
        return min(window, longest)

    def feigned_information(self, rows: np.ndarray, keep: np.ndarray,
                            covariances: np.ndarray, counted: np.ndarray) -> float:
        """
        Return the information on the offset of the clocks that noise of the poses feigns, 1/s².

        Rates tell the offset. Each absolute pose errs by itself: a rate over 2 w seconds errs by
        √2 of that over 2 w. Errors of odometry add up along the way. Over a step of s seconds
        they make rates differ by 1 / (w s) of what the misfits have, whatever their size; s counts
        as 2 w at least, where both rates are of the same errors in part.

        Parameters
        ----------
        rows : ndarray of int, shape (V,)
        keep : ndarray of bool, shape (m,)
            Which misfits count: of V - 1 steps of odometry, or of V poses.
        covariances, counted : ndarray, shape (m, 6, 6)
            Of the misfits, and those by which they count.

        """
        if not self.timed:
            return 0.0
        W = np.linalg.inv(counted[keep])
        if not self.odometry:
            return float(np.einsum('mii,i->', W, self._noise**2) / (2 * self._rate_step**2))
        steps = np.diff(self._instants[rows])[keep]
        share = np.einsum('mij,mji->m', W, covariances[keep]) / 6
        return (3 if self.flat else 6) * float(np.sum(
            share / (self._rate_step * np.maximum(steps, 2 * self._rate_step))))

    def way_errors(self, offset: float, rows: np.ndarray) -> np.ndarray:
        """
        Return how errors of odometry add up between successive images, for unit variances.

        The error of a small step is that of x, y, z, roll, pitch, yaw in the body. Each has a
        variance in proportion to the step's length (m) and turn (rad).

        Parameters
        ----------
        offset : float
        rows : ndarray of int, shape (V,)

        Returns
        -------
        ndarray, shape (6, V - 1, 6, 6)
            By the kind of error: covariances of the place of the later body and of its turn, in
            the axes of the earlier body.

        """
        here = self.at(offset, rows)
        R_back = np.swapaxes(here.rotation, 1, 2)
        if self.timed:
            when = self._instants[rows] - (offset if self._anchor is None else self._anchor)
            lower, upper = np.searchsorted(self._times, when[:-1]), np.searchsorted(
                self._times, when[1:])
        else:
            lower, upper = self._rows[rows][:-1] + 1, self._rows[rows][1:]
        result = np.zeros((6, len(rows) - 1, 6, 6))
        for k, (low, high) in enumerate(zip(lower, upper)):
            R = np.concatenate([here.rotation[k:k + 1], self._poses.rotation[low:high],
                                here.rotation[k + 1:k + 2]])
            p = np.concatenate([here.position[k:k + 1], self._poses.position[low:high],
                                here.position[k + 1:k + 2]])
            turned = rotation_vector(np.swapaxes(R[:-1], 1, 2) @ R[1:])
            way = np.linalg.norm(np.diff(p, axis=0), axis=1) + np.linalg.norm(turned, axis=1)
            # errors of a step arise about its middle
            axes = R_back[k] @ R[:-1] @ rotation_matrix(turned / 2)
            lever = (p[-1] - (p[:-1] + p[1:]) / 2) @ here.rotation[k]
            for axis in range(3):
                direction = axes[:, :, axis]
                moved = np.cross(direction, lever)
                placed = np.concatenate([direction, np.zeros_like(direction)], axis=1)
                swung = np.concatenate([moved, direction], axis=1)
                result[axis, k] = np.einsum('j,ja,jb->ab', way, placed, placed)
                result[3 + axis, k] = np.einsum('j,ja,jb->ab', way, swung, swung)
        return result
