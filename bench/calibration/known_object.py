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
"""Known objects: the thesis's grid (tables 3.1, 3.2), recorded sets, and `cv2.calibrateCamera`."""

from __future__ import annotations

from pathlib import Path
import time

from bench.inputs import data_folder, grey_frames, image_files, truth_of
from bench.tables import percent, Report
import cv2
import numpy as np
from selfcal_ros.calibration.known_object.point_calibration import calibrate_known_object
from selfcal_ros.features.targets import Chessboard
from selfcal_ros.features.tsai_grid import TsaiGrid
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.resection import decompose, resect, resect_linear
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.calibration_grid import grid_scene, view_of_grid
from selfcal_ros.synthetic.render import Renderer
from selfcal_ros.values.known_object import KnownObject
from selfcal_ros.values.tracks import Tracks

#: The thesis's grid: 16 squares on each of two planes, 512 x 512 pixels, αu 649, ζ 1.5.
GRID = TsaiGrid(4, 4, 0.04, 0.03, 0.03)
GRID_CAMERA = Camera([[648.7, 0, 251.8], [0, 972.7, 256.3], [0, 0, 1]], np.zeros(4), 512, 512)
IMAGES = 24
#: Corner noise that gives the thesis's reprojection error after the non-linear step.
THESIS_CORNER_NOISE_PX = 0.128
FREE_ASPECT = CameraFacts(skew=0.0)
#: A printed board before a camera, and how well its corners are found.
BOARD, VIEWS, BOARD_NOISE_PX = (9, 6), 15, 0.15
BOARD_CAMERA = Camera([[1150, 0, 650], [0, 1150, 470], [0, 0, 1]],
                      [-0.22, 0.09, 0.0005, -0.0004], 1280, 960)


def run(report: Report, options) -> None:
    """Print the grid of the thesis, then the recorded sets beside OpenCV."""
    thesis_grid(report)
    recorded(report)
    bent_boards(report, options.runs or 20)


def grid_poses(rng) -> list[np.ndarray]:
    """Return views of the grid: middle and four corners of the image in turn, other turns."""
    poses = []
    for k in range(IMAGES):
        place = np.array([(0, 0), (1, -1), (-1, -1), (-1, 1), (1, 1)][k % 5])
        turn = [0.35, 0, 0] + rng.uniform(-0.12, 0.12, 3)
        poses.append(view_of_grid(GRID.known.points, 1.0, turn, 0.05 * place * [1, 0.4],
                                  inside=bool(k % 2)))
    return poses


def thesis_grid(report: Report) -> None:
    """Tables 3.1 and 3.2 from rendered images, and from corners with the thesis's noise."""
    rng = np.random.default_rng(0)
    poses, points = grid_poses(rng), GRID.known.points
    renderer = Renderer(grid_scene(4, 4, 0.04, 0.03, 0.03), GRID_CAMERA, 3, 120)
    rendered = []
    for pose in poses:
        identity, xy = GRID.find(renderer.render(pose, rng, 2.0))
        if len(identity):
            rendered.append(xy)
    exact = [GRID_CAMERA.project(points @ pose[:, :3].T + pose[:, 3]) for pose in poses]
    noisy = [xy + THESIS_CORNER_NOISE_PX * rng.standard_normal(xy.shape) for xy in exact]
    report.section('Tsai grid, one image a calibration (thesis 3.2)',
                   f'{IMAGES} views, 128 corners; grid found in {len(rendered)} rendered images '
                   '(grey noise σ 2);', 'corner noise: true corners with '
                   f"{THESIS_CORNER_NOISE_PX} px a coordinate, which leave the thesis's error.",
                   'Our linear step normalises points and image; the thesis does not say so.')
    report.judge(len(rendered) == IMAGES, f'grid found in {len(rendered)} of {IMAGES} images')
    errors, spreads = [], []
    for name, views in (('rendered', rendered), ('corner noise', noisy)):
        linear, refined, cameras = [], [], []
        for xy in views:
            P = resect_linear(points, xy)
            x = points @ P[:, :3].T + P[:, 3]
            linear.append(np.linalg.norm(x[:, :2] / x[:, 2:] - xy, axis=1).mean())
            best = resect(points, xy, start=P)
            refined.append(best.mean_error_px)
            K = decompose(best.P).K
            cameras.append([K[0, 0], K[1, 1], K[1, 1] / K[0, 0], K[0, 2], K[1, 2]])
        errors.append((f'linear, {name}', np.mean(linear), np.max(linear), np.min(linear)))
        errors.append((f'non-linear, {name}', np.mean(refined), np.max(refined),
                       np.min(refined)))
        mean, deviation = np.mean(cameras, axis=0), np.std(cameras, axis=0, ddof=1)
        spreads.append((name, *(f'{m:.5g} ({100 * d / m:.2g} %)'
                                for m, d in zip(mean, deviation))))
        limits = [0.4, 0.5, 0.1, 8.0, 8.0]
        worst = np.max(100 * deviation / mean / limits)
        report.verdict(f'{name}: largest spread over that of the thesis', worst, 1.0)
    report.say('')
    report.table(('reprojection error px', 'mean', 'max', 'min'), [
        ('thesis, linear', 0.625, 2.075, 0.256), ('thesis, non-linear', 0.158, 0.283, 0.107),
        *errors])
    report.say('')
    report.table(('spread over 24 images', 'αu', 'αv', 'ζ', 'u0', 'v0'), [
        ('thesis', '648.7 (0.4 %)', '972.7 (0.5 %)', '1.4993 (0.1 %)', '251.8 (8 %)',
         '256.3 (8 %)'), *spreads])
    report.say('')
    views = rendered
    tracks = Tracks(np.repeat(np.arange(len(views)), 128), np.tile(np.arange(128), len(views)),
                    np.concatenate(views), (512, 512))
    result = calibrate_known_object(tracks, GRID.known, facts=FREE_ASPECT)
    report.say('All rendered images at once: ' + ', '.join(
        f'{name} {value:.3f} ± {result.sigma[name]:.3f}' for name, value in
        zip(('fx', 'fy', 'cx', 'cy'), result.camera.parameters)))
    report.verdict('focal length error, all images',
                   percent(result.camera.K[0, 0], GRID_CAMERA.K[0, 0]), 0.1, '%')


