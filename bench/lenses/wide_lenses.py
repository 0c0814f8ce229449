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
"""Wide lenses from images alone: rendered, in a room, on a drone; COLMAP on the same images."""

from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
import pickle
import tempfile
import time

from bench.calibration.known_object import room_board
from bench.colmap_peer import calibrate_lenses_with_colmap, is_installed
from bench.inputs import data_folder, grey_frames, image_files
from bench.lenses.held_lens import distance_after_similarity, observations_of, under_lens
from bench.lenses.lens_distance import angles_deg, pixel_grid, projection_distance, rms
from bench.tables import percent, Report
import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from selfcal_ros import (calibrate, calibrate_known_object, Calibration, Camera, CameraFacts,
                         NotCalibrated)
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.features.mask import ImageMask
from selfcal_ros.synthetic.recordings import agv_drive, write_image_folder
from selfcal_ros.synthetic.wide_recordings import fisheye_drive, hand_walk

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0)
CIRCLES_DEG = (120, 150, 185)
VIEWS, TIMED_VIEWS = 24, 30
#: Share of the circle whose pixels count in the renderings, and in the room.
RENDERED_SHARE, ROOM_SHARE = 0.95, 0.8
#: Keyframes of the drone, and points of the grid of its mapping error.
KEYFRAMES, MAPPING_GRID = 60, (40, 25)
#: Up to this angle the drone's board was seen well, and its two lenses agree.
MIDDLE_DEG = 45
FISHEYE = ('OPENCV_FISHEYE, own guess', 'OPENCV_FISHEYE', None)
ON_DRONE = (('SIMPLE_RADIAL', 'SIMPLE_RADIAL', None), ('OPENCV', 'OPENCV', None), FISHEYE)
#: The drone's cameras by others, from its boards: fx, fy, cx, cy, alpha, beta of the extended
#: unified model (Usenko, Demmel, Cremers, 3DV 2018; Basalt's data/euroc_eucm_calib.json).
ELSEWHERE = {'cam0': (460.7648, 459.4051, 365.8937, 249.3350, 0.590337, 1.127468),
             'cam1': (459.5522, 458.1718, 379.4067, 255.9830, 0.604989, 1.090729)}
#: Grey that covers the board of the room.
PAINT = 128


@dataclass(frozen=True)
class Measured:
    """Tracks, what was made of them, and processor seconds of both steps."""

    tracks: object
    mode: str
    result: object
    features_s: float
    estimate_s: float


def run(report: Report, options) -> None:
    """
    Print the tables; with --cache FOLDER, what is there is not computed again.

    Seconds are of the processor, all threads together, for the peer as for us.
    """
    kept = getattr(options, 'cache', None)
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(kept or scratch)
        work.mkdir(parents=True, exist_ok=True)
        for make in (fisheye_drive, hand_walk):
            for circle in CIRCLES_DEG:
                rendered(report, make, circle, work, options)
        room(report, work, options)
        for name in ('cam0', 'cam1'):
            drone(report, name, work, options)
        duration(report, work)


def measure(name: str, files, work: Path, mask=None, keyframes: int = 40,
            stamps=None, facts: CameraFacts = SQUARE, mode: str = 'auto') -> Measured:
    """Make tracks and a calibration of images, or take those of an earlier run."""
    path = work / f'{name}.tracks.pkl'
    if not path.exists():
        frames = grey_frames(files) if stamps is None else (
            (index, grey, stamp) for (index, grey, _), stamp in zip(grey_frames(files), stamps))
        began = time.process_time()
        made = extract_tracks(frames, mode, max_keyframes=keyframes, mask=mask)
        path.write_bytes(pickle.dumps((made.tracks, made.mode, made.keyframes,
                                       time.process_time() - began)))
    tracks, mode, _, features_s = pickle.loads(path.read_bytes())
    path = work / f'{name}.result.pkl'
    if not path.exists():
        began = time.process_time()
        result = calibrate(tracks, facts=facts)
        path.write_bytes(pickle.dumps((result, time.process_time() - began)))
    result, estimate_s = pickle.loads(path.read_bytes())
    return Measured(tracks, mode, result, features_s, estimate_s)


