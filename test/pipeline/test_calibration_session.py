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
"""The session that the calibrator node drives: keyframes, bounded memory, resets, requests."""

from dataclasses import replace

import numpy as np
import pytest

from selfcal_ros.calibration.result import HINT, NotCalibrated
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.pipeline.calibration_session import (CalibrationSession, EstimateRequest,
                                                      SessionSettings)
from selfcal_ros.synthetic.special_scenes import drive

SIZE = (640, 480)
STEP_NS = 33_000_000


def panning(step_px, frames, width=4000, seed=0):
    """Yield ids and positions of a camera that slides along a wall of points."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((0, 0), (width, 480), (width // 4, 2))
    for k in range(frames):
        xy = points - (k * step_px, 0)
        seen = np.flatnonzero((xy[:, 0] >= 0) & (xy[:, 0] < 640))
        yield seen, xy[seen]


def fed(settings=SessionSettings(), step_px=10, frames=100):
    session = CalibrationSession(settings)
    for k, (ids, xy) in enumerate(panning(step_px, frames)):
        session.add_tracks(k * STEP_NS, ids, xy, SIZE)
    return session


class FakeCalibration:
    """Stands for a calibration; true."""

    def __init__(self, sigma_px=1.0):
        self.camera = Camera(np.diag([500.0, 500.0, 1.0]), width=640, height=480)
        self.sigma = {'fx': sigma_px, 'cx': sigma_px, 'cy': sigma_px}


def played(session, first_ns, frames=40, seed=0):
    """Add a passage whose first image has this stamp; return what the first one interrupted."""
    said = [session.add_tracks(first_ns + k * STEP_NS, ids + 10_000 * seed, xy, SIZE)
            for k, (ids, xy) in enumerate(panning(10, frames, seed=seed))]
    assert not any(said[1:])
    return said[0]


def test_keyframes_are_one_step_of_parallax_apart():
    session = fed(step_px=10, frames=30)
    step = SessionSettings().parallax * np.hypot(*SIZE)
    gaps = np.diff([frame.index for frame in session.keyframes])
    assert (gaps == np.ceil(step / 10)).all()


def test_a_robot_that_stands_gathers_nothing():
    session = fed(step_px=0, frames=50)
    assert len(session.keyframes) == 1
    assert session.snapshot().frames == 50


def test_memory_is_bounded_and_the_views_stay_spread_and_connected():
    settings = SessionSettings(max_keyframes=12)
    session = fed(settings, step_px=20, frames=170)
    frames = session.keyframes
    assert len(frames) <= 12
    for before, after in zip(frames, frames[1:]):
        assert np.intersect1d(before.ids, after.ids).size >= settings.min_common
    # no more than the newest gap may differ from an even spread
    gaps = np.diff([frame.index for frame in frames])
    assert gaps.max() <= 3 * np.median(gaps)


def test_an_empty_image_is_no_keyframe():
    session = CalibrationSession()
    session.add_tracks(0, [], np.zeros((0, 2)), SIZE)
    assert not session.keyframes
    assert session.request() is None


def test_points_that_are_not_finite_or_twice_there_are_left_out():
    session = CalibrationSession()
    xy = np.random.default_rng(0).uniform(0, 400, (20, 2))
    xy[3] = np.nan
    ids = np.arange(20)
    ids[5] = 4
    session.add_tracks(0, ids, xy, SIZE)
    assert session.keyframes[0].ids.tolist() == [i for i in range(20) if i not in (3, 5)]


def test_time_that_jumps_back_begins_tracks_anew():
    session = fed(frames=40)
    ids, xy = next(panning(10, 1))
    interruption = session.add_tracks(0, ids, xy, SIZE)
    assert 'jumped back' in interruption.reason and not interruption.forgets
    assert len(session.keyframes) == 1


@pytest.mark.parametrize('step_s', [-0.25, -10, 10, 3600])
def test_a_step_of_the_clock_leaves_the_calibration_in_force(step_s):
    session = CalibrationSession()
    start = 10 ** 18
    played(session, start)
    calibration = FakeCalibration()
    session.accept(session.request(), calibration)
    newest = start + 39 * STEP_NS
    interruption = played(session, newest + int(step_s * 1e9), seed=1)
    assert (interruption is not None) == (step_s < 0)
    assert session.calibration is calibration
    # fewer views than the one in force rests on would hardly do better
    assert session.is_due()
    request = session.request()
    assert request.start is calibration
    known = {frame.index for frame in session.keyframes}
    assert known == set(request.tracks.frames.tolist())
    if step_s < 0:
        assert min(known) >= 40, 'no view shares a track with those before the step'


def test_one_stamp_that_is_wrong_costs_no_calibration():
    session = CalibrationSession()
    played(session, 0)
    calibration = FakeCalibration()
    session.accept(session.request(), calibration)
    ids, xy = next(panning(10, 1))
    assert session.add_tracks(39 * STEP_NS - 250_000_000, ids, xy, SIZE)
    assert session.add_tracks(40 * STEP_NS, ids, xy, SIZE) is None
    assert session.calibration is calibration and not session.is_due()


def test_what_was_asked_for_before_the_clock_stepped_is_taken():
    session = CalibrationSession()
    for lap in range(3):
        played(session, 0, seed=lap)
        request = session.request()
        assert played(session, 0, frames=3, seed=9)
        better = FakeCalibration(3.0 - lap)
        assert session.accept(request, better) and session.calibration is better
        # of another section, and less precise
        played(session, 0, seed=lap + 20)
        assert session.accept(session.request(), FakeCalibration(5.0))
        assert session.calibration is better and session.snapshot().failure is None


def test_after_an_alarm_a_less_precise_calibration_is_in_force():
    session = CalibrationSession()
    played(session, 0)
    session.accept(session.request(), FakeCalibration(0.1))
    session.hold()
    played(session, 0, seed=1)
    session.keep_since(session.keyframes[1].index)
    changed = FakeCalibration(1.0)
    session.accept(session.request(), changed)
    assert session.calibration is changed


def test_a_message_that_was_overtaken_is_ignored():
    session = fed(frames=40)
    ids, xy = next(panning(10, 1))
    assert session.add_tracks(38 * STEP_NS, ids, xy, SIZE) is None
    assert session.snapshot().frames == 40


def test_images_that_change_size_start_anew():
    session = fed(frames=40)
    ids, xy = next(panning(10, 1))
    session.accept(session.request(), FakeCalibration())
    interruption = session.add_tracks(41 * STEP_NS, ids, xy, (320, 240))
    assert '640x480 to 320x240' in interruption.reason and interruption.forgets
    assert session.calibration is None
    assert session.snapshot().image_size == (320, 240)


def test_estimates_come_when_there_is_enough_new():
    settings = SessionSettings(first_estimate=5, growth=0.5)
    session = CalibrationSession(settings)
    due = []
    for k, (ids, xy) in enumerate(panning(30, 30)):
        session.add_tracks(k * STEP_NS, ids, xy, SIZE)
        if session.is_due():
            due.append(len(session.keyframes))
            request = session.request()
            assert not session.is_due() and session.request() is None, 'one at a time'
            session.accept(request, NotCalibrated('not yet'))
    assert due == [5, 10, 20]
    assert session.is_due(idle=True), 'when nothing more comes, the rest is used'
    session.accept(session.request(), NotCalibrated('not yet'))
    assert not session.is_due(idle=True)


def test_a_failure_leaves_the_calibration_that_there_is():
    session = fed()
    first = session.request()
    assert session.accept(first, FakeCalibration())
    again = session.request()
    assert again.start is session.calibration
    session.accept(again, NotCalibrated('worse'))
    assert isinstance(session.calibration, FakeCalibration)
    assert session.snapshot().failure.reason == 'worse'


def test_a_hint_is_no_calibration_and_a_start_where_there_is_none():
    session, known = fed(), FakeCalibration()
    session.accept(session.request(), NotCalibrated('So little.', kind=HINT, hint=known))
    assert session.calibration is None and session.snapshot().failure.is_hint
    again = session.request()
    assert again.start is known
    session.accept(again, FakeCalibration())
    session.accept(session.request(), NotCalibrated('So little.', kind=HINT, hint=known))
    assert session.request().start is session.calibration is not known


def test_other_facts_make_an_estimate_due_and_drop_the_one_under_way():
    session = fed(step_px=20, frames=30)
    session.accept(session.request(), FakeCalibration())
    assert session.request().start is not None
    facts = CameraFacts(aspect_ratio=1.0)
    session.change(replace(session.settings, facts=facts))
    # what was asked for by the old facts is no answer any more
    under_way = session.calibration
    assert not session.is_due() and session.snapshot().estimating
    old = EstimateRequest(None, session.settings, None, 0, 8)
    assert not session.accept(old, FakeCalibration()) and session.calibration is under_way
    assert session.is_due()
    request = session.request()
    assert request.settings.facts == facts and request.start is None
    assert session.accept(request, FakeCalibration()) and not session.is_due()
    assert session.calibration is not under_way


def test_other_bounds_hold_for_what_has_been_gathered():
    session = fed(step_px=20, frames=50)
    before = {frame.index for frame in session.keyframes}
    session.change(replace(session.settings, max_keyframes=8, parallax=0.3))
    assert len(session.keyframes) == 8
    assert {frame.index for frame in session.keyframes} <= before
    # no other facts: nothing is due for that
    session.accept(session.request(), NotCalibrated('', ''))
    session.change(replace(session.settings, parallax=0.1))
    assert not session.is_due()
    for k, (ids, xy) in enumerate(panning(20, 80)):
        if k >= 50:
            session.add_tracks(k * STEP_NS, ids, xy, SIZE)
    assert session.keyframes[-1].index - session.keyframes[-2].index == 4


@pytest.mark.long
def test_many_keyframes_go_at_once_in_the_order_and_the_time_of_one_by_one(monkeypatch):
    most, least = 400, 3
    session = fed(SessionSettings(max_keyframes=most, parallax=1e-3), step_px=8, frames=most)
    expected = list(session.keyframes)
    assert len(expected) == most
    while len(expected) > least:
        shared = [len(np.intersect1d(before.ids, after.ids))
                  for before, after in zip(expected, expected[2:])]
        widest = int(np.argmax(shared))
        del expected[widest + 1 if shared[widest] >= session.settings.min_common else 0]
    compared, intersect = [], np.intersect1d

    def counting(*args, **kwargs):
        compared.append(1)
        return intersect(*args, **kwargs)

    monkeypatch.setattr(np, 'intersect1d', counting)
    session.change(replace(session.settings, max_keyframes=least, first_estimate=least))
    assert [frame.index for frame in session.keyframes] == [frame.index for frame in expected]
    assert len(compared) <= 3 * most


def test_an_estimate_that_was_wished_for_follows_the_one_that_is_dropped():
    session = fed(step_px=20, frames=30)
    under_way = session.request()
    assert session.request() is None and not session.snapshot().abandoned
    facts = CameraFacts(aspect_ratio=1.0)
    # by itself the next would come much later
    session.change(replace(session.settings, facts=facts, first_estimate=40))
    assert session.snapshot().abandoned and session.request() is None
    assert not session.is_due()
    assert not session.accept(under_way, FakeCalibration()) and session.is_due()
    assert session.request().settings.facts == facts and not session.is_due()
    # an alarm puts an end to the wish
    session.change(replace(session.settings, facts=CameraFacts()))
    assert session.request() is None
    session.hold()
    session.accept(under_way, FakeCalibration())
    assert not session.is_due()


def test_a_result_that_was_asked_for_before_a_reset_is_dropped():
    session = fed()
    request = session.request()
    session.reset()
    assert not session.accept(request, FakeCalibration())
    assert session.calibration is None
    assert not session.snapshot().estimating


def test_the_request_passes_on_facts_start_and_clean_tracks():
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0)
    session = fed(SessionSettings(facts=facts))
    session.accept(session.request(), FakeCalibration())
    asked = {}

    def calibrate(tracks, **options):
        asked.update(options, tracks=tracks)
        return NotCalibrated('a wall tells nothing')

    request = session.request()
    assert isinstance(request, EstimateRequest)
    assert not request.run(calibrate)
    assert asked['facts'] is facts and asked['start'] is session.calibration.camera
    assert asked['tracks'].image_size == SIZE
    assert len(asked['tracks']) > 0.9 * len(request.tracks)


@pytest.mark.parametrize('settings', [{'parallax': 0.0}, {'first_estimate': 2},
                                      {'first_estimate': 50, 'max_keyframes': 40}])
def test_impossible_settings_are_refused(settings):
    with pytest.raises(ArgumentError):
        SessionSettings(**settings)


def test_a_drive_is_calibrated_and_gets_better():
    sequence = drive(np.random.default_rng(4), noise_px=0.1, views=20, tracks=700)
    tracks = sequence.tracks
    session = CalibrationSession(SessionSettings(
        parallax=1e-3, first_estimate=10, growth=1.0,
        facts=CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')))
    results = []
    for frame in tracks.frames:
        mask = tracks.frame == frame
        session.add_tracks(int(frame) * STEP_NS, tracks.track[mask], tracks.xy[mask],
                           (sequence.camera.width, sequence.camera.height))
        if session.is_due():
            request = session.request()
            session.accept(request, request.run())
            results.append(session.calibration)
    request = session.request()
    session.accept(request, request.run())
    last = session.calibration
    assert last, session.snapshot().failure
    error = last.camera.parameters - sequence.camera.parameters
    for name, value in zip(('fx', 'fy', 'cx', 'cy'), error):
        assert abs(value) < 4 * last.sigma[name], (name, value, last.sigma[name])
    earlier = [result for result in results if result]
    assert earlier and last.sigma['fx'] < earlier[0].sigma['fx']
