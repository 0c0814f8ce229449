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
The shutter block: lines that are read one after the other, while the camera moves.

The unknown is the line delay, in units in which the whole image is read in so many intervals
between frames; it is negative where the lowest row is read first. An observation at row v is
taken at τ = line_delay · (v - middle) / rows after the instant of its view. Meanwhile the camera
has moved on along its path. How it moves near the instant of a view comes from the views around
it, or from the motion of the images. Within an adjustment this motion is held constant, and it
is renewed after it. So the displacement of an observation is linear in the line delay.
Of an image that was turned upright after it was read, the lines are its columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.clock import Clock, difference_weights, STENCIL
from selfcal_ros.calibration.bundle.neighbour_motion import motion_from_neighbours
from selfcal_ros.calibration.bundle.own_rows import OwnRows
from selfcal_ros.calibration.bundle.path import AxisPath, crossed
from selfcal_ros.calibration.bundle.priors import Prior
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.unknowns import PriorTerms, Unknowns
from selfcal_ros.calibration.bundle.zoom import projection
from selfcal_ros.geometry.rotation import left_jacobian, rotation_matrix, rotation_vector
from selfcal_ros.geometry.schur_complement import PointBlocks

#: Name of the unknown.
LINE_DELAY = 'line_delay'
#: Displacements of more than this share of the image are those of points that are not where the
#: state says; they are left as they are.
LARGEST_SHIFT = 0.25
#: The same of displacements in an interval between frames.
FASTEST = 2.0
#: A point projects to the row it is read in, unless it projects farther from what is measured than
#: this share of the image.
ASTRAY = 0.02
#: Views that are far apart in time tell no more than how fast the camera moves on the whole, by
#: one before and one after.
FAR_APART = 3


@dataclass(frozen=True)
class RowShifts:
    """
    How far observations have moved since the instant of their view.

    Attributes
    ----------
    line_delay : float
        That the displacements belong to.
    shift : ndarray, shape (N, 2)
        Displacement in pixels.
    slope : ndarray, shape (N, 2)
        Its derivative by the line delay.
    known : Prior, optional
        What is stated of the line delay.
    own : OwnRows, optional
        What each view's own motion does, where the views around it do not tell.

    """

    line_delay: float
    shift: np.ndarray
    slope: np.ndarray
    known: Prior | None = None
    own: OwnRows | None = None

    @classmethod
    def none(cls, count: int, known: Prior | None = None) -> RowShifts:
        """Return no displacement of so many observations, until the path is known."""
        return cls(0.0, np.zeros((count, 2)), np.zeros((count, 2)), known)

    def of_others(self, count: int, views: int) -> RowShifts:
        """Return no displacement of so many other observations that are read alike."""
        return replace(self.none(count, self.known),
                       own=self.own and self.own.of_others(count, views))

    @property
    def is_held(self) -> bool:
        """Tell whether the line delay is stated exactly."""
        return self.known is not None and self.known.sigma == 0

    @property
    def is_soft(self) -> bool:
        """Tell whether the line delay is stated with a sigma."""
        return self.known is not None and self.known.is_soft

    def select(self, rows: np.ndarray) -> RowShifts:
        """Return those of some observations."""
        return replace(self, shift=self.shift[rows], slope=self.slope[rows],
                       own=self.own and self.own.select(rows))

    def at(self, state: SceneState, view: np.ndarray) -> np.ndarray:
        """Return the displacements (N, 2) of observations in views (N,) for a state nearby."""
        displaced: np.ndarray = self.shift + (state.line_delay - self.line_delay) * self.slope
        if self.own is not None:
            displaced += self.own.beyond(state.row_motion, view)
        return displaced


def with_line_delay(unknowns: Unknowns, shifts: RowShifts) -> Unknowns:
    """Add the unknown of the block to those of lens and path."""
    unknowns = unknowns.extended(shared=(LINE_DELAY,))
    unknowns.free[unknowns.places((LINE_DELAY,))] = not shifts.is_held
    return unknowns if shifts.own is None else shifts.own.effects.extend(unknowns)


