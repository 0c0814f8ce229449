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
"""Time of the estimate and of the command, and how the estimate grows with the drive."""

from __future__ import annotations

from collections import Counter
from contextlib import ExitStack
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from unittest.mock import patch

from bench.inputs import process_environment
from bench.tables import percent, Report
import numpy as np
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.estimators import acceptance, model_selection
from selfcal_ros.calibration.uncertainty import assessed_estimate
from selfcal_ros.synthetic.recordings import agv_drive, write_image_folder
from selfcal_ros.synthetic.special_scenes import drive

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0)
GROWTH_VIEWS = (12, 24, 50, 100, 200, 1000)
#: Where covariance and identifiability are asked for; the outermost call counts.
EVIDENCE = ((model_selection, 'robust_covariance_of'), (assessed_estimate, 'robust_covariance_of'),
            (assessed_estimate, 'find_distortion_misfit'), (model_selection, 'segment_excess'),
            (model_selection, 'profile_likelihood_excess'),
            (model_selection, 'second_order_covariance'), (acceptance, 'identify'),
            (acceptance, 'suggest_motions'), (acceptance, 'sample_structure'),
            (Bundle, 'information'), (Bundle, 'covariance'))
#: Observations a view that the growth is measured at, and the length of a track in views.
OBSERVATIONS_PER_VIEW, TRACK_LENGTH = 150, 12
#: Seconds a view may grow by so much from the shorter drives to the longest: a linear method
#: with the scatter of a shared machine.
MAX_GROWTH = 1.3


def run(report: Report, options) -> None:
    """Print the three tables."""
    estimate(report)
    evidence(report)
    growth(report)
    command(report)


def best_of(count: int, function, clock=time.perf_counter):
    """Shortest time of several calls, and the last result."""
    times = []
    for _ in range(count):
        began = clock()
        result = function()
        times.append(clock() - began)
    return min(times), float(np.median(times)), result


def estimate(report: Report) -> None:
    """24 views, 2000 tracks; with distortion known and chosen."""
    report.section('The estimate alone: 24 views, 2000 tracks, 0.1 px')
    scene, rows = drive(np.random.default_rng(0), 0.1, 24, 2000), []
    for distortion in ('none', 'radial2', 'auto'):
        facts = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion=distortion)
        least, middle, result = best_of(3, lambda facts=facts: calibrate(scene.tracks,
                                                                         facts=facts))
        error = percent(result.camera.K[0, 0], scene.camera.K[0, 0]) if result else np.nan
        rows.append((distortion, len(scene.tracks), f'{least:.2f}', f'{middle:.2f}',
                     f'{error:+.4f}'))
    report.table(('distortion', 'observations', 'best s', 'median s', 'fx error %'), rows)
    report.say('')
    report.verdict('longest, best of 3', max(float(row[2]) for row in rows), 1.0, 's')


def evidence(report: Report) -> None:
    """What covariance, model error, identifiability and advice add to the estimate."""
    report.section('What covariance and identifiability add to the estimate', 'Processor time of '
                   'the outermost calls, over that of the rest; the quietest of 5 runs.')
    scene, rows = drive(np.random.default_rng(0), 0.1, 24, 2000), []
    shares = []
    for _ in range(5):
        spent = Counter()
        with ExitStack() as patches:
            for owner, name in EVIDENCE:
                patches.enter_context(patch.object(owner, name, _timed(owner, name, spent)))
            began = time.process_time()
            calibrate(scene.tracks, facts=FACTS)
            total = time.process_time() - began
        shares.append((sum(spent.values()) / (total - sum(spent.values())), total, spent))
    share, total, spent = min(shares, key=lambda run: run[1])
    rows = [(name, f'{1000 * spent[name]:.1f}',
             f'{100 * spent[name] / (total - sum(spent.values())):.1f}')
            for name in dict.fromkeys(name for _, name in EVIDENCE) if name in spent]
    report.table(('', 'ms', '% of the rest'), rows)
    report.say('')
    report.verdict('all of it', 100 * share, 20.0, '%')


