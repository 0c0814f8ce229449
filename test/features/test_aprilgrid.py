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
import cv2
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError
from selfcal_ros.features.targets import parse_target

pytestmark = pytest.mark.skipif(
    not hasattr(getattr(cv2, 'aruco', None), 'DICT_APRILTAG_36h11'),
    reason='this OpenCV has no AprilTags')
TAG, GAP = 100, 30


def picture(border_bits, upward, quarters):
    """Draw 4 x 3 tags, black squares between their corners, as Kalibr does or otherwise."""
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    draw = getattr(cv2.aruco, 'generateImageMarker', None) or cv2.aruco.drawMarker
    pitch = TAG + GAP
    board = np.full((3 * pitch + 3 * GAP, 4 * pitch + 3 * GAP), 255, np.uint8)
    for k in range(12):
        row, column = divmod(k, 4)
        y, x = 2 * GAP + (2 - row if upward else row) * pitch, 2 * GAP + column * pitch
        board[y:y + TAG, x:x + TAG] = np.rot90(draw(markers, k, TAG, borderBits=border_bits),
                                               quarters)
    for y in GAP + np.arange(4) * pitch:
        for x in GAP + np.arange(5) * pitch:
            board[y:y + GAP, x:x + GAP] = 0
    return board


@pytest.mark.parametrize('border_bits, upward, quarters', [(2, True, 0), (1, False, 1)],
                         ids=["Kalibr's", 'other'])
def test_corners_of_tags_are_where_they_were_drawn(border_bits, upward, quarters):
    board = picture(border_bits, upward, quarters)
    grid = parse_target('aprilgrid:4x3:0.08:0.3')
    h, w = board.shape
    H = cv2.getPerspectiveTransform(np.float32([[0, 0], [w, 0], [w, h], [0, h]]),
                                    np.float32([[60, 40], [590, 70], [550, 440], [90, 410]]))
    fine = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]) @ H
    image = cv2.resize(cv2.warpPerspective(board, fine, (2560, 1920), borderValue=200),
                       (640, 480), interpolation=cv2.INTER_AREA)
    image = np.clip(image + np.random.default_rng(0).normal(0, 2, image.shape), 0, 255)
    image = image.astype(np.uint8)
    image[:, :150] = 255                          # a part of the grid suffices
    identity, xy = grid.find(image)
    assert 24 <= len(identity) < 48 and len(set(identity.tolist())) == len(identity)
    # x to the right, y up, from the lower left corner of the lower left tag
    drawn = grid.known.points[identity, :2] / 0.08 * TAG * [1, -1] + [2 * GAP, h - 2 * GAP] - 0.5
    x = np.column_stack([drawn, np.ones(len(drawn))]) @ H.T
    assert np.sqrt(np.mean((xy - x[:, :2] / x[:, 2:])**2)) < 0.15


@pytest.mark.long
def test_nothing_is_found_where_there_is_no_grid():
    grid = parse_target('aprilgrid:4x3:0.08:0.3')
    for image in (np.zeros((1, 1), np.uint8), np.full((60, 80), 255, np.uint8),
                  np.random.default_rng(0).integers(0, 255, (120, 160), np.uint8)):
        assert len(grid.find(image)[0]) == 0
    # tags of other numbers
    other = parse_target('aprilgrid:2x1:0.08:0.3')
    assert len(other.find(picture(2, True, 0)[:130])[0]) == 0


@pytest.mark.parametrize('text, words', [
    ('aprilgrid:6x6:0.08', 'form aprilgrid'), ('aprilgrid:1x1:0.08:0.3', '2 to 587'),
    ('aprilgrid:30x30:0.08:0.3', '2 to 587'), ('aprilgrid:6x6:0.08:24', 'share of the side'),
    ('aprilgrid:6x6:0.08:-0.3', 'positive'),
])
def test_a_wrong_grid_is_refused_in_one_sentence(text, words):
    with pytest.raises(ArgumentError, match=words):
        parse_target(text)
