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
"""A wrong start, another object, a wrong model or camera: said, never tracked in silence."""

from dataclasses import replace
from functools import lru_cache

from bench.tracking.tracking_objects import slab
from bench.tracking.tracking_starts import longer_edge
import numpy as np
import pytest

from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState
from selfcal_ros.synthetic.objects import SHAPES, SolidObject, tracked_object


@lru_cache(maxsize=None)
def recorded():
    """Recording of a step block, with its images."""
    made = tracked_object(5, 'step_block', seed=6, supersampling=2)
    return made, [image for image, _ in made.frames()]


def follow(model=None, camera=None, turn_deg=(0, 0, 0), farther=1.0, sigma_m=None):
    """Follow the step block, through all images."""
    made, images = recorded()
    tracker = RorapidTracker(model or made.model, camera or made.camera)
    rotation = rotation_matrix(np.deg2rad(turn_deg)) @ made.rotations[0]
    tracker.start(rotation, farther * made.translations[0], distance_sigma_m=sigma_m)
    return [tracker.track(image) for image in images]


def stretched(factors):
    """Model of the step block with other sides."""
    model = recorded()[0].model
    return replace(model, vertices=model.vertices * factors)


def test_the_right_model_raises_no_doubt():
    frames = follow(sigma_m=0.005)
    assert all(f.state is TrackerState.TRACKING and not f.doubt for f in frames)


@pytest.mark.parametrize('turn', ((0, 15, 0), (20, -15, 15), (0, 0, -30)))
def test_a_start_some_degrees_off_converges(turn):
    made, _ = recorded()
    frames = follow(turn_deg=turn)
    assert frames[0] and np.allclose(frames[0].translation, made.translations[0], atol=2e-3)
    assert np.allclose(frames[0].rotation, made.rotations[0], atol=0.02)


@pytest.mark.parametrize('turn', ((60, 40, 50), (0, 75, 45)))
def test_a_start_far_off_publishes_no_wrong_pose(turn):
    frames = follow(turn_deg=turn)
    assert all(frame.state is TrackerState.INITIALISING and not frame for frame in frames)
    assert frames[-1].reason


def test_another_object_is_never_tracked():
    frames = follow(SHAPES['box']().model)
    assert not any(frames) and frames[-1].reason


def test_a_side_that_is_too_long_is_said_with_its_amount():
    frames = follow(stretched([1, 1, 1.05]))
    assert frames[-1].state is TrackerState.DEGRADED
    assert 'along its z seems' in frames[-1].doubt and 'too long' in frames[-1].doubt
    share = float(frames[-1].doubt.split('seems ')[1].split()[0])
    assert share == pytest.approx(5, abs=0.7)
    made, _ = recorded()
    error = frames[-1].translation - made.translations[-1]
    assert error @ np.linalg.solve(frames[-1].covariance[:3, :3], error) < 12


def test_a_doubt_stands_while_the_pose_gives_way_to_the_model():
    made = tracked_object(36, slab(308), seed=308, supersampling=2, speed=1.0)
    wrong, _, _ = longer_edge(0.05)(made, 0)
    tracker, renderer = RorapidTracker(wrong, made.camera), made.renderer()
    tracker.start(made.rotations[0], made.translations[0])
    frames = [tracker.track(made.frame(k, renderer)) for k in range(36)]
    assert all(f.state is TrackerState.DEGRADED for f in frames[5:])


def test_a_doubt_goes_when_the_edges_fit_again():
    right = tracked_object(100, 'step_block', seed=6, supersampling=1)
    solid, higher = SHAPES['step_block'](), np.array([1, 1, 1.05])
    surfaces = [replace(s, origin=s.origin * higher, edge_u=s.edge_u * higher,
                        edge_v=s.edge_v * higher) for s in solid.surfaces]
    model = replace(solid.model, vertices=solid.model.vertices * higher)
    wrong = tracked_object(12, SolidObject(model, surfaces), seed=6, supersampling=1)
    tracker = RorapidTracker(right.model, right.camera)
    tracker.start(right.rotations[0], right.translations[0])
    said = [tracker.track(made.frame(k, renderer)).doubt for made, renderer, images in (
        (wrong, wrong.renderer(), range(12)), (right, right.renderer(), range(12, 100)))
        for k in images]
    assert said[11] and not said[-1]


def test_a_wrong_focal_length_is_said():
    made, _ = recorded()
    K = made.camera.K.copy()
    K[:2, :2] *= 1.05
    frames = follow(camera=replace(made.camera, K=K), farther=1.05)
    assert "camera's focal length seems" in frames[-1].doubt
    assert 'too long' in frames[-1].doubt and frames[-1].state is TrackerState.DEGRADED
    assert frames[-1].covariance[2, 2]**0.5 > 0.02 * made.translations[-1][2]


def test_the_size_is_told_by_a_measured_distance_alone():
    large = stretched([1.1, 1.1, 1.1])
    assert not follow(large)[-1].doubt
    frame = follow(large, sigma_m=0.005)[-1]
    assert '10.0' in frame.doubt and 'too large' in frame.doubt
    made, _ = recorded()
    error = frame.translation - made.translations[-1]
    assert error @ np.linalg.solve(frame.covariance[:3, :3], error) < 12
