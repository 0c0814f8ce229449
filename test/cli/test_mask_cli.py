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
"""The option --mask: what it hides has no part in the result, and wrong files are told."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from selfcal_ros.features.mask import ImageMask, read_mask
from selfcal_ros.features.targets import Chessboard
from selfcal_ros.pipeline.feature_session import read_tracks
from selfcal_ros.pipeline.object_session import read_object_views
from selfcal_ros.synthetic.special_scenes import drive
from selfcal_ros.values.tracks import Tracks
from test_support.command_line import selfcal, SIZE


def _write_mask(name, size, black=None):
    usable = np.full(size[::-1], 255, np.uint8)
    if black is not None:
        usable[black] = 0
    cv2.imwrite(name, usable)
    return name


@pytest.fixture
def hidden_half():
    """Write the tracks of a drive above row 300 alone, and with wrong ones below; and a mask."""
    tracks = drive(np.random.default_rng(3), noise_px=0.1, views=14, tracks=300).tracks
    above = tracks.select(tracks.xy[:, 1] < 299.4)
    above.to_csv('above.csv')
    rng = np.random.default_rng(0)
    place = rng.uniform([20, 310], [620, 470], (240, 2))
    turn = np.arange(14)[:, None]
    # they revolve as nothing does that a camera drives past
    creep = np.repeat(40 * np.hstack([np.cos(turn), np.sin(turn)]), 240, axis=0) / 4
    Tracks(np.concatenate([above.frame, np.repeat(np.arange(14), 240)]),
           np.concatenate([above.track, np.tile(10_000 + np.arange(240), 14)]),
           np.concatenate([above.xy, np.tile(place, (14, 1)) + creep])).to_csv('t.csv')
    return _write_mask('mask.png', (640, 480), np.s_[300:])


@pytest.mark.long
def test_what_a_mask_hides_has_no_part_in_the_result(hidden_half):
    results = []
    for given in (['t.csv', '--mask', hidden_half], ['above.csv']):
        assert selfcal('calibrate', *given, '--motion', 'planar', *SIZE, '--quiet', '--force',
                       '--json', 'r.json') == 0
        results.append(json.loads(Path('r.json').read_text(encoding='utf-8')))
    masked, above = results
    assert abs(masked['camera']['fx'] - 520) < 4 * masked['sigma']['fx'] < 20
    assert masked['camera'] == above['camera'] and masked['sigma'] == above['sigma']
    # the mask tells the size of the images, too
    reading = read_tracks('t.csv', mask=read_mask(hidden_half))
    assert reading.tracks.image_size == (640, 480) and not reading.findings
    assert reading.tracks.xy[:, 1].max() < 300


def test_a_wrong_mask_is_status_2_in_one_sentence(capsys, driven):
    Path('text.png').write_text('white\n', encoding='utf-8')
    Path('images').mkdir()
    for number in range(3):
        cv2.imwrite(f'images/{number}.png', np.full((100, 120), 90, np.uint8))
    _write_mask('black.png', (640, 480), np.s_[:])
    _write_mask('small.png', (64, 48))
    for given, mask, words in (
            (['x.csv'], 'none.png', 'The mask none.png cannot be read: No such file'),
            (['x.csv'], '', 'The mask . cannot be read: Is a directory'),
            (['x.csv', 'y.csv'], 'text.png', 'The mask text.png is no image'),
            (['x.csv'], 'black.png', 'The mask black.png is black all over'),
            (['images'], 'small.png', 'small.png is 64x48 pixels, but the images are 120x100'),
            (['images', '--object', 'chessboard:5x4:0.1'], 'small.png', 'are 120x100'),
            ([driven[0], *SIZE], 'small.png', 'but the images are 640x480'),
            (['images', '--track', '--model', 'm.cao'], 'small.png', 'leave --mask out')):
        assert selfcal('calibrate', *given, '--quiet', '--mask', mask) == 2
        heard = capsys.readouterr()
        assert words in heard.err and heard.err.count('\n') == 1 and not heard.out


@pytest.mark.long
def test_many_recordings_share_a_mask(capsys):
    for number in range(2):
        drive(np.random.default_rng(number), 0.2, 12, 250, 12).tracks.to_csv(f'd{number}.csv')
    small = _write_mask('small.png', (64, 48))
    assert selfcal('calibrate', 'd0.csv', 'd1.csv', *SIZE, '--quiet', '--jobs', '1', '--mask',
                   small) == 2
    assert capsys.readouterr().err.count('small.png is 64x48 pixels') == 2


def test_a_board_behind_a_mask_is_not_looked_for(tmp_path):
    image = np.full((300, 640), 230, np.uint8)
    row, column = np.mgrid[:7, :6]
    board = np.kron(np.where((row + column) % 2, 230, 20), np.ones((30, 30))).astype(np.uint8)
    for left in (60, 400):
        image[45:255, left:left + 180] = board
    for number in range(2):
        cv2.imwrite(str(tmp_path / f'{number}.png'), image)
    for hidden, low, high in ((np.s_[:, :300], 400, 580), (np.s_[:, 300:], 60, 240)):
        usable = np.ones(image.shape)
        usable[hidden] = 0
        tracks = read_object_views(tmp_path, Chessboard(5, 6, 0.03), mask=ImageMask(usable)).tracks
        assert len(tracks) == 60
        assert ((tracks.xy[:, 0] > low) & (tracks.xy[:, 0] < high)).all()
