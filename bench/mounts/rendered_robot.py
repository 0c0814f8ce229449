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
A rendered vehicle with the floor in view: video and wheels to the camera's place on the robot.

Run: python -m bench.mounts.rendered_robot [--seconds 20] [--first 1] [--seeds 6] [--slips 3]
[--worse 1].

Wheels slip, and the stamps of the images are 37 ms late. Lens, place, path and hall are drawn
anew for every seed. Required: angles 0.05 degrees, x and y 5 mm, offset 2 ms, height above the
floor 1 %.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.interpolate import CubicSpline
from selfcal_ros import calibrate, Camera, CameraFacts
from selfcal_ros.calibration.mount import mount_rotation
from selfcal_ros.calibration.mounting.mounting import mount_camera
from selfcal_ros.calibration.structure.floor import with_floor
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.synthetic.recordings import FIRST_STAMP_NS, Recording
from selfcal_ros.synthetic.worlds import hall
from selfcal_ros.values.body_poses import BodyPoses, ODOMETRY

IMAGE_HZ, ODOMETRY_HZ = 15, 50
LATE_S = 0.037
#: Errors of the wheels on a metre (forward, sideways) and on a radian of turning.
FORWARD_M, SIDEWAYS_M, HEADING_RAD = 0.002, 0.0005, 0.003
#: What a slip adds: metres that were not driven, radians that were not turned; its length.
SLIP_M, SLIP_RAD, SLIP_S = 0.04, 0.02, 0.2


def course(rng: np.random.Generator, seconds: float) -> CubicSpline:
    """Draw a drive of curves to both sides: x, y (m) and heading (rad) by time (s)."""
    t = np.arange(-1.0, seconds + 1.0, 0.01)
    first, second, third = rng.uniform(0, 2 * np.pi, 3)
    heading = 0.8 * np.sin(0.45 * t + first) + 0.4 * np.sin(0.8 * t + second)
    speed = 0.5 + 0.2 * np.sin(0.6 * t + third)
    steps = 0.01 * speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return CubicSpline(t, np.column_stack([np.cumsum(steps, axis=0), heading]))


def rendered(rng: np.random.Generator, drive: CubicSpline, seconds: float,
             seed: int) -> tuple[Recording, np.ndarray]:
    """Draw a camera and its place; return what it records and T_body_camera."""
    focal = rng.uniform(420, 620)
    camera = Camera([[focal, 0, rng.uniform(310, 330)], [0, focal, rng.uniform(230, 250)],
                     [0, 0, 1]], (rng.uniform(-0.15, 0.0), 0.04, 0.0, 0.0, 0.0), 640, 480)
    mount = np.eye(4)
    mount[:3, :3] = mount_rotation(*np.radians(rng.uniform([-3, 12, -6], [3, 25, 6])))
    mount[:3, 3] = rng.uniform([0.1, -0.2, 0.8], [0.5, 0.2, 1.3])
    when = np.arange(0.5, seconds - 0.5, 1 / IMAGE_HZ)
    x, y, heading = drive(when).T
    body = np.broadcast_to(np.eye(4), (len(when), 4, 4)).copy()
    body[:, :3, :3] = rotation_matrix(np.stack([0 * x, 0 * x, heading], axis=1))
    body[:, 0, 3], body[:, 1, 3] = x, y
    stamps = FIRST_STAMP_NS + np.round(1e9 * (when + LATE_S)).astype(np.int64)
    surfaces = hall(rng, np.stack([x, y], axis=1), heading)
    return Recording('rendered_robot', camera, np.linalg.inv(body @ mount)[:, :3], stamps,
                     surfaces, seed=seed), mount


