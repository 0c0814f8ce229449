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
from selfcal_ros.features.board_corners import scatter
from selfcal_ros.features.chessboard import Chessboard

BOARD = Chessboard(7, 5, 0.03)
SIDE = 60


def squares(rim):
    """Draw 8 x 6 squares, the first dark, with a white rim of so many pixels."""
    y, x = np.mgrid[:6 * SIDE, :8 * SIDE] // SIDE
    return np.pad(np.where((x + y) % 2 == 0, 20, 230).astype(np.uint8), rim, constant_values=230)


def seen(rim=SIDE, around=230, blur=0.0, contrast=1.0, noise=2.0):
    """Show a board in perspective; returns the image and where its corners are."""
    picture = squares(rim)
    h, w = picture.shape
    H = cv2.getPerspectiveTransform(
        np.float32([[0, 0], [w, 0], [w, h], [0, h]]),
        np.float32([[110, 60], [540, 110], [500, 420], [90, 390]]))
    # four samples a pixel each way: the edges are then where they should be
    fine = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]) @ H
    image = cv2.warpPerspective(picture, fine, (2560, 1920), borderValue=around)
    image = cv2.resize(image, (640, 480), interpolation=cv2.INTER_AREA).astype(float)
    if blur:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    image = 128 + (image - 128) * contrast
    image += np.random.default_rng(0).normal(0, noise, image.shape)
    drawn = BOARD.known.points[:, :2] / 0.03 * SIDE + SIDE + rim - 0.5
    x = np.column_stack([drawn, np.ones(len(drawn))]) @ H.T
    return np.clip(image, 0, 255).astype(np.uint8), x[:, :2] / x[:, 2:]


def error(xy, true):
    """Root mean square distance; a board may be counted from either end."""
    return min(np.sqrt(np.mean((xy - one)**2)) for one in (true, true[::-1]))


@pytest.mark.long
@pytest.mark.skipif(not hasattr(cv2, 'findChessboardCornersSB'),
                    reason='this OpenCV has no sector-based detector')
def test_a_board_cut_out_along_its_squares_is_found_and_no_corner_is_misplaced(monkeypatch):
    image, true = seen(rim=0, around=20)
    identity, xy = BOARD.find(image)
    assert (identity == np.arange(35)).all()
    # the detector itself puts one corner 11 px away
    assert error(xy, true) < 0.05
    large = cv2.resize(image, None, fx=1.6, fy=1.6, interpolation=cv2.INTER_CUBIC)
    assert error((BOARD.find(large)[1] + 0.5) / 1.6 - 0.5, true) < 0.05
    # neither in a quick look, nor without that detector
    assert len(BOARD.find(image, thorough=False)[0]) == 0
    monkeypatch.delattr(cv2, 'findChessboardCornersSB')
    assert len(BOARD.find(image)[0]) == 0


def test_corners_of_a_blurred_dull_image_are_located_better():
    image, true = seen(blur=3, contrast=0.3, noise=6)
    xy = BOARD.find(image)[1]
    # 0.5 px without smoothing
    assert error(xy, true) < 0.3
    # and the scatter tells how well
    assert scatter(xy, 7, 5) == pytest.approx(error(xy, true), rel=0.3)


def test_a_sharp_image_loses_nothing():
    image, true = seen()
    assert error(BOARD.find(image)[1], true) < 0.03


@pytest.mark.parametrize('image', [
    np.zeros((1, 1), np.uint8), np.zeros((3, 700), np.uint8), np.full((20, 20), 255, np.uint8),
    np.random.default_rng(0).integers(0, 255, (120, 160), np.uint8),
    np.indices((64, 64)).sum(axis=0).astype(np.uint8) % 2 * 255, squares(0)[::20, ::20],
], ids=['pixel', 'strip', 'white', 'noise', 'pixels', 'tiny'])
def test_odd_images_show_no_board(image):
    assert len(BOARD.find(image)[0]) == 0