def recorded(report: Report) -> None:
    """Recorded sets with known cameras."""
    for name, read, limit in (('opencv_left', _left, 0.2), ('vamr_tags3d', _tags, 1.0),
                              ('kuka_chess', kuka_board, 0.1)):
        folder = data_folder(name)
        report.section(name, 'Facts: skew 0. Same corners for both; OpenCV with the same '
                       'distortion model. Boards are supposed flat, as the truths suppose.')
        if folder is None:
            report.say(f'Left out: ../shared/data/{name} is not there.')
            continue
        compare(report, truth_of(folder), *read(folder), limit)
    fisheye(report)


def room_board(folder: Path) -> tuple[Chessboard, list, Tracks]:
    """Find the board in the images of `fisheye_room`: itself, corners by view, and as tracks."""
    board, seen = Chessboard(8, 6, 0.117), []
    # the last image is a copy of the first
    for _, image, _ in grey_frames(image_files(folder)[:-1]):
        identity, xy = board.find(image)
        if len(identity):
            seen.append(xy)
    return board, seen, _tracks(seen, (748, 480))


def fisheye(report: Report) -> None:
    """Compare a board before a full-circle fisheye with `cv2.fisheye.calibrate`."""
    name = 'fisheye_room'
    report.section(name, 'Facts: skew 0, lens auto. Corners found in the images by '
                   'Chessboard.find, the same for both.')
    folder = data_folder(name)
    if folder is None or not hasattr(cv2, 'fisheye'):
        report.say(f'Left out: ../shared/data/{name} or cv2.fisheye is not there.')
        return
    board, seen, tracks = room_board(folder)
    began = time.perf_counter()
    result = calibrate_known_object(tracks, board.known, facts=FREE_ASPECT, flatness=0)
    seconds = time.perf_counter() - began
    if not report.judge(bool(result) and result.facts.distortion == 'equidistant',
                        f'lens {result.facts.distortion}' if result else str(result)):
        return
    flags = sum(getattr(cv2, f'CALIB_{what}', 0) or getattr(cv2.fisheye, f'CALIB_{what}')
                for what in ('RECOMPUTE_EXTRINSIC', 'FIX_SKEW', 'USE_INTRINSIC_GUESS'))
    points = board.known.points[None]
    # without a guess it stops with an error
    start = np.array([[230.0, 0, 373.5], [0, 230.0, 239.5], [0, 0, 1]])
    began = time.perf_counter()
    rms, K, _, _, _ = cv2.fisheye.calibrate(
        [points] * len(seen), [xy[None] for xy in seen], (748, 480), start,
        np.zeros((4, 1)), flags=flags)
    peer_s = time.perf_counter() - began
    rows = [(what, f'{value:.3f} ± {result.sigma[what]:.3f}', f'{peer:.3f}',
             f'{(value - peer) / result.sigma[what]:+.1f}')
            for what, value, peer in zip(('fx', 'fy', 'cx', 'cy'), result.camera.parameters,
                                         K[[0, 1, 0, 1], [0, 1, 2, 2]])]
    report.table(('', 'ours', 'cv2.fisheye', 'apart in σ'), rows)
    report.say(f'{len(seen)} views, {result.observation_count} points, '
               f'{result.outlier_count} left out; rms {result.reprojection_rms_px:.3f} px, '
               f'cv2.fisheye {rms:.3f} px; {seconds:.2f} s, cv2.fisheye {peer_s:.2f} s.')
    for k, what in enumerate(('fx', 'fy')):
        report.verdict(f'{what} beside cv2.fisheye',
                       percent(result.camera.parameters[k], K[k, k]), 0.1, '%')


