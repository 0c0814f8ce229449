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
"""What the live page shows, from drives whose turns are known."""

import json

import numpy as np
import pytest
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.report.live_advice import advise, Kind, LiveStatus
from selfcal_ros.report.live_state import LiveState, MOST_ESTIMATES, turn_deg

SIZE, FOCAL = (640, 480), 520.0
CALIBRATED = {'frames': '30', 'resets': '0', 'fx': '520', 'fx sigma': '5', 'cx': '320',
              'cx sigma': '4', 'cy': '240', 'cy sigma': '3', 'skew': '0', 'skew sigma': '0'}
FINE = LiveStatus(is_alive=True, text='calibrated', has_changed=False, no_images='',
                  has_tracks=True, points=300, is_still=False, left=45, right=45, rate=0,
                  coverage=0.9, empty='top left', sigma_share=0.01)


def seen(points, heading_deg, ahead):
    """Look from a point of a drive: identities and pixels of what is in the image."""
    turn = rotation_matrix(np.array([0.0, np.radians(heading_deg), 0.0]))
    inside = (points - [0, 0, ahead]) @ turn.T
    xy = FOCAL * inside[:, :2] / inside[:, 2:] + [320, 240]
    visible = (inside[:, 2] > 1) & (xy > 0).all(axis=1) & (xy < SIZE).all(axis=1)
    return np.flatnonzero(visible), xy[visible]


@pytest.mark.parametrize('degrees', [8.0, -8.0, 0.0])
@pytest.mark.parametrize('side', ['both', 'wall on the left'])
def test_a_turn_is_told_from_driving_on(degrees, side):
    rng = np.random.default_rng(1)
    points = rng.uniform([-12, -3, 6], [12 if side == 'both' else 0, 3, 30], (3000, 3))
    old = seen(points, 0.0, 0.0)
    new = seen(points, degrees, 0.4)
    # a wrong focal length scales it, no more
    for focal in (FOCAL, 0.8 * 640):
        assert turn_deg(old, new, focal, 640) == pytest.approx(degrees, abs=1.2)
    assert turn_deg(old, (new[0][:5], new[1][:5]), FOCAL, 640) is None


def test_a_drive_fills_the_image_and_its_turns_are_added_up():
    state, rng = LiveState(), np.random.default_rng(2)
    points = rng.uniform([-20, -6, 6], [20, 6, 30], (6000, 3))
    headings = [*np.arange(0, 41, 4.0), *np.arange(36, -13, -4.0)]
    for k, heading in enumerate(headings):
        state.take_tracks(*seen(points, heading, 0.05 * k), SIZE, 0.2 * k)
    shown = state.as_dict(0.2 * len(headings))
    assert shown['turned']['left'] == pytest.approx(40, abs=3)
    assert shown['turned']['right'] == pytest.approx(52, abs=3)
    assert shown['coverage']['share'] > 0.9
    assert shown['size'] == SIZE and max(shown['coverage']['cells']) == 1
    # one half of the image alone
    half = LiveState()
    for k, heading in enumerate(headings):
        ids, xy = seen(points, heading, 0.05 * k)
        half.take_tracks(ids[xy[:, 0] < 320], xy[xy[:, 0] < 320], SIZE, 0.2 * k)
    assert 0.4 < half.coverage <= 0.5
    assert 'right' in half._emptiest()


