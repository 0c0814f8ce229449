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
"""Cameras and settings that change while an object is followed, or sought."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.pipeline.tracking_session import TrackingSession
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.tracker import TrackerState
from selfcal_ros.synthetic.objects import perturbed, pose_errors, tracked_object

VIEWS = 14
#: One of each kind: read from image to image, built into the control points.
SETTINGS = ({'search_most_px': 40.0}, {'control_points_per_line': 9}, {'least_contrast': 5.0})


@pytest.fixture(scope='module')
def recording():
    """Render a few images of a cube that moves, once."""
    made = tracked_object(VIEWS, 'cube', size=(320, 240), rate_hz=30.0)
    return made, [image for image, _ in made.frames()]


def scaled(camera, factor):
    """Return a camera of another focal length."""
    return Camera(np.diag([factor, factor, 1]) @ camera.K, camera.distortion, camera.width,
                  camera.height) if factor != 1 else camera


@pytest.fixture
def start(recording):
    """Make a session that has followed the object through so many images."""
    made, images = recording

    def make(count, **options):
        session = TrackingSession(made.model, TrackerOptions(**options), made.camera)
        session.start(*perturbed(made.rotations[0], made.translations[0],
                                 np.random.default_rng(2), 0.03, 0.003))
        for k in range(count):
            session.add(images[k], int(made.stamps_ns[k]))
        return session

    return make


def lose(session, recording):
    """Cover the lens until the object is lost; returns the last pose before."""
    made, images = recording
    before = session.newest
    stamp = int(made.stamps_ns[-1])
    while session.newest.state is not TrackerState.LOST:
        stamp += 10 ** 8
        session.add(np.zeros_like(images[0]), stamp)
    return before


def is_close(made, index, tracked, degrees=1.0, share=0.02):
    angle, distance = pose_errors(tracked.rotation, tracked.translation, made.rotations[index],
                                  made.translations[index])
    return np.rad2deg(angle) < degrees and distance < share


@pytest.mark.long
@pytest.mark.parametrize('change', SETTINGS)
def test_other_settings_forget_nothing(start, recording, change):
    made, images = recording
    changed, same = start(8), start(8)
    changed.set_options(replace(changed.options, **change))
    frames = [session.add(images[8], int(made.stamps_ns[8])) for session in (changed, same)]
    assert is_close(made, 8, frames[0])
    # velocity and texture are known in the first image after it, as if nothing had happened
    assert frames[0].state is TrackerState.TRACKING
    assert len(frames[0].texture_px) == len(frames[1].texture_px) > 10
    ratio = frames[0].covariance.trace() / frames[1].covariance.trace()
    assert 0.5 < ratio < 2


@pytest.mark.parametrize('change', SETTINGS)
def test_an_object_that_is_lost_is_sought_on_where_it_was(start, recording, change):
    made, images = recording
    session = start(10)
    good = lose(session, recording)
    session.set_options(replace(session.options, **change))
    assert session.snapshot().losses == 1
    stamp = int(made.stamps_ns[-1]) + 10 ** 10
    tracked = session.add(np.zeros_like(images[0]), stamp)
    assert tracked.state is TrackerState.LOST and session.snapshot().losses == 1
    assert np.linalg.norm(tracked.translation - good.translation) < 0.1 * np.linalg.norm(
        good.translation - made.translations[0])
    # what it looks like is known still: it is found in the first image that shows it
    tracked = session.add(images[4], stamp + 10 ** 8)
    assert tracked and is_close(made, 4, tracked)


def test_another_camera_while_the_object_is_lost_claims_nothing(start, recording):
    made, images = recording
    session = start(10)
    good = lose(session, recording)
    assert session.set_camera(scaled(made.camera, 1.01))
    stamp = int(made.stamps_ns[-1]) + 10 ** 10
    for k in range(3):
        tracked = session.add(np.zeros_like(images[0]), stamp + k * 10 ** 8)
        assert tracked.state is TrackerState.LOST
    assert session.snapshot().losses == 1
    assert np.linalg.norm(tracked.translation - good.translation) < 0.1 * np.linalg.norm(
        good.translation - made.translations[0])


def test_an_object_that_no_image_has_shown_yet_is_sought_from_the_start_pose(start, recording):
    made, images = recording
    session = start(0)
    session.set_camera(scaled(made.camera, 4.0))
    for k in range(6):
        session.add(np.zeros_like(images[0]), int(made.stamps_ns[0]) - 10 ** 9 + k * 10 ** 8)
    assert session.newest.state is TrackerState.LOST
    session.set_camera(made.camera)
    assert is_close(made, 0, session.add(images[0], int(made.stamps_ns[0])))


@pytest.mark.long
@pytest.mark.parametrize('change', [*SETTINGS, 'camera'])
def test_a_zoom_goes_on_from_where_it_is(start, recording, change):
    made, images = recording
    session = start(0, camera_model='zoom')
    session.set_camera(scaled(made.camera, 0.94))
    for k in range(10):
        before = session.add(images[k], int(made.stamps_ns[k]))
    # the images have said something else than the calibration
    assert before.focal_px - session.camera.K[0, 0] > 15
    if change == 'camera':
        session.set_camera(scaled(made.camera, 0.93))
    else:
        session.set_options(replace(session.options, **change))
    # an image that says nothing
    after = session.add(np.zeros_like(images[0]), int(made.stamps_ns[10]))
    assert abs(after.focal_px - before.focal_px) < 5
    assert after.camera_model == 'zoom'


@pytest.mark.parametrize('method', ['rorapid', 'rapid'])
def test_the_methods_of_the_thesis_go_on_too(method):
    made = tracked_object(8, 'cube', background=False, supersampling=2)
    session = TrackingSession(made.model, TrackerOptions(method=method), made.camera)
    session.start(made.rotations[0], made.translations[0])
    changes = ({}, {}, {}, *SETTINGS, {'search_most_px': 8.0}, {'control_points_per_line': 4})
    for k, ((image, _), change) in enumerate(zip(made.frames(), changes)):
        session.set_options(replace(session.options, **change))
        tracked = session.add(image, int(made.stamps_ns[k]))
        assert tracked and is_close(made, k, tracked, 3.0)


def test_settings_that_are_refused_change_nothing(start, recording, monkeypatch):
    made, images = recording
    session = start(4)
    old = session.options
    monkeypatch.setattr('selfcal_ros.rorapid.visibility.visible_model.MAX_TESTS', 2000)
    for options in (replace(old, control_points_per_line=200),
                    replace(old, control_points_per_line=200, motion='translation')):
        with pytest.raises(ArgumentError, match='control points .* too many'):
            session.set_options(options)
        assert session.options is old
    # poses and their camera belong together: the next calibration is that of the next pose
    camera = scaled(made.camera, 1.05)
    assert session.set_camera(camera) and session.camera is camera
    tracked = session.add(images[4], int(made.stamps_ns[4]))
    assert tracked.focal_px == camera.K[0, 0]
    assert 1.02 < tracked.translation[2] / made.translations[4][2] < 1.08


def test_a_camera_that_is_refused_leaves_the_old_one_and_its_tracker(start, recording,
                                                                     monkeypatch):
    made, images = recording
    session = start(4)
    monkeypatch.setattr('selfcal_ros.rorapid.visibility.visible_model.MAX_TESTS', 10)
    with pytest.raises(ArgumentError, match='too many'):
        session.set_camera(scaled(made.camera, 1.05))
    assert session.camera is made.camera
    tracked = session.add(images[4], int(made.stamps_ns[4]))
    assert tracked.focal_px == made.camera.K[0, 0] and is_close(made, 4, tracked)
    with pytest.raises(ArgumentError, match='too many'):
        TrackingSession(made.model)
