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
Lenses that no model describes: measured ones, with bumps all over the image, in every view alike.

The bumps are a Gaussian field of waves of one length. Tracks wander besides, as patches do that
are followed, in a third of the runs. Nothing of it is drawn from what the estimator supposes:
that is a sum of polynomials.
"""

from __future__ import annotations

from functools import partial

from bench.lenses.lens_runs import compared, draw_camera, HEIGHT, MOTIONS, Outcome, WIDTH
from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.stats import chi2
from selfcal_ros import calibrate, CameraFacts, Tracks

RUNS = 200
#: Standard deviation of the filter that makes the bumps, pixels; and their size, pixels rms.
WAVES_PX = (24, 40, 96)
BUMPS_PX = (0.08, 0.3)
#: Noise of every image, and the step of the walk of a track from image to image, pixels.
NOISE_PX, WALK_PX = 0.15, (0.05, 0.2)
LENSES = ('none', 'radial2', 'plumb_bob')
VIEWS, TRACKS, LENGTH = (8, 12, 20), 400, 8
#: One value of the field every so many pixels.
_CELL = 8
SHARES = (0.6, 0.8, 0.9, 0.95)
MAX_SIGMAS = 4.0


def bumps(rng: np.random.Generator, xy: np.ndarray, wave_px: float) -> np.ndarray:
    """Displace places (N, 2) of an image by a random field."""
    field = gaussian_filter(rng.standard_normal((2, HEIGHT // _CELL, WIDTH // _CELL)),
                            (0, wave_px / _CELL, wave_px / _CELL))
    field *= rng.uniform(*BUMPS_PX) / field.std()
    place = xy.T[::-1] / _CELL
    return np.stack([map_coordinates(one, place, order=1, mode='nearest') for one in field],
                    axis=1)


def walks(rng: np.random.Generator, tracks: Tracks) -> np.ndarray:
    """Return how far the observations of every track have wandered, shape (N, 2)."""
    order = np.lexsort((tracks.frame, tracks.track))
    steps = rng.uniform(*WALK_PX) * rng.standard_normal((len(order), 2))
    _, first, label = np.unique(tracks.track[order], return_index=True, return_inverse=True)
    total = np.cumsum(steps, axis=0)
    wandered = np.empty_like(total)
    wandered[order] = total - total[first][label]
    return wandered


def one_run(seed: int, wave_px: float) -> Outcome:
    """Draw a lens with bumps, record and calibrate."""
    rng = np.random.default_rng([seed, int(wave_px), 29])
    camera = draw_camera(rng, LENSES[seed % 3])
    motion = MOTIONS[('drive', 'hand')[seed // 3 % 2]]
    tracks = motion(rng, NOISE_PX, int(rng.choice(VIEWS)), TRACKS, LENGTH, camera).tracks
    xy = tracks.xy + bumps(rng, tracks.xy, wave_px)
    if seed // 6 % 3 == 0:
        xy += walks(rng, tracks)
    seen = Tracks(tracks.frame, tracks.track, xy, tracks.image_size)
    return compared(calibrate(seen, facts=CameraFacts(aspect_ratio=1.0, skew=0.0)), camera)


def row(wave_px: float, outcomes: list[Outcome]) -> tuple:
    """Return a line of the table: errors, and whether the sigmas hold them."""
    found = [one for one in outcomes if one.error is not None]
    errors = np.array([one.error for one in found])
    pixels = np.array([one.error_px for one in found])
    chance = chi2.cdf([one.distance for one in found], [one.size for one in found])
    return (f'{wave_px} px', f'{len(found)} of {len(outcomes)}',
            ', '.join(f'{one:.2f}' for one in np.sqrt(np.mean(pixels**2, axis=0))),
            ', '.join(f'{one:.2f}' for one in np.sqrt(np.mean(errors**2, axis=0))),
            ' '.join(f'{np.mean(chance < share):.2f}' for share in SHARES),
            str(int(np.sum(np.abs(errors).max(axis=1) > MAX_SIGMAS))))


def run(report: Report, options) -> None:
    """Print the table."""
    report.section('Lenses with bumps', f'{NOISE_PX} px of noise, bumps of {BUMPS_PX[0]} to '
                   f'{BUMPS_PX[1]} px, 8 to 20 views. Errors of fx, cx, cy: root mean square.')
    runs = options.runs or RUNS
    rows = [row(wave_px, run_seeds(partial(one_run, wave_px=wave_px), range(runs),
                                   options.processes)) for wave_px in WAVES_PX]
    report.table(('waves', 'calibrated', 'px', 'sigmas', 'inside 60 80 90 95 %',
                  f'beyond {MAX_SIGMAS:g}'), rows)
    for one in rows:
        report.verdict(f'runs beyond {MAX_SIGMAS:g} sigmas, waves of {one[0]}', float(one[-1]),
                       0.5, '')
