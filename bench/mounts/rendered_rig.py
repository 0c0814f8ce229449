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
Two cameras of a vehicle that see nothing in common, rendered: images to their place in the rig.

Run: python -m bench.mounts.rendered_rig [--views 36] [--seeds 1] [--own-clock 16]. One looks
ahead, the other to the right from half a metre behind. With a clock of its own the second takes
its images halfway between those of the first, of which every 16th is used, or so. Required:
rotation 0.05 degrees, translation 1 % of the path.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
import time

import numpy as np
from selfcal_ros import calibrate_rig, Camera, CameraFacts
from selfcal_ros.features.at_instant import ImagesBeside
from selfcal_ros.features.rig_extraction import extract_rig_tracks
from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.synthetic.recordings import agv_drive

#: The second camera in the first: turned about the vertical, and its place, metres.
TURN, PLACE = rotation_matrix(np.array([0.0, 1.5, 0.0])), np.array([0.3, 0.1, -0.4])
#: Half the time between two images of a camera at 15 Hz.
HALF_S = 0.5 / 15
SIDE = Camera([[430, 0, 310], [0, 430, 235], [0, 0, 1]], (), 640, 480)


def one_run(views: int, seed: int, every: int) -> str:
    """Render, calibrate, and return a row; `every` 0: both cameras are triggered together."""
    # half steps of the video: the second camera has the odd ones
    steps = 2 * (every or 1)
    ahead = agv_drive(steps * views + 2, seed=seed)
    poses = TURN.T @ ahead.cam_from_world
    poses[:, :, 3] -= TURN.T @ PLACE
    aside = replace(ahead, camera=SIDE, cam_from_world=poses, seed=seed + 1000)
    instants = 2 + steps * np.arange(views)
    began = time.process_time()
    first, second = ahead.renderer(), aside.renderer()
    late = 1 if every else 0
    images = {'ahead': [ahead.frame(at, first) for at in instants],
              'aside': [aside.frame(at + late, second) for at in instants]}
    beside = {'aside': [ImagesBeside(HALF_S, tuple(
        ((1 + beyond) * HALF_S, aside.frame(at + 1 + beyond, second)) for beyond in (-2, 2)))
        for at in instants]} if every else None
    ahead = replace(ahead, cam_from_world=ahead.cam_from_world[instants])
    rendered = time.process_time()
    tracks = extract_rig_tracks(images, range(views), rng=np.random.default_rng(seed),
                                beside=beside)
    result = calibrate_rig(tracks.tracks, shared_tracks=tracks.shared > 0, facts=CameraFacts(
        aspect_ratio=1.0, skew=0.0))
    seconds = f'{rendered - began:.0f} + {time.process_time() - rendered:.0f}'
    if not result:
        return f'| {seed} | {views} | {result.kind} | | | | {seconds} |'
    pose, centres = result.poses['aside'], camera_centres(ahead.cam_from_world)
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    unit, way = float(np.sqrt(np.mean(steps**2))), steps.sum()
    turn = rotation_vector(pose.T_rig_camera[:3, :3] @ TURN.T)
    turned = np.abs(turn) / [pose.sigma[name] for name in ('roll', 'pitch', 'yaw')]
    along = ([(one.direction @ PLACE / unit - one.value, one.sigma) for one in pose.places]
             or list(zip(PLACE / unit - pose.T_rig_camera[:3, 3],
                         [pose.sigma[name] for name in 'xyz'])))
    lens = ', '.join(
        f'{100 * (found.camera.K[0, 0] / camera.K[0, 0] - 1):+.3f} ± '
        f'{100 * found.sigma["fx"] / camera.K[0, 0]:.3f}'
        for found, camera in zip(result.cameras.values(), (ahead.camera, SIDE)))
    return (f'| {seed} | {views} | {np.degrees(np.linalg.norm(turn)):.3f} '
            f'({turned.max():.1f} σ at most) | '
            + ', '.join(f'{100 * abs(off) * unit / way:.3f} ({abs(off) / sigma:.1f} σ)'
                        for off, sigma in along)
            + f' | {lens} | {", ".join(one.kind for one in result.findings)} | {seconds} |')


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--views', type=int, default=36)
    parser.add_argument('--seeds', type=int, default=1)
    parser.add_argument('--own-clock', type=int, default=0, metavar='EVERY', help=(
        'the cameras are not triggered together; of their 15 images a second every so many is '
        'used'))
    args = parser.parse_args()
    print('| seed | instants | rotation, deg | place, % of the path, what is shown | fx, % | told '
          '| render + rest, s |')
    print('|---' * 7 + '|')
    for seed in range(1, args.seeds + 1):
        print(one_run(args.views, seed, args.own_clock), flush=True)


if __name__ == '__main__':
    main()
