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
Views that are related by pure translation → K: the affine chain, then the bundle adjustment.

Chapter 4 of the thesis proposes the calibration, from the images alone or with the translated
views named by the user; the bundle adjustment for general motion, which also estimates the
distortion that the chain neglects, has the last word.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.affine.affine_calibration import calibrate_affine
from selfcal_ros.calibration.affine.pair_distortion import estimate_radial, undo_radial
from selfcal_ros.calibration.affine.translation_groups import translation_groups
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.estimators.motion_calibration import calibrate_from_motion
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.tracks import LARGEST_PX, Tracks

#: Tracks per view that the chain uses, the longest ones.
CHAIN_TRACKS_PER_VIEW = 100


def calibrate_translated(graph: ViewGraph, size: tuple[int, int], facts: CameraFacts,
                         translated: Sequence[int] | None = None, at_once: bool = False,
                         ) -> Calibration | NoEstimate:
    """
    Calibrate from views of which some are related by pure translation.

    Parameters
    ----------
    graph : ViewGraph
    size : (int, int)
        Width and height of the image, pixels.
    facts : CameraFacts
    translated : sequence of int, optional
        Frames that are related by pure translation; found from the images when not given.
    at_once : bool
        The views are of one instant, as objects in one image are.

    Returns
    -------
    Calibration or NoEstimate

    """
    frames = tuple(int(f) for f in graph.frames)
    stated = translated is not None
    if translated is None:
        found = translation_groups(graph.tracks, size)
        groups = found.finding()
        if isinstance(groups, NoEstimate):
            return groups.saying(motion='general')
        translated, radial, said = found.groups[0], found.radial, (groups,)
    else:
        absent = sorted({int(f) for f in translated} - set(frames))
        translated = tuple(int(f) for f in translated if f in frames)
        if len(translated) < 2:
            return NoEstimate('too_few_stated_frames')
        radial = estimate_radial(graph.tracks, size)
        said = (Finding('frames_said_translated', frames=translated), *(
            (Finding('frames_said_absent', absent=absent),) if absent else ()))
    tracks = graph.tracks
    straight = undo_radial(tracks.xy, radial, size)
    # beyond where the model bends back there is no place for a point
    usable = (np.abs(straight) <= LARGEST_PX).all(axis=1)
    tracks = Tracks(tracks.frame[usable], tracks.track[usable], straight[usable], size)
    tracks = tracks.longest(CHAIN_TRACKS_PER_VIEW)
    chain = calibrate_affine(tracks, translated, size, facts)
    if isinstance(chain, NoEstimate) and 'status' in chain.values:
        return chain.saying(motion='translation')
    proposals = [Camera(chain.K, width=size[0], height=size[1])] if chain else []
    motion = GENERAL
    if stated:
        motion = replace(motion, parallel=tuple(np.flatnonzero(np.isin(frames, translated))))
    result = calibrate_from_motion(graph, size, facts, proposals, (motion,), at_once=at_once)
    return replace(result, findings=(*said, *result.findings)) if result else result
