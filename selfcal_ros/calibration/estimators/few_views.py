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
Few general views → K: the modulus constraint proposes, the bundle adjustment has the last word.

The constraint (thesis 4.1.2) supposes neither an aspect ratio nor a principal point, as the sweep
over the focal length does. It needs four views.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.affine.modulus import MIN_POINTS, propose_camera
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.estimators.motion_calibration import calibrate_from_motion
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.tracks import Tracks

#: Frames among which the views are chosen: evenly spread over a longer recording.
MAX_CANDIDATES = 40


def spread_views(tracks: Tracks, views: int) -> Tracks:
    """
    Choose views that share many points and differ much.

    Parameters
    ----------
    tracks : Tracks
    views : int
        How many; fewer come back where no more share points with all that are chosen.

    Returns
    -------
    Tracks
        Of the chosen frames.

    """
    frames = tracks.frames
    if len(frames) <= views:
        return tracks
    few = np.linspace(0, len(frames) - 1, min(len(frames), MAX_CANDIDATES)).astype(int)
    frames = frames[few]
    worth = np.zeros((len(frames), len(frames)))
    for i, j in zip(*np.triu_indices(len(frames), 1)):
        names, xy_a, xy_b = tracks.matches(frames[i], frames[j])
        if len(names) >= MIN_POINTS:
            worth[i, j] = worth[j, i] = np.sqrt(len(names)) * np.median(
                np.linalg.norm(xy_b - xy_a, axis=1))
    if not worth.max() > 0:
        return tracks
    chosen = [int(k) for k in np.unravel_index(np.argmax(worth), worth.shape)]
    while len(chosen) < views:
        nearest = worth[:, chosen].min(axis=1)
        if not nearest.max() > 0:
            break
        chosen.append(int(np.argmax(nearest)))
    return tracks.in_frames(frames[chosen])


def calibrate_few_views(graph: ViewGraph, size: tuple[int, int], facts: CameraFacts,
                        proposals: list[Camera]) -> Calibration | NoEstimate:
    """
    Calibrate from few general views.

    Parameters
    ----------
    graph : ViewGraph
    size : (int, int)
        Width and height of the image, pixels.
    facts : CameraFacts
    proposals : list of Camera
        Calibrations to try before that of the modulus constraint; the sweep over the focal
        length comes last.

    Returns
    -------
    Calibration or NoEstimate

    """
    proposals = [*proposals, *propose_camera(graph.tracks, size, facts)]
    return calibrate_from_motion(graph, size, facts, proposals, (GENERAL,))
