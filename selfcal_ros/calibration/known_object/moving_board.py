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
Did the object move while each image was read? A rolling shutter bends what moves.

A board in a hand is turned by tenths of a degree from the first row to the last. So is one before
an arm that does not stop. The lens and a bend of the board take up what they can of that. It is
asked of cameras with a rolling shutter alone: what a lens or a print lacks looks much like it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.clock import was_turned_upright
from selfcal_ros.calibration.bundle.object_model import KnownPoints
from selfcal_ros.calibration.bundle.object_rows import ObjectRows
from selfcal_ros.calibration.bundle.own_rows import ROW_NAMES
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.calibration.bundle.tolerances import TO_ESTIMATE
from selfcal_ros.calibration.known_object.object_views import ObjectViews
from selfcal_ros.calibration.reconstruction import RowMotion
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.levenberg_marquardt import restricted
from selfcal_ros.geometry.no_estimate import NoEstimate

#: Fewer views tell too little of what is usual.
LEAST_VIEWS = 4
#: How large motions are supposed to be at first, and at most: more is no motion of rows.
FIRST_SIZE, LARGEST_SIZE = 0.005, 0.1
#: Rounds in which the size settles, and the change of its log that ends them.
ROUNDS, SETTLED = 5, 0.1
#: Log of the probability over that of an object that holds still, at least: odds of 50 to 1.
SURE = 4.0

#: An optimum: its observations, the adjustment, and where it is least.
Optimum: TypeAlias = tuple[ObjectViews, Bundle[ObjectState], ObjectState]


def moving_fit(views: ObjectViews, still: Optimum, size: tuple[int, int],
               fitted: Callable[[ObjectViews, ObjectState], Optimum | NoEstimate],
               ) -> Optimum | None:
    """
    Let the object move while each image is read, if that explains clearly more.

    Parameters
    ----------
    views : ObjectViews
        All that is to be explained.
    still : Optimum
        With all lines read at once.
    size : (int, int)
        Width and height of the image.
    fitted : callable
        (views, state) to the optimum from there.

    Returns
    -------
    Optimum or None
        None where nothing moves, as far as the images tell.

    """
    if len(views.frames) < LEAST_VIEWS:
        return None
    # of a photograph that was turned upright the lines are columns; of one that was not, rows
    found = [_settled(replace(views, rows=ObjectRows(FIRST_SIZE, size[axis], axis)), still[2],
                      fitted) for axis in ((0, 1) if was_turned_upright(size) else (1,))]
    best = max((one for one in found if one is not None), default=None,
               key=lambda one: -one[1].sigma_px)
    return best if best is not None and _gain(best, still) > SURE else None


def _gain(moving: Optimum, still: Optimum) -> float:
    """Log of the probability of motions over that of none, by Laplace's method."""
    views, bundle, state = moving
    rows, held = views.rows, np.isin(still[0].frames, views.frames)
    assert rows is not None
    without = replace(views, rows=None).bundle(bundle.priors, bundle.sigma_px)
    rest = without.optimise(still[2].of_views(held), tolerance=TO_ESTIMATE)
    # what is supposed of motions about a mean that is as uncertain
    supposed = np.linalg.slogdet(rows.effects.information(len(views.frames)))[1]
    return (without.cost(rest) - bundle.cost(state) + 0.5 * len(ROW_NAMES) * float(supposed)
            - 0.5 * (_log_information(bundle, state) - _log_information(without, rest)))


def _log_information(bundle: Bundle[ObjectState], state: ObjectState) -> float:
    """Log of the determinant of the normal matrix, the poses eliminated."""
    matrix = np.asarray(bundle.normal_equations(state).matrix)
    return float(np.linalg.slogdet(restricted(matrix, bundle.unknowns.selection))[1])


def _settled(views: ObjectViews, state: ObjectState,
             fitted: Callable[[ObjectViews, ObjectState], Optimum | NoEstimate],
             ) -> Optimum | None:
    """Fit with the most probable size of the motion; None where there is none."""
    found = None
    for _ in range(ROUNDS):
        one = fitted(views, state)
        if isinstance(one, NoEstimate):
            return None
        used, bundle, state = found = one
        if len(used.frames) < len(views.frames):
            # a view that is lost would have no motion to begin with
            views = views.select(np.isin(views.frames, used.frames)[views.view])
        rows, motion = views.rows, state.row_motion
        assert rows is not None and motion is not None
        sigma = rows.effects.size_after(motion, bundle.covariance(state), bundle.unknowns)
        if not sigma < LARGEST_SIZE:
            return None
        if abs(np.log(max(sigma, 1e-12) / rows.sigma)) < SETTLED:
            break
        views = replace(views, rows=replace(rows, sigma=max(sigma, 1e-6)))
    return found


def row_motion_of(bundle: Bundle[ObjectState], state: ObjectState, extent: float,
                  ) -> RowMotion | None:
    """
    Tell how the camera moved before the object while each image was read.

    Parameters
    ----------
    bundle : Bundle
    state : ObjectState
    extent : float
        Length in the unit of the object that is one in the adjustment.

    Returns
    -------
    RowMotion or None
        In the unit of the object; None where nothing moved.

    """
    rows, motion = _rows_of(bundle), state.row_motion
    if rows is None or motion is None:
        return None
    there = state.path.cam_from_object[:, :, 3]
    turn = motion[:, :3]
    moved = motion[:, 3:] * np.linalg.norm(there, axis=1, keepdims=True)
    # the object turns about its own middle, and the camera about its centre
    by_powers = np.zeros((len(motion), 3, 6))
    by_powers[:, 0] = np.column_stack([turn, extent * (np.cross(turn, there) - moved)])
    return RowMotion(by_powers, rows.lines, rows.axis)


def motion_findings(bundle: Bundle[ObjectState], state: ObjectState) -> tuple[Finding, ...]:
    """Tell how far points moved while their images were read."""
    rows = _rows_of(bundle)
    if rows is None:
        return ()
    still = bundle.model.predict(replace(state, row_motion=None), bundle.blocks, bundle.xy)
    moved = bundle.predict(state).residual - still.residual
    return (Finding('object_moves_in_rows', shift_px=float(np.sqrt(np.mean(
        np.sum(moved**2, axis=1)))), lines='rows' if rows.axis else 'columns'),)


def _rows_of(bundle: Bundle[ObjectState]) -> ObjectRows | None:
    model = bundle.model
    return model.rows if isinstance(model, KnownPoints) else None
