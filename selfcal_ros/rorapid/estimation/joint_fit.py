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
One round of edge search and solution, of several objects or starts at once.

An object has a hundred control points, and NumPy takes as long for three hundred. So their arrays
are put one after the other. Only what belongs to one object is done for each: its own matrix of
six rows, its median, what it remembers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TYPE_CHECKING

import numpy as np

from selfcal_ros.geometry.robust_loss import tukey_weight
from selfcal_ros.geometry.robust_scale import fast_robust_sigma
from selfcal_ros.geometry.small_system import solved
from selfcal_ros.rorapid.edges.control_points import joined
from selfcal_ros.rorapid.edges.edge_choice import contrast_penalty
from selfcal_ros.rorapid.edges.edge_noise import end_factor
from selfcal_ros.rorapid.edges.edgels import BOW_OF_LANES, find_edgels, MARGIN_PX, sample_normals
from selfcal_ros.rorapid.edges.limb import limb_shift
from selfcal_ros.rorapid.estimation.edge_fit import (
    EdgeCandidates, EdgeChoice, EdgeFit, NOWHERE_PX, PosePrior, SearchRound)
from selfcal_ros.rorapid.projection.camera_models import ProjectedPoints
from selfcal_ros.rorapid.projection.free_directions import apart_from
from selfcal_ros.rorapid.texture.corner_fit import AgreeingCorners

if TYPE_CHECKING:
    from selfcal_ros.rorapid.estimation.edge_search import EdgeSearch

#: Noise of the edges in one image against what was learned, at the least.
_MIN_NOISE = 0.7
#: Tukey's limit in sigmas.
_TUKEY = 4.5
#: Standard deviation of an edge where a round part turns away before another one, over that of a
#: line: both of its sides are shaded, which draws all of them one way.
_BEFORE_PART = 3.5


class FitTask(NamedTuple):
    """Attributes of one fit: what is remembered and known, where it is searched, and corners."""

    edges: EdgeSearch
    prior: PosePrior
    around: SearchRound
    corners: AgreeingCorners | None = None


def fit_together(image: np.ndarray, tasks: Sequence[FitTask]) -> list[EdgeFit]:
    """
    Search edges and solve for states, corners included.

    Parameters
    ----------
    image : ndarray, shape (H, W), uint8
    tasks : sequence of FitTask

    Returns
    -------
    list of EdgeFit

    """
    groups: list[list[int]] = []
    for k, task in enumerate(tasks):
        for group in groups:
            if task.edges.is_alike(tasks[group[0]].edges):
                group.append(k)
                break
        else:
            groups.append([k])
    if not tasks:
        return []
    if len(groups) == 1:
        return _Fits(image, tasks).solve()
    fits: dict[int, EdgeFit] = {}
    for group in groups:
        fits.update(zip(group, _Fits(image, [tasks[k] for k in group]).solve()))
    return [fits[k] for k in range(len(tasks))]


