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
Rolling shutter: camera and line delay found, their sigmas true, and global left alone.

Tracks of a drive and of a waved camera with 0, 5, 15 and 33 ms of readout; the share of runs in
which camera and line delay together lie inside the stated ellipsoids. Then rendered videos at
30 Hz, from images to K, and twelve images of each as photographs.
"""

from __future__ import annotations

from functools import partial

from bench.calibration.coverage import ALLOWED, distances, SHARES
from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from scipy.stats import chi2
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.synthetic.rolling_recordings import rolling_video
from selfcal_ros.synthetic.rolling_scenes import drive, hand, record

PATHS = {'drive': drive, 'hand': hand}
READOUTS_MS = (0, 5, 15, 33)
NAMES = ('fx', 'cx', 'cy', 'k1', 'k2')
#: Largest errors of the rendered videos: focal length and line delay in percent, principal point
#: in pixels.
LIMITS = (0.1, 2.0, 0.5)
FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2', lens_population=False)
FAR_SIGMAS = 4.0
#: Images of a video from one photograph to the next, half a second; largest errors of the
#: photographs: focal length in percent, principal point in pixels.
PHOTOGRAPH_STEP, PHOTOGRAPH_LIMITS = 15, (0.1, 1.0)


def one_run(seed: int, kind: str, readout_ms: float):
    """
    Calibrate one sequence of 16 views, evenly spaced in time.

    Returns
    -------
    deviation : ndarray, shape (k,), or None
        Estimate less truth of the camera, and of the readout in ms where it is estimated.
    covariance : ndarray, shape (k, k), or None
    """
    rng = np.random.default_rng([seed, int(10 * abs(readout_ms)), len(kind)])
    sequence = record(rng, PATHS[kind](rng), 1e-3 * readout_ms, np.linspace(0, 5, 16), points=140)
    result = calibrate(sequence.tracks, facts=FACTS,
                       motion='planar' if kind == 'drive' else 'general')
    if not result:
        return None, None
    places = [result.parameter_names.index(name) for name in NAMES]
    deviation = (result.camera.parameters - sequence.camera.parameters)[places]
    covariance = result.covariance[np.ix_(places, places)]
    if result.shutter is None:
        return deviation, covariance
    # covariances with the camera are not in the result: alone
    rows = result.shutter.rows
    late = 1e3 * (result.shutter.line_delay_s - sequence.line_delay_s) * rows
    return np.append(deviation, late), np.pad(covariance, (0, 1)) + np.diag(
        [0.0] * len(places) + [(1e3 * result.shutter.sigma_s * rows)**2])


def run(report: Report, options) -> None:
    """Print the tables."""
    _coverage(report, options)
    _videos(report)
    _photographs(report)


def _coverage(report: Report, options) -> None:
    runs = options.runs or 1000
    report.section(f'Rolling shutter, simulated: shares inside the stated ellipsoids ({runs} runs '
                   'each)', 'fx, cx, cy, k1, k2 together; 16 views in 5 s, 0.2 px. The line delay '
                   'beside: mean error and root mean square in its sigmas.')
    rows = []
    for kind in PATHS:
        for readout in READOUTS_MS:
            results = run_seeds(partial(one_run, kind=kind, readout_ms=readout), range(runs),
                                options.processes)
            done = [one for one in results if one[0] is not None]
            rolling = [one for one in done if len(one[0]) > len(NAMES)]
            camera = [(one[0][:len(NAMES)], one[1][:len(NAMES), :len(NAMES)]) for one in done]
            distance, size = distances(camera)
            held = np.mean(distance[:, None] < chi2.ppf(SHARES, size), axis=0)
            late = np.array([one[0][-1] / np.sqrt(one[1][-1, -1]) for one in rolling])
            beyond = sum(bool((np.abs(one[0]) > FAR_SIGMAS * np.sqrt(np.diag(one[1]))).any())
                         for one in done)
            rows.append((kind, readout, len(done), len(rolling),
                         *(f'{share:.3f}' for share in held),
                         f'{late.mean():+.2f}' if len(late) else '-',
                         f'{np.sqrt(np.mean(late**2)):.2f}' if len(late) else '-', beyond))
            report.verdict(f'{kind}, {readout} ms: largest distance from the shares',
                           float(np.abs(held - SHARES).max()), ALLOWED)
    report.table(('path', 'readout ms', 'runs', 'found rolling',
                  *(f'{share:.2f}' for share in SHARES), 'delay', 'its rms',
                  f'beyond {FAR_SIGMAS:.0f} sigmas'), rows)


def _videos(report: Report) -> None:
    report.section('Rolling shutter, rendered: 5 s at 30 Hz, 640x480, f = 520, from images to K',
                   'Facts: square pixels; lens and shutter found out.')
    rows = []
    for kind in PATHS:
        for readout in READOUTS_MS:
            video = rolling_video(kind, 1e-3 * readout, length_s=5.0)
            renderer = video.renderer(2)
            found = extract_tracks((k, video.frame(k, renderer), int(stamp))
                                   for k, stamp in enumerate(video.stamps_ns))
            result = calibrate(found.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
            name = f'{kind}, {readout} ms'
            if not result:
                report.judge(False, f'{name}: {result}')
                continue
            error = result.camera.parameters - video.camera.parameters
            focal, aside = 100 * error[0] / 520, float(np.hypot(*error[2:4]))
            sigmas = error[[0, 2, 3]] / [result.sigma[one] for one in ('fx', 'cx', 'cy')]
            shutter = result.shutter
            late = np.nan if not (shutter and readout) else 100 * (
                1e3 * shutter.readout_s / readout - 1)
            rows.append((kind, readout, len(result.frames), f'{focal:+.3f}', f'{aside:.2f}',
                         f'{np.abs(sigmas).max():.1f}', 'global' if shutter is None else
                         f'{1e3 * shutter.readout_s:.2f} ± '
                         f'{1e3 * shutter.rows * shutter.sigma_s:.2f}'))
            report.verdict(f'{name}: fx error', focal, LIMITS[0], '%')
            report.verdict(f'{name}: principal point error', aside, LIMITS[2], 'px')
            if readout:
                report.verdict(f'{name}: line delay error', late, LIMITS[1], '%')
                report.verdict(f'{name}: line delay error, sigmas', np.nan if shutter is None else
                               (shutter.readout_s - 1e-3 * readout)
                               / (shutter.rows * shutter.sigma_s), FAR_SIGMAS)
            else:
                report.judge(shutter is None, f'{name}: found to be global')
    report.table(('path', 'readout ms', 'views', 'fx error %', 'pp error px', 'largest, sigmas',
                  'readout found, ms'), rows)


def _photographs(report: Report) -> None:
    report.section('Rolling shutter, rendered: twelve photographs, half a second apart',
                   'The same cameras and facts. Views so far apart do not tell how the camera '
                   'moved while one was read.')
    rows = []
    for kind in PATHS:
        for readout in READOUTS_MS:
            video = rolling_video(kind, 1e-3 * readout)
            renderer = video.renderer(2)
            found = extract_tracks(
                ((k, video.frame(k, renderer), int(video.stamps_ns[k]))
                 for k in range(0, len(video.stamps_ns), PHOTOGRAPH_STEP)), mode='wide')
            result = calibrate(found.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
            name = f'{kind}, {readout} ms'
            if not result:
                report.judge(False, f'{name}: {result}')
                continue
            error = (result.camera.parameters - video.camera.parameters)[[0, 2, 3]]
            focal, aside = 100 * error[0] / 520, float(np.hypot(*error[1:]))
            sigmas = error / [result.sigma[one] for one in ('fx', 'cx', 'cy')]
            told = {'rolling_shutter', 'rows_by_view'} & {one.kind for one in result.findings}
            rows.append((kind, readout, f'{focal:+.3f}', f'{aside:.2f}',
                         f'{np.abs(sigmas).max():.1f}', f'{result.noise_sigma_px:.3f}',
                         ', '.join(sorted(told)) or 'global'))
            report.verdict(f'{name}: fx error', focal, PHOTOGRAPH_LIMITS[0], '%')
            report.verdict(f'{name}: principal point error', aside, PHOTOGRAPH_LIMITS[1], 'px')
            report.verdict(f'{name}: largest error, sigmas', float(np.abs(sigmas).max()),
                           FAR_SIGMAS)
            report.judge(bool(told) == bool(readout), f'{name}: told')
    report.table(('path', 'readout ms', 'fx error %', 'pp error px', 'largest, sigmas',
                  'noise px', 'said'), rows)
