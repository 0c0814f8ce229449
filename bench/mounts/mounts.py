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
Mounts of cameras on robots: recorded sets against their truth, degenerate motions, coverage.

`python -m bench mounts [--runs N] [--cache FOLDER]`: N simulated robots of each sort (1000 by
default, which takes an hour), tracks and calibrations of the sets kept in the folder.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path
import pickle
import tempfile

from bench.calibration.known_object import FREE_ASPECT, kuka_board
from bench.inputs import data_folder, grey_frames, image_files
from bench.lenses.lens_distance import best_rotation, pixel_grid
from bench.mounts import mount_worlds as worlds
from bench.tables import Report
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from selfcal_ros import calibrate, Camera, CameraFacts, Tracks
from selfcal_ros.calibration.known_object.point_calibration import calibrate_known_object
from selfcal_ros.calibration.mount import NAMES
from selfcal_ros.calibration.mounting.gyro import mount_by_gyro
from selfcal_ros.calibration.mounting.mounting import mount_camera
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.values.angular_rates import AngularRates
from selfcal_ros.values.body_poses import BodyPoses, ODOMETRY

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0)
SHIFTS_MS = (0, 5, 50)
LEVELS = (0.6, 0.8, 0.9, 0.95)
HEADER = ('set', 'status', 'place mm', 'sigma mm', 'turn °', 'with the rays aligned', 'sigma °',
          'scale ± %', 'offset ms', 'poses, set aside', 'fx before', 'fx after')


def run(report: Report, options) -> None:
    """Print all tables."""
    work = Path(options.cache or tempfile.mkdtemp())
    work.mkdir(parents=True, exist_ok=True)
    _recorded(report, work)
    _coverage(report, options.runs or 1000)


def _kept(path: Path, make):
    """Make something, or take it from an earlier run."""
    if not path.exists():
        path.write_bytes(pickle.dumps(make()))
    return pickle.loads(path.read_bytes())