def say_result(report: Report, found: Measured, images: int, true: Camera) -> bool:
    """Print what was found, and how far the truth is in its own sigmas; False if refused."""
    result = found.result
    report.say(f'{len(found.tracks)} observations, {found.mode} mode; processor time: features '
               f'{found.features_s:.1f} s, estimate {found.estimate_s:.1f} s\n')
    if not result:
        report.judge(False, f'refused: {result}')
        return False
    own, sigma = result.camera, result.sigma
    rows = []
    for name, value, right in zip(own.parameter_names, own.parameters, true.parameters):
        if sigma[name] > 0:
            away = f'{(value - right) / sigma[name]:+.2f}' if own.model == true.model or \
                name in ('fx', 'fy', 'cx', 'cy') else '-'
            rows.append((name, f'{value:.6g}', f'{sigma[name]:.2g}', away))
    report.table(('parameter', 'estimate', 'σ', 'from the truth in σ'), rows)
    report.say(f'\n{result.facts.distortion}, motion {result.motion}, {len(result.frames)} of '
               f'{images} images, noise {result.noise_sigma_px:.3f} px')
    return True


def sigmas_from(result, true: Camera) -> float:
    """Return the largest distance of fx, cx, cy from the truth in stated sigmas."""
    own, right, sigma = result.camera.K, true.K, result.sigma
    return max(abs(own[0, 0] - right[0, 0]) / sigma['fx'],
               abs(own[0, 2] - right[0, 2]) / sigma['cx'],
               abs(own[1, 2] - right[1, 2]) / sigma['cy'])


def basics(camera: Camera, true: Camera) -> list[str]:
    """Return the errors of the focal length and of the principal point as cells."""
    return [f'{percent(camera.K[0, 0], true.K[0, 0]):+.4f}',
            f'{np.hypot(*(camera.K[:2, 2] - true.K[:2, 2])):.3f}']


def rows_beside(report: Report, options, files, work: Path, found: Measured,
                configurations, cells) -> list:
    """Return one row of the result and one a configuration of COLMAP."""
    rows = []
    if found.result:
        rows.append((f'selfcal_ros ({found.result.facts.distortion})',
                     *cells(found.result.camera), f'{len(found.result.frames)}/{len(files)}',
                     f'{found.features_s + found.estimate_s:.1f}'))
    if options.no_peer:
        return rows
    if not is_installed():
        report.say('COLMAP left out: pip install pycolmap to see it beside.\n')
        return rows
    done = work / 'colmap.pkl'
    work.mkdir(exist_ok=True)
    if not done.exists():
        results = list(calibrate_lenses_with_colmap(files, work / 'run', configurations))
        done.write_bytes(pickle.dumps(results))
    for name, camera, registered, seconds in pickle.loads(done.read_bytes()):
        values = cells(camera) if camera else ['-'] * 4
        rows.append((f'COLMAP {name}', *values, f'{registered}/{len(files)}', f'{seconds:.1f}'))
    return rows


# ---------------------------------------------------------------------- rendered

def rendered(report: Report, make, circle: int, work: Path, options) -> None:
    """Render one recording and hold the result to its camera."""
    recording = make(VIEWS, circle_deg=circle)
    name, true = f'{make.__name__}_{circle}', recording.camera
    report.section(f'{make.__name__}, {VIEWS} views 640x480, equidistant, a circle of {circle}°',
                   f'f = {true.K[0, 0]:.2f}. Facts: square pixels. Angles: of every fourth pixel '
                   f'each way, up to {RENDERED_SHARE:.0%} of the circle, after the best rotation.')
    folder = work / name
    if not (folder / 'done').exists():
        folder.mkdir(exist_ok=True)
        write_image_folder(recording, folder / 'images')
        (folder / 'done').touch()
    files = image_files(folder)
    found = measure(name, files, work)
    reach = RENDERED_SHARE * circle / 2

    def cells(camera):
        angle = angles_deg(camera, true, reach)
        return [*basics(camera, true), f'{rms(angle):.4f}', f'{angle.max():.4f}']

    held = say_result(report, found, len(files), true)
    report.say('')
    start = ('OPENCV_FISHEYE, from the truth', 'OPENCV_FISHEYE', true)
    report.table(('method', 'fx error %', 'pp error px', 'angle rms °', 'largest °', 'views',
                  'cpu s'),
                 rows_beside(report, options, files, work / f'{name}.colmap', found,
                             (FISHEYE, start), cells))
    report.say('')
    if held:
        camera = found.result.camera
        angle = angles_deg(camera, true, reach)
        report.verdict('fx error', percent(camera.K[0, 0], true.K[0, 0]), 0.05, '%')
        report.verdict('principal point error',
                       float(np.hypot(*(camera.K[:2, 2] - true.K[:2, 2]))), 0.2, 'px')
        report.verdict('angle of a pixel, largest', float(angle.max()), 0.02, '°')
        report.verdict('truth from the result, largest of fx, cx, cy',
                       sigmas_from(found.result, true), 3.0, 'stated sigmas')


