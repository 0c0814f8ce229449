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
"""The monitor where the model does not hold: rolling shutter, shaking, things that move."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from selfcal_ros.calibration.monitoring.change_detector import ChangeMonitor
from selfcal_ros.calibration.monitoring.window_score import window_score, WindowScore
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.synthetic.rolling_scenes import CAMERA, drive, record
from selfcal_ros.values.tracks import Tracks

FREE = ('f', 'cx', 'cy', 'k1', 'k2')
NOISE_PX, INTERVAL_S = 0.2, 0.3
TIMES = INTERVAL_S * np.arange(9)
SIGMAS = np.array([1.0, 0.8, 0.8])     # fx, cx, cy


def window(seed, readout_s=0.0, shake_deg=0.0):
    """Record nine keyframes of a drive."""
    rng = np.random.default_rng(seed)
    path = drive(rng, length_s=4.0, travel_m=2.0)
    if shake_deg:
        path = shaken(path, np.radians(shake_deg))
    return record(rng, path, readout_s, 1.0 + TIMES, noise_px=NOISE_PX, points=400).tracks


def shaken(path, size):
    """Pitch the camera faster than the keyframes tell."""
    def pose(time):
        time = np.asarray(time, float)
        R, centre = path(time)
        angle = size * np.sin(2 * np.pi * 1.9 * time + 1)
        one, none = np.ones_like(angle), np.zeros_like(angle)
        pitch = np.stack([one, none, none, none, np.cos(angle), -np.sin(angle), none,
                          np.sin(angle), np.cos(angle)], axis=-1).reshape(*angle.shape, 3, 3)
        return pitch @ R, centre
    return pose


def with_something_moving(seed, share):
    """Let a body follow the vehicle at a pace of its own, with that share of the tracks."""
    still = window(seed)
    rng = np.random.default_rng([seed, 9])
    path = drive(np.random.default_rng(seed), length_s=4.0, travel_m=2.0)
    middle = path(np.array([1.0 + TIMES[4]]))[1]

    def beside(time):
        # before a body that moves on, the vehicle seems to go there and back
        R, centre = path(time)
        pace = 0.5 * np.sin(2.5 * np.asarray(time, float))[..., None]
        return R, middle + pace * (centre - middle)

    moving = record(rng, beside, 0.0, 1.0 + TIMES, noise_px=NOISE_PX, points=400,
                    depth_m=(2.0, 3.0)).tracks
    some = moving.select(moving.track < round(share / (1 - share) * 400))
    return Tracks(np.r_[still.frame, some.frame],
                  np.r_[still.track, some.track + still.track.max() + 1],
                  np.concatenate([still.xy, some.xy]), still.image_size, still.stamps_ns)


def squares(score):
    """Tell how far the window is from the true camera, in sigmas of the whole."""
    return float(score.step @ score.information @ score.step) / max(1.0, score.variance_inflation)


def test_rows_that_are_read_in_turn_do_not_look_like_another_camera():
    score = window_score(window(1, readout_s=0.03), CAMERA, FREE, np.random.default_rng(0))
    assert squares(score) < chi2.isf(1e-3, len(FREE))
    assert score.line_delay == pytest.approx(0.1, abs=4 * score.line_delay_sigma)
    assert score.line_delay > 4 * score.line_delay_sigma
    # a camera that shakes between the keyframes makes every image another shape
    shaky = window_score(window(2, readout_s=0.016, shake_deg=1.0), CAMERA, FREE,
                         np.random.default_rng(0))
    assert squares(shaky) < chi2.isf(1e-3, len(FREE))


@pytest.mark.long
def test_neighbours_that_are_seconds_away_tell_a_delay_in_intervals():
    for interval_s, readout_s in ((0.3, 0.03), (0.1, 0.03)):
        rng = np.random.default_rng(1)
        path = drive(rng, length_s=4.0 * interval_s / INTERVAL_S, travel_m=2.0)
        video = record(rng, path, readout_s, interval_s * (10 / 3 + np.arange(9)),
                       noise_px=NOISE_PX, points=400, interval_s=1 / 30).tracks
        score = window_score(video, CAMERA, FREE, np.random.default_rng(0))
        expected = readout_s / interval_s
        # how the camera moved between the images is known to about a hundredth
        assert score.line_delay == pytest.approx(expected, abs=0.01 * expected)
        assert score.noise_px < 1.1 * NOISE_PX
        # without stamps nobody knows how many intervals they are away
        unstamped = replace(video, stamps_ns=None)
        alone = replace(unstamped, neighbours=None)
        same = [window_score(one, CAMERA, FREE, np.random.default_rng(0)).line_delay
                for one in (unstamped, alone)]
        assert same[0] == same[1] == pytest.approx(expected, rel=0.05)


def test_what_moves_by_itself_is_set_aside():
    score = window_score(with_something_moving(3, 0.3), CAMERA, FREE, np.random.default_rng(0))
    assert score.still < 0.95
    assert score.noise_px < 1.1 * NOISE_PX
    assert squares(score) < chi2.isf(1e-3, len(FREE))


def test_images_that_are_shifted_do_not_look_like_another_camera():
    still = window(4)
    by_view = np.random.default_rng(4).normal(0, 3.0, (len(TIMES), 2))
    tracks = replace(still, xy=still.xy + by_view[still.frame])
    plain, known = (window_score(tracks, CAMERA, FREE, np.random.default_rng(0), shift_px)
                    for shift_px in (0.0, 3.0))
    assert squares(plain) > chi2.isf(1e-3, len(FREE)) > squares(known)
    assert known.noise_px < 1.1 * NOISE_PX < plain.noise_px


def test_the_monitor_knows_how_far_images_were_shifted():
    told = Finding('images_shifted', shift_px=3.0 * np.sqrt(2))
    assert ChangeMonitor(calibration()).shift_px == 0
    assert ChangeMonitor(replace(calibration(), findings=(told,))).shift_px == pytest.approx(3.0)


def calibration(f=520.0):
    """Calibration with square pixels and known distortion."""
    to_parameters = np.zeros((len(PARAMETER_NAMES), 3))
    to_parameters[[0, 1, 2, 3], [0, 0, 1, 2]] = 1
    to_parameters *= SIGMAS
    return Calibration(
        camera=Camera([[f, 0, 320], [0, f, 240], [0, 0, 1]], (), 640, 480),
        covariance=to_parameters @ to_parameters.T, status={}, held_by={}, motion='planar',
        facts=CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none'), frames=(),
        reprojection_rms_px=NOISE_PX, noise_sigma_px=NOISE_PX, observation_count=0,
        outlier_count=0, reconstruction=None)


#: Sigmas of f, cx, cy of windows at 0.2 px with a hundred points a view, and a known lens.
SIGMAS_OF_WINDOWS = np.array([1.4, 0.9, 2.5])
CORRELATION = np.array([[1, 0.1, 0.2], [0.1, 1, 0.1], [0.2, 0.1, 1]])


def scores(rng, count, f=520.0, **other):
    """Yield windows of a camera."""
    covariance = CORRELATION * np.outer(SIGMAS_OF_WINDOWS, SIGMAS_OF_WINDOWS)
    for k in range(count):
        step = rng.multivariate_normal([f - 520.0, 0, 0], covariance)
        yield replace(WindowScore((8 * k, 8 * k + 8), np.array([520.0, 320, 240]), step,
                                  np.linalg.inv(covariance), 1.0, NOISE_PX, 0.9), **other)


def test_windows_that_no_camera_explains_have_no_vote_and_are_counted():
    rng, monitor = np.random.default_rng(4), ChangeMonitor(calibration())
    for score in scores(rng, 4):
        monitor.learn(score)
    # what moves pulls a window as far as it likes
    for score in scores(rng, 20, f=700.0, noise_px=0.5, misfit=1.6, still=0.8):
        monitor.add(score)
    assert monitor.change is None and monitor.windows == 0 and monitor.unexplained == 20
    # more noise is noise where pairs of images have it, too
    for score in scores(rng, 3, noise_px=0.5):
        monitor.add(score)
    assert monitor.windows == 3 and monitor.unexplained == 0


def test_tracks_that_agree_with_themselves_alone_weigh_less():
    rng, monitor = np.random.default_rng(5), ChangeMonitor(calibration())
    for score in scores(rng, 4):
        monitor.learn(score)
    for score in scores(rng, 12, f=524.0, variance_inflation=8.0):
        monitor.add(score)
    assert monitor.change is None and monitor.windows == 12


def test_one_per_cent_of_the_focal_length_is_noticed_within_a_hundred_keyframes():
    late = []
    for seed in range(20):
        rng = np.random.default_rng([seed, 6])
        monitor = ChangeMonitor(calibration(520.0 + rng.standard_normal()))
        for score in (*scores(rng, 6), *scores(rng, 12, f=525.2)):
            monitor.add(score)
        late.append(monitor.change is None)
    assert np.mean(late) <= 0.05
