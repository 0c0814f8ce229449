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
"""Projection over the whole image of recorded perspective lenses, in stated sigmas."""

from __future__ import annotations

import json
from pathlib import Path
import tempfile

from bench.inputs import data_folder, image_files, truth_of
from bench.lenses.wide_lenses import measure
from bench.tables import percent, Report
import numpy as np
from selfcal_ros import calibrate, Camera, CameraFacts, Tracks
from selfcal_ros.report.comparison import compare_cameras

#: Set, name in the cache, images used (from 1), true fy / fx.
SETS = (('kuka_chess', 'kuka6', (8, 9, 10, 11, 12, 15), 1.0), ('kuka_chess', 'kuka', None, 1.0),
        ('fountain_p11', 'fountain', None, 1382.08 / 1379.74),
        ('kitti00_turn_a', 'kitti', None, 1.0))


def run(report: Report, options) -> None:
    """Print one row a set and a truth."""
    report.section('Projection over the whole image, auto, facts: the aspect ratio, no skew',
                   'A grid of 25 x 25 points, after the best rotation, in sigmas of both sides. '
                   'kuka_chess: also against', 'its own board whose points are left free.')
    rows, verdicts = [], []
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(options.cache or scratch)
        work.mkdir(parents=True, exist_ok=True)
        for name, label, numbers, aspect in SETS:
            folder = data_folder(name)
            if folder is None:
                report.say(f'Left out: ../shared/data/{name} is not there.')
                continue
            found = measure(label, image_files(folder, numbers), work,
                            facts=CameraFacts(aspect_ratio=aspect, skew=0.0))
            result, size = found.result, found.tracks.image_size
            what = name + (f', {len(numbers)} images' if numbers else '')
            if not result:
                report.judge(False, f'{what} refused: {result}')
                continue
            truths = [('published', published(folder, size), None)]
            if (folder / 'corners.npz').is_file():
                free = free_board(folder, size)
                if free:
                    truths.append(('board left free', free.camera, free.covariance))
            for against, camera, covariance in truths:
                compared = compare_cameras(result.camera, camera, result.covariance, covariance)
                distance, sigmas = compared.distance_px, compared.sigmas
                most = float(np.nanmax(sigmas))
                rows.append((what, against, result.facts.distortion, result.motion,
                             f'{percent(result.camera.K[0, 0], camera.K[0, 0]):+.3f}',
                             f'{100 * result.sigma["fx"] / result.camera.K[0, 0]:.3f}',
                             f'{np.hypot(*(result.camera.K[:2, 2] - camera.K[:2, 2])):.1f}',
                             f'{np.sqrt(np.nanmean(distance**2)):.2f}',
                             f'{np.nanmax(distance):.2f}', f'{np.nanmedian(sigmas):.2f}',
                             f'{most:.2f}'))
                verdicts.append((f'{what}, {against}', most, against))
    report.table(('set', 'against', 'lens', 'motion', 'fx %', 'σ %', 'pp px', 'rms px',
                  'largest px', 'median σ', 'largest σ'), rows)
    report.say('')
    for what, most, against in verdicts:
        if what.startswith('kuka') and against == 'published':
            continue        # it carries the shape of the board
        report.verdict(what, most, 3.0, 'stated sigmas')


def published(folder: Path, size) -> Camera:
    """Return the published camera of a set."""
    if (folder / 'gt.json').is_file():
        truth = truth_of(folder)
        return Camera(truth['K'], truth['dist'], *size)
    truth = json.loads((folder / 'truth.json').read_text(encoding='utf-8'))
    return Camera(truth['K'], truth.get('dist', ()), *size)


def free_board(folder: Path, size):
    """Calibrate from the corners of the board, their places left free."""
    with np.load(folder / 'corners.npz') as stored:
        xy = stored['image'].reshape(stored['image'].shape[0], -1, 2)
    frame, track = np.indices(xy.shape[:2])
    tracks = Tracks(frame.ravel(), track.ravel(), xy.reshape(-1, 2), size)
    return calibrate(tracks, motion='general', facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
