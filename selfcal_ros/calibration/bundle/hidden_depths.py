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
Points whose depth no view shows: those that are seen only while the camera stands or turns.

Noise alone tells where they are, and puts some of them beside the camera's own centre. There the
smallest of steps moves an image by much. Such points hold the path, and with it the lens, at a
wrong place, and sigmas are a tenth of what they should be. So they are taken for directions, which
still tell how the camera turns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.geometry.projective import lengths
from selfcal_ros.geometry.schur_complement import PointBlocks

#: A depth is hidden where the path moves a point of usual depth by less than so many times the
#: noise. Where more than this share of the points is so, the camera hardly moves: none is hidden.
STEP_SIGMAS, MOST = 0.5, 0.6
#: What seems nearer than this share of the usual depth is hidden where the path moves a point of
#: usual depth by less than so many times the noise. A point that is so near becomes an outlier.
#: What is hidden already stays so up to there.
NEAR, STEP_SIGMAS_OF_NEAR = 0.2, 2.0
#: The usual depth of a view is at least this share of that of all: in views that only turn, noise
#: may have put most points beside the camera.
LEAST_OF_ALL = 0.5


def hidden_depths(state: SceneState, blocks: PointBlocks, sigma_px: float) -> np.ndarray:
    """
    Find the points whose depth no view shows.

    Parameters
    ----------
    state : SceneState
    blocks : PointBlocks
        Point and view of every observation.
    sigma_px : float
        Noise of a coordinate.

    Returns
    -------
    ndarray of bool, shape (P,)

    """
    low, high = _boxes(state, blocks)
    distance = _distances(state, blocks)
    usual, there = _usual(distance, blocks), state.points[:, 3] == 0
    near = np.minimum.reduceat(distance, blocks.first) < NEAR * usual
    limit_px = sigma_px * np.where(near | there, STEP_SIGMAS_OF_NEAR, STEP_SIGMAS)
    hidden: np.ndarray = state.lens['f'] * lengths(high - low) < limit_px * usual
    return hidden if hidden.mean() <= MOST else np.zeros_like(hidden)


def with_hidden_depths(state: SceneState, blocks: PointBlocks, hidden: np.ndarray,
                       directions: np.ndarray) -> SceneState:
    """
    Put points of hidden depth at infinity, where they stay, and others there at usual depth.

    Parameters
    ----------
    state : SceneState
    blocks : PointBlocks
        Point and view of every observation.
    hidden : ndarray of bool, shape (P,)
    directions : ndarray, shape (N, 3)
        Of every observation, unit, in the world.

    Returns
    -------
    SceneState

    """
    low, _ = _boxes(state, blocks)
    usual = _usual(_distances(state, blocks), blocks)
    mean = blocks.sum_over_points(directions)
    mean /= np.maximum(lengths(mean), 1e-12)[:, None]
    points = state.points.copy()
    shown = ~hidden & (points[:, 3] == 0)
    again = np.column_stack([low + usual[:, None] * mean, np.ones(len(mean))])
    points[shown] = (again / lengths(again)[:, None])[shown]
    points[hidden] = np.column_stack([mean, np.zeros(len(mean))])[hidden]
    return replace(state, points=points)


def _boxes(state: SceneState, blocks: PointBlocks) -> tuple[np.ndarray, np.ndarray]:
    """Corners (P, 3) of the boxes that hold the views of each point."""
    centres = state.path.centres()[blocks.view]
    return (np.minimum.reduceat(centres, blocks.first),
            np.maximum.reduceat(centres, blocks.first))


def _usual(distance: np.ndarray, blocks: PointBlocks) -> np.ndarray:
    """Usual depths (P,) where each point is seen, by the distances (N,) of all."""
    usual = np.maximum(_median_of_views(blocks, distance), LEAST_OF_ALL * np.median(distance))
    least: np.ndarray = np.minimum.reduceat(usual[blocks.view], blocks.first)
    return least


def _distances(state: SceneState, blocks: PointBlocks) -> np.ndarray:
    """Distances (N,) of the points from the views that see them; at infinity, the usual one."""
    centres, points = state.path.centres()[blocks.view], state.points[blocks.point]
    away, weight = lengths(points[:, :3] - points[:, 3:] * centres), np.abs(points[:, 3])
    known = weight > 0
    distance: np.ndarray = away / np.where(known, weight, 1)
    distance[~known] = np.median(distance[known]) if known.any() else 1
    return distance


def _median_of_views(blocks: PointBlocks, values: np.ndarray) -> np.ndarray:
    """Medians (V,) of the values (N,) of each view, which all have some."""
    order = np.lexsort((values, blocks.view))
    count = np.bincount(blocks.view, minlength=blocks.view_count)
    middle: np.ndarray = values[order][np.cumsum(count) - (count + 1) // 2]
    return middle
