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
"""Keyframes to windows to a verdict; and a session that keeps its calibration until told."""

from dataclasses import dataclass, replace

from bench.mounts.mount_worlds import odometry
import numpy as np
import pytest
from selfcal_ros import calibrate
from selfcal_ros.calibration.mount import Mount, mount_rotation, MountFacts, NAMES
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.pipeline.calibration_session import CalibrationSession, Keyframe, SessionSettings
from selfcal_ros.pipeline.monitoring import MAX_WAITING, Monitoring
from selfcal_ros.pipeline.robot.live_robot import RobotSnapshot
from selfcal_ros.pipeline.robot.robot_source import RobotSource
from selfcal_ros.synthetic.special_scenes import drive
from selfcal_ros.values.neighbours import Film, SeenPoints

SIZE = (640, 480)
VIEWS, CALIBRATED = 50, 20


@pytest.fixture(scope='module')
def road():
    """Tracks of a drive, and a calibration from its beginning."""
    tracks = drive(np.random.default_rng(31), 0.1, VIEWS, 1600).tracks
    first = tracks.in_frames(range(CALIBRATED)).with_at_least(2)
    return tracks, first, calibrate(first, motion='planar', facts=CameraFacts(
        aspect_ratio=1.0, skew=0.0, distortion='none'))


def keyframe(tracks, index):
    mask = tracks.frame == index
    return Keyframe(index, index * 10**9, tracks.track[mask], tracks.xy[mask])


@pytest.mark.long
def test_windows_are_scored_and_agree_with_the_calibration(road):
    tracks, first, calibration = road
    monitoring = Monitoring()
    monitoring.watch(calibration, first)
    for index in range(CALIBRATED, VIEWS):
        for _ in range(2):      # a keyframe that is offered twice counts once
            monitoring.add_keyframe(keyframe(tracks, index), SIZE)
    monitoring.work_off()
    state = monitoring.snapshot()
    assert state.windows == 3 and state.skipped == 0 and state.change is None
    assert 0 <= state.statistic < state.threshold


@pytest.mark.parametrize('ended', [False, True])
def test_windows_of_a_video_wait_for_the_image_after_them(road, ended):
    tracks, first, calibration = road
    film, monitoring = Film(), Monitoring()
    monitoring.watch(calibration, first)
    while monitoring.next_request():
        pass
    last = monitoring.settings.keyframes - 1
    for index in range(last + 1):
        frame = keyframe(tracks, index)
        film.add(SeenPoints(frame.ids, frame.xy, frame.stamp_ns))
        newest = replace(frame, filmed=film.keep())
        monitoring.add_keyframe(newest, SIZE)
    assert monitoring.next_request() is None
    if ended:
        monitoring.interrupt()
    else:
        after = keyframe(tracks, last + 1)
        film.add(SeenPoints(after.ids, after.xy, after.stamp_ns))
        monitoring.add_keyframe(newest, SIZE)
    window = monitoring.next_request().tracks
    followed = np.isfinite(window.neighbours).all(axis=2)
    assert list(window.frames) == list(range(last + 1))
    assert followed[(window.frame > 0) & (window.frame < last)].mean() > 0.8
    assert followed[window.frame == last, 1].any() != ended
    assert monitoring.next_request() is None


def robot_with(sequence, knocked_from, knock_deg):
    """Return a mount, and odometry of a body whose camera is knocked at a view."""
    mount = np.eye(4)
    mount[:3, :3], mount[:3, 3] = mount_rotation(0, np.radians(20), np.radians(5)), (0.3, 0.1, 0.6)
    knocked = mount.copy()
    knocked[:3, :3] = rotation_matrix(np.radians(knock_deg)) @ mount[:3, :3]
    cameras = np.broadcast_to(np.eye(4), (VIEWS, 4, 4)).copy()
    cameras[:, :3] = sequence.cam_from_world
    late = (np.arange(VIEWS) >= knocked_from)[:, None, None]
    body = np.linalg.inv(np.where(late, knocked, mount) @ cameras)
    sigma = np.array([0.002, 0.002, np.inf, 2e-4, 2e-4, 1e-3, 1e-3, 0])
    odometer = (0.01, 0.001, 1e-3, 1e-3, 1e-3, 3e-3)
    found = Mount('base_link', mount, np.diag(sigma**2), dict.fromkeys(NAMES, 'estimated'), 1.0,
                  0.0, {}, CALIBRATED, 0, 0.0, 0.0, pose_sigmas=odometer)
    poses = odometry(np.random.default_rng(6), body[:, :3, :3], body[:, :3, 3],
                     (0.01, 0.001, 0.003), stamps_ns=np.arange(VIEWS) * 10**9)
    return found, RobotSnapshot(RobotSource.parse('/odom'), MountFacts(), poses)


