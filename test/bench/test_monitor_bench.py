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
"""The endless drives of the monitor's bench: true geometry, stated errors, honest counting."""

from itertools import islice

from bench.live.linear_windows import EndlessDrive, linear_hours, LinearWindow
from bench.live.monitor import (changed_camera, drawn_chances, DRIFT, episodes, KINDS, noticed,
                                rate_bound)
from bench.live.monitored_drive import keyframes, MeasuredDrive, window_of
import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.monitoring.change_detector import ChangeMonitor
from selfcal_ros.calibration.monitoring.window_score import window_score
from selfcal_ros.synthetic.special_scenes import drive


@pytest.fixture(scope='module')
def measured():
    """A drive that stands for the rendered one; 48 steps there and back are six windows."""
    sequence = drive(np.random.default_rng(3), 0.1, 25, 450)
    seen = np.zeros((25, len(sequence.points)), bool)
    seen[sequence.tracks.frame, sequence.tracks.track] = True
    calibration = calibrate(sequence.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0,
                                                               distortion='none'))
    points = np.column_stack([sequence.points, np.ones(len(sequence.points))])
    return MeasuredDrive(sequence.camera, sequence.cam_from_world, points, seen, 0.03, 0.02,
                         calibration)


def test_drives_go_there_and_back_with_new_points_and_drifting_errors(measured):
    there = list(islice(keyframes(measured, np.random.default_rng(0)), 49))
    tracks = window_of(there, (640, 480))
    assert tracks.frames.tolist() == list(range(49))
    first, last = there[0], there[48]
    # the same place, other tracks, the same points to within the errors
    assert len(first[1]) == len(last[1]) > 20 * len(np.intersect1d(first[1], last[1]))
    order = np.lexsort(np.round(first[2][:, ::-1] / 20).T)
    assert len(order) == measured.seen[0].sum()
    ideal = measured.camera.project(np.einsum(
        'ij,pj->pi', measured.poses[0], measured.points)[measured.seen[0]])
    apart = np.linalg.norm(ideal[:, None] - first[2][None], axis=2).min(axis=1)
    assert np.median(apart) < 0.2


def test_the_camera_changes_as_the_table_says(measured):
    camera = measured.camera
    for kind in KINDS:
        assert changed_camera(camera, kind, 50, 1.0, 49) is camera
        late = changed_camera(camera, kind, 50, 1.0, 50 + DRIFT).parameters - camera.parameters
        if 'focal' in kind:
            assert late[0] == pytest.approx(0.02 * camera.K[0, 0]) and not late[2:].any()
        else:
            assert np.hypot(*late[2:4]) == pytest.approx(5) and not late[:2].any()


@pytest.mark.long
def test_a_zoom_is_noticed(measured):
    delay, ratio, seconds = noticed(measured, 'focal length +2 %', 1)
    assert delay <= 50 and 0.5 < ratio < 1.5 and seconds


def test_drawn_hours_of_gaussian_windows_raise_nothing(measured):
    rng = np.random.default_rng(4)
    information = np.diag([0.3, 0.6, 0.5])
    piece = [(rng.standard_normal(3) / np.sqrt(np.diag(information)), information, 1.0)
             for _ in range(40)]
    chances = drawn_chances(measured, [piece], 5, hours=0.5)
    assert len(chances) >= 225 and chances.min() > 1e-4


def test_alarms_in_a_row_are_one_episode():
    chances = np.ones(100)
    chances[[10, 11, 15, 60, 99]] = 1e-9
    assert episodes(chances, 1e-6) == 3 and episodes(chances, 1e-10) == 0


def test_a_window_whose_keyframes_are_not_connected_is_no_window(measured):
    frames = [(index, at, identity, index) for index, at, identity in (
        (k, np.flatnonzero(measured.seen[k]), np.flatnonzero(measured.seen[k]))
        for k in range(9))]
    # new tracks in one view: nothing links it to the others
    index, at, identity, view = frames[4]
    frames[4] = index, at, identity + len(measured.points), view
    with pytest.raises(ValueError, match='not connected'):
        LinearWindow(measured, frames, ChangeMonitor(measured.calibration).free)


def test_no_event_in_three_hundred_hours_bounds_the_rate_by_one_in_a_hundred():
    assert rate_bound(0, 300) == pytest.approx(-np.log(0.05) / 300)
    assert 100 * rate_bound(0, 300) < 1 < 100 * rate_bound(1, 300)


@pytest.mark.long
def test_windows_to_first_order_err_as_whole_ones_do(measured):
    """The same errors, adjusted wholly and to first order."""
    monitor = ChangeMonitor(measured.calibration)
    true = Lens.of(measured.camera).take(monitor.free)
    whole = []
    frames = list(islice(keyframes(measured, np.random.default_rng(1)), 97))
    for first in range(0, 96, 8):
        score = window_score(window_of(frames[first:first + 9], (640, 480)), measured.camera,
                             monitor.free, np.random.default_rng(0))
        whole.append(score.at + score.step - true)
    endless = EndlessDrive(measured, 9, monitor.free)
    linear = [score[0] for _, score in endless.scores(np.random.default_rng(1), len(whole))]

    whole, linear = np.array(whole)[:, 0], np.array(linear)[:, 0]
    assert np.std(linear) == pytest.approx(np.std(whole), rel=0.35)
    assert np.corrcoef(whole, linear)[0, 1] > 0.6
    alarms, chances, _ = linear_hours(measured, 0.5, 1.0, 3)
    assert alarms == 0 and len(chances) == 225
