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
"""Long recordings: what is chosen, what is followed, and what is said early."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from selfcal_ros import CameraFacts
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import InputError
from selfcal_ros.features.extraction import Extraction
from selfcal_ros.features.glance import Glance, glance
from selfcal_ros.features.segments import choose_segments, stood
from selfcal_ros.pipeline import long_recording
from selfcal_ros.pipeline.calibrate_input import calibrate_input, CalibrationSettings
from selfcal_ros.pipeline.long_policy import LongRecordings
from selfcal_ros.pipeline.sources import Excerpt, open_source
from selfcal_ros.report.result_json import result_to_dict
from selfcal_ros.report.timeline_figure import timeline_html
from selfcal_ros.synthetic.recordings import default_camera
from selfcal_ros.values.tracks import Tracks

BAG = Path(__file__).resolve().parents[2] / 'bags' / 'agv_drive'
#: That bag is long by this, and has room for two segments.
POLICY = LongRecordings(least_images=50, glances=22, images=24, longest=8, way=0.6, segments=2)


def _glances(seconds=600, rate_hz=2, every=15):
    """Stand for two minutes, drive straight on, turn at 300 s for 8 s, and blindly at 400 s."""
    found = []
    for k in range(seconds * rate_hz):
        t = k / rate_hz
        one = Glance(k * every, round(1e9 * t), 300, 0.9, 1.0)
        if t >= 120:
            one = replace(one, speed=0.02, fastest=0.05, growth=0.03, parallax=0.01)
        if 300 <= t < 308 or 400 <= t < 408:
            one = replace(one, speed=0.15, fastest=0.2, shift=(0.15, 0.0), parallax=0.03)
        if 400 <= t < 408:
            one = replace(one, followed=0.2)
        found.append(one)
    return found


def test_turns_are_chosen_and_what_stands_or_is_blurred_is_not():
    segments = choose_segments(_glances(), 1500, 600, 1.2, 3)
    assert len(segments) >= 2 and sum(one.images for one in segments) <= 1500
    best = segments[0]
    # nearly all of the turn is in it
    assert best.start_s <= 301 and best.end_s >= 306.5 and 'turning left' in best.why
    for one in segments:
        assert one.start_s >= 115 and not (400 <= one.start_s < 408) and one.images <= 601
        assert one.first == round(one.start_s * 30) and one.way <= 1.3
    order = sorted(segments, key=lambda one: one.first)
    assert all(a.last <= b.first for a, b in zip(order, order[1:]))
    assert [one.gain for one in segments] == sorted((one.gain for one in segments), reverse=True)
    assert not choose_segments([replace(one, followed=0.0) for one in _glances()], 900, 600, 1, 3)
    assert stood(_glances(seconds=120)) and not stood(_glances(seconds=130))


def test_turns_to_both_sides_are_worth_more_than_more_of_one():
    glances = [one if one.stamp_ns < 400e9 else replace(one, followed=0.9) for one in _glances()]
    # the camera turns left at 300 and at 400 s, and to the right, more slowly, at 500 s
    glances = [replace(one, speed=0.1, shift=(-0.1, 0.0)) if 500e9 <= one.stamp_ns < 508e9
               else one for one in glances]
    left, right = choose_segments(glances, 1000, 300, 1.2, 2)
    assert 'turning left' in left.why and 'turning right' not in left.why
    assert 'turning right' in right.why and 495 <= right.start_s <= 508


def test_a_glance_measures_the_motion():
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.integers(0, 255, (300, 400), np.uint8), (0, 0), 2.0)
    image = cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX)
    turn = cv2.getRotationMatrix2D((199.5, 149.5), -1.0, 1.01)
    turn[:, 2] += 3.0, -1.0
    seen = glance(7, 5, image, cv2.warpAffine(image, turn, (400, 300), borderMode=2), 0.1)
    assert seen.index == 7 and seen.followed > 0.7 and seen.covered > 0.9
    assert np.allclose(seen.shift, np.array([30.0, -10.0]) / 500, atol=0.003)
    assert seen.roll == pytest.approx(np.deg2rad(10.0), abs=0.004)
    assert seen.growth == pytest.approx(0.1, abs=0.01) and seen.parallax < 0.003
    still = glance(0, 0, image, image.copy(), 0.1)
    assert still.speed == still.fastest == 0.0 and still.texture > 100
    assert glance(0, 0, image * 0, image * 0, 0.1).texture == 0


def _settings(**more):
    return CalibrationSettings(facts=CameraFacts(aspect_ratio=1.0, skew=0.0),
                               **{'long': POLICY, **more})


def test_a_long_recording_is_followed_in_segments(monkeypatch):
    asked = []

    def by_turns(tracks, *, motion, facts, start, rng):
        """Say fx 500 +- 2, then 510 +- 4, as if from images."""
        asked.append((tracks, facts, start))
        shift, sigma = ((0.0, 2.0), (10.0, 4.0))[len(asked) - 1]
        camera = replace(default_camera(), K=np.array(
            [[500.0 + shift, 0, 320], [0, 500.0 + shift, 240], [0, 0, 1]]))
        names = camera.parameter_names
        spread = np.array([{'fx': sigma, 'fy': sigma, 'cx': 1.0, 'cy': 1.0}.get(name, 0.0)
                           for name in names])
        covariance = np.diag(spread**2)
        covariance[0, 1] = covariance[1, 0] = sigma**2
        return Calibration(
            camera=camera, covariance=covariance, motion='planar',
            status={name: 'estimated' if s else 'held' for name, s in zip(names, spread)},
            held_by={}, facts=replace(facts, distortion='none'), frames=tuple(tracks.frames),
            reprojection_rms_px=0.1, noise_sigma_px=0.1, observation_count=len(tracks),
            outlier_count=0, reconstruction=None)

    monkeypatch.setattr(long_recording, 'calibrate', by_turns)
    heard = []
    result, reading = calibrate_input(BAG, _settings(excerpt=Excerpt(start_s=1.0)),
                                      lambda text, *_: heard.append(text))
    # weights 1 / 4 and 1 / 16
    assert result.camera.K[0, 0] == pytest.approx(502.0, abs=0.01)
    expected = np.sqrt(1 / (1 / 4 + 1 / 16))
    assert expected <= result.sigma['fx'] < 2.2 * expected
    # the lens model of the first holds for the second, which starts from its camera
    assert asked[0][1].distortion == 'auto' and asked[1][1].distortion == 'none'
    assert asked[0][2] is None and asked[1][2].K[0, 0] == 500.0
    parts = result_to_dict(result)['segments']
    assert len(parts) == 2 and {part['status'] for part in parts} == {'used'}
    assert [part['fx'] for part in parts] == [500.0, 510.0]
    for (tracks, *_), part in zip(asked, parts):
        assert len(tracks.frames) >= 3 and len(tracks) > 500
        assert part['first'] <= tracks.frames.min() <= tracks.frames.max() <= part['last']
    # seconds and numbers are those of the whole recording, at 15 Hz
    for part in parts:
        assert part['first'] >= 15 and abs(part['start_s'] - part['first'] / 15) < 0.01
    assert (reading.tracks.frames == asked[0][0].frames).all()
    assert {'Looking through the recording', 'Following the segments'} <= set(heard)
    assert 'segments were followed' in result.findings[0].sentence
    page = timeline_html(reading.survey)
    assert '<svg' in page and page.count('<tr><td>') == 2 and '± 2 px' in page


def test_where_no_segment_calibrates_the_best_says_why(monkeypatch):
    monkeypatch.setattr(long_recording, 'calibrate', lambda *_, **__: NotCalibrated('No.'))
    nothing = Extraction(Tracks([], [], np.empty((0, 2)), (640, 480)), np.empty(0, int), 'video')
    monkeypatch.setattr(long_recording, 'extract_tracks',
                        lambda frames, *_, **__: [frame for frame in frames] and nothing)
    result, reading = calibrate_input(BAG, _settings(long=replace(POLICY, segments=1, whole=0)))
    assert not result and result.reason == 'No.'
    part, = result_to_dict(result)['segments']
    assert part['reason'] == 'No.' and part['status'] == 'refused' and part['fx'] is None
    assert 'not used: No.' in timeline_html(reading.survey)


def test_what_is_no_long_film_is_read_as_ever():
    with open_source(BAG) as source:
        assert POLICY.concern(source, _settings())
        assert not LongRecordings().concern(source, _settings())
        for other in ({'motion': 'translation'}, {'mode': 'wide'}, {'views': 4},
                      {'excerpt': Excerpt(every=2)}, {'translation_frames': (0, 1)},
                      {'facts': CameraFacts(focal='varying')}):
            assert not POLICY.concern(source, replace(_settings(), **other))
    with open_source(BAG, excerpt=Excerpt(duration_s=2.0)) as source:
        assert not POLICY.concern(source, _settings())


def test_what_shows_nothing_is_refused_before_anything_is_followed(tmp_path, monkeypatch):
    def never(*_, **__):
        raise AssertionError('nothing is to be followed')
    monkeypatch.setattr(long_recording, 'extract_tracks', never)
    rng = np.random.default_rng(0)
    image = cv2.resize(rng.integers(0, 255, (18, 24), np.uint8), (192, 144))
    for name, kind in (('standing', 1), ('blank', 0)):
        (tmp_path / name).mkdir()
        for k in range(60):
            cv2.imwrite(str(tmp_path / name / f'{k}.png'), image * kind)
    result, reading = calibrate_input(tmp_path / 'standing', _settings())
    assert not result and result.kind == 'no_motion' and reading.survey.glances
    with pytest.raises(InputError, match='need texture'):
        calibrate_input(tmp_path / 'blank', _settings())
