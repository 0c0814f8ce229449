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
"""Boards that are waved before a rolling shutter, beside `cv2.calibrateCamera`."""

from __future__ import annotations

import time

from bench.tables import Report
import cv2
import numpy as np
from selfcal_ros.calibration.known_object.point_calibration import calibrate_known_object
from selfcal_ros.features.targets import Chessboard
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.synthetic.waved_boards import CAMERA, waved_board

BOARD = Chessboard(9, 6, 0.03).known
#: Time in which all rows are read, ms; pace of the hand; noise of the corners, px.
CASES = ((0, 1.0, 0.1), (20, 0.1, 0.1), (20, 0.3, 0.1), (10, 0.5, 0.05), (20, 1.0, 0.1),
         (33, 1.0, 0.2))
NAMES = ('fx', 'fy', 'cx', 'cy')
#: Most sigmas that a stated shutter may be off.
MOST_SIGMAS = 4.0


def run(report: Report, options) -> None:
    """Calibrate with the shutter stated, with it not stated, and by OpenCV."""
    runs = options.runs or 20
    report.section('Boards that are waved', f'9 x 6 corners 30 mm apart, 20 views, {runs} boards '
                   'a row. Pace 1: 20° and 0.1 m a second. Facts: skew 0.',
                   'fx error: root mean square. Sigmas: of fx, fy, cx, cy.')
    rows = []
    for readout_ms, pace, noise_px in CASES:
        found: dict[str, list] = {'rolling stated': [], 'not stated': [], 'OpenCV': []}
        seconds = dict.fromkeys(found, 0.0)
        told = 0
        for seed in range(runs):
            tracks = waved_board(np.random.default_rng([seed, 41]), BOARD, readout_ms / 1000,
                                 pace, noise_px=noise_px)
            for name, shutter in (('rolling stated', 'rolling'), ('not stated', 'auto')):
                began = time.process_time()
                result = calibrate_known_object(tracks, BOARD, facts=CameraFacts(
                    skew=0.0, shutter=shutter))
                seconds[name] += time.process_time() - began
                if result:
                    sigma = np.array([result.sigma[what] for what in NAMES])
                    found[name].append((result.camera.parameters[:4], sigma))
                    told += any(one.kind == 'object_moves_in_rows' for one in result.findings)
            began = time.process_time()
            found['OpenCV'].append(_opencv(tracks))
            seconds['OpenCV'] += time.process_time() - began
        for name, results in found.items():
            values = np.array([value for value, _ in results])
            sigma = np.array([one for _, one in results])
            off = (values - CAMERA.parameters[:4]) / sigma
            error = 100 * (values[:, 0] / CAMERA.K[0, 0] - 1)
            rows.append((f'{readout_ms} ms, {pace:g}, {noise_px:g} px', name, len(results),
                         f'{np.sqrt(np.mean(error**2)):.3f}',
                         f'{100 * np.median(sigma[:, 0]) / CAMERA.K[0, 0]:.3f}',
                         f'{np.sqrt(np.mean(off**2)):.2f}', f'{np.abs(off).max():.1f}',
                         f'{told} of {runs}' if name == 'rolling stated' else '',
                         f'{seconds[name] / runs:.2f}'))
            if name == 'rolling stated':
                report.judge(len(results) == runs and np.abs(off).max() < MOST_SIGMAS,
                             f'{readout_ms} ms, pace {pace:g}: all calibrated, none beyond '
                             f'{MOST_SIGMAS:g} σ')
    report.say('')
    report.table(('rows in, pace, noise', 'shutter', 'runs', 'fx error %', 'σ of fx %',
                  'rms σ', 'worst σ', 'motion told', 's a run'), rows)


def _opencv(tracks) -> tuple[np.ndarray, np.ndarray]:
    """Calibrate by OpenCV with its five coefficients: fx, fy, cx, cy, and their sigmas."""
    views = [tracks.xy[tracks.frame == frame].astype(np.float32) for frame in tracks.frames]
    points = [BOARD.points.astype(np.float32)] * len(views)
    _, K, _, _, _, deviations, _, _ = cv2.calibrateCameraExtended(
        points, views, tracks.image_size, None, None)
    return K[[0, 1, 0, 1], [0, 1, 2, 2]], deviations.ravel()[:4]