class _Fits:
    """Fits of one camera and one number of unknowns; arrays have one task after the other."""

    def __init__(self, image: np.ndarray, tasks: Sequence[FitTask]) -> None:
        """Find the control points that are searched, and edges near them."""
        self._tasks = tasks
        views = [task.around.view for task in tasks]
        #: Of each task: which control points of its view, and its part of the arrays.
        self._at = [np.flatnonzero(view.searched) for view in views]
        self._counts = [len(at) for at in self._at]
        ends = np.cumsum(self._counts).tolist()
        self._own = [slice(end - count, end) for end, count in zip(ends, self._counts)]
        if len(tasks) == 1:
            self._where = self._at[0]
        else:
            begins = np.cumsum([0] + [len(view.ids) for view in views[:-1]])
            self._where = np.concatenate([at + first for at, first in zip(self._at, begins)])
        self._pixels = self._of_views([view.projected.pixels for view in views])
        self._normal = self._of_views([view.normal for view in views])
        self._end_factor = end_factor(self._of_views([view.end_px for view in views]))
        self._found = self._candidates(image)
        self._rows = self._jacobian()

    def _of_views(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Return what all control points of the views have, of those that are searched."""
        searched: np.ndarray = joined(parts)[self._where]
        return searched

    def _each(self, values: Sequence[float]) -> np.ndarray | float:
        """Spread one value a task over its control points; one number where all are the same."""
        first = values[0]
        if all(value == first for value in values):
            return first
        return np.repeat(values, self._counts)

    def _jacobian(self) -> np.ndarray:
        """Motion of the control points along their normals per unit of correction, (C, m)."""
        tasks = self._tasks
        first = tasks[0]
        seen = [task.around.view.projected for task in tasks]
        control = first.edges.control
        rows = control.projection.rows(first.around.state, ProjectedPoints(
            self._pixels, self._of_views([one.xy for one in seen]),
            self._of_views([one.turned for one in seen]),
            self._of_views([one.inverse_depth for one in seen])), self._normal)
        out = np.empty((len(rows), first.edges.basis.shape[1]))
        for task, own in zip(tasks, self._own):
            mine, control = rows[own], task.edges.control
            if len(control.free_turns):
                mine = mine @ apart_from(control.free(task.around.state))
            np.matmul(mine, task.edges.basis, out=out[own])
        return out

    def _candidates(self, image: np.ndarray) -> EdgeCandidates:
        """Search the edges along the normals of all control points that are to be searched."""
        tasks = self._tasks
        views, options = [task.around.view for task in tasks], tasks[0].edges.options
        weight = self._of_views([task.around.weights for task in tasks])
        if not len(self._where):
            none = np.zeros((0, options.candidates))
            return EdgeCandidates(none, none, none, none, weight, np.zeros((0, 1)))
        wanted = self._of_views([task.edges.contrast[view.ids]
                                 for task, view in zip(tasks, views)])
        reach = [task.around.reach for task in tasks]
        most = max(reach)
        profiles = sample_normals(image, self._pixels, self._normal, most)
        edgels = find_edgels(profiles, options.candidates, options.least_contrast, wanted,
                             None if min(reach) == most else np.repeat(reach, self._counts))
        offset, contrast = edgels.offset, edgels.contrast
        # the outer lanes meet a curve where it has bent away
        offset = offset - BOW_OF_LANES * self._of_views(
            [view.curvature for view in views])[:, None]
        worse = np.ones(offset.shape)
        penalty = contrast_penalty(contrast, wanted)
        for task, view, at, own in zip(tasks, views, self._at, self._own):
            if not task.edges.is_round:
                continue
            beyond = most - task.around.reach
            mine = profiles[own, beyond:profiles.shape[1] - beyond]
            inside, primitive = view.inside[at], view.primitive[at]
            limb = np.flatnonzero(primitive >= view.limb)
            if len(limb):
                shift, worse[own.start + limb] = limb_shift(
                    mine[limb], edgels.offset[own][limb], contrast[own][limb], inside[limb])
                offset[own.start + limb] -= shift
            before = np.flatnonzero((primitive >= view.outline) & (primitive < view.limb))
            worse[own.start + before] = _BEFORE_PART
            if task.edges.greys is not None:
                penalty[own] += task.edges.greys.penalty(mine, self._pixels[own], inside,
                                                         offset[own])
        offset = np.where(np.isfinite(offset), offset, NOWHERE_PX)
        return EdgeCandidates(offset, contrast, penalty, worse, weight, profiles)

    def solve(self) -> list[EdgeFit]:
        """Choose edges and solve, by the steps of each task; all end together."""
        tasks, rows, m = self._tasks, self._rows, self._rows.shape[1]
        steps = max(len(task.around.limits) for task in tasks)
        fixed, pull = np.zeros((len(tasks), m, m)), np.zeros((len(tasks), m))
        backs = np.empty((len(tasks), m))
        corner = np.zeros((len(tasks), m, m))
        for k, task in enumerate(tasks):
            edges, corners, state = task.edges, task.corners, task.around.state
            if corners is not None and corners.matches is not None and corners.agree.any():
                corner[k], pull[k] = edges.corners.terms(state, corners.matches, corners.agree,
                                                         edges.share)
            backs[k] = edges.basis.T @ edges.control.projection.difference(
                state, task.prior.state)
            fixed[k] = corner[k] + task.prior.information
            pull[k] -= task.prior.information @ backs[k]
        q, moved = np.zeros((len(tasks), m)), np.empty(len(rows))
        H = np.empty((len(tasks), m, m))
        for step in range(steps):
            late = step - steps
            begun = [len(task.around.limits) + late >= 0 for task in tasks]
            for own, one in zip(self._own, q):
                np.matmul(rows[own], one, out=moved[own])
            choice = self._chosen(moved, [
                task.around.limits[max(late, -len(task.around.limits))] for task in tasks],
                begun, step + 1 == steps)
            weighed = rows * choice.weight[:, None]
            offset = np.where(choice.near, choice.offset, 0.0)
            for k, own in enumerate(self._own):
                if begun[k]:
                    across = weighed[own].T
                    np.matmul(across, rows[own], out=H[k])
                    q[k] = solved(H[k] + fixed[k], across @ offset[own] + pull[k])
        for own, one in zip(self._own, q):
            np.matmul(rows[own], one, out=moved[own])
        residual = np.where(choice.near, choice.offset - moved, np.nan)
        square = choice.off * choice.off
        fits = []
        for k, (task, at, own) in enumerate(zip(tasks, self._at, self._own)):
            edges, information = task.edges, task.prior.information
            after = edges.control.projection.moved(task.around.state, edges.basis @ q[k])
            mine, of_edges = rows[own], H[k]
            if len(edges.control.free_turns):
                # the last step has turned what the shape leaves open
                keep = apart_from(edges.basis.T @ edges.control.free(after))
                of_edges, mine = keep @ of_edges @ keep, mine @ keep
            measured = of_edges + corner[k]
            beyond = (self._found.profiles.shape[1] - 1) // 2 - task.around.reach - MARGIN_PX
            fits.append(EdgeFit(
                state=after, edges=of_edges, measured=measured, solved=measured + information,
                pull=information @ (backs[k] + q[k]), view=task.around.view, at=at,
                clutter_weight=self._found.weight[own], rows=mine, residual=residual[own],
                contrast=choice.contrast[own], weight=choice.weight[own], off=square[own],
                profiles=self._found.profiles[
                    own, beyond:self._found.profiles.shape[1] - beyond]))
        return fits

    def _chosen(self, along: np.ndarray, limits: Sequence[float], begun: Sequence[bool],
                last: bool) -> EdgeChoice:
        """
        Choose one edge for each control point, and weigh it.

        Parameters
        ----------
        along : ndarray, shape (C,)
            Where the corrections so far put each control point on its normal, pixels.
        limits : sequence of float
            Of Tukey's biweight, pixels, one a task. At the last limit of a task its correction is
            nearly right: the noise is known, and tells the limit.
        begun : sequence of bool
            Whether the task has begun.
        last : bool
            It is the last step.

        Returns
        -------
        EdgeChoice

        """
        found, limit = self._found, self._each(limits)
        share = np.minimum(np.asarray(limit) / 8, 1.0)
        distances = np.abs(found.offset - along[:, None])
        distances += (share if share.ndim == 0 else share[:, None]) * found.penalty
        line = np.arange(len(along))
        best = distances.argmin(axis=1) if len(line) else line
        place = best + line * distances.shape[1]
        distance, offset = distances.take(place), found.offset.take(place)
        contrast = found.contrast.take(place)
        near = distance < limit
        narrow = [k for k, (task, one, on) in enumerate(zip(self._tasks, limits, begun))
                  if on and one == task.around.limits[-1]]
        sigma = self._each([max(one / 3, 0.5) for one in limits])
        most = limit
        if narrow:
            noise = [task.edges.noise.variance for task in self._tasks]
            residual = offset - along
            own = np.sqrt(self._end_factor * (
                self._each([one[0] for one in noise]) + self._each([one[1] for one in noise])
                / np.maximum(contrast * contrast, 1.0)))
            scaled = np.abs(residual / own)
            close = near & (np.abs(residual) < 3)
            if len(narrow) < len(limits):
                sigma, most = (np.array(np.broadcast_to(one, len(line)), float)
                               for one in (sigma, most))
            else:
                sigma, most = np.empty(len(line)), np.empty(len(line))
            for k in narrow:
                mine = self._own[k]
                sigma[mine] = own[mine] * fast_robust_sigma(scaled[mine][close[mine]], _MIN_NOISE)
                most[mine] = np.minimum(_TUKEY * sigma[mine], limits[k])
        off = distance / most
        weight = found.weight * tukey_weight(off, 1.0) / sigma**2
        if last:
            # not before: from afar every edge is needed to draw the pose near
            weight = weight / found.worse.take(place)**2
        return EdgeChoice(offset, contrast, near, weight, off)