def _timed(owner, name: str, spent: Counter):
    """Let a function count its time, unless another that counts has called it."""
    function = getattr(owner, name)

    def counting(*arguments, **options):
        if spent.get('running'):
            return function(*arguments, **options)
        spent['running'] = 1
        began = time.process_time()
        try:
            return function(*arguments, **options)
        finally:
            del spent['running']
            spent[name] += time.process_time() - began
    return counting


def growth(report: Report) -> None:
    """Processor time of the estimate for drives of 12 to 1000 views."""
    report.section('Growth with the length of the drive',
                   f'About {OBSERVATIONS_PER_VIEW} observations a view, tracks of up to '
                   f'{TRACK_LENGTH} views, 0.1 px, distortion chosen by the data. Processor '
                   'time of all threads.')
    rows, per_view = [], []
    for views in GROWTH_VIEWS:
        tracks = _tracks_for(views)
        scene = drive(np.random.default_rng(1), 0.1, views, tracks, TRACK_LENGTH)
        least, _, result = best_of(2, lambda scene=scene: calibrate(scene.tracks, facts=FACTS),
                                   time.process_time)
        per_view.append(least / views)
        error = percent(result.camera.K[0, 0], scene.camera.K[0, 0]) if result else np.nan
        rows.append((views, f'{len(scene.tracks) / views:.0f}', f'{least:.2f}',
                     f'{1000 * per_view[-1]:.1f}', f'{per_view[-1] / per_view[0]:.2f}',
                     f'{error:+.4f}', '' if result else result.reason[:60]))
    report.table(('views', 'observations a view', 's', 'ms a view', 'ms a view / shortest',
                  'fx error %', ''), rows)
    report.say('')
    report.verdict('ms a view at 1000 views over the mean of the shorter drives',
                   per_view[-1] / float(np.mean(per_view[:-1])), MAX_GROWTH)


def _tracks_for(views: int) -> int:
    """Number of tracks that gives the wanted number of observations a view."""
    probe = drive(np.random.default_rng(1), 0.1, views, 20 * views, TRACK_LENGTH)
    return round(20 * views * OBSERVATIONS_PER_VIEW * views / len(probe.tracks))


def command(report: Report) -> None:
    """`selfcal calibrate` as a user runs it, and what starting it costs."""
    report.section('The command, as a process of its own')
    selfcal = [sys.executable, '-c',
               'import sys; from selfcal_ros.cli.main import main; sys.exit(main())']
    rows = []
    least, middle, _ = best_of(3, lambda: _call([*selfcal, '--help']))
    rows.append(('selfcal --help', f'{least:.2f}', f'{middle:.2f}', ''))
    least, middle, _ = best_of(3, lambda: _call([sys.executable, '-c', 'import selfcal_ros']))
    rows.append(('python -c "import selfcal_ros"', f'{least:.2f}', f'{middle:.2f}', ''))
    with tempfile.TemporaryDirectory() as folder:
        images = write_image_folder(agv_drive(24), Path(folder) / 'drive')
        call = [*selfcal, 'calibrate', str(images), '--aspect-ratio', '1', '--skew', '0',
                '--output', str(Path(folder) / 'camera.yaml'), '--force', '--quiet']
        least, middle, status = best_of(3, lambda: _call(call))
        rows.append(('selfcal calibrate, 24 views 640x480', f'{least:.2f}', f'{middle:.2f}',
                     f'exit status {status}'))
    report.table(('command', 'best s', 'median s', ''), rows)
    report.say('')
    report.verdict('selfcal calibrate on the 24-view drive, best of 3', least, 10.0, 's')
    report.judge(status == 0, f'its exit status is {status}')


def _call(arguments) -> int:
    return subprocess.run(arguments, cwd=tempfile.gettempdir(), env=process_environment(),
                          stdout=subprocess.DEVNULL, timeout=300).returncode