def _poses(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read rotations and positions of a table with tx .. qz."""
    with path.open(encoding='utf-8', newline='') as file:
        rows = list(csv.DictReader(file))
    place, turn = (np.array([[float(row[name]) for name in names] for row in rows])
                   for names in (('tx', 'ty', 'tz'), ('qx', 'qy', 'qz', 'qw')))
    return Rotation.from_quat(turn).as_matrix(), place


def _degrees(rotation) -> str:
    turn = np.rad2deg(rotation_vector(rotation))
    return f'{np.linalg.norm(turn):.3f} (' + ' '.join(f'{one:+.3f}' for one in turn) + ')'


def _row(name, before, after, truth, lens=None):
    """
    Return a row of the table.

    An optical axis depends on the lens that it is of: 1 px of principal point turns it by 1 px.
    So the mounts are also compared after our rays of the pixels were turned onto those of the
    lens that the truth was made with.
    """
    mount = after.mount
    if not mount:
        return [name, mount.reason]
    T, sigma = mount.T_body_camera, mount.sigma
    off = 1e3 * (T[:3, 3] - truth[:3, 3])
    aligned = ''
    if lens is not None:
        pixels = pixel_grid(lens.width, lens.height, 40, 30)
        ours, theirs = after.camera.rays(pixels), lens.rays(pixels)
        seen = np.isfinite(ours).all(axis=1) & np.isfinite(theirs).all(axis=1)
        onto = best_rotation(theirs[seen], ours[seen]).as_matrix()
        aligned = _degrees(T[:3, :3] @ onto @ truth[:3, :3].T)
    return [name, ''.join(mount.status[one][0] for one in NAMES),
            ' '.join(f'{one:+.2f}' for one in off),
            ' '.join(f'{1e3 * sigma[one]:.2f}' for one in 'xyz'),
            _degrees(T[:3, :3] @ truth[:3, :3].T), aligned,
            ' '.join(f'{np.rad2deg(sigma[one]):.3f}' for one in ('roll', 'pitch', 'yaw')),
            f'{100 * sigma["scale"] / mount.scale:.3f}',
            f'{1e3 * mount.time_offset_s:+.3f} ± {1e3 * sigma["time_offset"]:.2f}',
            f'{mount.pose_count}, {mount.outlier_count}',
            f'{before.camera.K[0, 0]:.2f} ± {before.sigma["fx"]:.2f}',
            f'{after.camera.K[0, 0]:.2f} ± {after.sigma["fx"]:.2f}']


def _recorded(report: Report, work: Path) -> None:
    """Hold mounts against the truth of recorded sets."""
    report.section('Recorded sets', 'Status: e estimated, h held, u unobservable, of '
                   + ', '.join(NAMES) + '.')
    rows = []

    def images(name, files, **more):
        made = _kept(work / f'{name}.tracks.pkl', lambda: extract_tracks(
            grey_frames(files), 'wide', max_keyframes=len(files)).tracks)
        return _kept(work / f'{name}.result.pkl',
                     lambda: calibrate(made, facts=SQUARE, **more))
    for name, source, key in (('kuka_hand_eye', 'kuka_chess', 'T_flange_cam'),
                              ('cs_synthetic', 'cs_synthetic', 'T_flange_cam')):
        folder, pictures = data_folder(name), data_folder(source)
        if folder is None or pictures is None:
            continue
        found = images(name, image_files(pictures))
        R, p = _poses(folder / 'poses.csv')
        truth = json.loads((folder / 'truth.json').read_text(encoding='utf-8'))
        lens = _published(truth, truth['image_size'])
        poses = BodyPoses(R, p, frames=np.arange(len(p)))
        after = mount_camera(found, poses)
        rows.append(_row(name, found, after, np.array(truth[key]), lens))
        if name == 'kuka_hand_eye':
            # the same estimate of a mount, once from the board: what is left is the images' own
            board = calibrate_known_object(*kuka_board(pictures), facts=FREE_ASPECT)
            mount = mount_camera(board, poses)
            rows += [_row('its board, free to bend, beside the published mount', board, mount,
                          np.array(truth[key]), lens),
                     _row('kuka_hand_eye beside its board', found, after,
                          mount.mount.T_body_camera, mount.camera)]
    folder = data_folder('euroc_v101')
    if folder is not None:
        files = sorted((folder / 'cam0').glob('*.jpg'))
        found = images('euroc_v101', files)
        R, p = _poses(folder / 'body_poses.csv')
        lines = (folder / 'body_poses.csv').read_text(encoding='utf-8').splitlines()[1:]
        poses = BodyPoses(R, p, stamps_ns=np.array([int(one.split(',')[0]) for one in lines]))
        truth = json.loads((folder / 'truth.json').read_text(encoding='utf-8'))
        T, lens = truth['cam0']['T_body_cam'], _published(truth['cam0'], truth['image_size'])
        for shift in SHIFTS_MS:
            stamps = {k: int(path.stem) + shift * 10**6 for k, path in enumerate(files)}
            rows.append(_row(f'euroc_v101, stamps {shift} ms late', found,
                             mount_camera(found, poses, stamps), np.array(T), lens))
            rows.append(_row(f'the same by its gyro, {shift} ms late', found,
                             mount_by_gyro(found, _gyro(folder), stamps), np.array(T), lens))
    folder = data_folder('planar_robot_odometry')
    if folder is not None:
        found = _kept(work / 'planar.result.pkl', lambda: _planar_robot(folder))
        table = np.loadtxt(folder / 'odometry.csv', delimiter=',', skiprows=1)
        none = 0 * table[:, 0]
        poses = BodyPoses(rotation_matrix(np.stack([none, none, table[:, 3]], axis=1)),
                          np.stack([table[:, 1], table[:, 2], none], axis=1),
                          frames=table[:, 0].astype(int), kind=ODOMETRY)
        truth = json.loads((folder / 'truth.json').read_text(encoding='utf-8'))
        rows.append(_row('planar_robot_odometry', found, mount_camera(found, poses),
                         np.array(truth['T_base_cam'])))
    report.table(HEADER, [row + [''] * (len(HEADER) - len(row)) for row in rows])


def _published(truth: dict, size) -> Camera:
    """Return the lens that a truth was made with."""
    return Camera(truth['K'], truth.get('dist', ()), *size)


def _gyro(folder: Path) -> AngularRates:
    """Read what the inertial unit of the drone measured."""
    with (folder / 'imu.csv').open(encoding='utf-8', newline='') as file:
        rows = list(csv.DictReader(file))
    return AngularRates(np.array([int(row['stamp_ns']) for row in rows]), np.array(
        [[float(row[f'gyro_{axis}']) for axis in 'xyz'] for row in rows]))


def _planar_robot(folder: Path):
    """Calibrate from the tracks of the planar robot."""
    table = np.loadtxt(folder / 'tracks.csv', delimiter=',', skiprows=1)
    tracks = Tracks(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2:4], (640, 480))
    return calibrate(tracks, motion='planar', facts=CameraFacts(
        aspect_ratio=1.0, skew=0.0, distortion='none'))


def simulated(kind: str, rng: np.random.Generator):
    """Draw a robot: a world, its calibration, poses, stamps and the offset of the clocks."""
    T, late = worlds.mount_of(rng), 0.0
    stamps, timed = None, kind.endswith('by time')
    motion = worlds.drive if kind.startswith('drive') else worlds.hand
    images = 0.5 + 0.5 * np.arange(50)
    own, when = images, {'frames': np.arange(len(images))}
    if timed:
        late, own = rng.uniform(-0.1, 0.1), np.arange(0, images[-1] + 1, 0.04)
        when = {'stamps_ns': np.round(own * 1e9).astype(int)}
        stamps = {k: int(round(t * 1e9)) for k, t in enumerate(images)}
    world = worlds.World(*motion(images - late), T, motion is worlds.drive)
    calibration = worlds.calibrated(rng, world)
    path = motion(own)
    poses = worlds.odometry(rng, *path, (0.01, 0.003, 0.01), **when) \
        if motion is worlds.drive else worlds.measured(rng, *path, 1e-3, 1e-3, **when)
    return world, calibration, poses, stamps, late


def _coverage(report: Report, runs: int) -> None:
    """Count truths within the ellipsoids of mount, scale and offset together."""
    report.section('Coverage', f'{runs} robots each: shares of truths within the ellipsoids of '
                   'all that was estimated.')
    rows = []
    for kind in ('hand', 'hand by time', 'drive', 'drive by time'):
        levels, refused = [], 0
        for seed in range(runs):
            world, calibration, poses, stamps, late = simulated(
                kind, np.random.default_rng(seed))
            mount = mount_camera(calibration, poses, stamps).mount
            if not mount:
                refused += 1
                continue
            use = [k for k, name in enumerate(NAMES) if mount.status[name] == 'estimated']
            errors = worlds.mount_errors(mount, world.T_body_camera,
                                         worlds.true_scale(world, calibration), late)[use]
            square = errors @ np.linalg.solve(mount.covariance[np.ix_(use, use)], errors)
            levels.append(chi2.cdf(square, len(use)))
        shares = [float(np.mean(np.array(levels) < level)) for level in LEVELS]
        rows.append([kind, *(f'{share:.3f}' for share in shares), refused])
        report.judge(max(abs(share - level) for share, level in zip(shares, LEVELS)) < 0.03,
                     f'{kind}: shares within 0.03')
    report.table(('robot', *LEVELS, 'refused'), rows)