def bent_boards(report: Report, runs: int) -> None:
    """Boards that are not flat, beside OpenCV: as flat boards, and with its boards left free."""
    report.section('Bent boards', f'{BOARD[0]} x {BOARD[1]} corners 27 mm apart, {VIEWS} views, '
                   f'{BOARD_NOISE_PX} px of noise, {runs} boards a row, bent as a part of a '
                   'cylinder. Facts: skew 0.', 'fx error: root mean square. beyond 3 σ: of fx, '
                   'fy, cx, cy. OpenCV leaves a board free with calibrateCameraRO.')
    rows = []
    for bend_mm in (0.0, 0.1, 0.3, 0.6, 1.0, 3.0):
        found: dict[str, list] = {'ours': [], 'ours, held flat': [], 'cv2, flat': [],
                                  'cv2, board free': []}
        told = 0
        for seed in range(runs):
            rng = np.random.default_rng([seed, 7])
            tracks, target = bent_views(rng, bend_mm / 1000)
            for name, flatness in (('ours', None), ('ours, held flat', 0)):
                result = calibrate_known_object(tracks, target, facts=FREE_ASPECT,
                                                flatness=flatness)
                if result:
                    sigma = np.array([result.sigma[what] for what in ('fx', 'fy', 'cx', 'cy')])
                    found[name].append((result.camera.parameters[:4], sigma))
                    told += any(one.kind == 'board_bent' for one in result.findings)
            for name, free in (('cv2, flat', False), ('cv2, board free', True)):
                found[name].append(_opencv_board(tracks, target, free))
        for name, results in found.items():
            values = np.array([value for value, _ in results])
            off = (values - BOARD_CAMERA.parameters[:4]) / [sigma for _, sigma in results]
            error = 100 * (values[:, 0] / BOARD_CAMERA.K[0, 0] - 1)
            rows.append((f'{bend_mm:g}', name, len(results), f'{np.sqrt(np.mean(error**2)):.3f}',
                         int((np.abs(off) > 3).any(axis=1).sum()), f'{np.abs(off).max():.1f}',
                         f'{told} of {runs}' if name == 'ours' else ''))
            if name == 'ours':
                report.judge(len(results) == runs and np.abs(off).max() < 4,
                             f'{bend_mm:g} mm: all calibrated, none beyond 4 σ')
    report.say('')
    report.table(('bend mm', 'method', 'runs', 'fx error %', 'beyond 3 σ', 'worst σ',
                  'bend told'), rows)


def bent_views(rng: np.random.Generator, bend_m: float) -> tuple[Tracks, KnownObject]:
    """Corners of a board that bends by so much, as a camera sees them in tilted views."""
    columns, rows = BOARD
    y, x = 0.027 * np.mgrid[:rows, :columns].reshape(2, -1)
    flat = np.column_stack([x, y, np.zeros(x.size)])
    middle, extent = flat.mean(axis=0), float(np.ptp(x))
    height = ((flat[:, 0] - middle[0]) / extent)**2
    bent = flat + (bend_m / np.ptp(height) * height)[:, None] * [0, 0, 1]
    seen: list[np.ndarray] = []
    while len(seen) < VIEWS:
        R = rotation_matrix(rng.uniform(-0.6, 0.6, 3) * [1, 1, 0.6])
        away = extent * rng.uniform(1.1, 2.0)
        place = np.array([*(rng.uniform(-0.25, 0.25, 2) * away * [1.1, 0.8]), away])
        xy = BOARD_CAMERA.project((bent - middle) @ R.T + place)
        if ((xy > 0) & (xy < [BOARD_CAMERA.width, BOARD_CAMERA.height])).all():
            seen.append(xy + BOARD_NOISE_PX * rng.standard_normal(xy.shape))
    return (_tracks(seen, (BOARD_CAMERA.width, BOARD_CAMERA.height)),
            KnownObject(np.arange(len(flat)), flat))


