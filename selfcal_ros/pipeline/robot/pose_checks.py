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
"""Checks poses of a body as they were written, and converts them to `BodyPoses`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.values.angular_rates import AngularRates
from selfcal_ros.values.body_poses import BodyPoses

#: Faster than this is no robot (250 km/h), but a millimetre called a metre.
FASTEST_M_S = 70.0
#: No fast robot tells poses so soon after each other; from 2 Hz on, microseconds taken for
#: nanoseconds do.
SHORTEST_NS = 500_001
#: Farther than this from pose to pose, without a clock, is none either.
LONGEST_STEP_M = 20.0
#: A unit quaternion whose digits were cut off errs by less.
UNIT_LENGTH = 5e-3
#: Metres in the units that positions may be written in.
SMALLEST_UNIT_M, LARGEST_UNIT_M = 1e-6, 1e6


@dataclass(frozen=True)
class PoseReading:
    """
    How poses are to be taken.

    Parameters
    ----------
    kind : {'absolute', 'odometry'}, optional
        By default what the source is.
    sigma_position_m, sigma_rotation_rad : float, optional
        See `BodyPoses`.
    unit_m : float, optional
        Metres in a unit of the positions; given, it is not doubted.
    body_frame : str, optional
        What to call the body.

    Raises
    ------
    ArgumentError
        If the unit is none that positions are written in.

    """

    kind: str | None = None
    sigma_position_m: float | None = None
    sigma_rotation_rad: float | None = None
    unit_m: float | None = None
    body_frame: str | None = None

    def __post_init__(self) -> None:
        """Check the unit."""
        if self.unit_m is not None and not SMALLEST_UNIT_M <= self.unit_m <= LARGEST_UNIT_M:
            raise ArgumentError(f'--robot-unit is the metres in a unit, {SMALLEST_UNIT_M:g} to '
                                f'{LARGEST_UNIT_M:g}, such as 0.001 for millimetres, not '
                                f'{self.unit_m:g}.')

    def named(self, rates: AngularRates) -> AngularRates:
        """
        Return the rates of a gyro under the stated name of its frame.

        Raises
        ------
        ArgumentError
            If something is stated that only poses have.

        """
        stated = [option for option, value in (
            ('--robot-kind', self.kind), ('--robot-sigma', self.sigma_position_m),
            ('--robot-unit', self.unit_m)) if value is not None]
        if stated:
            raise ArgumentError(f'{stated[0]} is for poses; a gyro needs none, so leave it out.')
        return replace(rates, frame=self.body_frame) if self.body_frame else rates

    def applied(self, poses: BodyPoses, source: str) -> BodyPoses:
        """
        Take poses as stated.

        Raises
        ------
        InputError
            If the positions are hardly metres.

        """
        if self.unit_m is None:
            check_metres(poses, source)
        return replace(poses, position=poses.position * (self.unit_m or 1.0),
                       kind=self.kind or poses.kind,
                       body_frame=self.body_frame or poses.body_frame,
                       sigma_position_m=self.sigma_position_m,
                       sigma_rotation_rad=self.sigma_rotation_rad)


def check_metres(poses: BodyPoses, source: str) -> None:
    """
    Refuse positions that are hardly in metres; the sentence suggests a factor.

    Raises
    ------
    InputError
        If a robot that moves like this would be too fast, or its steps too long; stamps in
        another unit than nanoseconds are named as such.

    """
    steps = np.linalg.norm(np.diff(poses.position, axis=0), axis=1)
    moved = steps > 1e-9
    if moved.sum() < 2:
        return
    if poses.stamps_ns is None:
        typical, limit = float(np.median(steps[moved])), LONGEST_STEP_M
        what = f'{typical:.3g} m from pose to pose'
    else:
        seconds = np.diff(poses.stamps_ns)[moved] / 1e9
        typical, limit = float(np.median(steps[moved] / seconds)), FASTEST_M_S
        what = f'{typical:.3g} m/s'
    if typical > limit and poses.stamps_ns is not None:
        apart_ns = float(np.median(np.diff(poses.stamps_ns)))
        if apart_ns < SHORTEST_NS:
            raise InputError(f'The stamps of {source} are hardly nanoseconds: its poses would be '
                             f'{apart_ns:.3g} ns apart; give stamp_ns in nanoseconds, or stamp_s '
                             'in seconds.')
    if typical > limit:
        # who writes no metres writes millimetres, however short the steps
        raise InputError(f'The positions of {source} look like millimetres: as metres the robot '
                         f'would move {what}; state --robot-unit 0.001 (centimetres: 0.01), or '
                         '1 if they are metres.')


def in_order(when: np.ndarray, what: str, source: str) -> None:
    """
    Refuse instants or frames that do not ascend.

    Raises
    ------
    InputError
        If one occurs twice, or stands before an earlier one.

    """
    steps = np.diff(when)
    if len(steps) and not steps.any():
        raise InputError(f'All poses of {source} have {what} {when[0]}; write when each of them '
                         'was.')
    if (steps == 0).any():
        twice = when[int(np.argmax(steps == 0))]
        raise InputError(f'{source} has two poses of {what} {twice}; keep one of them.')
    if (steps < 0).any():
        at = int(np.argmax(steps < 0))
        raise InputError(f'{source} goes back in {what} from {when[at]} to {when[at + 1]}; sort '
                         'it, or cut it there.')
