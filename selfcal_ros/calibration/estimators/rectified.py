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
Images without distortion, whose pixels nothing checks: they may be rectified.

Hardly a lens distorts so little. And what rectifies images often leaves pixels that are not
square: the new camera matrix of OpenCV changes the aspect ratio by some percent.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts

#: One of 24 measured lenses moves no point by more than this share of its distance from the
#: axis, up to the corner of the image.
LEAST_DISTORTION = 0.002
#: Points that are asked on each half diagonal.
_POINTS = 12


def rectified_findings(camera: Camera, stated: CameraFacts, of_facts: tuple[Finding, ...],
                       ) -> tuple[Finding, ...]:
    """
    Tell where images seem to be rectified, and the calibration rests on their pixels.

    Parameters
    ----------
    camera : Camera
        The result, of known size.
    stated : CameraFacts
        Of the user; a lens that is stated without distortion is no surprise.
    of_facts : tuple of Finding
        What was found of the facts.

    Returns
    -------
    tuple of Finding

    """
    rests = any(one.kind == 'fact_unchecked' and one.values['unknown'] == 'aspect'
                for one in of_facts)
    if not rests or stated.distortion != 'auto':
        return ()
    share = most_distorted(camera)
    return (Finding('images_rectified', share=share),) if share < LEAST_DISTORTION else ()


def most_distorted(camera: Camera) -> float:
    """
    Return the largest distortion between the principal point and the corners.

    Parameters
    ----------
    camera : Camera
        Of known size.

    Returns
    -------
    float
        How far a point moves, as a share of its distance from the principal point.

    """
    centre = camera.K[:2, 2]
    corners = np.array([[x, y] for x in (0, camera.width - 1) for y in (0, camera.height - 1)])
    away = (np.linspace(0, 1, _POINTS + 1)[1:, None, None] * (corners - centre)).reshape(-1, 2)
    rays = np.linalg.solve(camera.K, np.column_stack([centre + away, np.ones(len(away))]).T).T
    moved = camera.project(rays) - centre - away
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    return float(np.max(np.linalg.norm(moved, axis=1) / distance))
