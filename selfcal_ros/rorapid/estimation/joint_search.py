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
Search of edges for several objects in one image, round by round together.

A tracker that wants edges yields a `SearchTask` and is sent what was found. Who drives one tracker
answers at once (`alone`). Who drives several lets all of them come to such a place, and answers
all in one go (`together`).
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from selfcal_ros.rorapid.edges.control_points import (
    ControlView, placed_together, views_together)
from selfcal_ros.rorapid.edges.edge_choice import clutter_weight
from selfcal_ros.rorapid.estimation.edge_fit import EdgeFit, PosePrior, SearchRound
from selfcal_ros.rorapid.estimation.edge_search import EdgeSearch, scattered_together
from selfcal_ros.rorapid.estimation.joint_fit import fit_together, FitTask
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.texture.corner_fit import AgreeingCorners

#: Search range once the object is nearly there, pixels.
_NEAR_REACH_PX = 5


class SearchTask(NamedTuple):
    """
    What is to be searched.

    Attributes
    ----------
    image : ndarray, shape (H, W), uint8
    edges : EdgeSearch
    prior : PosePrior
    corners : AgreeingCorners
        And the state to begin from.
    led : bool
        That state is from the corners, and nearly right; else edges may be further away.

    """

    image: np.ndarray
    edges: EdgeSearch
    prior: PosePrior
    corners: AgreeingCorners
    led: bool


class SearchedEdges(NamedTuple):
    """
    What was found.

    Attributes
    ----------
    fit : EdgeFit
        Of the last round.
    corners : AgreeingCorners
        Those that agree with its beginning.
    view : ControlView
        At the state that was found.
    scatter : ndarray, shape (4,)
        Sums of `edges.edge_noise.CommonScatter`, to be learned if the state is accepted.

    """

    fit: EdgeFit
    corners: AgreeingCorners
    view: ControlView
    scatter: np.ndarray


_Result = TypeVar('_Result')
#: Comes to a result, and asks for searches on the way.
Searching: TypeAlias = Generator[SearchTask, SearchedEdges, _Result]
Measuring: TypeAlias = Searching[PoseMeasurement]


def search_together(image: np.ndarray, tasks: Sequence[SearchTask]) -> list[SearchedEdges]:
    """
    Search the edges about states, in some rounds.

    Parameters
    ----------
    image : ndarray, shape (H, W), uint8
    tasks : sequence of SearchTask

    Returns
    -------
    list of SearchedEdges

    """
    states = [task.corners.state for task in tasks]
    controls = [task.edges.control for task in tasks]
    corners = [task.corners for task in tasks]
    views = views_together(controls, states)
    weights = [clutter_weight(view) for view in views]
    reaches = [int(np.ceil(task.edges.options.search_least_px)) if task.led else
               task.edges.reach(state, view, task.prior.covariance)
               for task, state, view in zip(tasks, states, views)]
    fits: dict[int, EdgeFit] = {}
    for turn in range(max(task.edges.options.rounds for task in tasks)):
        now = [k for k, task in enumerate(tasks) if turn < task.edges.options.rounds]
        for k in now if turn else ():
            matches = corners[k].matches
            reaches[k] = min(reaches[k], _NEAR_REACH_PX)
            if not tasks[k].led and matches is not None:
                corners[k] = replace(corners[k], agree=tasks[k].edges.corners.near(
                    fits[k].state, matches))
        found = fit_together(image, [FitTask(tasks[k].edges, tasks[k].prior, SearchRound(
            states[k], views[k], reaches[k], tasks[k].edges.limits(
                reaches[k], turn == 0 and not tasks[k].led,
                turn + 1 == tasks[k].edges.options.rounds), weights[k]), corners[k]) for k in now])
        fits.update(zip(now, found))
        after = placed_together([controls[k] for k in now], [views[k].shown for k in now],
                                [views[k].searched for k in now], [fit.state for fit in found])
        for k, fit, view in zip(now, found, after):
            states[k], views[k] = fit.state, view
    scatter: dict[int, np.ndarray] = {}
    for size in {len(fit.solved) for fit in fits.values()}:
        of_size = [k for k, fit in fits.items() if len(fit.solved) == size]
        scatter.update(zip(of_size, scattered_together([fits[k] for k in of_size])))
    return [SearchedEdges(fits[k], corners[k], views[k], scatter[k]) for k in range(len(tasks))]


def alone(searching: Searching[_Result]) -> _Result:
    """Answer one that asks for searches, to its result."""
    return together([searching])[0]


def together(searching: Sequence[Searching[_Result]]) -> list[_Result]:
    """Answer several that ask for searches, to their results; those in one image at once."""
    results: dict[int, _Result] = {}
    answers: dict[int, SearchedEdges | Exception | None] = dict.fromkeys(range(len(searching)))
    while answers:
        asked: dict[int, SearchTask] = {}
        for k, answer in answers.items():
            one = searching[k]
            try:
                asked[k] = (one.throw(answer) if isinstance(answer, Exception) else
                            next(one) if answer is None else one.send(answer))
            except StopIteration as end:
                results[k] = end.value
        answers = {}
        for image in {id(task.image): task.image for task in asked.values()}.values():
            here = [k for k, task in asked.items() if task.image is image]
            answers.update(zip(here, _answers(image, [asked[k] for k in here])))
    return [results[k] for k in range(len(searching))]


def _answers(image: np.ndarray, tasks: Sequence[SearchTask],
             ) -> Sequence[SearchedEdges | Exception]:
    """Search together; a search that fails takes no other along."""
    try:
        return search_together(image, tasks)
    except Exception as error:  # it is raised where the search was asked for
        if len(tasks) == 1:
            return [error]
        return [answer for task in tasks for answer in _answers(image, [task])]
