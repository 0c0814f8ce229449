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
"""A path that is known of some views is continued to all, and keeps its scale."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import CameraFacts
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL, NEARLY_PLANAR
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.robust_fit import Observations
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.initialisation.continued_path import continued_path
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.hard_scenes import s_curve, scene, short_tracks, vehicle
from selfcal_ros.synthetic.scenes import pitched_mount, PointSequence

VIEWS, FIRST, LAST = 72, 20, 44


def drive(rng):
    """Drive in steps of 6 cm, turning by 2 degrees a view; no point is seen in over ten views."""
    return vehicle(rng, s_curve(VIEWS, turn_deg=80.0, step_m=0.06), count=2500,
                   seen=short_tracks(rng, 10))


def hand_before_wall(rng):
    """Turn by 2 degrees a view before a wall, moving by 4 cm: pairs show no one geometry."""
    at = np.linspace(0, 4 * np.pi, VIEWS)
    R = rotation_matrix(np.radians(15) * np.column_stack([np.sin(at), np.cos(0.7 * at), 0 * at]))
    centres = 0.25 * np.column_stack([np.cos(at), np.sin(1.3 * at), np.sin(0.5 * at)])
    return scene(rng, np.concatenate([R, -R @ centres[:, :, None]], axis=2), count=2500,
                 surface=lambda points: points * 4 / points[:, 2:], seen=short_tracks(rng, 10))


def problem_and_known(sequence: PointSequence, motion):
    tracks = sequence.tracks
    problem = SelfCalibrationProblem(
        Observations.of(tracks, np.arange(VIEWS)), [], tracks.image_size,
        CameraFacts(aspect_ratio=1.0, skew=0.0), 0.2, motion=motion)
    known = AxisPath.of_poses(pitched_mount(np.radians(20.0)), sequence.cam_from_world[FIRST:LAST])
    return problem, SceneState(Lens.of(sequence.camera), known)


@pytest.mark.parametrize('made, motion', [(drive, NEARLY_PLANAR), (hand_before_wall, GENERAL)])
def test_the_scale_stays_to_both_ends(made, motion):
    sequence = made(np.random.default_rng(3))
    problem, known = problem_and_known(sequence, motion)

    path = continued_path(problem, known, FIRST, 40, exact=False)

    R, t = np.split(sequence.cam_from_world, [3], axis=2)
    steps = np.linalg.norm(np.diff(-np.einsum('vji,vjk->vi', R, t), axis=0), axis=1)
    ratio = np.linalg.norm(np.diff(path.centres(), axis=0), axis=1) / steps
    known_ratio = np.median(ratio[FIRST:LAST - 1])
    assert len(path) == VIEWS
    for end in (ratio[:8], ratio[-8:]):
        assert abs(np.median(end) / known_ratio - 1) < 0.1


def test_views_that_share_no_points_are_not_invented():
    sequence = drive(np.random.default_rng(3))
    problem, known = problem_and_known(sequence, NEARLY_PLANAR)
    kept = problem.observations.view != LAST
    problem = replace(problem, observations=problem.observations.select(kept)[0])

    assert continued_path(problem, known, FIRST, 40, exact=False) is None