@pytest.mark.long
def test_a_camera_that_is_knocked_on_its_robot_is_noticed(road):
    tracks, first, calibration = road
    sequence = drive(np.random.default_rng(31), 0.1, VIEWS, 1600)
    mount, robot = robot_with(sequence, 28, (0, 0.5, 0))
    monitoring = Monitoring()
    monitoring.watch(replace(calibration, mount=mount), first)
    for index in range(CALIBRATED, VIEWS):
        monitoring.add_keyframe(keyframe(tracks, index), SIZE)
        while (request := monitoring.next_request(lambda: robot)) is not None:
            alarm = monitoring.accept(request, request.run())
            assert alarm is None or index > 30
    state = monitoring.snapshot()
    assert state.mount.windows == 3 and state.mount.skipped == 0
    assert state.change.turn == pytest.approx(np.radians([0, 0.5, 0]), abs=np.radians(0.1))
    assert 'pitch +0.' in str(state.change) and 'yaw' not in str(state.change)
    assert 20 <= state.change.since_frame <= 28 <= state.change.clear_from_frame <= 36
    # the camera itself is what it was
    assert state.statistic < state.threshold


def test_nothing_is_watched_before_there_is_a_calibration(road):
    tracks, first, calibration = road
    monitoring = Monitoring()
    for index in range(VIEWS):
        monitoring.add_keyframe(keyframe(tracks, index), SIZE)
    assert monitoring.next_request() is None and monitoring.change is None
    monitoring.watch(calibration, first)
    monitoring.forget()
    assert monitoring.next_request() is None and monitoring.snapshot().windows == 0


def test_scores_for_another_calibration_and_windows_that_say_nothing_do_not_count(road):
    tracks, first, calibration = road
    monitoring = Monitoring()
    monitoring.watch(calibration, first)
    late = monitoring.next_request()
    score = late.run()
    monitoring.watch(calibration, first)
    assert monitoring.accept(late, score) is None
    request = replace(monitoring.next_request(), reference=False)
    monitoring.accept(request, NotCalibrated('The estimate failed.'))
    assert monitoring.snapshot().windows == 0
    assert monitoring.snapshot().skipped == 1 and 'failed' in monitoring.snapshot().why_skipped


def test_a_slow_machine_leaves_windows_out(road):
    tracks, first, calibration = road
    monitoring = Monitoring()
    monitoring.watch(calibration, first)
    frame = keyframe(tracks, 0)
    for index in range(9 * MAX_WAITING):
        monitoring.add_keyframe(replace(frame, index=index), SIZE)
    state = monitoring.snapshot()
    assert state.skipped > 0 and 'keep up' in state.why_skipped


@dataclass(frozen=True)
class FakeCalibration:
    """Stands for a calibration of a stated precision."""

    sigma_px: float
    camera: Camera = Camera([[520, 0, 320], [0, 520, 240], [0, 0, 1]], (), *SIZE)
    focal: None = None

    @property
    def sigma(self):
        return dict.fromkeys(('fx', 'cx', 'cy'), self.sigma_px)


def fed(session, tracks, views):
    for view in views:
        frame = keyframe(tracks, view)
        session.add_tracks(frame.stamp_ns, frame.ids, frame.xy, SIZE)
    return session


SETTINGS = SessionSettings(parallax=1e-3, first_estimate=5, max_keyframes=10, growth=0.1)


@pytest.mark.parametrize('sigma_px, settled', [(0.3, True), (3.0, False)])
def test_a_precise_calibration_from_all_that_is_kept_stays(road, sigma_px, settled):
    session = fed(CalibrationSession(SETTINGS), road[0], range(12))
    session.accept(session.request(), FakeCalibration(sigma_px))
    fed(session, road[0], range(12, 20))
    assert session.is_due() is not settled
    assert session.request() is not None, 'who asks gets an estimate'


def test_one_from_fewer_views_gets_better(road):
    session = fed(CalibrationSession(SETTINGS), road[0], range(6))
    session.accept(session.request(), FakeCalibration(0.1))
    assert fed(session, road[0], range(6, 10)).is_due()


def test_a_session_that_is_held_takes_nothing_until_it_goes_on(road):
    session = fed(CalibrationSession(SETTINGS), road[0], range(6))
    session.accept(session.request(), FakeCalibration(1.0))
    under_way = fed(session, road[0], range(6, 9)).request()
    session.hold()
    assert not session.accept(under_way, FakeCalibration(2.0))
    fed(session, road[0], range(9, 24))
    assert session.calibration.sigma_px == 1.0 and not session.is_due(idle=True)
    session.keep_since(8)
    assert session.keyframes and min(frame.index for frame in session.keyframes) >= 8
    assert session.calibration.sigma_px == 1.0 and session.is_due()
    session.accept(session.request(), FakeCalibration(4.0))
    assert session.calibration.sigma_px == 4.0
