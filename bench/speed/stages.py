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
"""Every stage of photographs to K beside the least that it can cost, and the command."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from unittest.mock import patch

from bench.colmap_peer import calibrate_with_colmap, CONFIGURATIONS, is_installed
from bench.inputs import process_environment
from bench.tables import Report
import cv2
import numpy as np
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.features import detection, extraction
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.synthetic.recordings import agv_drive, write_image_folder

VIEWS = 24
#: The feature stage over its floor, and the command over COLMAP's default.
MOST_OVER_FLOOR, MOST_OF_COLMAP = 2.0, 0.1
#: Stage and the function that does it.
STAGES = (('look-alikes that never move', 'still_features'), ('pairs', 'propose_pairs'),
          ('matching', 'match_pairs'), ('tracks', 'link'),
          ('registration', 'registered_positions'), ('verification', 'finish_tracks'))


def run(report: Report, options) -> None:
    """Print the stages of a rendered drive, then the command beside COLMAP."""
    with tempfile.TemporaryDirectory() as folder:
        images = write_image_folder(agv_drive(VIEWS), Path(folder) / 'drive')
        files = sorted(images.glob('*.png'))
        stages(report, files)
        command(report, images, files, Path(folder), not options.no_peer)


def _timed(function, *arguments):
    """Return the processor time of a call, all threads, and its result."""
    began = time.process_time()
    result = function(*arguments)
    return time.process_time() - began, result


def stages(report: Report, files: list[Path]) -> None:
    """Processor time of each stage, the floor from OpenCV on the same images and pairs."""
    report.section(f'Stages of {VIEWS} photographs 640x480', 'Processor seconds of all threads. '
                   'Floor: OpenCV alone, on the same images and pairs.')
    spent, used = {}, []

    def counting(name, function):
        def counted(*arguments):
            if name == 'match_pairs':
                used.extend((arguments[0], arguments[1]))
            spent[name], result = _timed(function, *arguments)
            return result
        return counted

    reading, images = _timed(lambda: [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
                                      for path in files])
    with ExitStack() as patches:
        for _, name in STAGES:
            patches.enter_context(patch.object(extraction, name,
                                               counting(name, getattr(extraction, name))))
        features, found = _timed(extract_tracks, ((k, image, k) for k, image in enumerate(images)),
                                 'wide')
    estimate, _ = _timed(lambda: calibrate(found.tracks, facts=CameraFacts(aspect_ratio=1.0,
                                                                           skew=0.0)))
    sift = cv2.SIFT_create(nfeatures=0, **detection.SIFT)  # type: ignore[attr-defined]
    detecting, _ = _timed(lambda: [sift.detectAndCompute(image, None) for image in images])
    matching = _brute_force(*used)
    floors = {'reading': reading, 'detection': detecting, 'matching': matching}
    rows = [('reading', reading), ('detection', features - sum(spent.values())),
            *((what, spent.get(name, 0.0)) for what, name in STAGES), ('estimate', estimate)]
    report.table(('stage', 'observations', 's', 'floor s'),
                 [(what, '' if what != 'tracks' else len(found.tracks), f'{seconds:.2f}',
                   f'{floors[what]:.2f}' if what in floors else '') for what, seconds in rows])
    report.say('')
    report.verdict('feature stage over its floor', features / (detecting + matching),
                   MOST_OVER_FLOOR)


def _brute_force(features, pairs) -> float:
    """Processor time in which OpenCV matches the pairs."""
    looks = [one.described().vectors for one in features]
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    return _timed(lambda: [matcher.knnMatch(looks[i], looks[j], k=2) for i, j in pairs])[0]


def command(report: Report, images: Path, files: list[Path], folder: Path, peer: bool) -> None:
    """Time of `selfcal calibrate` and of COLMAP's default, both as they are started."""
    report.section('The command beside COLMAP, default, exhaustive matching',
                   'Seconds on the clock, the median of three for the command.')
    call = [sys.executable, '-c',
            'import sys; from selfcal_ros.cli.main import main; sys.exit(main())', 'calibrate',
            str(images), '--aspect-ratio', '1', '--skew', '0', '--force', '--quiet',
            '--output', str(folder / 'camera.yaml')]
    seconds = []
    for _ in range(3):
        began = time.perf_counter()
        status = subprocess.run(call, cwd=folder, env=process_environment(),
                                stdout=subprocess.DEVNULL, timeout=600).returncode
        seconds.append(time.perf_counter() - began)
    ours = float(np.median(seconds))
    rows = [('selfcal calibrate', f'{ours:.1f}', '1')]
    report.judge(status == 0, f'the exit status of the command is {status}')
    theirs = None
    if peer and is_installed():
        for name, _, _, theirs in calibrate_with_colmap(files, folder / 'peer',
                                                        CONFIGURATIONS[:1]):
            rows.append((f'COLMAP {name}', f'{theirs:.1f}', f'{theirs / ours:.1f}'))
    report.table(('', 's', 'ratio'), rows)
    if theirs:
        report.say('')
        report.verdict('the command over COLMAP', ours / theirs, MOST_OF_COLMAP)