def with_stated_delay(terms: PriorTerms, line_delay: float, shifts: RowShifts,
                      unknowns: Unknowns) -> PriorTerms:
    """Add a line delay that is stated to cost, gradient (n,) and diagonal (n,) of others."""
    known = shifts.known
    if known is None or not known.is_soft:
        return terms
    cost, gradient, diagonal = terms
    place, deviation = unknowns.places((LINE_DELAY,)), (line_delay - known.value) / known.sigma
    gradient[place] += deviation / known.sigma
    diagonal[place] += 1 / known.sigma**2
    return cost + 0.5 * deviation**2, gradient, diagonal


def local_motion(path: AxisPath, times: np.ndarray, most: int = STENCIL,
                 ) -> np.ndarray:
    """
    Tell how the camera moves at the instant of each view, from the views around it.

    Parameters
    ----------
    path : AxisPath
    times : ndarray, shape (V,)
    most : int
        Views that are used for each.

    Returns
    -------
    derivatives : ndarray, shape (3, V, 6)
        Velocity, acceleration and jerk of rotation vector (3) and centre (3) in the frame of the
        view, before the mount.

    """
    near, weights = difference_weights(times, most)
    R, C = path.rotations(), path.centres()
    turned = rotation_vector(R[near] @ np.swapaxes(R, 1, 2)[:, None])
    apart = np.einsum('vij,vsj->vsi', R, C[near] - C[:, None])
    away = np.concatenate([turned, apart], axis=2)
    derivatives: np.ndarray = np.einsum('dvs,vsk->dvk', weights, away)
    return derivatives


def usual_motion(path: AxisPath, times: np.ndarray) -> np.ndarray:
    """Return the usual turn and move in an interval between frames, along each axis, (6,)."""
    velocity = local_motion(path, times, 3)[0]
    size = np.sqrt([np.mean(velocity[:, :3]**2), np.mean(velocity[:, 3:]**2)])
    return np.repeat(size, 3)


def row_shifts(state: SceneState, blocks: PointBlocks, xy: np.ndarray, clock: Clock,
               neighbours: np.ndarray | None = None, most: int = STENCIL,
               own: OwnRows | None = None, before: np.ndarray | None = None) -> RowShifts:
    """
    Displace every observation by the motion of the camera until its row is read.

    The row is the one that the point projects to. A measured row would carry its noise into the
    derivatives, which the same noise in the residuals then seems to bear out: where little is
    known of how views move on the whole, that would be found.

    Parameters
    ----------
    state : SceneState
    blocks : PointBlocks
        Point and view of every observation.
    xy : ndarray, shape (N, 2)
        Observed pixels; their rows tell when.
    clock : Clock
    neighbours : ndarray, shape (N, 2, 3), optional
        Of a video; see `motion_from_neighbours`.
    most : int
        Views that tell how the camera moves at one of them.
    own : OwnRows, optional
        What is supposed where each view has a motion of its own, too; it says how many views
        tell.
    before : ndarray, shape (N, 2), optional
        Displacements as they were known before, pixels. None: the measured rows count.

    Returns
    -------
    RowShifts

    """
    motion = _motion_of_views(state, blocks, xy, clock, neighbours, most, own)
    view, path = blocks.view, state.path
    placed, weight = state.placed_ahead(blocks, xy)
    still = projection(state.lens, placed @ path.mount.T, state.zoom, view)
    delay = clock.delays(xy if before is None else read_at(still.uv + before, xy, clock.lines))
    tau = (state.line_delay * delay)[:, None]
    velocity, acceleration, jerk = motion[:, view]
    rate = velocity + tau * (acceleration + 0.5 * tau * jerk)
    moved = tau * (velocity + tau * (0.5 * acceleration + tau / 6 * jerk))
    if own is not None:
        values, usual = _values_of_own(state, clock), usual_motion(path, clock.times)
        moved += delay[:, None] * (values * usual)[view]
    turn, there = moved[:, :3], placed - weight * moved[:, 3:]
    R = rotation_matrix(turn)
    there = np.einsum('nij,nj->ni', R, there)
    later = projection(state.lens, there @ path.mount.T, state.zoom, view)
    spin = np.einsum('nij,nj->ni', left_jacobian(turn), rate[:, :3])
    speed = np.cross(spin, there) - weight * np.einsum('nij,nj->ni', R, rate[:, 3:])
    by_there = later.by_points() @ path.mount
    slope = delay[:, None] * np.einsum('nij,nj->ni', by_there, speed)
    shift = later.uv - still.uv
    with np.errstate(invalid='ignore'):
        lost = ~(np.abs(shift).max(axis=1) < LARGEST_SHIFT * clock.lines)
        too_fast = ~(np.abs(slope).max(axis=1) < FASTEST * clock.lines)
    # where a view moves by itself, what its neighbours say wildly of it says nothing of the shift
    lost |= too_fast & (own is None)
    shift[lost], slope[lost | too_fast] = 0, 0
    if own is not None:
        by_turn = crossed(there, by_there) @ left_jacobian(turn)
        by_move = -weight[:, :, None] * (by_there @ R)
        of_own = delay[:, None, None] * usual * np.concatenate([by_turn, by_move], axis=2)
        of_own[lost] = 0
        own = replace(own, motion=values, slope=of_own)
    return RowShifts(state.line_delay, shift, slope, clock.known, own)


