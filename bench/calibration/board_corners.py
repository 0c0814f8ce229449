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
"""
Corners of chessboards and of ChArUco boards in drawn images: how far they are from the truth.

Boards of the same size before the same camera, tilted at random, with blur and noise. Around a
corner of a ChArUco board there is less that is its own: the markers stand next to it.
"""

from __future__ import annotations

from bench.tables import Report
import cv2
import numpy as np
from selfcal_ros.features.targets import parse_target

COLUMNS, ROWS, SIDE = 9, 6, 60
SIZE = (640, 480)
MARKER = 'DICT_5X5_1000'
#: Blur and length of a motion, pixels; grey noise; size of the board and how tilted it is.
IMAGES = {'sharp': (0.0, 0, 2.0, 1.0, 0.25), 'blur 1 px': (1.0, 0, 2.0, 1.0, 0.25),
          'blur 1.4 px': (1.4, 0, 2.0, 1.0, 0.25), 'blur 2 px': (2.0, 0, 2.0, 1.0, 0.25),
          'motion 3 px': (0.0, 3, 2.0, 1.0, 0.25), 'noise 5': (0.7, 0, 5.0, 1.0, 0.25),
          'noise 10': (0.7, 0, 10.0, 1.0, 0.25), 'noise 20': (0.7, 0, 20.0, 1.0, 0.25),
          'tilted': (0.7, 0, 3.0, 1.0, 0.7), 'small': (0.7, 0, 3.0, 0.7, 0.25)}


def run(report: Report, options) -> None:
    """Print the error of the corners of both, row by row."""
    runs = options.runs or 12
    report.section('Corners of boards', f'{COLUMNS} x {ROWS} corners, some 40 px apart, {runs} '
                   'images a row. px: root mean square of a coordinate, median of the images. '
                   'found: images, and corners in them.')
    if not hasattr(getattr(cv2, 'aruco', None), 'CharucoDetector'):
        report.say('Left out: this OpenCV draws no ChArUco boards.')
        return
    boards = {'chessboard': (chessboard(), f'chessboard:{COLUMNS}x{ROWS}:0.03'),
              'ChArUco': (charuco(), f'charuco:{COLUMNS}x{ROWS}:0.03:0.022:{MARKER}')}
    rows = []
    for name, what in IMAGES.items():
        row: list = [name]
        for picture, text in boards.values():
            errors, corners, target = [], 0, parse_target(text)
            for seed in range(runs):
                image, true = drawn(picture, np.random.default_rng(seed), *what)
                identity, xy = target.find(image)
                if len(identity):
                    # a chessboard may be found from its other end
                    errors.append(min(np.sqrt(np.mean((xy - one[identity])**2))
                                      for one in (true, true[::-1])))
                    corners += len(identity)
            row += [f'{np.median(errors):.3f}' if errors else '',
                    f'{len(errors)}, {corners / max(len(errors), 1):.0f}']
        rows.append(tuple(row))
    report.table(('images', 'chessboard px', 'found', 'ChArUco px', 'found'), rows)


def chessboard() -> np.ndarray:
    """Draw the board, with a margin of one square."""
    y, x = np.mgrid[:(ROWS + 3) * SIDE, :(COLUMNS + 3) * SIDE] // SIDE
    inside = (x > 0) & (x < COLUMNS + 2) & (y > 0) & (y < ROWS + 2)
    return np.where(inside & ((x + y) % 2 == 0), 20, 230).astype(np.uint8)


def charuco() -> np.ndarray:
    """Draw the board with markers, its corners where those of the chessboard are."""
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, MARKER))
    board = cv2.aruco.CharucoBoard((COLUMNS + 1, ROWS + 1), 0.03, 0.022, markers)
    image = board.generateImage(((COLUMNS + 1) * SIDE, (ROWS + 1) * SIDE))
    return np.pad(np.where(image > 128, 230, 20).astype(np.uint8), SIDE, constant_values=230)


def drawn(picture: np.ndarray, rng: np.random.Generator, blur: float, motion: int, noise: float,
          scale: float, tilt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return an image of the board, and the places of its corners (P, 2)."""
    height, width = picture.shape
    sheet = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    middle = np.array(SIZE) / 2
    seen = np.array([[120, 70], [530, 70], [530, 400], [120, 400]]) - middle
    seen = middle + scale * (seen + rng.uniform(-110, 110, (4, 2)) * tilt)
    H = cv2.getPerspectiveTransform(sheet, seen.astype(np.float32))
    # drawn four times as large, so that pixels hold means
    large = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]) @ H
    image = cv2.warpPerspective(picture, large, (4 * SIZE[0], 4 * SIZE[1]), borderValue=200,
                                flags=cv2.INTER_AREA)
    image = cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA).astype(float)
    if blur:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    if motion:
        image = cv2.blur(image, (motion, 1))
    image = np.clip(np.rint(image + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)
    y, x = np.mgrid[:ROWS, :COLUMNS].reshape(2, -1)
    corners = np.column_stack([SIDE * (x + 2) - 0.5, SIDE * (y + 2) - 0.5, np.ones(x.size)]) @ H.T
    return image, corners[:, :2] / corners[:, 2:]
