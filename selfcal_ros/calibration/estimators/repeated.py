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
Equal objects in one image → K: each object is a view of one object (thesis 4.2.2).

The camera is the same for all objects, so that what holds for views holds for them. Objects that
stand parallel are views related by translation. Where that is stated it is a fact, and a strong
one: the affine chain proposes and the bundle adjustment keeps them parallel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from selfcal_ros.calibration.affine.affine_calibration import calibrate_affine
from selfcal_ros.calibration.affine.pair_distortion import straightened
from selfcal_ros.calibration.affine.translation_groups import translation_groups
from selfcal_ros.calibration.estimators.motion_calibration import (calibrate_from_motion,
                                                                   MOTION_MODELS)
from selfcal_ros.calibration.estimators.translation import (calibrate_translated,
                                                            CHAIN_TRACKS_PER_VIEW)
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.two_view_tests import PARALLAX_RATIO


def calibrate_repeated_objects(graph: ViewGraph, size: tuple[int, int], facts: CameraFacts,
                               parallel: Sequence[int] | None = None,
                               ) -> Calibration | NoEstimate:
    """
    Calibrate from equal objects in one image, or in few images of one camera.

    Parameters
    ----------
    graph : ViewGraph
        Its frames are the objects; see `tracks_from_objects`.
    size : (int, int)
        Width and height of the image, pixels.
    facts : CameraFacts
    parallel : sequence of int, optional
        Objects that are known to stand parallel.

    Returns
    -------
    Calibration or NoEstimate

    """
    if parallel is not None:
        return _of_objects(calibrate_translated(graph, size, facts, parallel, at_once=True))
    found = translation_groups(graph.tracks, size)
    proposals = []
    if found.groups:
        tracks = straightened(graph.tracks, size, found.radial).longest(CHAIN_TRACKS_PER_VIEW)
        chain = calibrate_affine(tracks, found.groups[0], size, facts)
        proposals = [Camera(chain.K, width=size[0], height=size[1])] if chain else []
    # objects that stand on one plane are views of planar motion
    result = calibrate_from_motion(graph, size, facts, proposals, MOTION_MODELS['auto'],
                                   at_once=True)
    if not result and graph.parallax < PARALLAX_RATIO:
        flat = calibrate_from_motion(graph, size, facts, [], MOTION_MODELS['auto'], flat=True,
                                     at_once=True)
        result = flat or result
    return _of_objects(result)


def refused_for_objects(why: NoEstimate) -> NoEstimate:
    """Refuse for the same reason, and say that the images are objects."""
    carried = {name: why.values[name] for name in ('motion', 'status', 'facts')
               if name in why.values}
    inner = {name: value for name, value in why.values.items()
             if name not in carried and name != 'further'}
    return NoEstimate('objects_insufficient', why=Finding(why.kind, **inner), **carried)


def _of_objects(found: Calibration | NoEstimate) -> Calibration | NoEstimate:
    """Say that the views are objects."""
    if isinstance(found, NoEstimate):
        return refused_for_objects(found)
    return replace(found, findings=(Finding('objects_as_views'), *found.findings))
