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
Smooth parts given as meshes, followed by their outline: accuracy, hindrances, honesty, time.

The parts are those of `selfcal_ros.synthetic.mesh_scenes`, whose poses are exact.
"""

from __future__ import annotations

import time

from bench.tables import Report
from bench.tracking.tracking_poses import rms, settled, SHARES
from bench.tracking.tracking_runs import frame_error
import numpy as np
from scipy.stats import chi2
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState
from selfcal_ros.synthetic.mesh_scenes import MeshRenderer, SMOOTH
from selfcal_ros.synthetic.objects import object_poses, perturbed, tracked_object
from selfcal_ros.values.mesh import MeshModel

CAMERA = Camera(np.array([[520, 0, 320], [0, 520, 240], [0, 0, 1.0]]), (), 640, 480)
IMAGES, SPEED = 150, 0.7
#: Images in which the left half of the part is hidden.
HIDDEN = 60, 100
#: Required: degrees, share of the distance, milliseconds, images until it is followed again.
ROTATION_DEG, TRANSLATION, MEDIAN_MS, LATE_MS, AGAIN = 1.0, 0.01, 4.0, 6.0, 10


def run(report: Report, options) -> None:
    """Print the table; with --runs sequences of so many images."""
    count = options.runs or IMAGES
    report.section('Meshes: smooth parts by their outline',
                   f'{count} images 640x480 each, from a start 3° and 1 % off, grey noise 1.')
    rows, worst, times, inside = [], np.zeros(2), [], []
    lost, again = 0, 0
    for name in SMOOTH:
        for what in ('plain', 'before blobs', 'textured', 'half hidden'):
            if what == 'half hidden' and count <= HIDDEN[1]:
                continue
            errors, states, seconds, square, distance = follow(name, what, count)
            rotation, shift = np.rad2deg(rms(errors[:, 3:])), rms(errors[:, :3]) / distance
            missing = sum(state is TrackerState.LOST for state in states)
            off = np.linalg.norm(errors[:, 3:], axis=1) > np.deg2rad(10)
            followed = [state in (TrackerState.TRACKING, TrackerState.DEGRADED)
                        for state in states][-len(off):]
            lost = max(lost, int(np.count_nonzero(off & followed)))
            if what == 'half hidden':
                late = off[HIDDEN[1] - count:] | ~np.array(followed[HIDDEN[1] - count:])
                again = max(again, int(np.flatnonzero(late).max(initial=-1)) + 1)
            else:
                worst = np.maximum(worst, [rotation, shift])
                inside.append(square)
            times.append(seconds)
            rows.append((name, what, f'{rotation:.2f}', f'{100 * shift:.2f}', missing,
                         f'{1000 * np.median(seconds):.1f}',
                         *(f'{np.mean(square < chi2.ppf(share, 6)):.2f}' for share in SHARES)))
    report.table(('part', '', 'rotation rms °', 'translation rms %', 'lost', 'ms an image',
                  *(f'{100 * share:.0f} %' for share in SHARES)), rows)
    report.say('')
    report.verdict('rotation, worst rms', worst[0], ROTATION_DEG, '°')
    report.verdict('translation, worst rms', 100 * worst[1], 100 * TRANSLATION, '%')
    report.judge(lost == 0, f'{lost} images more than 10° off, and not said, at the worst')
    report.judge(again <= AGAIN, f'followed again {again} images after half of it was hidden')
    shares = [float(np.mean(np.concatenate(inside) < chi2.ppf(share, 6))) for share in SHARES]
    report.verdict('share of true poses inside the ellipsoids, worst difference',
                   max(abs(a - b) for a, b in zip(shares, SHARES)), 0.05)
    seconds = 1000 * np.concatenate(times)
    report.verdict('median', float(np.median(seconds)), MEDIAN_MS, 'ms')
    report.verdict('95 %', float(np.percentile(seconds, 95)), LATE_MS, 'ms')
    report.say(f'A rendered cube in the same run: {1000 * cube_seconds():.1f} ms.')


def follow(name: str, what: str, count: int):
    """Follow a part; returns errors, states, seconds, Mahalanobis squares and mean distance."""
    vertices, faces = SMOOTH[name]()
    model = MeshModel.build(vertices, faces, name)
    drawn = MeshRenderer(vertices, faces, CAMERA, np.random.default_rng(1)
                         if what in ('before blobs', 'half hidden') else None,
                         textured=what == 'textured')
    poses = object_poses('general', count, model.diameter_m, speed=SPEED)
    distance = float(np.linalg.norm(poses[:, :, 3], axis=1).mean())
    tracker = RorapidTracker(model, CAMERA, rng=np.random.default_rng(0))
    tracker.start(*perturbed(poses[0][:, :3], poses[0][:, 3], np.random.default_rng(3), 0.05,
                             0.01 * distance))
    errors, states, seconds, squares = [], [], [], []
    for k, pose in enumerate(poses):
        image = drawn.render(pose, np.random.default_rng(k), 1.0)
        if what == 'half hidden' and HIDDEN[0] <= k < HIDDEN[1]:
            middle = CAMERA.project(pose[:, 3][None])[0]
            image[:, max(int(middle[0]) - 150, 0):max(int(middle[0]), 0)] = 90
        began = time.thread_time()
        frame = tracker.track(image)
        seconds.append(time.thread_time() - began)
        error, square = frame_error(frame, pose[:, :3], pose[:, 3])
        errors.append(error)
        states.append(frame.state)
        squares.append(square)
    return (settled(np.array(errors)), states, seconds[1:], settled(np.array(squares)), distance)


def cube_seconds() -> float:
    """Median time of an image of a rendered cube."""
    made = tracked_object(40, 'cube', seed=16)
    tracker = RorapidTracker(made.model, made.camera, rng=np.random.default_rng(0))
    tracker.start(made.rotations[0], made.translations[0])
    seconds = []
    for image, _ in made.frames():
        began = time.thread_time()
        tracker.track(image)
        seconds.append(time.thread_time() - began)
    return float(np.median(seconds))
