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
Several cameras that see one object: accuracy, honest sigmas, and what is wrong between them.

Rendered objects before two or three cameras of their own walls, and the recorded tea box.
"""

from __future__ import annotations

from dataclasses import replace
import time

from bench.inputs import data_folder
from bench.tables import Report
from bench.tracking.tracking_poses import SHARES
from bench.tracking.tracking_runs import frame_error, WRONG
from bench.tracking.tracking_stereo import CAMERAS, CLICKS, CORNERS
import cv2
import numpy as np
from scipy.stats import chi2
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.pipeline.file_sources import VideoSource
from selfcal_ros.rorapid.estimation.initial_pose import pose_from_clicks
from selfcal_ros.rorapid.model import read_model
from selfcal_ros.rorapid.several_cameras.rig_tracker import RigTracker
from selfcal_ros.rorapid.tracker import RorapidTracker
from selfcal_ros.synthetic.objects import perturbed
from selfcal_ros.synthetic.several_cameras import object_before_cameras, turned_camera
from selfcal_ros.values.camera_rig import PlacedCamera

#: Object, seed, where the cameras stand (in distances of the object), speed.
SCENES = (('cube', 201, (0, 0.3), 0.6), ('box', 202, (0, -0.5), 0.7),
          ('step_block', 203, (0, 0.8), 0.8), ('l_block', 204, (0, 0.15), 0.9),
          ('spool', 205, (0, 0.4), 1.0), ('cube', 206, (0, 0.6, -0.6), 1.1),
          ('step_block', 207, (0, 0.25), 1.2), ('box', 208, (0, -0.3), 0.65))
IMAGES = 100
#: Images in which a camera is covered, and from which on one is knocked by so many degrees.
COVERED, KNOCKED, DEGREES = (30, 70), 40, 2.0
#: Images within which something must be said.
SAID = 30


class _Scene:
    """One object before some cameras."""

    def __init__(self, shape, seed, aside, speed, count):
        self.recordings, self.cameras = object_before_cameras(
            count, shape, aside, seed=seed, supersampling=2, speed=speed)
        self.images = [[image for image, _ in one.frames()] for one in self.recordings]
        self.truth, self.seed, self.count = self.recordings[0], seed, count
        self.start = perturbed(self.truth.rotations[0], self.truth.translations[0],
                               np.random.default_rng(seed), 0.04, 0.003)

    def error(self, tracked, k):
        """Error (6,) of a pose, and its square in sigmas."""
        return frame_error(tracked, self.truth.rotations[k], self.truth.translations[k])

    def follow(self, what):
        """Follow with something wrong; returns rows (error, square, depth sigma) and findings."""
        cameras, model = list(self.cameras), self.truth.model
        rng = np.random.default_rng(self.seed + 7)
        if what == 'transform':
            cameras[-1] = turned_camera(cameras[-1], DEGREES, rng.normal(size=3))
        if what == 'size':
            model = replace(model, vertices=0.96 * model.vertices)
        rig = RigTracker(model, cameras)
        rig.start(*self.start)
        K = self.truth.camera.K
        axis = rng.normal(size=3) * [1, 1, 0.3]
        turn = K @ rotation_matrix(np.deg2rad(DEGREES) * axis / np.linalg.norm(axis)) @ (
            np.linalg.inv(K))
        rows, said = [], None
        for k in range(self.count):
            now = [one[k] for one in self.images]
            if what == 'covered' and COVERED[0] <= k < COVERED[1]:
                which = self.seed % len(now)
                now[which] = np.full_like(now[which], 90)
            if what == 'knock' and k >= KNOCKED:
                now[-1] = cv2.warpPerspective(now[-1], turn, now[-1].shape[::-1], borderMode=1)
            began = time.thread_time()
            tracked = rig.track(now).tracked
            seconds = time.thread_time() - began
            if tracked.doubt and said is None:
                said = k
            if tracked:
                rows.append((*self.error(tracked, k), tracked.covariance[2, 2], seconds,
                             len(tracked.doubt)))
        return rows, said

    def alone(self, which):
        """Follow with one camera; returns frames."""
        tracker = RorapidTracker(self.truth.model, self.truth.camera)
        back = np.linalg.inv(self.cameras[which].T_rig_camera)
        tracker.start(back[:3, :3] @ self.start[0], back[:3, :3] @ self.start[1] + back[:3, 3])
        return [tracker.track(image) for image in self.images[which]]


def run(report: Report, options) -> None:
    """Print the tables; with --runs so many images each."""
    count = options.runs or IMAGES
    report.section('One object, several cameras',
                   f'{len(SCENES)} scenes of {count} images 640x480; the last camera has what is '
                   'wrong.')
    squares, alone, ratio, gain, table, wrong, late = [], [], [], [], [], 0, []
    for shape, seed, aside, speed in SCENES:
        scene = _Scene(shape, seed, aside, speed, count)
        frames = [scene.alone(k) for k in range(len(aside))]
        for what in ('clean', 'covered', 'transform', 'knock', 'size'):
            if what == 'size' and (scene.truth.model.cylinders or scene.truth.model.conics):
                continue
            rows, said = scene.follow(what)
            off = [row[1] for row in rows]
            bad = int(np.sum(np.array(off) > WRONG))
            wrong += bad
            due = {'transform': 0, 'size': 0, 'knock': KNOCKED}.get(what)
            if due is not None and count > due:
                late.append((count if said is None else said) - due)
            elif said is not None and what != 'knock':
                late.append(count)
            table.append((f'{shape} {seed}', len(aside), what, len(rows), bad,
                          f'{max(off):.0f}', '-' if said is None else said))
            if what == 'clean':
                squares += off
                alone += [scene.error(frame, k)[1] for k, frame in enumerate(frames[0]) if frame]
                sigma = np.sqrt([row[2] for row in rows])
                gain.append(np.median(sigma / [frame.covariance[2, 2]**0.5
                                               for frame in frames[0][-len(sigma):]]))
                ratio.append(np.median(sigma / _expected(scene, frames)[-len(sigma):]))
    report.table(('scene', 'cameras', 'what', 'poses', f'squares > {WRONG:.0f}', 'worst square',
                  'said in image'), table)
    report.say('')
    report.judge(wrong == 0, f'{wrong} poses confidently wrong')
    report.judge(max(late) <= SAID, f'what is wrong was said after {max(late)} images at the most')
    shares = [float(np.mean(np.array(squares) < chi2.ppf(share, 6))) for share in SHARES]
    report.say(f'True poses inside the 60, 80, 90, 95 % ellipsoids: {_percent(shares)}; of one '
               f'camera {_percent([np.mean(np.array(alone) < chi2.ppf(s, 6)) for s in SHARES])}.')
    report.verdict('worst difference', max(abs(a - b) for a, b in zip(shares, SHARES)), 0.05)
    report.say(f'Sigma of depth over that of one camera: {min(gain):.2f} to {max(gain):.2f}.')
    report.verdict('sigma of depth, over that of the sum of the single informations, worst',
                   float(np.abs(np.log(ratio)).max()), 0.25)
    _tea_box(report)


def _percent(shares) -> str:
    return ', '.join(f'{100 * share:.1f}' for share in shares) + ' %'


def _expected(scene: _Scene, frames) -> np.ndarray:
    """Sigma of depth of the summed information of single cameras, (V,) metres."""
    found = []
    for k in range(scene.count):
        known = np.zeros((6, 6))
        for placed, some in zip(scene.cameras, frames):
            turn = np.kron(np.eye(2), placed.T_rig_camera[:3, :3])
            known += turn @ np.linalg.inv(some[k].covariance) @ turn.T
        found.append(np.linalg.inv(known)[2, 2]**0.5)
    return np.array(found)


def _tea_box(report: Report) -> None:
    """Follow the recorded box by both cameras."""
    folder = data_folder('visp_tracking_videos')
    if folder is None:
        report.say('The tea box is left out: the recorded sets are not there.')
        return
    model = read_model(folder / 'teabox.cao')
    back = np.linalg.inv(np.loadtxt(folder / 'cRightMcLeft.txt'))
    cameras, images = [], []
    for side, place in (('left', np.eye(4)), ('right', back)):
        fx, fy, cx, cy = CAMERAS[side]
        camera = Camera([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], (), 640, 480)
        cameras.append(PlacedCamera(side, camera, place))
        images.append([frame.image for frame in VideoSource(
            folder / 'images' / f'teabox_{side}.mp4')])
    rig = RigTracker(model, cameras)
    rig.start(*pose_from_clicks(CORNERS, CLICKS['left'], cameras[0].camera)[:2])
    frames = [rig.track(pair).tracked for pair in zip(*images)]
    report.judge(all(frames), f'tea box: {sum(map(bool, frames))} of {len(frames)} images '
                 'followed by both')
    said = [k for k, frame in enumerate(frames) if frame.doubt]
    report.say(f'Said in {len(said)} of them, from image {said[0] if said else "-"} on: '
               f'{frames[-1].doubt or "nothing"}')
