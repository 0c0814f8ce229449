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
"""Arms: rendered moves, recorded sets, and the spread over the Cramér-Rao bound."""

from __future__ import annotations

from functools import partial
import time

from bench.calibration.robot_poses import camera_by_poses
from bench.inputs import data_folder, grey_frames, image_files, truth_of
from bench.monte_carlo import run_seeds
from bench.tables import percent, Report
import numpy as np
from scipy.stats import chi2
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.recordings import arm_move, REALISTIC_DISTORTION
from selfcal_ros.synthetic.scenes import observe, si_camera

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0)
#: Name, distortion, limits of fx in percent and of the principal point in pixels.
MOVES = (('square pixels, no distortion', (), 0.05, 0.5),
         ('k1 -0.12, k2 0.05', REALISTIC_DISTORTION, 0.1, 1.0))
NOISE_PX, POINTS = 0.1, 60
FREE = (0, 2, 3)      # f, cx, cy: pixels square, no distortion


def run(report: Report, options) -> None:
    """Print everything."""
    for move in MOVES:
        rendered(report, *move)
    for name, motion, facts, limits in (
            ('kuka_chess', 'translation', SQUARE, (0.3, 5.0)),
            ('kuka_chess', 'auto', SQUARE, (0.3, 5.0)),
            ('kuka_chess', 'general', CameraFacts(1.0, 0.0, distortion='none'), None),
            ('rct_circles', 'auto', SQUARE, None)):
        recorded(report, name, motion, facts, limits)
    monte_carlo(report, options.runs or 1000, options.processes)


def rendered(report: Report, name, distortion, fx_limit, pp_limit) -> None:
    """Calibrate a rendered move from its images."""
    recording = arm_move(24, distortion=distortion)
    report.section(f'Rendered arm, 24 views 640x480, f = 520, {name}')
    frames = [(k, image, stamp) for k, (image, stamp) in enumerate(recording.frames())]
    began = time.perf_counter()
    tracks = extract_tracks(frames).tracks
    middle = time.perf_counter()
    result = calibrate(tracks, facts=SQUARE)
    end = time.perf_counter()
    if not result:
        report.judge(False, str(result))
        return
    errors = against(report, result, recording.camera)
    report.say(f'motion {result.motion}; features {middle - began:.1f} s, estimate '
               f'{end - middle:.1f} s')
    report.verdict('fx error', errors[0], fx_limit, '%')
    report.verdict('principal point error', errors[1], pp_limit, 'px')
    report.verdict('truth from the result, largest', errors[2], 3.0, 'stated sigmas')


def against(report: Report, result, truth) -> tuple[float, float, float]:
    """Print the errors; returns fx in percent, principal point in pixels, largest in sigmas."""
    own, true = result.camera.parameters, truth.parameters
    sigma = np.sqrt(np.diag(result.covariance))
    report.say(f'fx {own[0]:.2f} ± {sigma[0]:.2f} (true {true[0]:.2f}), principal point '
               f'({own[2]:.2f}, {own[3]:.2f}) ± ({sigma[2]:.2f}, {sigma[3]:.2f}) '
               f'(true {true[2]:.2f}, {true[3]:.2f}), k1 {own[5]:.4f} (true {true[5]:.4f}), noise '
               f'{result.noise_sigma_px:.3f} px')
    away = (own - true)[:4] / np.maximum(sigma[:4], 1e-12)
    return (percent(own[0], true[0]), float(np.hypot(*(own - true)[2:4])),
            float(np.abs(away).max()))


def recorded(report: Report, name: str, motion: str, facts: CameraFacts, limits) -> None:
    """Calibrate a recorded set from its images."""
    from selfcal_ros.geometry.camera import Camera
    folder = data_folder(name)
    report.section(f'{name}, all images, --motion {motion}, distortion {facts.distortion}')
    if folder is None:
        report.say(f'Left out: ../shared/data/{name} is not there.')
        return
    truth, files = truth_of(folder), image_files(folder)
    began = time.perf_counter()
    tracks = extract_tracks(grey_frames(files)).tracks
    middle = time.perf_counter()
    result = calibrate(tracks, motion=motion, facts=facts)
    end = time.perf_counter()
    report.say(f'features {middle - began:.1f} s, estimate {end - middle:.1f} s')
    by_poses = camera_by_poses(folder)
    report.say(f'by the robot\'s poses: fx, fy, cx, cy {by_poses.intrinsics.round(2)} ± '
               f'{by_poses.sigma.round(2)}; leaves {by_poses.left_px:.3f} px; the board is '
               f'{by_poses.flat_mm:.2f} mm rms from flat')
    if not result:
        report.judge(limits is None, f'refused: {result}')
        return
    errors = against(report, result, Camera(truth['K'], truth['dist']))
    report.say(' '.join(result.notes))
    # the published cameras rest on a flat board
    apart = result.camera.parameters[:4] - by_poses.intrinsics
    variance = np.diag(result.covariance)[:4] + by_poses.sigma**2
    report.verdict('camera by the robot\'s poses, largest',
                   float(np.abs(apart / np.sqrt(variance)).max()), 3.0, 'sigmas of both')
    if limits is None:
        report.say(f'fx error {errors[0]:+.2f} %, principal point {errors[1]:.1f} px')
        # right or refused
        report.verdict('truth from the result, largest', errors[2], 3.0, 'stated sigmas')
        return
    report.verdict('fx error', errors[0], limits[0], '%')
    report.verdict('principal point error', errors[1], limits[1], 'px')
    report.verdict('truth from the result, largest', errors[2], 3.0, 'stated sigmas')
    report.verdict('whole set', end - began, 30.0, 's')
    report.verdict('estimate', end - middle, 2.0, 's')


