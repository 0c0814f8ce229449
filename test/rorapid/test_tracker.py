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
"""The tracker on rendered objects with exact truth, and on what it must refuse."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerOptions, TrackerState
from selfcal_ros.synthetic.objects import perturbed, tracked_object
from selfcal_ros.synthetic.wide_recordings import wide_camera


@lru_cache(maxsize=None)
def rendered(views, **kwargs):
    made = tracked_object(views, supersampling=2, **kwargs)
    renderer = made.renderer()
    return made, [made.frame(k, renderer) for k in range(views)]


#: The longest recordings of which others are the beginning.
LONGEST = {(): 120, (('motion', 'planar'),): 50, (('clutter', 0.5),): 45}


def recording(views=40, **kwargs):
    made, images = rendered(LONGEST.get(tuple(kwargs.items()), views), **kwargs)
    return made, images[:views]


def tracker_of(made, options=None, guess=0.03, camera=None):
    tracker = RorapidTracker(made.model, camera or made.camera, options, np.random.default_rng(0))
    tracker.start(*perturbed(made.rotations[0], made.translations[0], np.random.default_rng(1),
                             guess, 0.3 * guess * made.model.diameter_m))
    return tracker


def follow(made, images, options=None, **kwargs):
    tracker = tracker_of(made, options, **kwargs)
    return [tracker.track(image, int(stamp)) for image, stamp in zip(images, made.stamps_ns)]


@lru_cache(maxsize=None)
def longest_followed(**kwargs):
    return follow(*rendered(LONGEST[tuple(kwargs.items())], **kwargs))


def errors(made, frames):
    """Rotation errors in degrees, translation errors as shares of the distance."""
    angle = np.degrees([np.linalg.norm(rotation_vector(f.rotation @ R.T))
                        for f, R in zip(frames, made.rotations)])
    offset = np.array([f.translation - t for f, t in zip(frames, made.translations)])
    distance = np.linalg.norm(made.translations[:len(frames)], axis=1)
    return angle, np.linalg.norm(offset, axis=1) / distance


@pytest.mark.parametrize('kwargs', (
    {}, {'shape': 'step_block'}, {'speed': 4.0}, *(
        pytest.param(one, marks=pytest.mark.long) for one in (
            {'shape': 'spool'}, {'clutter': 0.5}, {'distortion': (-0.25, 0.08, 1e-3, -1e-3)}))),
                         ids=str)
def test_poses_are_those_of_the_truth(kwargs):
    if tuple(kwargs.items()) in LONGEST:
        made, frames = recording(**kwargs)[0], longest_followed(**kwargs)[:40]
    else:
        made, images = recording(24, **kwargs)
        frames = follow(made, images)
    angle, offset = errors(made, frames)
    assert all(f.state is TrackerState.TRACKING and not f.reason for f in frames)
    assert angle.max() < 0.3 and offset.max() < 0.005
    assert np.sqrt(np.mean(angle**2)) < 0.12
    assert np.nanmax([f.rms_px for f in frames]) < 0.8


#: Wider than a plumb bob can be, 93 degrees down the image.
RATIONAL = Camera([[300, 0, 325], [0, 300, 236], [0, 0, 1]],
                  [0.25, 0.02, 5e-4, -5e-4, 0, 0.55, 0.08, 0.002], 640, 480,
                  'rational_polynomial')


@pytest.mark.long
@pytest.mark.parametrize('camera', (wide_camera(150.0), RATIONAL), ids=lambda c: c.model)
def test_poses_through_wide_lenses_are_those_of_the_truth_within_their_sigmas(camera):
    made = tracked_object(18, supersampling=2, camera=camera, seed=11)
    renderer = made.renderer()
    images = [made.frame(k, renderer) for k in range(18)]
    frames = follow(made, images)
    angle, offset = errors(made, frames)
    assert all(f.state is TrackerState.TRACKING and not f.reason for f in frames)
    assert angle[4:].max() < 0.15 and offset[4:].max() < 0.002
    away = [np.append(f.translation - t, rotation_vector(f.rotation @ R.T))
            for f, R, t in zip(frames, made.rotations, made.translations)]
    square = [e @ np.linalg.solve(f.covariance, e) for e, f in zip(away[4:], frames[4:])]
    # six degrees of freedom; errors of neighbouring images are alike
    assert 2 < np.mean(square) < 12


@pytest.mark.long
@pytest.mark.parametrize('motion', ('translation', 'planar'))
def test_restricted_motion_is_at_least_as_accurate_and_more_certain(motion):
    made, images = recording(motion=motion)
    axis = tuple(made.rotations[0][:, 2])
    general = longest_followed(motion=motion)[:40] if motion == 'planar' else follow(made, images)
    limited = follow(made, images, TrackerOptions(motion=motion, plane_axis=axis))
    rms = [np.sqrt(np.mean(np.square(errors(made, frames)), axis=1))
           for frames in (limited, general)]
    assert (rms[0] < 1.1 * rms[1]).all()
    # both estimate the noise of each image anew, so that single images may be the other way
    trace = [np.array([np.trace(f.covariance[3:, 3:]) for f in frames[10:]])
             for frames in (limited, general)]
    assert trace[0].mean() < 0.9 * trace[1].mean()
    assert np.mean(trace[0] < trace[1]) > 0.8


@pytest.mark.long
def test_the_plane_of_motion_is_learned():
    made, images = recording(50, motion='planar')
    frames = follow(made, images, TrackerOptions(motion='planar'))
    general = longest_followed(motion='planar')
    assert errors(made, frames)[0].max() < 0.3
    assert np.trace(frames[-1].covariance[3:, 3:]) < np.trace(general[-1].covariance[3:, 3:])


@pytest.mark.parametrize('wrong', (400.0, 555.0))
def test_zoom_finds_the_focal_length(wrong):
    made, images = recording()
    K = made.camera.K.copy()
    K[:2, :2] *= wrong / K[0, 0]
    tracker = RorapidTracker(made.model, Camera(K, width=640, height=480),
                             TrackerOptions(camera_model='zoom'))
    tracker.start(made.rotations[0], made.translations[0] * [1, 1, wrong / made.camera.K[0, 0]])
    frames = [tracker.track(image) for image in images]
    assert abs(frames[-1].focal_px / made.camera.K[0, 0] - 1) < 0.01
    assert 0 < frames[-1].focal_sigma_px < 10
    assert frames[-1].camera_model == 'zoom'


@pytest.mark.long
def test_zoom_says_when_the_focal_length_cannot_be_told():
    made, images = recording(15, zoom_px=(20000.0, 25000.0))
    frames = follow(made, images, TrackerOptions(camera_model='zoom'), guess=0.01,
                    camera=made.camera_at(0))
    assert frames[-1].camera_model == 'weak' and frames[-1].reason
    assert frames[-1].state is TrackerState.TRACKING


def test_covariance_is_consistent():
    made, _ = recording()
    frames = longest_followed()[5:]
    error = np.array([np.r_[f.translation - t, rotation_vector(f.rotation @ R.T)] for f, t, R in
                      zip(frames, made.translations[5:], made.rotations[5:])])
    square = np.array([e @ np.linalg.solve(f.covariance, e) for e, f in zip(error, frames)])
    for share in (0.6, 0.8, 0.9, 0.95):
        # errors of neighbouring images are not independent
        assert abs(np.mean(square < chi2.ppf(share, 6)) - share) < 0.15


@lru_cache(maxsize=None)
def turns_from(seed, angle):
    """Turn of each pose from the truth after a start that is so far off."""
    made, images = recording(20, clutter=0.5)
    tracker = RorapidTracker(made.model, made.camera)
    tracker.start(*perturbed(made.rotations[0], made.translations[0],
                             np.random.default_rng(seed), angle, 0.0))
    frames = [tracker.track(image) for image in images]
    return [rotation_vector(f.rotation @ R.T) for f, R in zip(frames, made.rotations)]


@pytest.mark.parametrize('seed', range(4))
def test_an_error_of_the_start_is_forgotten(seed):
    """The texture is learned where the edges put the object, not where the start put it."""
    # a start without an error is the same whatever the seed
    right, wrong = np.degrees([turns_from(0, 0.0), turns_from(seed, np.deg2rad(3))])[:, 5:]
    assert np.linalg.norm(wrong, axis=1).max() < 0.3
    assert np.linalg.norm(wrong - right, axis=1).max() < 0.1


@pytest.mark.parametrize('method', ('modern', 'rorapid', 'rapid'))
def test_the_methods_follow_a_plain_object(method):
    made, images = recording(20, background=False)
    frames = follow(made, images, TrackerOptions(method=method), guess=0.005)
    angle, offset = errors(made, frames)
    assert angle[-1] < 3 and offset[-1] < 0.02


def test_a_hidden_object_is_lost_and_found_again():
    made, images = recording(45, clutter=0.5)
    images = list(images)
    for k in range(20, 32):
        images[k] = np.full_like(images[k], 90)
    frames = follow(made, images)
    states = [f.state for f in frames]
    assert all(s is TrackerState.TRACKING for s in states[:20])
    assert states[24] is TrackerState.LOST and not frames[24]
    assert all(s is TrackerState.LOST and f.reason for s, f in
               zip(states[24:32], frames[24:32]))
    assert states[-1] is TrackerState.TRACKING
    assert errors(made, frames)[0][-5:].max() < 0.5


@pytest.mark.parametrize('low, high', ((0.0, 0.4), (0.5, 1.0)))
def test_a_partly_hidden_object_is_followed(low, high):
    made, images = recording(clutter=0.5)
    hidden = []
    for image, R, t in zip(images, made.rotations, made.translations):
        x = made.camera.project(made.model.vertices @ R.T + t)[:, 0]
        a, b = (int(np.interp(s, [0, 1], [x.min(), x.max()])) for s in (low, high))
        hidden.append(image.copy())
        hidden[-1][:, max(a, 0):b] = 90
    frames = follow(made, images[:3] + hidden[3:])
    assert errors(made, frames)[0].max() < 2.5
    assert not any(f.state is TrackerState.LOST for f in frames)


@pytest.mark.parametrize('method', ('modern', 'rorapid', 'rapid'))
@pytest.mark.parametrize('image', (np.zeros((480, 640), np.uint8),
                                   np.full((480, 640, 3), 255, np.uint8)), ids=('black', 'white'))
def test_nothing_to_see_is_lost_within_five_images(method, image):
    made, _ = recording()
    tracker = tracker_of(made, TrackerOptions(method=method))
    frames = [tracker.track(image) for _ in range(5)]
    assert frames[-1].state is TrackerState.LOST and frames[-1].reason
    assert np.isfinite(frames[-1].covariance).all()


def test_noise_images_are_no_object():
    made, images = recording()
    tracker = tracker_of(made)
    for image in images[:10]:
        tracker.track(image)
    rng = np.random.default_rng(3)
    for _ in range(5):
        frame = tracker.track(rng.integers(0, 256, (480, 640)).astype(np.uint8))
    assert frame.state is TrackerState.LOST


def test_images_that_do_not_belong_are_refused():
    made, images = recording()
    tracker = tracker_of(made)
    for image in (np.zeros((240, 320), np.uint8), images[0].astype(float),
                  np.zeros((1, 1), np.uint8), np.zeros((0, 0), np.uint8)):
        with pytest.raises(InputError):
            tracker.track(image)
    free = RorapidTracker(made.model, Camera(made.camera.K))
    free.start(made.rotations[0], made.translations[0])
    assert free.track(np.zeros((1, 1), np.uint8)).share_found == 0


def test_impossible_starts_are_refused():
    made, images = recording()
    tracker = RorapidTracker(made.model, made.camera)
    with pytest.raises(ArgumentError):
        tracker.track(images[0])
    R, t = made.rotations[0], made.translations[0]
    for rotation, translation in ((R, t * np.nan), (2 * R, t), (-R, t), (R, -t), (R[:2], t)):
        with pytest.raises(ArgumentError):
            tracker.start(rotation, translation)


@pytest.mark.parametrize('change', (
    {'method': 'best'}, {'search_least_px': 30.0}, {'candidates': 1.5}, {'support_px': np.nan},
    {'plane_axis': (0, 0, 0)}, {'camera_model': 'affine', 'motion': 'planar'},
    {'least_per_line': 9}, {'frame_rate_hz': 0}))
def test_impossible_options_are_refused(change):
    with pytest.raises(ArgumentError):
        replace(TrackerOptions(), **change)


def test_a_reset_forgets_everything():
    made, images = recording()
    tracker = tracker_of(made)
    first = [tracker.track(image) for image in images[:5]]
    tracker.reset()
    assert tracker.state is TrackerState.LOST
    with pytest.raises(ArgumentError):
        tracker.track(images[0])
    again = tracker_of(made)
    assert np.allclose(again.track(images[0]).translation, first[0].translation, atol=1e-12)


@pytest.mark.long
def test_an_affine_start_that_is_off_is_looked_at_from_other_sides():
    """Turned starts need an affine camera each; without one there was an error."""
    made = tracked_object(8, shape='step_block', supersampling=2)
    renderer = made.renderer()
    tracker = RorapidTracker(made.model, made.camera, TrackerOptions(camera_model='affine'),
                             rng=np.random.default_rng(0))
    off = rotation_matrix(np.deg2rad([0.0, 15.0, 8.0]))
    tracker.start(off @ made.rotations[0], made.translations[0])
    frames = [tracker.track(made.frame(k, renderer)) for k in range(8)]
    assert frames[0].state is TrackerState.INITIALISING and frames[-1]
    assert np.degrees(np.linalg.norm(rotation_vector(
        frames[-1].rotation @ made.rotations[7].T))) < 6
