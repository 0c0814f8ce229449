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
Time of the tracker: an image, its parts, and 10 000 images.

One core: run with OMP_NUM_THREADS=1 and OPENBLAS_NUM_THREADS=1, as `make bench` does.
"""

from __future__ import annotations

import cProfile
import pstats
import resource
import time

from bench.tables import Report
from bench.tracking import visp_peer
from bench.tracking.tracking_runs import cube_sequence, follow
import cv2
import numpy as np
from selfcal_ros.pipeline.tracking_session import TrackingSession
from selfcal_ros.rorapid.estimation.joint_search import together
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerOptions
from selfcal_ros.synthetic.objects import tracked_object
from selfcal_ros.synthetic.several_objects import objects_beside

#: Required, milliseconds.
MEDIAN_MS, LATE_MS = 2.0, 3.0
LONG = 10_000
#: Images that the long run goes through, forward and backward.
LOOP = 120
#: The last tenth of a long run may take so much longer than the second.
MAX_GROWTH = 1.1
MAX_MEMORY_MB = 5.0
#: Images of the scene of several objects; three may take so many times what one takes.
SEVERAL_IMAGES, MAX_THREE = 60, 2.2
#: What a room or module of the tracker is for, in the table of parts.
PARTS = {'edgels': 'edges along the normals', 'visibility': 'visible primitives',
         'projection': 'projection and derivatives',
         'joint_fit': 'edges along the normals',
         'primitive_detection': 'robust parts', 'kalman_filter': 'Kalman filter',
         'view_memory': 'recovery', 'texture_memory': 'texture', 'robust_tracker': 'cycle',
         'rapid_tracker': 'cycle', 'control_points': 'cycle', 'tracker': 'cycle'}


def run(report: Report, options) -> None:
    """Print the tables."""
    speed(report)
    several(report)
    long_run(report, options.runs or LONG)


def speed(report: Report) -> None:
    """Time of an image on the cube sequence, beside ViSP."""
    report.section('Speed: the cube sequence, 640x480, 12 lines, one core')
    cv2.setNumThreads(1)
    sequence = cube_sequence()
    if sequence is None:
        report.say('left out: the recorded sets are not there')
        return
    rows, verdicts = [], None
    for name, options in (
            ('ours', TrackerOptions()),
            ('ours, 100 control points', TrackerOptions(control_points_per_line=11)),
            ('ours, edges only', TrackerOptions(texture=False)),
            ('RoRAPiD', TrackerOptions(method='rorapid')),
            ('RAPiD', TrackerOptions(method='rapid'))):
        points = []
        # the better of two: the machine is shared
        seconds = min((follow(sequence.images, sequence.model, sequence.camera, sequence.start,
                              options, each=lambda _, seen: points.append(
                                  np.count_nonzero(~seen.hidden))).seconds for _ in range(2)),
                      key=np.median)
        late = 1000 * float(np.percentile(seconds, 95))
        rows.append((name, f'{np.mean(points):.0f}', f'{1000 * np.median(seconds):.2f}',
                     f'{late:.2f}', f'{1000 * seconds.max():.2f}'))
        if name.endswith('points'):
            verdicts = 1000 * float(np.median(seconds)), late
    peer = visp_peer.build()
    if peer is not None:
        for name, kind in (('ViSP, edges (C++)', 'edges'), ('ViSP, edges + KLT (C++)', 'both')):
            seconds = visp_peer.track(peer, sequence.images, kind)[2]
            rows.append((name, '', f'{1000 * np.median(seconds):.2f}',
                         f'{1000 * np.percentile(seconds, 95):.2f}',
                         f'{1000 * seconds.max():.2f}'))
    report.table(('tracker', 'control points', 'median ms', '95 % ms', 'most ms'), rows)
    report.say('')
    report.verdict('median, about 100 control points', verdicts[0], MEDIAN_MS, 'ms')
    report.verdict('95th percentile', verdicts[1], LATE_MS, 'ms')
    report.say('')
    parts(report, sequence)


def several(report: Report) -> None:
    """Time of an image with three objects, over that with one of them."""
    report.section('Several objects, 640x480')
    made = objects_beside(('cube', 'l_block', 'step_block'), SEVERAL_IMAGES, supersampling=2)
    images = made.frames()

    def seconds(chosen) -> tuple[float, float]:
        sessions = [TrackingSession(one.model, camera=one.camera) for one in chosen]
        for session, one in zip(sessions, chosen):
            session.start(one.rotations[0], one.translations[0])
        walls = []
        worked = time.process_time()
        for image in images:
            began = time.perf_counter()
            frames = together([session.finding(image) for session in sessions])
            walls.append(time.perf_counter() - began)
        worked = time.process_time() - worked
        if not all(frames):
            report.say('an object was lost')
        return float(np.median(walls)), worked / len(images)

    # each alone, and all together, by turns: the machine is shared
    turns = [([seconds([one]) for one in made.objects], seconds(made.objects)) for _ in range(3)]
    alone = np.median([[one for one in each] for each, _ in turns], axis=0)
    all_three = np.median([three for _, three in turns], axis=0)
    rows = [(one.model.name, f'{1000 * wall:.2f}', f'{1000 * worked:.2f}')
            for one, (wall, worked) in zip(made.objects, alone)]
    rows.append(('all three', *(f'{1000 * value:.2f}' for value in all_three)))
    report.table(('objects', 'median ms', 'processor, ms an image'), rows)
    report.say('')
    wall, worked = all_three / alone.mean(axis=0)
    report.verdict('three objects over one, time of an image', float(wall), MAX_THREE, 'times')
    report.say(f'Over one they take {worked:.2f} times its processor time.')


def parts(report: Report, sequence) -> None:
    """Where the time goes, by module, from a profile."""
    tracker = RorapidTracker(sequence.model, sequence.camera, TrackerOptions(),
                             np.random.default_rng(0))
    tracker.start(*sequence.start)
    images = sequence.images
    profile = cProfile.Profile()
    began = time.thread_time()
    for image in images:
        profile.runcall(tracker.track, image)
    total = time.thread_time() - began
    spent = _by_part(pstats.Stats(profile))
    whole = sum(spent.values())
    rows = [(part, f'{100 * seconds / whole:.0f}') for part, seconds in
            sorted(spent.items(), key=lambda item: -item[1])]
    report.say('Parts, with what they call of NumPy and OpenCV; under the profiler an image '
               f'takes {1000 * total / len(images):.1f} ms.\n')
    report.table(('part', '% of the time'), rows)


def _by_part(stats: pstats.Stats) -> dict:
    """Sum the times of a profile by what the modules are for."""
    spent = {}
    for (path, _, _), (_, _, own, _, callers) in stats.stats.items():
        place = _part_of(path)
        if place is not None:
            spent[place] = spent.get(place, 0.0) + own
            continue
        # NumPy, OpenCV and built-in functions count for who called them
        for (caller, _, _), values in callers.items():
            place = _part_of(caller) or 'what they call in turn'
            spent[place] = spent.get(place, 0.0) + values[2]
    return spent


def _part_of(path: str):
    """Name the part that a source file belongs to; None outside the tracker."""
    if '/rorapid/' not in path.replace('\\', '/'):
        return None
    *_, room, module = path.replace('\\', '/').removesuffix('.py').split('/')
    return PARTS.get(module) or PARTS.get(room, 'other')


def long_run(report: Report, count: int) -> None:
    """Time and memory over many images."""
    report.section(f'{count} images in a row', 'A rendered cube, forward and backward.')
    recording = tracked_object(LOOP, 'cube', 'general', size=(640, 480), seed=16)
    images = [image for image, _ in recording.frames()]
    order = [*range(LOOP), *range(LOOP - 2, 0, -1)]
    tracker = RorapidTracker(recording.model, recording.camera, TrackerOptions(),
                             np.random.default_rng(0))
    tracker.start(recording.rotations[0], recording.translations[0])
    seconds, memory, lost = np.zeros(count), np.zeros(count), 0
    for number in range(count):
        image = images[order[number % len(order)]]
        began = time.thread_time()
        lost += not tracker.track(image)
        seconds[number] = time.thread_time() - began
        if number % 100 == 0:
            memory[number:] = resident_mb()
    tenth = count // 10
    rows = [(f'{k * tenth} to {(k + 1) * tenth}',
             f'{1000 * np.median(seconds[k * tenth:(k + 1) * tenth]):.2f}',
             f'{memory[(k + 1) * tenth - 1]:.1f}') for k in range(10)]
    report.table(('images', 'median ms', 'resident MB'), rows)
    report.say('')
    growth = np.median(seconds[-tenth:]) / np.median(seconds[tenth:2 * tenth])
    report.verdict('median ms of the last tenth over the second', float(growth), MAX_GROWTH)
    report.verdict('growth of the memory after the first tenth',
                   max(float(memory[-1] - memory[tenth]), 0.0), MAX_MEMORY_MB, 'MB')
    report.judge(lost == 0, f'{lost} images without a pose')


def resident_mb() -> float:
    """Return the memory that this process holds, megabytes."""
    try:
        with open('/proc/self/statm', encoding='ascii') as stream:
            return int(stream.read().split()[1]) * resource.getpagesize() / 1e6
    except OSError:
        # elsewhere the peak has to do
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
