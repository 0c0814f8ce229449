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
"""Fits that cannot change a decision are not made: by what is known before them."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import CameraFacts
from selfcal_ros.calibration.bundle.motion import NEARLY_PLANAR
from selfcal_ros.calibration.estimators.motion_problem import problem_of
from selfcal_ros.calibration.initialisation import multi_start
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.hard_scenes import s_curve, scene, short_tracks
from selfcal_ros.synthetic.scenes import pitched_mount, planar_poses

NOISE_PX, TILT_DEG = 0.1, 1.0


def drive_over(tilt_deg):
    """Return the camera of a drive over ground that tilts every view so much, and the problem."""
    rng = np.random.default_rng(3)
    turns, places = s_curve(20)
    tilt = np.radians(tilt_deg) * rng.standard_normal((len(turns), 3)) * [1, 1, 0]
    poses = (pitched_mount(np.radians(20)) @ rotation_matrix(tilt)
             @ planar_poses(np.eye(3), turns, places))
    drawn = scene(rng, poses, noise_px=NOISE_PX, count=150, seen=short_tracks(rng, 6))
    graph = build_view_graph(drawn.tracks, np.random.default_rng(0))
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0)
    return drawn.camera, replace(problem_of(graph, (640, 480), facts), motion=NEARLY_PLANAR,
                                 supposes_plane=True)


@pytest.fixture(scope='module')
def uneven():
    """A drive over ground that tilts every view by a degree: its camera, and the problem."""
    return drive_over(TILT_DEG)


def counting(monkeypatch, module, name):
    """Count the calls of a function, which does what it does."""
    function, calls = getattr(module, name), []

    def counted(*arguments):
        calls.append(arguments)
        return function(*arguments)

    monkeypatch.setattr(module, name, counted)
    return calls


def test_free_motion_that_explains_the_images_ends_the_sweep(uneven, monkeypatch):
    camera, problem = uneven
    # pairs of views may absorb errors that no path does
    problem = replace(problem, noise_px=problem.noise_px / 1.3)
    tried = counting(monkeypatch, multi_start, 'supposed_camera')
    start, noise_px = multi_start.best_start(problem, [])

    # what the plane leaves would have called for all focal lengths
    assert noise_px > multi_start.GOOD_ENOUGH * problem.noise_px
    assert abs(start.lens['f'] / camera.K[0, 0] - 1) < multi_start.ALIKE
    # once in the plane, once freely
    assert len(tried) == 2