def sequence(seed: int, noise_px: float = NOISE_PX):
    """Six views of an arm: two of one orientation, four turned about several axes."""
    layout = np.random.default_rng(11)
    points = layout.uniform([-1.5, -1.2, 4], [1.5, 1.2, 7], (POINTS, 3))
    turns = np.radians([[0, 0, 0], [0, 0, 0], [8, 3, 0], [-6, 9, 4], [2, -10, -8], [10, 5, 12.0]])
    centres = layout.uniform(-0.5, 0.5, (6, 3))
    R = rotation_matrix(turns)
    poses = np.concatenate([R, -R @ centres[:, :, None]], axis=2)
    return observe(np.random.default_rng(seed), si_camera(), poses, points, noise_px)


def bound() -> np.ndarray:
    """Smallest covariance of f, cx, cy, all poses and points unknown, shape (3, 3)."""
    scene = sequence(0, 0.0)
    poses, points, K = scene.cam_from_world, scene.points, scene.camera.K
    views = len(poses)

    def pixels(change):
        inner, turn, move = change[:3], *np.split(change[3:3 + 6 * views].reshape(views, 6), 2, 1)
        X = points + change[3 + 6 * views:].reshape(-1, 3)
        R = rotation_matrix(turn) @ poses[:, :, :3]
        local = X @ np.swapaxes(R, 1, 2) + (poses[:, :, 3] + move)[:, None]
        flat = local[..., :2] / local[..., 2:]
        return (flat * (K[0, 0] + inner[0]) + K[:2, 2] + inner[1:]).ravel()

    count, step = 3 + 6 * views + points.size, 1e-5
    J = np.column_stack([(pixels(d) - pixels(-d)) / (2 * step) for d in step * np.eye(count)])
    A, B = J[:, :3] / NOISE_PX, J[:, 3:] / NOISE_PX
    # the seven directions of the world's frame and scale cost nothing: a projection leaves them
    left = A - B @ np.linalg.lstsq(B, A, rcond=1e-9)[0]
    return np.linalg.inv(left.T @ left)


def one_run(seed: int, facts: CameraFacts):
    """Errors of f, cx, cy and their stated covariance, None when refused."""
    scene = sequence(seed)
    result = calibrate(scene.tracks, motion='general', facts=facts)
    if not result:
        return None
    chosen = list(FREE)
    error = (result.camera.parameters - scene.camera.parameters)[chosen]
    return error, result.covariance[np.ix_(chosen, chosen)]


def monte_carlo(report: Report, runs: int, processes: int) -> None:
    """Compare the spread with the bound, and the stated ellipsoids with the errors."""
    report.section(f'Six views, general motion, {POINTS} points, {NOISE_PX} px, {runs} runs',
                   'Facts: square pixels, no distortion.')
    facts = CameraFacts(1.0, 0.0, distortion='none')
    found = [one for one in run_seeds(partial(one_run, facts=facts), range(runs), processes)
             if one is not None]
    errors = np.array([error for error, _ in found])
    smallest = np.sqrt(np.diag(bound()))
    ratio = errors.std(axis=0) / smallest
    distance = np.array([e @ np.linalg.solve(C, e) for e, C in found])
    report.table(('parameter', 'sigma', 'bound', 'ratio', 'bias / sigma'),
                 [(name, f'{s:.3f}', f'{b:.3f}', f'{r:.2f}', f'{m:+.3f}') for name, s, b, r, m in
                  zip(('f', 'cx', 'cy'), errors.std(axis=0), smallest, ratio,
                      errors.mean(axis=0) / errors.std(axis=0))])
    shares = (0.6, 0.8, 0.9, 0.95)
    inside = [float(np.mean(distance < chi2.ppf(share, 3))) for share in shares]
    report.say('\ninside the 60, 80, 90, 95 % ellipsoids: '
               + ', '.join(f'{100 * share:.1f} %' for share in inside)
               + f'; refused {runs - len(found)}')
    report.verdict('sigma over the bound, largest', float(ratio.max()), 1.10)
    report.verdict('share inside against nominal, largest',
                   float(np.abs(np.array(inside) - shares).max()), 0.03)