def _opencv_board(tracks: Tracks, target: KnownObject, free: bool):
    """Calibrate with OpenCV, k1 k2 p1 p2 k3; values and sigmas of fx, fy, cx, cy."""
    frames = np.unique(tracks.frame)
    objects = [target.points.astype(np.float32)] * len(frames)
    seen = [tracks.xy[tracks.frame == f].astype(np.float32)[:, None] for f in frames]
    if free:
        # the corner at the end of the first row is held, as its documentation says
        found = cv2.calibrateCameraROExtended(objects, seen, tracks.image_size, BOARD[0] - 1,
                                              None, None)
        K, spread = found[1], found[6]
    else:
        found = cv2.calibrateCameraExtended(objects, seen, tracks.image_size, None, None)
        K, spread = found[1], found[5]
    return K[[0, 1, 0, 1], [0, 1, 2, 2]], spread.ravel()[:4]


def _left(folder):
    board, seen = Chessboard(9, 6, 0.025), []
    for index, image, _ in grey_frames(image_files(folder)):
        identity, xy = board.find(image)
        if len(identity):
            seen.append(xy)
    return _tracks(seen, (640, 480)), board.known


def _tags(folder):
    points = np.loadtxt(folder / 'p_W_corners.txt', delimiter=',') / 100
    seen = np.loadtxt(folder / 'detected_corners.txt').reshape(-1, len(points), 2)
    return _tracks(seen, (752, 480)), KnownObject(np.arange(len(points)), points)


def kuka_board(folder):
    """Return the corners of the board of `kuka_chess`, and the board."""
    corners = np.load(folder / 'corners.npz', allow_pickle=False)
    seen = corners['image'][:, :, 0].astype(float)
    return _tracks(seen, (1928, 1208)), KnownObject(np.arange(seen.shape[1]), corners['object'])


def _tracks(seen, size) -> Tracks:
    count = len(seen[0])
    return Tracks(np.repeat(np.arange(len(seen)), count), np.tile(np.arange(count), len(seen)),
                  np.concatenate(seen), size)


def compare(report: Report, truth, tracks: Tracks, target: KnownObject, limit: float) -> None:
    """Print ours, OpenCV's and the truth side by side."""
    seconds = []
    for _ in range(3):
        began = time.perf_counter()
        result = calibrate_known_object(tracks, target, facts=FREE_ASPECT, flatness=0)
        seconds.append(time.perf_counter() - began)
    if not report.judge(bool(result), 'calibrated' if result else str(result)):
        return
    peer, peer_sigma, peer_s = with_opencv(tracks, target, result)
    K = truth['K']
    true = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    rows = []
    for k, name in enumerate(('fx', 'fy', 'cx', 'cy')):
        value, sigma = result.camera.parameters[k], result.sigma[name]
        rows.append((name, f'{true[k]:.3f}', f'{value:.3f} ± {sigma:.3f}',
                     f'{(value - true[k]) / sigma:+.1f}',
                     f'{peer[k]:.3f} ± {peer_sigma[k]:.3f}',
                     f'{(peer[k] - true[k]) / peer_sigma[k]:+.1f}'))
    report.table(('', 'truth', 'ours', 'off in σ', 'OpenCV', 'off in σ'), rows)
    report.say(f'\n{len(result.frames)} views, {result.observation_count} points, distortion '
               f'{result.facts.distortion}, noise {result.noise_sigma_px:.3f} px; '
               f'{1000 * min(seconds):.0f} ms, OpenCV {1000 * peer_s:.0f} ms (ratio '
               f'{min(seconds) / peer_s:.2f}). ' + ' '.join(result.notes))
    for k, name in enumerate(('fx', 'fy')):
        report.verdict(f'{name} error', percent(result.camera.parameters[k], true[k]), limit, '%')


def with_opencv(tracks: Tracks, target: KnownObject, result):
    """Calibrate with OpenCV from the same corners; values, sigmas and the best time of three."""
    solid = bool(np.ptp(target.points[:, 2]) > 0)
    objects = [target.points.astype(np.float32)] * len(result.frames)
    seen = [tracks.xy[tracks.frame == f].astype(np.float32)[:, None] for f in result.frames]
    flags = cv2.CALIB_USE_INTRINSIC_GUESS if solid else 0
    if result.status['k3'] == 'held':
        flags |= cv2.CALIB_FIX_K3
    seconds = []
    for _ in range(3):
        # it has no start of its own for solids
        start = np.array(result.camera.K) if solid else None
        began = time.perf_counter()
        _, K, _, _, _, spread, *_ = cv2.calibrateCameraExtended(
            objects, seen, tracks.image_size, start, None, flags=flags)
        seconds.append(time.perf_counter() - began)
    return (K[[0, 1, 0, 1], [0, 1, 2, 2]], spread.ravel()[:4], min(seconds))
