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
"""What a path through a scene has to explain, and whether it can be one camera that saw it."""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.motion import PLANAR
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, RobustFit
from selfcal_ros.calibration.estimators.acceptance import unchecked
from selfcal_ros.calibration.estimators.shutter_choice import timed
from selfcal_ros.calibration.initialisation.planar_scene import FlatScene
from selfcal_ros.calibration.initialisation.problem import observations_of, SelfCalibrationProblem
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.observability import held_facts, LEAST_NOISE_PX
from selfcal_ros.calibration.uncertainty.cluster_covariance import robust_covariance_of
from selfcal_ros.calibration.uncertainty.two_cameras import two_cameras, two_focal_lengths
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.two_view_tests import PARALLAX_RATIO

#: Tracks per view on which the distortion model and the planarity are decided.
MODEL_TRACKS_PER_VIEW = 100


def problem_of(graph: ViewGraph, size: tuple[int, int], facts: CameraFacts, flat: bool = False,
               at_once: bool = False, turns: bool = False) -> SelfCalibrationProblem | NoEstimate:
    """Set up what is to be explained; see `motion_calibration`. Turns need no parallax."""
    observations = timed(observations_of(graph.tracks, graph.frames), graph.tracks,
                         graph.frames, size, facts)
    if len(graph.frames) < 3:
        held = held_facts(facts)
        return NoEstimate('too_few_images', images=len(graph.frames), status={
            name: 'held' if name in held else 'unobservable' for name in MATRIX_PARAMETERS})
    plane = FlatScene.of(graph.tracks, graph.frames, graph.lens) if flat else None
    problem = SelfCalibrationProblem(observations, graph.pairs, size, facts,
                                     max(graph.noise_px, LEAST_NOISE_PX), flat=plane,
                                     bend=graph.bend,
                                     instants=() if at_once else tuple(
                                         float(frame) for frame in graph.frames))
    refusal = unchecked(bundle_of(observations, PLANAR, priors_from_facts(facts), 1.0))
    # of few points a homography explains as much as any motion does
    if refusal is None and graph.parallax < PARALLAX_RATIO and plane is None and not turns:
        return NoEstimate('no_parallax', parallax_ratio=float(graph.parallax), motion='rotation')
    return problem if refusal is None else refusal


def of_two_cameras(fit: RobustFit, window: SelfCalibrationProblem, graph: ViewGraph,
                   ) -> NoEstimate | None:
    """Refuse images of two cameras, and tell which they are."""
    if fit.state.zoom is not None:
        second = two_focal_lengths(fit.state.zoom.log_focal)
    else:
        second = two_cameras(fit, robust_covariance_of(fit, window.size).variance_inflation)
    if second is None:
        return None
    frames = np.array(window.instants, dtype=int)
    return NoEstimate('two_cameras', first=frames[~second].tolist(),
                      second=frames[second].tolist(), all_views=len(second) == len(graph.frames))