def wheels(rng: np.random.Generator, drive: CubicSpline, seconds: float, slips: int,
           worse: float = 1.0) -> BodyPoses:
    """Return odometry of a drive, each step wrong by itself, with slips at random instants."""
    when = np.arange(0, seconds, 1 / ODOMETRY_HZ)
    x, y, theta = drive(when).T
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    ahead, aside = c * np.diff(x) + s * np.diff(y), c * np.diff(y) - s * np.diff(x)
    turned, way = np.diff(theta), np.hypot(ahead, aside)
    ahead = ahead + worse * FORWARD_M * np.sqrt(way) * rng.standard_normal(len(way))
    aside = aside + worse * SIDEWAYS_M * np.sqrt(way) * rng.standard_normal(len(way))
    turned = turned + worse * HEADING_RAD * np.sqrt(np.abs(turned)) * rng.standard_normal(len(way))
    lasts = int(SLIP_S * ODOMETRY_HZ)
    for at in rng.integers(0, len(way) - lasts, slips):
        ahead[at:at + lasts] += SLIP_M / lasts
        turned[at:at + lasts] += rng.choice([-1, 1]) * SLIP_RAD / lasts
    theta = np.append(0, np.cumsum(turned))
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    place = np.zeros((len(when), 3))
    place[1:, 0], place[1:, 1] = np.cumsum(c * ahead - s * aside), np.cumsum(s * ahead + c * aside)
    return BodyPoses(rotation_matrix(np.stack([0 * theta, 0 * theta, theta], axis=1)), place,
                     FIRST_STAMP_NS + np.round(1e9 * when).astype(np.int64), kind=ODOMETRY)


def one_run(seed: int, seconds: float, slips: int, worse: float) -> str:
    """Render, calibrate, find the mount, and return a row."""
    rng = np.random.default_rng([16, seed])
    drive = course(rng, seconds)
    recording, truth = rendered(rng, drive, seconds, seed)
    poses = wheels(rng, drive, seconds, slips, worse)
    tracks = extract_tracks((k, image, stamp)
                            for k, (image, stamp) in enumerate(recording.frames())).tracks
    found = calibrate(tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
    if not found:
        return f'| {seed} | {found.kind} |'
    stamps = {k: int(stamp) for k, stamp in enumerate(recording.stamps_ns)}
    found = with_floor(mount_camera(found, poses, stamps), tracks)
    mount = found.mount
    if not mount:
        return f'| {seed} | {mount.reason} |'
    T, sigma = mount.T_body_camera, mount.sigma
    place = 1e3 * (T[:3, 3] - truth[:3, 3])
    turn = np.degrees(rotation_vector(T[:3, :3] @ truth[:3, :3].T))
    cells = [f'{place[k]:+.1f} ± {1e3 * sigma[name]:.1f}' if mount.status[name] == 'estimated'
             else mount.status[name] for k, name in enumerate('xyz')]
    cells += [f'{off:+.3f} ± {np.degrees(sigma[name]):.3f}' if mount.status[name] == 'estimated'
              else mount.status[name] for off, name in zip(turn, ('roll', 'pitch', 'yaw'))]
    cells.append(f'{1e3 * (mount.time_offset_s - LATE_S):+.2f} ± {1e3 * sigma["time_offset"]:.2f}')
    floor, height = mount.floor, truth[2, 3]
    cells.append(f'{100 * (floor.height_m / height - 1):+.2f} ± {100 * floor.sigma_m / height:.2f}'
                 if floor else str(getattr(floor, 'reason', 'not asked')))
    fx = recording.camera.K[0, 0]
    cells.append(f'{100 * (found.camera.K[0, 0] / fx - 1):+.3f} ± '
                 f'{100 * found.sigma["fx"] / fx:.3f}')
    cells += [str(mount.outlier_count), ', '.join(one.kind for one in found.findings)]
    return f'| {seed} | ' + ' | '.join(cells) + ' |'


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=20.0)
    parser.add_argument('--first', type=int, default=1)
    parser.add_argument('--seeds', type=int, default=6)
    parser.add_argument('--slips', type=int, default=3)
    parser.add_argument('--worse', type=float, default=1.0, help='times the errors of wheels')
    args = parser.parse_args()
    print('| seed | x, mm | y, mm | z | roll, ° | pitch, ° | yaw, ° | offset, ms | floor, % '
          '| fx, % | poses set aside | told |')
    print('|---' * 12 + '|')
    for seed in range(args.first, args.first + args.seeds):
        print(one_run(seed, args.seconds, args.slips, args.worse), flush=True)


if __name__ == '__main__':
    main()
