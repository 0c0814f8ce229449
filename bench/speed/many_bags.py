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
"""A hundred bags of 24 frames: one core against two, Dask, a broken bag, the joint estimate."""

from __future__ import annotations

from importlib.util import find_spec
import json
import os
from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time

from bench.inputs import process_environment
from bench.tables import Report
import numpy as np
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.engines import ENGINES
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.synthetic.recordings import agv_drive

#: Bags, images in each, and their size: small, so that the bench ends in minutes.
BAGS, VIEWS, SIZE = 100, 24, (320, 240)
#: Halls that are rendered; the bags are drives through them with noise of their own.
HALLS, NOISE_GREY = 4, 1.0
MIN_SPEEDUP = 1.8
#: A file that is no bag.
BROKEN = 'broken.mcap'
NAMES = {'processes': 'two processes', 'dask': 'two workers of Dask'}


def run(report: Report, options) -> None:
    """Print the table."""
    bags = options.runs or BAGS
    engines = [options.engine] if options.engine else list(ENGINES)
    if 'dask' in engines and not find_spec('distributed'):
        engines.remove('dask')
        report.say('Dask is not installed: left out.')
    if not engines:
        return
    report.section(f'{bags} bags of {VIEWS} frames, and a broken one',
                   f'{SIZE[0]}x{SIZE[1]} pixels, {HALLS} halls with noise of {NOISE_GREY:g} grey '
                   'levels; the wall clock of `selfcal calibrate FOLDER`, start, report and, with '
                   'Dask, a cluster of as many local workers included; one process on one core. '
                   'CPU is that of all its processes: where it grows with their number, the cores '
                   'were not free.')
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / 'drives'
        camera = write_bags(folder, bags)
        (folder / BROKEN).write_bytes(b'no bag')
        # what everything is read from is read once before, so that the first run has no handicap
        calibrate(sorted(folder.iterdir())[:2], Path(temporary) / 'first', engines[0], 1)
        rows, seconds, contents = [], {}, {}
        for engine in engines:
            for jobs in (1, 2):
                output = Path(temporary) / f'{engine}{jobs}'
                wall, cpu, contents[engine, jobs] = calibrate([folder], output, engine, jobs)
                seconds[engine, jobs] = wall
                rows.append((engine, jobs, f'{wall:.1f}', f'{cpu:.1f}', f'{wall / bags:.2f}',
                             f'{seconds[engine, 1] / wall:.2f}'))
                print(f'{engine} {jobs}: {wall:.1f} s', file=sys.stderr, flush=True)
    report.table(('engine', 'processes', 's', 'CPU s', 's a bag', 'speed-up'), rows)
    report.say('')
    for engine in engines:
        speedup = seconds[engine, 1] / seconds[engine, 2]
        report.judge(speedup >= MIN_SPEEDUP, f'{NAMES[engine]} are {speedup:.2f} times as fast '
                     f'as one, required {MIN_SPEEDUP:g}')
    check(report, bags, camera, contents)


def check(report: Report, bags: int, camera, contents) -> None:
    """Judge the results themselves."""
    for (engine, jobs), content in contents.items():
        recordings = content['cameras'][0]['recordings']
        good = sum(one['result']['status'] == 'calibrated' for one in recordings)
        lines = [Path(one['path']).name for one in content['failures']]
        report.judge(lines == [BROKEN] and len(recordings) == bags,
                     f'{engine}, {jobs}: the broken bag costs its own line only: '
                     f'{len(recordings)} of {bags} others are there, {good} calibrate')
    found = next(iter(contents.values()))['cameras'][0]
    same = all(content['cameras'][0]['joint'] == found['joint'] for content in contents.values())
    report.judge(same, 'all runs give the same joint estimate, bit by bit')
    joint = found['joint']
    error = joint['camera']['fx'] - camera.K[0, 0]
    report.say(f'joint fx {joint["camera"]["fx"]:.3f} ± {joint["sigma"]["fx"]:.3f} px, error '
               f'{error:+.3f} px; a single bag has ± '
               f'{np.median([_sigma(one) for one in found["recordings"] if _sigma(one)]):.3f} px')
    report.say(found['verdict'])


def _sigma(recording) -> float | None:
    return (recording['result']['sigma'] or {}).get('fx')


def write_bags(folder: Path, count: int):
    """Write bags of drives through a few halls; returns the true camera."""
    folder.mkdir()
    clean = []
    for hall in range(min(HALLS, count)):
        recording = agv_drive(VIEWS, SIZE, noise_sigma=0.0, seed=hall + 1)
        clean.append([image.astype(np.float32) for image, _ in recording.frames()])
    for number in range(count):
        rng = np.random.default_rng(number)
        # a bag an hour
        start = 1_700_000_000_000_000_000 + number * 3_600_000_000_000
        frames = [Frame(k, start + k * 66_666_667,
                        np.clip(np.rint(image + NOISE_GREY * rng.standard_normal(
                            image.shape, np.float32)), 0, 255).astype(np.uint8))
                  for k, image in enumerate(clean[number % len(clean)])]
        write_image_bag(folder / f'drive_{number:03d}', frames)
    return recording.camera


def calibrate(inputs: list[Path], output: Path, engine: str, jobs: int):
    """Run the command; returns its wall clock, its CPU time, and what it wrote."""
    call = [sys.executable, '-m', 'selfcal_ros.cli.main', 'calibrate', *map(str, inputs),
            '--output-dir', str(output), '--engine', engine, '--jobs', str(jobs), '--force',
            '--quiet']
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    # one process on one core: OpenCV's threads would use the other one
    core = None if jobs > 1 else (lambda: os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}))
    subprocess.run(call, cwd=inputs[0].parent, env=process_environment(OMP_NUM_THREADS='1'),
                   stderr=subprocess.DEVNULL, timeout=3600, check=True, preexec_fn=core)
    wall = time.perf_counter() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall, cpu, json.loads((output / 'summary.json').read_text(encoding='utf-8'))