def _motion_of_views(state: SceneState, blocks: PointBlocks, xy: np.ndarray, clock: Clock,
                     neighbours: np.ndarray | None, most: int, own: OwnRows | None) -> np.ndarray:
    """Velocity, acceleration and jerk (3, V, 6), as `local_motion` and neighbours tell."""
    motion = local_motion(state.path, clock.times, most if own is None else own.near)
    if own is not None and own.near == FAR_APART:
        motion[1:] = 0
    return motion if neighbours is None else motion_from_neighbours(
        state, blocks, xy, neighbours, clock, motion)


def _values_of_own(state: SceneState, clock: Clock) -> np.ndarray:
    """Return what each view moves by itself (V, 6), in units of what is usual."""
    return np.zeros((len(clock.times), 6)) if state.row_motion is None else state.row_motion


def motion_by_powers(state: SceneState, blocks: PointBlocks, xy: np.ndarray, clock: Clock,
                     neighbours: np.ndarray | None = None, own: OwnRows | None = None,
                     ) -> np.ndarray:
    """
    Tell how the camera moved while each view was read.

    Parameters are those of `row_shifts`.

    Returns
    -------
    ndarray, shape (V, 3, 6)
        Turn and move before the mount, by the first three powers of `Clock.delays`.

    """
    motion = _motion_of_views(state, blocks, xy, clock, neighbours, STENCIL, own)
    powers = np.array([1.0, 1 / 2, 1 / 6]) * state.line_delay**np.arange(1, 4)
    by_powers: np.ndarray = np.moveaxis(powers[:, None, None] * motion, 0, 1)
    if own is not None:
        by_powers[:, 0] += _values_of_own(state, clock) * usual_motion(state.path, clock.times)
    return by_powers


def read_at(projected: np.ndarray, xy: np.ndarray, lines: int) -> np.ndarray:
    """Return where points project (N, 2), or the measured pixels where that is far from them."""
    with np.errstate(invalid='ignore'):
        near = np.abs(projected - xy).max(axis=1) < ASTRAY * lines
    return np.where(near[:, None], projected, xy)


def pace_doubt(state: SceneState, blocks: PointBlocks, xy: np.ndarray, clock: Clock) -> float:
    """
    Tell how far the displacements differ if fewer views tell how the camera moves.

    Returns
    -------
    float
        Share of their size, root mean square; near one where the views are too far apart in time
        to tell anything.

    """
    every, fewer = (row_shifts(state, blocks, xy, clock, None, most).slope
                    for most in (STENCIL, STENCIL - 2))
    size = float(np.sqrt(np.mean(every**2)))
    return float(np.sqrt(np.mean((every - fewer)**2))) / max(size, 1e-300)
