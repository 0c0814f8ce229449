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
"""Three laps of a drive in a thousand images: time, memory, loops; beside COLMAP in sequence."""

from __future__ import annotations

import multiprocessing
from pathlib import Path
import resource
import tempfile
import time

from bench.colmap_peer import calibrate_sequence_with_colmap, is_installed
from bench.tables import percent, Report
import numpy as np
from selfcal_ros import CameraFacts
from selfcal_ros.pipeline.calibrate_input import calibrate_input, CalibrationSettings
from selfcal_ros.synthetic import worlds
from selfcal_ros.synthetic.paths import planar_poses
from selfcal_ros.synthetic.recordings import (default_camera, FIRST_STAMP_NS, REALISTIC_DISTORTION,
                                              Recording, write_image_folder)

VIEWS, FEW, LAPS, LENGTH_M, SEED = 1000, 50, 3, 16.0, 1
#: Milliseconds an image over those with few images; megabytes; tracks that make a loop closed.
MOST_GROWTH, MOST_MB, ENOUGH_TRACKS = 1.0, 1000, 15


def run(report: Report, options) -> None:
    """Calibrate from the first images of the drive, and from all of them."""
    views = options.runs or VIEWS
    camera = default_camera(distortion=REALISTIC_DISTORTION)
    report.section(f'{LAPS} laps of {LENGTH_M:g} m in {views} images of 640x480', 'Processor '
                   'seconds of a process of its own; memory is its largest resident set.')
    with tempfile.TemporaryDirectory() as folder:
        images = write_image_folder(drive_of_laps(views), Path(folder) / 'laps')
        files = sorted(images.glob('*.png'))
        beginning = Path(folder) / 'beginning'
        beginning.mkdir()
        for file in files[:FEW]:
            (beginning / file.name).hardlink_to(file)
        found = [_apart(ours, path, count, views // LAPS)
                 for path, count in ((beginning, FEW), (images, views))]
        rows = [('selfcal', one['images'], f"{one['seconds']:.0f}",
                 f"{1000 * one['seconds'] / one['images']:.0f}", f"{one['peak_mb']:.0f}",
                 f"{100 * one['closed']:.0f}", f"{percent(one['fx'], camera.K[0, 0]):+.4f}",
                 f"{(one['fx'] - camera.K[0, 0]) / one['sigma']:+.1f}") for one in found]
        if not options.no_peer and is_installed():
            peer = _apart(theirs, files, Path(folder) / 'peer')
            rows.append(('COLMAP', peer['registered'], f"{peer['seconds']:.0f}",
                         f"{1000 * peer['seconds'] / views:.0f}", f"{peer['peak_mb']:.0f}", '',
                         f"{percent(peer['fx'], camera.K[0, 0]):+.4f}", ''))
        report.table(('', 'images', 's', 'ms an image', 'MB', 'views that close a loop, %',
                      'fx %', 'sigmas'), rows)
    report.say('')
    each = [one['seconds'] / one['images'] for one in found]
    report.verdict(f'time an image over that of {FEW}', each[1] / each[0], MOST_GROWTH)
    report.verdict('memory', found[1]['peak_mb'], MOST_MB, 'MB')


def drive_of_laps(views: int) -> Recording:
    """Drive an oval in a furnished hall, each lap some centimetres aside of the others."""
    way = np.linspace(0, LAPS, views, endpoint=False)
    xy, heading = _oval(way)
    aside = 0.15 * np.sin(2 * np.pi * 0.37 * way)[:, None]
    xy = xy + aside * np.column_stack([-np.sin(heading), np.cos(heading)])
    heading = heading + 0.06 * np.sin(2 * np.pi * 0.61 * way)
    surfaces = worlds.hall(np.random.default_rng([SEED, 0]), *_oval(np.linspace(0, 1, 400)), 34)
    return Recording('laps', default_camera(distortion=REALISTIC_DISTORTION),
                     planar_poses(xy, heading, 1.1, 0.35, 20.0),
                     FIRST_STAMP_NS + 66_666_667 * np.arange(views), surfaces, seed=SEED)


def _oval(way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 2) and headings (N,) after so many laps, (N,)."""
    s = np.linspace(0, 1, 4001)
    heading = 2 * np.pi * s + 0.5 * np.sin(4 * np.pi * s)
    ahead = np.column_stack([np.cos(heading), np.sin(heading)])
    xy = np.concatenate([[[0, 0]], np.cumsum((ahead[1:] + ahead[:-1]) / 2, axis=0)])
    xy *= LENGTH_M / (len(s) - 1)
    return (np.column_stack([np.interp(way % 1, s, axis) for axis in xy.T]),
            np.interp(way % 1, s, heading))


def _apart(function, *arguments):
    """Call a function in a process of its own, whose time and memory are its own."""
    with multiprocessing.get_context('spawn').Pool(1) as pool:
        return pool.apply(function, arguments)


def ours(images: Path, count: int, lap: int) -> dict:
    """Calibrate from a folder of images in any order, all of them as keyframes."""
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0)
    result, reading = calibrate_input(images, CalibrationSettings(
        facts=facts, mode='wide', max_keyframes=count))
    fx, sigma = (result.camera.K[0, 0], result.sigma['fx']) if result else (np.nan, np.nan)
    return {'images': count, 'fx': float(fx), 'sigma': sigma,
            'closed': closed_share(reading.tracks, lap), **_spent()}


def closed_share(tracks, lap: int) -> float:
    """Share of the views after the first lap that share enough tracks with an earlier lap."""
    point = np.unique(tracks.track, return_inverse=True)[1]
    first = np.full(point.max() + 1, np.inf)
    np.minimum.at(first, point, tracks.frame // lap)
    again = first[point] < tracks.frame // lap
    known = np.bincount(tracks.frame[again], minlength=tracks.frame.max() + 1)[lap:]
    return float(np.mean(known >= ENOUGH_TRACKS)) if len(known) else float('nan')


def theirs(files: list[Path], folder: Path) -> dict:
    """Calibrate by COLMAP, in sequence and with loops."""
    camera, registered, seconds = calibrate_sequence_with_colmap(files, folder)
    return {'fx': np.nan if camera is None else float(camera.K[0, 0]), 'registered': registered,
            **_spent(), 'seconds': seconds}


def _spent() -> dict:
    return {'seconds': time.process_time(),
            'peak_mb': resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000}
