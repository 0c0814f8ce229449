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
Images as cameras make them: compressed, dark, interlaced, stabilised, with a person in view.

Two drives and two walks are rendered, as photographs and as videos, each with a lens of its own.
Then every trouble of `image_troubles` is done to each. From images to K, square pixels stated.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
import tempfile

from bench.calibration.image_troubles import TROUBLES, true_matrix
from bench.calibration.suppositions import MAX_SIGMAS
from bench.monte_carlo import run_seeds
from bench.tables import percent, Report
import cv2
import numpy as np
from selfcal_ros import Camera, CameraFacts
from selfcal_ros.pipeline.calibrate_input import calibrate_input, CalibrationSettings
from selfcal_ros.synthetic.recordings import agv_drive, Recording
from selfcal_ros.synthetic.wide_recordings import hand_walk

#: Images of photographs and of videos.
PHOTOGRAPHS, VIDEO = 24, 90
#: Recordings of a seed: how it moves, and how many images it has.
RECORDINGS = tuple(product((agv_drive, hand_walk), (PHOTOGRAPHS, VIDEO)))


def draw_recording(seed: int, kind: int) -> Recording:
    """Draw a lens for one of `RECORDINGS`."""
    rng = np.random.default_rng([seed, kind, 29])
    move, views = RECORDINGS[kind]
    f = float(np.exp(rng.uniform(*np.log([400, 750]))))
    barrel = -rng.uniform(0, 0.3) * min(1.0, 0.4 * (f / 320)**2)
    camera = Camera([[f, 0, 319.5 + rng.uniform(-12, 12)], [0, f, 239.5 + rng.uniform(-12, 12)],
                     [0, 0, 1]], (barrel, 0.04 * rng.random(), *rng.normal(0, 3e-4, 2), 0),
                    640, 480)
    mounted = {'pitch_deg': rng.uniform(8, 25)} if move is agv_drive else {}
    return move(views, camera=camera, seed=1000 * seed + kind, **mounted)


def one_recording(task: tuple[int, int]) -> list[tuple[str, str, float, float, bool]]:
    """Calibrate a recording with each trouble: refusal, sigmas and percent off, whether told."""
    seed, kind = task
    recording = draw_recording(seed, kind)
    renderer = recording.renderer(2)
    images = [recording.frame(index, renderer) for index in range(len(recording))]
    return [(name, *_with_trouble(name, images, recording.camera, seed)) for name in TROUBLES]


def _with_trouble(name: str, images, camera, seed: int) -> tuple[str, float, float, bool]:
    rng = np.random.default_rng([seed, list(TROUBLES).index(name)])
    with tempfile.TemporaryDirectory() as folder:
        for index, image in enumerate(TROUBLES[name](images, rng)):
            cv2.imwrite(str(Path(folder) / f'{index:03d}.png'), image)
        result, reading = calibrate_input(folder, CalibrationSettings(
            facts=CameraFacts(aspect_ratio=1.0, skew=0.0)))
    if not result:
        return result.kind, np.nan, np.nan, True
    truth, found = true_matrix(name, camera.K, camera.width), result.camera.K
    sigmas = max(abs(found[place] - truth[place]) / result.sigma[which]
                 for which, place in (('fx', (0, 0)), ('cx', (0, 2)), ('cy', (1, 2))))
    told = any(one.kind in ('views_unconnected', 'path_torn', 'focal_varies')
               for one in (*result.findings, *reading.findings))
    return '', float(sigmas), percent(found[0, 0], truth[0, 0]), told


def run(report: Report, options) -> None:
    """Print a line a trouble."""
    seeds = range(1, 1 + (options.runs or 3))
    tasks = list(product(seeds, range(len(RECORDINGS))))
    found = [one for some in run_seeds(one_recording, tasks, options.processes) for one in some]
    report.section(f'Images as cameras make them, {len(tasks)} recordings',
                   f'{PHOTOGRAPHS} photographs or {VIDEO} images of a video, 640x480; from images '
                   'to K, square pixels stated.')
    rows = []
    for name in TROUBLES:
        some = [one[1:] for one in found if one[0] == name]
        right = [one for one in some if not one[0]]
        rows.append((name, len(some), ', '.join(sorted(one[0] for one in some if one[0])) or '-',
                     f'{np.median([abs(one[2]) for one in right]):.3f}' if right else '-',
                     f'{max(abs(one[2]) for one in right):.3f}' if right else '-',
                     f'{max(one[1] for one in right):.1f}' if right else '-'))
    report.table(('images', 'recordings', 'refused as', 'fx off, median %', 'worst %',
                  'worst, sigmas'), rows)
    silent = [one for one in found if one[2] > MAX_SIGMAS and not one[4]]
    report.say('')
    report.verdict('beyond 4 sigmas in silence', len(silent), 0)
    report.verdict('refused', 100 * np.mean([bool(one[1]) for one in found]), 3, '%')