def test_sigmas_are_remembered_until_a_reset_and_no_longer_than_needed():
    state = LiveState()
    for k in range(MOST_ESTIMATES + 50):
        state.take_status('planar_calibrator', 'front', 0, 'calibrated',
                          {**CALIBRATED, 'frames': str(30 + k),
                           'fx sigma': str(10 / (k // 2 + 1))}, k)
    shown = state.as_dict(k)
    json.dumps(shown, allow_nan=False)
    history = shown['history']
    # what has not changed is no news
    assert len(history) == (MOST_ESTIMATES + 50) // 2
    assert history[0]['focal'] == pytest.approx(100 * 10 / 520)
    assert history[-1]['focal'] < 0.01
    assert [one['name'] for one in shown['parameters']] == ['fx', 'cx', 'cy', 'skew']
    assert shown['alive'] and not state.as_dict(k + 10)['alive']
    for k in range(2 * MOST_ESTIMATES):
        state.take_status('planar_calibrator', 'front', 0, 'calibrated',
                          {**CALIBRATED, 'frames': str(10 ** 6), 'fx sigma': str(1 + k)}, 9e3 + k)
    assert len(state.as_dict(1e4)['history']) == MOST_ESTIMATES
    state.take_status('planar_calibrator', 'front', 1, 'not calibrated yet',
                      {'frames': '0', 'resets': '1'}, 1e4)
    shown = state.as_dict(1e4)
    assert not shown['history'] and not shown['parameters'] and not any(shown['turned'].values())


def test_the_page_says_which_file_holds_the_numbers():
    state = LiveState()

    def shown(**changes):
        values = {**CALIBRATED, 'calibration file': '/c/front.yaml',
                  **{name.replace('_', ' '): value for name, value in changes.items()}}
        state.take_status('planar_calibrator', 'front', 0, 'calibrated', values, 1.0)
        return state.as_dict(1.0)

    first = shown()
    assert first['source'] == 'estimate' and not first['is_saved']
    assert first['kept'] == 'Not saved yet. The button writes /c/front.yaml.'
    fresh = shown(saved_at='10:31:05', saved='True')
    assert fresh['is_saved'] and fresh['kept'] == 'Saved in /c/front.yaml at 10:31:05.'
    older = shown(saved_at='10:31:05', saved='False')
    assert not older['is_saved']
    assert older['kept'] == ('/c/front.yaml holds the numbers of 10:31:05. Those here are newer: '
                             'save them, too.')
    # a reset takes the numbers, and leaves the file
    state.take_status('planar_calibrator', 'front', 1, 'not calibrated yet', {
        'frames': '0', 'resets': '1', 'calibration file': '/c/front.yaml', 'saved': 'False',
        'saved at': '10:31:05'}, 2.0)
    empty = state.as_dict(2.0)
    assert empty['source'] == '' and empty['parameters'] == []
    assert empty['kept'] == '/c/front.yaml holds the calibration that was saved at 10:31:05.'


def test_the_numbers_of_an_earlier_run_are_shown_as_such():
    state = LiveState()
    state.take_status('planar_calibrator', 'front', 1, 'the calibration of /c/front.yaml is in '
                      'force; not calibrated yet', {
                          'frames': '3', 'calibration file': '/c/front.yaml',
                          'file written': '2026-11-27 10:00', 'file fx': '500', 'file fx sigma':
                          '0.5', 'file k1': '-0.1'}, 1.0)
    shown = state.as_dict(1.0)
    assert shown['source'] == 'file' and not shown['history']
    assert shown['parameters'] == [{'name': 'fx', 'value': 500.0, 'sigma': 0.5},
                                   {'name': 'k1', 'value': -0.1, 'sigma': None}]
    assert 'of an earlier run, written 2026-11-27 10:00.' in shown['kept']
    # they are no reason to stop
    assert shown['advice']['kind'] != 'done'
    state.take_status('planar_calibrator', 'front', 0, 'calibrated', CALIBRATED, 2.0)
    assert state.as_dict(2.0)['source'] == 'estimate'


@pytest.mark.parametrize('values', [{'fx': 'nan', 'fx sigma': 'inf'}, {'fx': '', 'fx sigma': 'x'},
                                    {'frames': '1e999', 'fx': '-1', 'fx sigma': '-2'}])
def test_nonsense_in_the_diagnostics_is_shown_as_nothing(values):
    state = LiveState()
    state.take_status('<b>', '<script>', 200, '', values, 1.0)
    shown = state.as_dict(1.0)
    json.dumps(shown, allow_nan=False)
    assert not shown['history'] and shown['frames'] == 0


@pytest.mark.parametrize('change, kind, words', [
    ({'is_alive': False}, Kind.TROUBLE, 'Start the nodes'),
    ({'has_changed': True, 'sigma_share': 1e-4}, Kind.TROUBLE, 'The camera has changed'),
    ({'sigma_share': 0.0008, 'no_images': 'no images for 9 s'}, Kind.DONE, 'Save it'),
    ({'sigma_share': 0.0008, 'saved': '/c/front.yaml'}, Kind.DONE,
     'It is saved The focal length is known to 0.08 %, and /c/front.yaml holds it.'),
    ({'sigma_share': 0.01, 'saved': '/c/front.yaml'}, Kind.MOVE, 'Go on'),
    ({'no_images': 'no images for 9 s'}, Kind.TROUBLE, 'No images for 9 s.'),
    ({'has_tracks': False}, Kind.TROUBLE, 'Start the tracker'),
    ({'points': 7}, Kind.TROUBLE, 'Only 7 points'),
    ({'left': 0, 'right': 0, 'sigma_share': None}, Kind.LEFT, 'Turn left now'),
    ({'left': 40, 'right': 8}, Kind.RIGHT, 'Turn right now'),
    ({'left': 10, 'right': 40, 'rate': 20}, Kind.LEFT, 'Go on turning left'),
    ({'left': 40, 'right': 10, 'rate': 20}, Kind.RIGHT, 'Turn right now'),
    ({'is_still': True}, Kind.MOVE, 'Move on'),
    ({'coverage': 0.3}, Kind.MOVE, 'Fill the top left'),
    ({'sigma_share': None, 'text': 'the path is straight'}, Kind.MOVE, 'The path is straight.'),
    ({}, Kind.MOVE, 'Go on')])
def test_one_thing_to_do_at_a_time(change, kind, words):
    advice = advise(LiveStatus(**{**vars(FINE), **change}))
    assert advice.kind is kind
    assert words in f'{advice.do} {advice.why}'
