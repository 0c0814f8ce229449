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
"""Rendered drive, images to K, beside COLMAP on the same images."""

from __future__ import annotations

from pathlib import Path
import tempfile
import time

from bench.colmap_peer import calibrate_with_colmap, is_installed
from bench.inputs import grey_frames
from bench.tables import percent, Report
import numpy as np
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.synthetic.recordings import agv_drive, REALISTIC_DISTORTION, write_image_folder

VIEWS = 24
#: Name, distortion of the camera, limits: fx in percent, principal point in pixels, k1.
DRIVES = (('no distortion', (), 0.2, 1.0, None),
          ('k1 -0.12, k2 0.05', REALISTIC_DISTORTION, 0.5, 2.0, 0.01))


def run(report: Report, options) -> None:
    """Render, calibrate, compare; once without and once with distortion."""
    for name, distortion, fx_limit, pp_limit, k1_limit in DRIVES:
        recording = agv_drive(VIEWS, distortion=distortion)
        report.section(f'Rendered drive, {VIEWS} views 640x480, pitched 20 degrees, f = 520, '
                       f'{name}', 'Facts: square pixels. Everything else is free, distortion '
                       'chosen by the data.')
        with tempfile.TemporaryDirectory() as folder:
            images = write_image_folder(recording, Path(folder) / 'drive')
            measure(report, recording.camera, sorted(images.glob('*.png')), Path(folder),
                    (fx_limit, pp_limit, k1_limit), options)


def measure(report: Report, truth, files, folder: Path, limits, options) -> None:
    """Print one table: ours, then the peer's configurations."""
    began = time.perf_counter()
    extraction = extract_tracks(grey_frames(files))
    middle = time.perf_counter()
    result = calibrate(extraction.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
    end = time.perf_counter()
    report.say(f'{len(extraction.tracks)} observations, {extraction.mode} mode; features '
               f'{middle - began:.2f} s, estimate {end - middle:.2f} s\n')
    if not result:
        report.judge(False, str(result))
        return
    camera, sigma = result.camera, result.sigma
    K, seconds = camera.K, end - began
    shift = K[:2, 2] - truth.K[:2, 2]
    errors = percent(K[0, 0], truth.K[0, 0]), float(np.hypot(*shift))
    k1_error = camera.distortion[0] - truth.distortion[0]
    sigmas = [(K[0, 0] - truth.K[0, 0]) / sigma['fx'], shift[0] / sigma['cx'],
              shift[1] / sigma['cy']]
    rows = [(f'selfcal_ros ({result.facts.distortion})', f'{errors[0]:+.3f}', f'{errors[0]:+.3f}',
             f'{errors[1]:.2f}', f'{k1_error:+.4f}', f'{len(result.frames)}/{len(files)}',
             f'{seconds:.1f}', '1')]
    if not options.no_peer and is_installed():
        for name, other, registered, time_s in calibrate_with_colmap(files, folder / 'peer'):
            line = [f'COLMAP {name}'] + ['-'] * 4
            if other:
                away = np.hypot(other['cx'] - truth.K[0, 2], other['cy'] - truth.K[1, 2])
                line[1:] = [f'{percent(other["fx"], truth.K[0, 0]):+.3f}',
                            f'{percent(other["fy"], truth.K[1, 1]):+.3f}',
                            f'{away:.2f}',
                            f'{other["k1"] - truth.distortion[0]:+.4f}']
            rows.append((*line, f'{registered}/{len(files)}', f'{time_s:.1f}',
                         f'{time_s / seconds:.1f}'))
    report.table(('method', 'fx error %', 'fy error %', 'pp error px', 'k1 error', 'views', 's',
                  'time / ours'), rows)
    if not options.no_peer and not is_installed():
        report.say('\nCOLMAP left out: pip install pycolmap to see it beside.')
    report.say(f'\nStated: fx ± {100 * sigma["fx"] / K[0, 0]:.3f} %, cx ± {sigma["cx"]:.2f} px, '
               f'cy ± {sigma["cy"]:.2f} px; reprojection {result.reprojection_rms_px:.3f} px')
    report.verdict('fx error', errors[0], limits[0], '%')
    report.verdict('principal point error', errors[1], limits[1], 'px')
    if limits[2] is not None:
        report.verdict('k1 error', k1_error, limits[2])
    report.verdict('truth from the result, largest', float(np.abs(sigmas).max()), 3.0, 'sigmas')
