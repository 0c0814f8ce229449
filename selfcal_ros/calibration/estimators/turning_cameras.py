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
Images of two cameras that only turn, in one folder.

Rotations of one camera leave much of them, and free translations explain the rest away, with a
focal length that is neither's. So where rotations leave much, the images are parted in two that
differ like cameras. They are two cameras if rotations explain those of one alone.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.estimators.rotation import fit_rotations, RotationFit
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.uncertainty.cluster_covariance import robust_covariance_of
from selfcal_ros.calibration.uncertainty.two_cameras import two_cameras
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate

#: Rotations explain images where they leave less than so many times the noise of their pairs.
EXPLAINED = 1.5
#: Fewer images than this agree with rotations by themselves.
LEAST_VIEWS = 4


def of_two_turning(turning: RotationFit, graph: ViewGraph, size: tuple[int, int],
                   facts: CameraFacts) -> NoEstimate | None:
    """
    Refuse images of two cameras that only turn, and tell which they are.

    Parameters
    ----------
    turning : RotationFit
        All images by rotations of one camera.
    graph : ViewGraph
    size : (int, int)
        Width and height of the image.
    facts : CameraFacts

    Returns
    -------
    NoEstimate or None
        Of the kind `two_cameras`; None where they are not.

    """
    noise_px = max(graph.noise_px, turning.noise_px)
    if turning.lens.fit.state.zoom is not None or turning.left_px < EXPLAINED * noise_px:
        return None
    fit = turning.lens.fit
    second = two_cameras(fit, robust_covariance_of(fit, size).variance_inflation)
    if second is None:
        return None
    first, others = turning.frames[~second], turning.frames[second]
    more = first if len(first) >= len(others) else others
    if len(more) < LEAST_VIEWS:
        return None
    alone = fit_rotations(graph.tracks.in_frames(more.tolist()), size, facts, turning.left_px)
    if not isinstance(alone, RotationFit) or not alone.left_px < EXPLAINED * max(
            graph.noise_px, alone.noise_px if np.isfinite(alone.noise_px) else 0.0):
        return None
    return NoEstimate('two_cameras', first=first.tolist(), second=others.tolist(),
                      all_views=len(turning.frames) == len(graph.frames))
