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
from selfcal_ros.features import circles_grid
from selfcal_ros.features.targets import parse_target

UNIT = 60


def seen(grid, radius):
    """Show a grid of circles in steep perspective; returns the image, and the true centres."""
    places = UNIT * (grid.known.points[:, :2] / grid.spacing_m + 1.5)
    w, h = (places.max(axis=0) + 1.5 * UNIT).astype(int)
    board = np.full((h, w), 230, np.uint8)
    for x, y in np.rint(16 * places).astype(int):
        cv2.circle(board, (int(x), int(y)), int(16 * radius * UNIT), 20, -1, cv2.LINE_AA, 4)
    H = cv2.getPerspectiveTransform(np.float32([[0, 0], [w, 0], [w, h], [0, h]]),
                                    np.float32([[170, 60], [470, 90], [620, 440], [60, 400]]))
    fine = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]) @ H
    image = cv2.resize(cv2.warpPerspective(board, fine, (2560, 1920), borderValue=180),
                       (640, 480), interpolation=cv2.INTER_AREA)
    image = np.clip(image + np.random.default_rng(0).normal(0, 2, image.shape), 0, 255)
    x = np.column_stack([places, np.ones(len(places))]) @ H.T
    return image.astype(np.uint8), x[:, :2] / x[:, 2:]


def error(xy, true):
    return min(np.sqrt(np.mean((xy - one)**2)) for one in (true, true[::-1]))


@pytest.mark.parametrize('text, radius', [('acircles:4x11:0.02', 0.55), ('circles:7x6:0.03', 0.3)])
def test_centres_of_circles_are_freed_of_perspective(text, radius, monkeypatch):
    grid = parse_target(text)
    image, true = seen(grid, radius)
    identity, xy = grid.find(image)
    assert (identity == np.arange(len(grid.known))).all()
    assert error(xy, true) < 0.06
    monkeypatch.setattr(circles_grid, '_eccentricity', lambda flat, xy, area: 0 * xy)
    assert error(grid.find(image)[1], true) > 2 * error(xy, true)


def test_staggered_rows_stand_as_in_opencv():
    points = parse_target('acircles:3x4:0.02').known.points
    assert points[:6, :2].tolist() == pytest.approx(np.array(
        [[0, 0], [0.04, 0], [0.08, 0], [0.02, 0.02], [0.06, 0.02], [0.1, 0.02]]))


@pytest.mark.long
def test_odd_images_show_no_circles():
    grid = parse_target('acircles:4x11:0.02')
    for image in (np.zeros((1, 1), np.uint8), np.full((60, 80), 255, np.uint8),
                  np.random.default_rng(0).integers(0, 255, (120, 160), np.uint8)):
        assert len(grid.find(image)[0]) == 0


@pytest.mark.parametrize('text, words', [
    ('circles:7x6', 'form circles'), ('acircles:4x11:0.02:1', 'form acircles'),
    ('acircles:2x11:0.02', 'at least 3 x 3'), ('circles:7x6:0', 'positive')])
def test_a_wrong_grid_is_refused_in_one_sentence(text, words):
    with pytest.raises(ArgumentError, match=words):
        parse_target(text)
