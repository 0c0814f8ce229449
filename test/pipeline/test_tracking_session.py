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
"""Sessions and runs of the tracker: true poses, and a sentence for every wrong input."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.pipeline.tracking_outcome import TrackingRun
from selfcal_ros.pipeline.tracking_run import (playing_rate_hz, read_start, Target,
                                               track_objects)
from selfcal_ros.pipeline.tracking_session import TrackingSession
from selfcal_ros.report.overlay_video import drawing_into, OverlayVideo
from selfcal_ros.report.poses_csv import PosesTable, read_poses
from selfcal_ros.rorapid.tracker import TrackerState
from selfcal_ros.synthetic.objects import perturbed, pose_errors, tracked_object
from selfcal_ros.synthetic.recordings import write_image_folder

VIEWS = 14


@pytest.fixture(scope='module')
def recording():
    """Render a few images of a cube, once."""
    made = tracked_object(VIEWS, 'cube', size=(320, 240), distortion=(-0.1, 0.02, 0, 0, 0))
    return made, [image for image, _ in made.frames()]


@pytest.fixture(scope='module')
def folder(recording, tmp_path_factory):
    return write_image_folder(recording[0], tmp_path_factory.mktemp('cube') / 'images')


def guess(made):
    return perturbed(made.rotations[0], made.translations[0], np.random.default_rng(2), 0.03,
                     0.003)


@pytest.fixture
def session(recording):
    made = recording[0]
    started = TrackingSession(made.model, camera=made.camera)
    started.start(*guess(made))
    return started


def close(made, index, tracked, share=0.01):
    angle, distance = pose_errors(tracked.rotation, tracked.translation, made.rotations[index],
                                  made.translations[index])
    return np.rad2deg(angle) < 1.0 and distance < share


def test_poses_are_true(session, recording):
    made, images = recording
    for image, stamp in zip(images, made.stamps_ns):
        tracked = session.add(image, int(stamp))
    assert close(made, -1, tracked)
    snapshot = session.snapshot()
    assert snapshot.images == VIEWS and snapshot.losses == 0 and not snapshot.waiting_for
    assert sum(snapshot.by_state.values()) == VIEWS


def test_a_session_waits_for_camera_and_pose(recording):
    made, images = recording
    waiting = TrackingSession(made.model)
    assert waiting.snapshot().waiting_for == 'camera'
    with pytest.raises(InputError, match='no calibration of the camera'):
        waiting.add(images[0])
    assert waiting.set_camera(made.camera)
    assert not waiting.set_camera(Camera(made.camera.K, made.camera.distortion, 320, 240))
    assert waiting.snapshot().waiting_for == 'pose'
    with pytest.raises(InputError, match='no start pose'):
        waiting.add(images[0])


@pytest.mark.parametrize('image, words', [
    (np.zeros((1, 1), np.uint8), '1x1'),
    (np.zeros((480, 640), np.uint8), '640x480, the calibration for 320x240'),
    (np.zeros((240, 320), np.float32), 'float32'),
    (np.zeros((240, 320, 4), np.uint8), 'shape'),
    (np.zeros((0, 0), np.uint8), '0x0')])
def test_an_image_that_cannot_be_used_is_told_and_the_next_is_tracked(session, recording, image,
                                                                      words):
    made, images = recording
    for k in range(3):
        session.add(images[k])
    with pytest.raises(InputError, match=words):
        session.add(image)
    assert close(made, 3, session.add(images[3]))


def test_black_images_are_a_loss_with_a_reason(session, recording):
    images = recording[1]
    for k in range(3):
        session.add(images[k])
    states = [session.add(np.zeros_like(images[0])) for _ in range(6)]
    assert states[-1].state is TrackerState.LOST and not states[-1]
    assert states[-1].reason
    assert session.snapshot().losses == 1


def test_images_out_of_order_are_refused_and_a_jump_begins_anew(session, recording):
    made, images = recording
    for k in range(4):
        session.add(images[k], int(made.stamps_ns[k]))
    with pytest.raises(InputError, match='ms older'):
        session.add(images[1], int(made.stamps_ns[1]))
    assert close(made, 4, session.add(images[4], int(made.stamps_ns[4])))
    resets = session.snapshot().resets
    # the bag is played again
    assert session.add(images[0], int(made.stamps_ns[0]) - 10 ** 10)
    assert session.snapshot().resets == resets + 1 and session.snapshot().images == 1


def test_a_clock_that_stands_still_is_no_clock(session, recording):
    made, images = recording
    for k in range(6):
        tracked = session.add(images[k], 0)
    assert close(made, 5, tracked)


@pytest.mark.parametrize('rotation, translation, words', [
    (np.eye(3), [0, 0, np.nan], 'finite'),
    (np.eye(3), [0, 0, -1], 'behind the camera'),
    (np.eye(3), [5, 0, 1], 'outside the image'),
    (np.eye(3), [0, 0, 1e308], 'is 1e\\+308 m away'),
    (np.eye(3), [0, 0, 1e12], 'away; check its unit'),
    (2 * np.eye(3), [0, 0, 1], 'no rotation'),
    (-np.eye(3), [0, 0, 1], 'no rotation'),
    (np.eye(2), [0, 0, 1], 'finite numbers')])
def test_a_start_that_cannot_be_is_refused(session, recording, rotation, translation, words):
    with pytest.raises(InputError, match=words):
        session.start(rotation, translation)
    # what there was goes on
    assert session.add(recording[1][0])


def test_another_calibration_is_followed_on(session, recording):
    made, images = recording
    for k in range(4):
        session.add(images[k])
    K = made.camera.K.copy()
    K[:2, :2] *= 1.01
    assert session.set_camera(Camera(K, made.camera.distortion, 320, 240))
    assert close(made, 4, session.add(images[4]), share=0.03)


def test_other_settings_are_followed_on(session, recording):
    made, images = recording
    for k in range(4):
        session.add(images[k], int(made.stamps_ns[k]))
    options = replace(session.options, search_most_px=40.0, texture=False)
    session.set_options(options)
    assert session.options is options
    assert close(made, 4, session.add(images[4], int(made.stamps_ns[4])))
    assert session.snapshot().losses == 0
    # before there is a camera they wait for it
    waiting = TrackingSession(made.model)
    waiting.set_options(options)
    waiting.set_camera(made.camera)
    waiting.start(*guess(made))
    assert close(made, 0, waiting.add(images[0]))


def test_a_folder_gives_poses_and_a_video(recording, folder, tmp_path):
    made = recording[0]
    seen = []
    table = PosesTable()
    with open_source(folder) as source, \
            OverlayVideo(tmp_path / 'overlay.avi', playing_rate_hz(source)) as video:
        draw = drawing_into(video, [made.model], made.camera)
        run, = track_objects(source, [Target(made.model, guess(made))], made.camera, listeners=(
            lambda frame, tracked: table.add(frame, tracked[0]), draw,
            lambda frame, _: seen.append(frame.index)))
    assert run.followed and run.images == VIEWS and seen == list(range(VIEWS))
    assert run.rms_px < 1.0 and f'Tracked in {VIEWS} of {VIEWS} images' in run.text()
    poses = read_poses(table.write(tmp_path / 'poses.csv'))
    angle, share = pose_errors(poses['rotation'], poses['translation'], made.rotations,
                               made.translations)
    assert np.median(share) < 0.005 and np.rad2deg(np.median(angle)) < 1.0
    assert (poses['sigma_t'] > 0).all() and (poses['focal_px'] == made.camera.K[0, 0]).all()
    video = cv2.VideoCapture(str(tmp_path / 'overlay.avi'))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == VIEWS
    assert sorted(path.name for path in tmp_path.iterdir()) == ['overlay.avi', 'poses.csv']


def test_a_calibration_of_another_size_is_refused_before_anything(recording, folder):
    made = recording[0]
    other = Camera(made.camera.K, (), 640, 480)
    with open_source(folder) as source, \
            pytest.raises(InputError, match='320x240, the calibration is for 640x480'):
        track_objects(source, [Target(made.model, guess(made))], other)


def test_starts_are_read_from_numbers_files_and_clicks(recording, tmp_path):
    made = recording[0]
    R, t = made.rotations[0], made.translations[0]
    numbers = ' '.join(f'{value:.9f}' for value in (*t, *rotation_vector(R)))
    (tmp_path / 'a.pos').write_text(numbers)
    corners = made.model.vertices[:6]
    (tmp_path / 'a.init').write_text('6\n' + '\n'.join(' '.join(map(str, c)) for c in corners))
    clicks = made.camera.project(corners @ R.T + t).ravel()
    for init, given in ((numbers, None), (str(tmp_path / 'a.pos'), None),
                        (str(tmp_path / 'a.init'), clicks)):
        angle, share = pose_errors(*read_start(init, given, made.camera), R, t)
        assert angle < 1e-3 and share < 1e-3
    (tmp_path / 'words.pos').write_text('hi\n')
    wrong = np.random.default_rng(0).uniform(0, 240, 12)
    for init, given, error, words in (
            (None, None, ArgumentError, 'Say where'), ('1 2 3', None, ArgumentError, 'six finite'),
            ('1 2 3 4 5 nan', None, ArgumentError, 'six finite'),
            ('0 0 x 0 0 0', None, ArgumentError, 'six finite'),
            (str(tmp_path / 'a.init'), None, ArgumentError, '--clicks'),
            (str(tmp_path / 'a.init'), [1, 2, 3], ArgumentError, 'takes 12 numbers'),
            (str(tmp_path / 'a.init'), wrong, InputError, 'order of a.init'),
            (str(tmp_path / 'words.pos'), None, InputError, "holds 'hi', where numbers are"),
            (numbers, clicks, ArgumentError, 'leave one of them out'),
            (str(tmp_path / 'a.pos'), clicks, ArgumentError, 'leave one of them out'),
            ('nowhere.pos', None, InputError, 'nowhere.pos')):
        with pytest.raises(error, match=words):
            read_start(init, given, made.camera)


def test_a_loss_in_a_single_image_is_told_as_one():
    run = TrackingRun(images=5, by_state={'lost': 4, 'tracking': 1},
                      stretches=[(2, 2, 'Hidden.'), (7, 9, 'Gone.')])
    said = run.text().splitlines()
    assert 'Lost in image 2: Hidden.' in said and 'Lost from image 7 to 9: Gone.' in said


def test_a_loss_is_one_where_only_every_third_image_is_tracked(session, recording):
    made, images = recording
    run = TrackingRun()
    for k in range(12):
        image = np.zeros_like(images[0]) if 2 <= k < 9 else images[0]
        run.count(3 * k, session.add(image))
    (first, last, _), = run.stretches
    assert first % 3 == 0 and 9 <= first <= 21 and last >= 24
    assert run.text().count('Lost ') == 1


def test_a_start_after_a_search_is_sought_where_it_was(recording):
    made, images = recording
    blank = np.full_like(images[0], 120)
    said = []
    for seeks in (False, True):
        session = TrackingSession(made.model, camera=made.camera)
        if seeks:
            session.seek()
            for _ in range(2):
                assert session.add(blank).state is TrackerState.LOST
        session.start(*guess(made))
        frames = [session.add(blank) for _ in range(6)]
        assert frames[-1].state is TrackerState.LOST and len(frames[-1].image_px)
        said.append(frames[-1].reason)
    assert said[0] == said[1]