# ---------------------------------------------------------------------- the room

def room(report: Report, work: Path, options) -> None:
    """Calibrate the full-circle fisheye of a room: without its board, then with it."""
    folder = data_folder('fisheye_room')
    board = bent_board(folder) if folder else None
    for name, painted in (('room_painted', True), ('room_board', False)):
        what = 'its board painted grey' if painted else 'the board left in'
        report.section(f'fisheye_room, 15 images, {what}',
                       'Image 16 repeats image 1 and is left out. FA-RE: rms distance over '
                       f'{ROOM_SHARE:.0%} of the circle from the lens that the board gives, '
                       'after the best rotation. Facts: square pixels.')
        if folder is None:
            report.say('Left out: ../shared/data/fisheye_room is not there.')
            continue
        truth = json.loads((folder / 'truth.json').read_text(encoding='utf-8'))
        true = Camera(truth['K'], truth['dist'], *truth['image_size'], 'equidistant')
        files = [path for path in image_files(folder) if not path.stem.endswith('16')]
        if painted:
            files = [without_board(path, folder, work / 'room') for path in files]
        mask = ImageMask(cv2.imread(str(folder / 'mask.png'), cv2.IMREAD_GRAYSCALE))
        found = measure(name, files, work, mask)
        circle = truth['image_circle']
        pixels = pixel_grid(true.width, true.height, true.width // 4, true.height // 4)
        inside = np.linalg.norm(pixels - circle['centre'], axis=1)
        pixels = pixels[inside <= ROOM_SHARE * circle['radius_px']]

        def cells(camera):
            distance = projection_distance(camera, true, pixels)
            return [*basics(camera, true), f'{rms(distance):.3f}', f'{distance.max():.3f}']

        held = say_result(report, found, len(files), true)
        report.say('')
        start = ('OPENCV_FISHEYE, from the board', 'OPENCV_FISHEYE', true)
        rows = rows_beside(report, options, files, work / f'{name}.colmap', found,
                           (FISHEYE, start), cells)
        report.table(('method', 'fx error %', 'pp error px', 'FA-RE px', 'largest px', 'views',
                      'cpu s'), rows)
        report.say('')
        if held:
            camera = found.result.camera
            report.verdict('FA-RE', rms(projection_distance(camera, true, pixels)), 1.0, 'px')
            report.verdict('fx error', percent(camera.K[0, 0], true.K[0, 0]), 0.5, '%')
            report.verdict('truth from the result, largest of fx, cx, cy',
                           sigmas_from(found.result, true), 3.0, 'stated sigmas')
            if board:
                report.verdict('the board with its bend estimated, largest of fx, cx, cy',
                               sigmas_between(found.result, board), 3.0, 'sigmas of both')


def bent_board(folder: Path) -> Calibration | NotCalibrated:
    """Calibrate from the board of the room, whose published lens takes it for flat."""
    board, _, tracks = room_board(folder)
    return calibrate_known_object(tracks, board.known, facts=CameraFacts(
        skew=0.0, distortion='equidistant'))


def sigmas_between(result, other) -> float:
    """Return the largest difference of fx, cx, cy of two results in sigmas of both."""
    values = [dict(zip(one.parameter_names, one.camera.parameters)) for one in (result, other)]
    return max(abs(values[0][name] - values[1][name])
               / float(np.hypot(result.sigma[name], other.sigma[name]))
               for name in ('fx', 'cx', 'cy'))


def without_board(path: Path, folder: Path, work: Path) -> Path:
    """Paint the board of an image grey; returns where the image then lies."""
    made = work / f'{path.stem}.png'
    if not made.exists():
        work.mkdir(parents=True, exist_ok=True)
        image, board = cv2.imread(str(path)), folder / 'board_masks' / f'{path.stem}.png'
        if board.exists():
            where = cv2.imread(str(board), cv2.IMREAD_GRAYSCALE)
            image[cv2.dilate(where, np.ones((9, 9))) > 0] = PAINT
        cv2.imwrite(str(made), image)
    return made


# ---------------------------------------------------------------------- the drone

def drone(report: Report, name: str, work: Path, options) -> None:
    """Calibrate one camera of a drone, and ask its images about the published lens."""
    folder = data_folder('euroc_v101')
    report.section(f'euroc_v101 {name}, {KEYFRAMES} keyframes', 'Facts: square pixels. Mapping '
                   'error: 1000 points of a grid over the image, seen by the published lens, '
                   'after the best rotation, rms.')
    if folder is None:
        report.say('Left out: ../shared/data/euroc_v101 is not there.')
        return
    truth = json.loads((folder / 'truth.json').read_text(encoding='utf-8'))
    true = Camera(truth[name]['K'], truth[name]['dist'], *truth['image_size'])
    files = sorted((folder / name).glob('*.jpg'))
    found = measure(name, files, work, keyframes=KEYFRAMES,
                    stamps=[int(path.stem) for path in files])
    pixels = pixel_grid(true.width, true.height, *MAPPING_GRID)

    def cells(camera):
        distance = projection_distance(camera, true, pixels)
        return [*basics(camera, true), f'{rms(distance):.3f}', f'{distance.max():.3f}']

    held = say_result(report, found, len(files), true)
    report.say('')
    rows = rows_beside(report, options, files, work / f'{name}.colmap', found, ON_DRONE, cells)
    report.table(('method', 'fx error %', 'pp error px', 'mapping error px', 'largest px',
                  'views', 'cpu s'), rows)
    report.say('')
    if held:
        camera = found.result.camera
        error = percent(camera.K[0, 0], true.K[0, 0])
        angle = np.arccos(camera.rays(pixels)[:, 2])
        middle = projection_distance(camera, true, pixels[angle <= np.deg2rad(MIDDLE_DEG)])
        report.say(f'Up to {MIDDLE_DEG}° from the axis: {rms(middle):.2f} px rms, '
                   f'{middle.max():.2f} px at most.\n')
        report.verdict('fx against the published one', error, 0.2, '%')
        report.verdict('principal point', float(np.hypot(*(camera.K[:2, 2] - true.K[:2, 2]))),
                       2.0, 'px')
        report.verdict('mapping error', rms(projection_distance(camera, true, pixels)), 0.6, 'px')
        report.verdict('published from the result, largest of fx, cx, cy',
                       sigmas_from(found.result, true), 3.0, 'stated sigmas')
        report.verdict('processor time', found.features_s + found.estimate_s, 30, 's')
        beside_elsewhere(report, camera, true, name)
        ask_the_images(report, found, true, folder, name)


def beside_elsewhere(report: Report, camera: Camera, true: Camera, name: str) -> None:
    """Hold the result and the published lens against what others found from the same boards."""
    fx, fy, cx, cy, *shape = ELSEWHERE[name]
    other = Camera([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], shape, true.width, true.height, 'eucm')
    pixels = pixel_grid(true.width, true.height, *MAPPING_GRID)
    inner = np.arccos(other.rays(pixels)[:, 2]) <= np.deg2rad(MIDDLE_DEG)
    rows = []
    for what, one in (('the result', camera), ('the published lens', true)):
        distance = projection_distance(one, other, pixels)
        rows.append((what, *basics(one, other), f'{rms(distance):.2f}', f'{distance.max():.1f}',
                     f'{rms(distance[inner]):.2f}'))
    report.say('Against the extended unified model of Usenko and others from the boards:\n')
    report.table(('lens', 'fx error %', 'pp error px', 'mapping error px', 'largest px',
                  f'to {MIDDLE_DEG}° px'), rows)
    report.say('')


def ask_the_images(report: Report, found: Measured, true: Camera, folder: Path,
                   name: str) -> None:
    """Hold the published lens against the result's on the same observations."""
    result = found.result
    observations, state = observations_of(result, found.tracks)
    stamps = [int(path.stem) for path in sorted((folder / name).glob('*.jpg'))]
    places = camera_centres(folder, name, [stamps[frame] for frame in result.frames])
    aspect = true.K[1, 1] / true.K[0, 0]
    published = CameraFacts(aspect_ratio=aspect, skew=0.0, distortion='radtan')
    lenses = (('the result, held', result.camera, None),
              ('the published lens, held', true, None),
              ('k1 k2 p1 p2 free, published aspect', true, published),
              ('k1 k2 p1 p2 free', true, CameraFacts(aspect_ratio=1.0, skew=0.0,
                                                     distortion='radtan')),
              ('and k3', true, CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='plumb_bob')),
              ('equidistant, aspect free', result.camera,
               CameraFacts(skew=0.0, distortion='equidistant')))
    rows = []
    for what, start, facts in lenses:
        if facts is not None and facts.distortion == 'equidistant' != result.camera.model:
            continue
        lens = under_lens(observations, state, result.noise_sigma_px, start, facts)
        if lens is None:
            rows.append((what, '-', '-', '-', '-', '-'))
            continue
        K = lens.camera.K
        rows.append((what, f'{lens.cost:.0f}', f'{lens.noise_px:.3f}', f'{K[0, 0]:.2f}',
                     f'{K[1, 1] / K[0, 0]:.5f}',
                     f'{1000 * distance_after_similarity(lens.centres, places):.1f}'))
    report.say(f'\nThe same {len(observations.view)} observations under other lenses, poses and '
               'points free each time:\n')
    report.table(('lens', 'robust cost', 'noise px', 'fx', 'fy / fx',
                  'centres from the poses of the body, mm'), rows)


