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
"""One pose from the images of several cameras, against rendered truth."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.several_cameras.rig_tracker import RigTracker
from selfcal_ros.rorapid.tracked_frame import TrackerState
from selfcal_ros.rorapid.tracker import RorapidTracker
from selfcal_ros.synthetic.objects import perturbed
from selfcal_ros.synthetic.several_cameras import object_before_cameras, turned_camera

VIEWS = 46


@lru_cache(maxsize=None)
def scene(shape='l_block', seed=41, aside=(0.0, 0.35), views=VIEWS):
    recordings, cameras = object_before_cameras(views, shape, aside, seed=seed, supersampling=2)
    return recordings, cameras, [[image for image, _ in one.frames()] for one in recordings]


def started(model, cameras, truth, **kwargs):
    rig = RigTracker(model, cameras, **kwargs)
    rig.start(*perturbed(truth.rotations[0], truth.translations[0], np.random.default_rng(3),
                         0.04, 0.003))
    return rig


def error(tracked, truth, k):
    return np.r_[tracked.translation - truth.translations[k],
                 rotation_vector(tracked.rotation @ truth.rotations[k].T)]


def square(tracked, truth, k):
    off = error(tracked, truth, k)
    return float(off @ np.linalg.solve(tracked.covariance, off))


@pytest.mark.long
def test_two_cameras_know_depth_better_by_what_triangulation_gives():
    (truth, _), cameras, (left, right) = scene()
    rig = started(truth.model, cameras, truth)
    alone = RorapidTracker(truth.model, truth.camera)
    alone.start(truth.rotations[0], truth.translations[0])
    both, one, sigmas = [], [], []
    for k, pair in enumerate(zip(left, right)):
        found, single = rig.track(pair), alone.track(pair[0])
        assert found.tracked.state is TrackerState.TRACKING and found.sees == (True, True)
        assert not found.tracked.doubt
        both.append(error(found.tracked, truth, k))
        one.append(error(single, truth, k))
        sigmas.append([found.tracked.covariance[2, 2]**0.5, single.covariance[2, 2]**0.5])
        assert square(found.tracked, truth, k) < chi2.ppf(1 - 1e-5, 6)
    both, one, sigmas = np.array(both), np.array(one), np.array(sigmas)
    # rays that meet under 19 degrees, against one camera's depth by perspective
    assert np.median(sigmas[:, 0] / sigmas[:, 1]) < 0.85
    rms = np.sqrt((both**2).mean(axis=0)), np.sqrt((one**2).mean(axis=0))
    assert np.linalg.norm(rms[0][:3]) < np.linalg.norm(rms[1][:3])
    assert np.linalg.norm(rms[0][:3]) < 2e-4 and np.rad2deg(np.linalg.norm(rms[0][3:])) < 0.1


@pytest.mark.long
@pytest.mark.parametrize('which, what', ((0, 'covered'), (1, 'no image')))
def test_a_camera_that_sees_nothing_for_25_images_does_no_harm(which, what):
    (truth, _), cameras, images = scene()
    rig = started(truth.model, cameras, truth)
    for k in range(VIEWS):
        pair = [one[k] for one in images]
        if 10 <= k < 35:
            pair[which] = None if what == 'no image' else np.full_like(pair[which], 90)
        found = rig.track(pair, k * 33_000_000)
        assert found.tracked.state is TrackerState.TRACKING
        assert found.sees == tuple(j != which or not 10 <= k < 35 for j in (0, 1)) or k in (35, 36)
        assert square(found.tracked, truth, k) < chi2.ppf(1 - 1e-6, 6)
        assert np.linalg.norm(error(found.tracked, truth, k)[:3]) < 1e-3


def test_all_cameras_covered_is_a_loss_and_the_object_is_found_again():
    (truth, _), cameras, images = scene()
    rig = started(truth.model, cameras, truth)
    states = []
    for k in range(40):
        pair = [np.full_like(one[k], 90) if 10 <= k < 22 else one[k] for one in images]
        found = rig.track(pair)
        states.append(found.tracked.state)
        assert not found.tracked or k < 15 or square(found.tracked, truth, k) < 40
    assert set(states[13:22]) == {TrackerState.LOST}
    assert states[-1] is TrackerState.TRACKING


def test_an_instant_that_only_a_camera_that_looks_away_has_an_image_of_is_no_end():
    (truth, _), cameras, (left, right) = scene()
    rig = started(truth.model, [cameras[0], turned_camera(cameras[1], 180.0, (0, 1, 0))], truth)
    with pytest.raises(InputError, match='looks away'):
        rig.track((None, right[0]))
    before = [rig.track((left[k], right[k])) for k in range(4)][-1]
    without = rig.track((None, right[4]))
    assert without.sees == (False, False) and without.views == (None, None)
    assert without.tracked.state is before.tracked.state and not without.tracked.found.any()
    # the prediction is all that is known
    assert np.all(np.diag(without.tracked.covariance) > np.diag(before.tracked.covariance))
    after = rig.track((left[5], right[5])).tracked
    assert after.state is TrackerState.TRACKING
    assert square(after, truth, 5) < chi2.ppf(1 - 1e-5, 6)


@pytest.mark.long
@pytest.mark.parametrize('degrees', (2.0, 0.3))
def test_a_wrong_transform_is_said_and_no_sigma_is_small(degrees):
    (truth, _), cameras, images = scene('step_block', 43, views=30)
    rig = started(truth.model, [cameras[0], turned_camera(cameras[1], degrees)], truth)
    for k, pair in enumerate(zip(*images)):
        found = rig.track(pair)
        if found.tracked and k >= 5:
            assert found.tracked.state is TrackerState.DEGRADED
            assert 'contradict' in found.tracked.doubt or 'elsewhere' in found.tracked.doubt
        if found.tracked:
            assert square(found.tracked, truth, k) < 40
    said = float(found.tracked.doubt.partition('by ')[2].partition(' ')[0])
    assert said == pytest.approx(degrees, rel=0.15)


@pytest.mark.long
def test_what_is_not_known_of_a_transform_counts_and_is_no_contradiction():
    (truth, _), cameras, images = scene('cube', 44, views=30)
    wrong = turned_camera(cameras[1], 0.05)
    spread = np.diag([1e-4**2] * 3 + [np.deg2rad(0.05)**2] * 3)
    wrong = replace(wrong, covariance=spread)
    rig, exact = started(truth.model, [cameras[0], wrong], truth), started(
        truth.model, cameras, truth)
    for k, pair in enumerate(zip(*images)):
        found, best = rig.track(pair).tracked, exact.track(pair).tracked
        assert not found.doubt and found.state is TrackerState.TRACKING
        assert square(found, truth, k) < chi2.ppf(1 - 1e-5, 6)
    assert np.trace(found.covariance[:3, :3]) > np.trace(best.covariance[:3, :3])


@pytest.mark.long
def test_of_three_cameras_the_one_that_is_knocked_is_named_and_left_out():
    recordings, cameras, images = scene('box', 45, (0.0, 0.35, -0.4), 42)
    truth = recordings[0]
    rig = started(truth.model, cameras, truth)
    K = truth.camera.K
    turn = K @ rotation_matrix(np.deg2rad([0.8, -1.5, 1.0])) @ np.linalg.inv(K)
    said = []
    for k in range(42):
        now = [one[k] for one in images]
        if k >= 25:
            now[1] = cv2.warpPerspective(now[1], turn, (640, 480), borderMode=1)
        found = rig.track(now)
        assert found.tracked and square(found.tracked, truth, k) < 40
        assert found.sees[0] and found.sees[2] and found.sees[1] == (k < 25)
        said.append('cam1' in found.tracked.doubt)
    assert not any(said[:25]) and any(said[25:37]) and said[-1]


@pytest.mark.long
def test_a_model_that_is_too_large_is_said_as_such():
    (truth, _), cameras, images = scene('cube', 44, views=30)
    large = replace(truth.model, vertices=1.04 * truth.model.vertices)
    rig = started(large, cameras, truth)
    for k, pair in enumerate(zip(*images)):
        found = rig.track(pair).tracked
        assert not found or k < 5 or found.state is TrackerState.DEGRADED
        assert not found or square(found, truth, k) < 40
    assert found.doubt.startswith('The model is 4.')
    assert 'too large for the distances between the cameras' in found.doubt


def test_what_is_for_one_camera_is_refused_in_a_sentence():
    (truth, _), cameras, images = scene()
    with pytest.raises(ArgumentError, match='Several cameras of one object need motion general'):
        RigTracker(truth.model, cameras, TrackerOptions(motion='planar', plane_axis=(0, 0, 1)))
    rig = RigTracker(truth.model, cameras)
    with pytest.raises(ArgumentError, match='needs a start pose'):
        rig.track([one[0] for one in images])
    with pytest.raises(ArgumentError, match='behind all cameras'):
        rig.start(np.eye(3), [0, 0, -1.0])
    rig.start(truth.rotations[0], truth.translations[0])
    with pytest.raises(ArgumentError, match='no image of any camera'):
        rig.track([None, None])


def test_a_pose_that_is_not_confirmed_is_told_in_the_frame_of_the_rig():
    (truth, _), cameras, images = scene()
    rig = RigTracker(truth.model, cameras)
    guessed = np.diag([1e-4, 1e-4, 9e-4, 1e-4, 1e-4, 1e-4])
    rig.start(truth.rotations[0], truth.translations[0], guessed)
    blank = np.full_like(images[1][0], 120)
    # in the frame of the second camera the object is 22 mm and 20 degrees elsewhere
    for k, instant in enumerate(((None, blank), (blank, blank), (None, blank))):
        tracked = rig.track(instant).tracked
        assert tracked.state is TrackerState.INITIALISING
        assert np.linalg.norm(tracked.translation - truth.translations[0]) < 1e-3
        assert np.allclose(tracked.rotation, truth.rotations[0], atol=1e-3)
        assert k or np.allclose(tracked.covariance[:3, :3], guessed[:3, :3], atol=1e-6)
