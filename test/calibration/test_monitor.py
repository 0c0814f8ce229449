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
"""The monitor: keeps still while the camera stays as it is, speaks soon when it changes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from selfcal_ros.calibration.monitoring.camera_change import MonitorSettings
from selfcal_ros.calibration.monitoring.change_detector import ChangeMonitor
from selfcal_ros.calibration.monitoring.window_score import window_score, WindowScore
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.synthetic.scenes import observe
from selfcal_ros.synthetic.special_scenes import drive
from selfcal_ros.values.tracks import Tracks

NOISE_PX = 0.1
VIEWS = 105
WINDOW = MonitorSettings().keyframes
TRUTH = Camera([[520, 0, 320], [0, 520, 240], [0, 0, 1]], (), 640, 480)
SIGMAS = np.array([1.0, 0.7, 0.8])     # fx, cx, cy


def calibration(camera=TRUTH, sigmas=SIGMAS):
    """Calibration with square pixels and known distortion."""
    to_parameters = np.zeros((len(PARAMETER_NAMES), 3))
    to_parameters[[0, 1, 2, 3], [0, 0, 1, 2]] = 1
    to_parameters *= sigmas
    return Calibration(
        camera=camera, covariance=to_parameters @ to_parameters.T, status={}, held_by={},
        motion='planar', facts=CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none'),
        frames=(), reprojection_rms_px=NOISE_PX, noise_sigma_px=NOISE_PX, observation_count=0,
        outlier_count=0, reconstruction=None)


def moved(focal=1.0, cx=0.0, cy=0.0):
    values = TRUTH.parameters
    values[:2] *= focal
    values[2:4] += cx, cy
    return Camera.from_parameters(values, 640, 480)


@pytest.fixture(scope='module')
def scene():
    """A long drive; the tracks of it by any camera at any view."""
    sequence = drive(np.random.default_rng(5), 0.0, VIEWS, 3000, camera=TRUTH)
    seen = np.zeros((VIEWS, len(sequence.points)), bool)
    seen[sequence.tracks.frame, sequence.tracks.track] = True
    return sequence, seen


def windows(scene, seed, camera_at=lambda view: TRUTH, first=0, last=VIEWS):
    """Yield the windows of a drive whose view k is taken by camera_at(k)."""
    sequence, seen = scene
    rng = np.random.default_rng(seed)
    for begin in range(first, last - WINDOW + 1, WINDOW - 1):
        parts = []
        for view in range(begin, begin + WINDOW):
            poses = sequence.cam_from_world[view:view + 1]
            tracks = observe(rng, camera_at(view), poses, sequence.points, NOISE_PX, True,
                             seen[view:view + 1]).tracks
            parts.append((np.full(len(tracks), view), tracks.track, tracks.xy))
        yield Tracks(*(np.concatenate(part) for part in zip(*parts)), (640, 480))


def watched(scene, seed, camera_at=lambda view: TRUTH, monitor=None, **span):
    """Watch a drive; returns the monitor after it, and the last view before the alarm."""
    monitor = monitor or ChangeMonitor(calibration())
    alarm = None
    for tracks in windows(scene, seed, camera_at, **span):
        monitor.add(window_score(tracks, monitor.camera, monitor.free,
                                 np.random.default_rng(0)))
        if monitor.change and alarm is None:
            alarm = int(tracks.frames[-1])
    return monitor, alarm


@pytest.mark.long
def test_scores_of_the_true_camera_scatter_as_they_say(scene):
    free = ChangeMonitor(calibration()).free
    scores = [window_score(tracks, TRUTH, free, np.random.default_rng(0))
              for tracks in windows(scene, 1)]
    squares = [score.step @ score.information @ score.step for score in scores]
    freedom = 3 * len(scores)
    assert chi2.ppf(1e-4, freedom) < np.sum(squares) < chi2.isf(1e-4, freedom)
    assert np.mean([score.variance_inflation for score in scores]) == pytest.approx(1, abs=0.15)
    assert np.mean([score.noise_px for score in scores]) == pytest.approx(NOISE_PX, rel=0.1)


@pytest.mark.long
def test_a_camera_that_stays_raises_no_alarm(scene):
    error = SIGMAS * [1.0, -1.0, 1.0]
    off = moved(1 + error[0] / 520, error[1], error[2])
    monitor, alarm = watched(scene, 3, monitor=ChangeMonitor(calibration(off)))
    assert alarm is None and monitor.windows == 13 and monitor.discarded == 0
    # its error of a sigma in each is no news
    assert monitor.statistic < chi2.isf(1e-3, 3)


@pytest.mark.parametrize('change, clear, stays', [
    ({'focal': 1.02}, [10.4, 0, 0], ('cx', 'cy')),
    ({'cx': 3.0, 'cy': -4.0}, [0, 3, -4], ('focal length',))], ids=['zoom', 'knock'])
def test_a_sudden_change_is_noticed_within_fifty_keyframes_and_named(scene, change, clear,
                                                                     stays):
    onset = 43
    monitor, alarm = watched(
        scene, 4, lambda view: moved(**change) if view >= onset else TRUTH, last=97)
    assert alarm is not None and alarm - onset < 50
    stated = monitor.change
    assert (np.abs(stated.change_px - clear) < 4 * stated.sigma_px).all(), str(stated)
    assert (stated.sigma_px < 2).all()
    assert not any(name in str(stated) for name in stays), str(stated)
    # to within the window that shows both cameras
    assert stated.since_frame - WINDOW < onset <= stated.clear_from_frame < onset + 2 * WINDOW


@pytest.mark.long
def test_a_slow_drift_is_noticed_before_it_is_over(scene):
    monitor, alarm = watched(scene, 6, lambda view: moved(1 + 0.03 * view / VIEWS))
    assert alarm is not None
    assert monitor.change.change_px[0] > 3 * monitor.change.sigma_px[0]


def test_a_calibration_that_never_fitted_is_noticed_and_a_vague_one_is_forgiven(scene):
    off = moved(cx=6.0)
    monitor, alarm = watched(scene, 7, monitor=ChangeMonitor(calibration(off, SIGMAS / 5)),
                             last=33)
    assert alarm is not None
    assert monitor.change.change_px[1] == pytest.approx(-6, abs=4 * monitor.change.sigma_px[1])
    vague, alarm = watched(scene, 7, monitor=ChangeMonitor(calibration(off, SIGMAS * 8)),
                           last=33)
    assert alarm is None


def test_one_rotten_window_proves_nothing_and_is_left_out(scene):
    monitor = ChangeMonitor(calibration())
    for k, score in enumerate(_gaussian_scores(np.random.default_rng(8), 30)):
        monitor.add(replace(score, step=score.step + [0, 40, 0]) if k == 9 else score)
    assert monitor.change is None and monitor.discarded == 1
    assert monitor.statistic < chi2.isf(1e-3, 3)


def _gaussian_scores(rng, count, sigmas=(2.0, 1.4, 1.8), at=(520.0, 320.0, 240.0)):
    information = np.diag(1 / np.square(sigmas))
    for k in range(count):
        yield WindowScore((8 * k, 8 * k + 8), np.array(at), rng.standard_normal(3) * sigmas,
                          information, 1.0, NOISE_PX, 1.0)


def test_false_alarms_stay_below_the_stated_rate():
    # 10 drives of 1600 keyframes at one stated false alarm in 4000 keyframes: 4 allowed
    settings = MonitorSettings(false_alarm_keyframes=4000, tolerance_px=0.01)
    rng = np.random.default_rng(9)
    alarms = 0
    for _ in range(10):
        monitor = ChangeMonitor(calibration(moved(cx=0.7 * rng.standard_normal()),
                                            (1e-3, 0.7, 1e-3)), settings)
        at = monitor.in_force
        for score in _gaussian_scores(rng, 200):
            monitor.add(replace(score, at=at, step=score.step + [520, 320, 240] - at))
            alarms += monitor.change is not None
            if monitor.change:
                break
    assert alarms <= 4


def test_the_threshold_follows_the_stated_rate():
    rare, often = (ChangeMonitor(calibration(), MonitorSettings(false_alarm_keyframes=n))
                   for n in (3.6e6, 3.6e3))
    assert chi2.sf(rare.threshold, 3) == pytest.approx(8 / 3.6e6)
    assert often.threshold < rare.threshold


def test_windows_of_the_calibration_teach_how_much_scenes_differ():
    tells = list(_gaussian_scores(np.random.default_rng(10), 6, (0.2, 0.2, 0.2)))
    monitor, taught = ChangeMonitor(calibration()), ChangeMonitor(calibration())
    for k, score in enumerate(tells):
        taught.learn(replace(score, step=score.step + [0, 4 * (-1)**k, 0]))
    for score in tells * 2:
        for one in (monitor, taught):
            one.add(replace(score, step=score.step + [0, 5, 0]))
    assert monitor.change is not None and taught.change is None


def test_evidence_of_a_hundred_hours_takes_little_memory():
    monitor = ChangeMonitor(calibration())
    for score in _gaussian_scores(np.random.default_rng(11), 1000):
        monitor.add(score)
    assert monitor.change is None
    assert len(monitor.remembered) < 60
    assert sum(block.windows for block in monitor.remembered) == 1000


def test_a_window_without_parallax_says_so():
    rng = np.random.default_rng(12)
    points = rng.uniform([-3, -2, 5], [3, 2, 9], (300, 3))
    turn = [np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
            for a in np.linspace(0, 0.2, WINDOW)]
    poses = np.concatenate([turn, np.zeros((WINDOW, 3, 1))], axis=2)
    tracks = observe(rng, TRUTH, poses, points, NOISE_PX, True).tracks
    free = ChangeMonitor(calibration()).free
    assert window_score(tracks, TRUTH, free, rng).kind == 'window_without_parallax'
    assert window_score(tracks.in_frames([0]), TRUTH, free,
                        rng).kind == 'too_few_images_share_points'


@pytest.mark.parametrize('settings', [{'keyframes': 2}, {'false_alarm_keyframes': 0},
                                      {'tolerance_px': 0}, {'tolerance_px': float('nan')}])
def test_impossible_settings_are_refused(settings):
    with pytest.raises(ArgumentError):
        MonitorSettings(**settings)