def camera_centres(folder: Path, name: str, stamps) -> np.ndarray:
    """Return where the camera was, shape (V, 3), from the measured poses of the body."""
    truth = json.loads((folder / 'truth.json').read_text(encoding='utf-8'))
    lever = np.array(truth[name]['T_body_cam'])[:3, 3]
    with open(folder / 'body_poses.csv', encoding='utf-8') as lines:
        poses = {int(line.split(',')[0]): np.array(line.split(',')[1:], float)
                 for line in list(lines)[1:]}
    known = np.array(sorted(poses))
    rows = np.array([poses[known[np.abs(known - stamp).argmin()]] for stamp in stamps])
    return Rotation.from_quat(rows[:, [4, 5, 6, 3]]).apply(lever) + rows[:, :3]


# ---------------------------------------------------------------------- time

def duration(report: Report, work: Path) -> None:
    """Compare a drive through a wide lens with one through a pinhole."""
    report.section(f'Time: {TIMED_VIEWS} views 640x480, a lens of 150° beside a pinhole',
                   'Processor time, images to K; each way of following points by itself.')
    folders = {}
    for name, recording in (('timed_pinhole', agv_drive(TIMED_VIEWS)),
                            ('timed_fisheye', fisheye_drive(TIMED_VIEWS))):
        folders[name] = work / name
        if not (folders[name] / 'done').exists():
            write_image_folder(recording, folders[name] / 'images')
            (folders[name] / 'done').touch()
    rows = [(name, mode, measure(f'{name}_{mode}', image_files(folder), work, mode=mode))
            for mode in ('wide', 'video') for name, folder in folders.items()]
    report.table(('drive', 'mode', 'observations', 'features s', 'estimate s'),
                 [(name, mode, len(found.tracks), found.features_s, found.estimate_s)
                  for name, mode, found in rows])
    report.say('')
    for (_, mode, pinhole), (_, _, fisheye) in (rows[:2], rows[2:]):
        ratio = ((fisheye.features_s + fisheye.estimate_s)
                 / (pinhole.features_s + pinhole.estimate_s))
        report.verdict(f'{mode}, fisheye over pinhole', ratio, 2.0)
