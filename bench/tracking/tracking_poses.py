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
Poses against truth on rendered objects: accuracy, honest covariances, motion models, zoom.

The objects are those of `selfcal_ros.synthetic.objects`, whose poses are exact.
"""

from __future__ import annotations

from bench.tables import Report
from bench.tracking.tracking_runs import follow, pose_error, WRONG
import numpy as np
from scipy.stats import chi2
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.rorapid.tracker import TrackerOptions, TrackerState
from selfcal_ros.synthetic.objects import perturbed, tracked_object

SHARES = np.array([0.6, 0.8, 0.9, 0.95])
#: Images of each sequence, and of those that the covariances are judged on, and their seeds.
IMAGES, MANY = 150, 500
SEEDS = (31, 32, 33, 34)
#: The first images, in which a guess becomes a pose, do not count.
SETTLING = 15
#: How far the start is from the truth: radians and share of the distance.
START_RAD, START_FRACTION = 0.03, 0.01
#: Time in which all rows are read.
READOUT_S = 0.02
#: Required.
ROTATION_DEG, TRANSLATION_FRACTION, FOCAL_FRACTION, COVERAGE = 0.3, 0.005, 0.01, 0.05


def run(report: Report, options) -> None:
    """Print the tables; with --runs N sequences of N images."""
    images = options.runs or IMAGES
    accuracy(report, images)
    coverage(report, options.runs or MANY)
    motion_models(report, images)
    focal(report, images)
    rolling(report, images)


def start_of(recording, seed: int = 1):
    """Return a guess of the first pose."""
    distance = np.linalg.norm(recording.translations[0])
    return perturbed(recording.rotations[0], recording.translations[0],
                     np.random.default_rng(seed), START_RAD, START_FRACTION * distance)


def tracked(recording, options: TrackerOptions | None = None, camera: Camera | None = None,
            start=None):
    """Follow a rendered object; returns the track and its errors after settling."""
    images = [image for image, _ in recording.frames()]
    track = follow(images, recording.model, camera or recording.camera,
                   start or start_of(recording), options, recording.stamps_ns)
    return track, settled(pose_error(track, recording))


def settled(rows: np.ndarray) -> np.ndarray:
    """Leave out the first images."""
    return rows[min(SETTLING, len(rows) // 4):]


def rms(rows: np.ndarray) -> float:
    """Root mean square length of vectors (N, k)."""
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))


def accuracy(report: Report, images: int) -> None:
    """Rotation and translation against the truth."""
    report.section('Poses against truth: rendered objects, exact poses',
                   f'{images} images 640x480 each, distorted lens (k1 = -0.12), from a start '
                   f'{np.rad2deg(START_RAD):.1f}° and {100 * START_FRACTION:g} % off.')
    rows, worst = [], np.zeros(2)
    for shape in ('cube', 'step_block', 'spool'):
        for motion in ('general', 'translation', 'planar'):
            recording = tracked_object(images, shape, motion, distortion=(-0.12, 0.05, 0, 0, 0),
                                       seed=11)
            track, errors = tracked(recording)
            distance = np.linalg.norm(recording.translations, axis=1).mean()
            turn, shift = np.rad2deg(rms(errors[:, 3:])), rms(errors[:, :3]) / distance
            worst = np.maximum(worst, [turn, shift])
            rows.append((shape, motion, f'{turn:.3f}', f'{100 * shift:.3f}',
                         f'{1000 * rms(errors[:, :3]):.2f}', f'{int(track.lost.sum())}',
                         f'{1000 * np.median(track.seconds):.1f}'))
    report.table(('object', 'motion', 'rotation rms °', 'translation rms %', 'mm', 'lost',
                  'ms an image'), rows)
    report.say('')
    report.verdict('rotation, worst rms', worst[0], ROTATION_DEG, '°')
    report.verdict('translation, worst rms', 100 * worst[1], 100 * TRANSLATION_FRACTION, '%')


def coverage(report: Report, images: int) -> None:
    """Share of the true poses inside the stated ellipsoids."""
    report.section('Honest covariances: true poses inside the stated ellipsoids',
                   f'{len(SEEDS)} sequences of {images} images each. Errors of neighbouring '
                   'images are alike, so that one sequence counts like a hundred independent '
                   'images (a share is known to 0.05); all of them together decide.')
    rows, worst = [], 0.0
    for shape in ('cube', 'step_block'):
        pooled = []
        for seed in SEEDS:
            recording = tracked_object(images, shape, 'general', seed=seed)
            track, errors = tracked(recording)
            distance = np.einsum('ni,ni->n', errors, np.linalg.solve(
                settled(track.covariances), errors[..., None])[..., 0])
            rows.append((shape, seed, *_inside(distance), int(track.lost.sum())))
            pooled.append(distance)
        inside = _inside(np.concatenate(pooled))
        worst = max(worst, max(abs(share - want) for share, want in zip(inside, SHARES)))
        rows.append((shape, 'all', *inside, ''))
    report.table(('object', 'seed', *(f'{100 * share:.0f} %' for share in SHARES), 'lost'),
                 [(row[0], row[1], *(f'{share:.3f}' for share in row[2:6]), row[6])
                  for row in rows])
    report.say('')
    report.verdict('largest difference from the nominal share', worst, COVERAGE)


def rolling(report: Report, images: int) -> None:
    """Rows that are read one after the other, with their delay known and not."""
    report.section('Rolling shutter: rows read in 20 ms',
                   f'{len(SEEDS)} sequences of {images} images; speed 1 is up to 5 px between '
                   'images. The same images, with the line delay stated and without.')
    rows = []
    for shape in ('cube', 'step_block'):
        for speed in (1.0, 3.0):
            # with the line delay and without: squared distances, errors, images called tracked
            pooled: list[tuple] = [([], [], []), ([], [], [])]
            for seed in SEEDS:
                recording = tracked_object(images, shape, 'general', speed=speed,
                                           readout_s=READOUT_S, seed=seed)
                for delay, found in zip((READOUT_S / recording.camera.height, 0.0), pooled):
                    track, errors = tracked(recording, TrackerOptions(line_delay_s=delay))
                    good = np.array([state is TrackerState.TRACKING for state in track.states])
                    square = np.einsum('ni,ni->n', errors, np.linalg.solve(
                        settled(track.covariances), errors[..., None])[..., 0])
                    for into, values in zip(found, (square, errors, settled(good))):
                        into.append(values)
            for name, found in zip(('stated', 'not stated'), pooled):
                square, errors, good = map(np.concatenate, found)
                rows.append((shape, f'{speed:g}', name, f'{np.rad2deg(rms(errors[:, 3:])):.3f}',
                             f'{1000 * rms(errors[:, :3]):.2f}', f'{100 * good.mean():.0f} %',
                             *(f'{share:.3f}' for share in _inside(square)),
                             f'{int((good & (square > WRONG)).sum())}'))
    report.table(('object', 'speed', 'line delay', 'rotation rms °', 'mm', 'called tracked',
                  *(f'{100 * share:.0f} %' for share in SHARES), 'tracked and wrong'), rows)
    report.say('')
    report.verdict('called tracked and wrong, line delay stated',
                   sum(int(row[-1]) for row in rows[::2]), 0)


def _inside(distance: np.ndarray) -> list:
    """Shares of squared distances (N,) inside the ellipsoids."""
    return [float(np.mean(distance < chi2.ppf(share, 6))) for share in SHARES]


def motion_models(report: Report, images: int) -> None:
    """Figure 7.10 of the thesis: restricted motion models against the general one."""
    report.section('Motion models (thesis, figure 7.10)',
                   'The same images tracked with the general model and with the one that fits.')
    rows = []
    for motion in ('translation', 'planar'):
        recording = tracked_object(images, 'cube', motion, seed=13)
        # a restricted model keeps what the start says of the rest, so both start at the truth
        start = recording.rotations[0], recording.translations[0]
        figures = {}
        for model in ('general', motion):
            axis = tuple(recording.rotations[0][:, 2]) if model == 'planar' else None
            track, errors = tracked(recording, TrackerOptions(motion=model, plane_axis=axis),
                                    start=start)
            sigma = np.sqrt(np.einsum('nii->ni', settled(track.covariances)))
            figures[model] = rms(errors), rms(sigma)
            rows.append((motion, model, f'{np.rad2deg(rms(errors[:, 3:])):.4f}',
                         f'{1000 * rms(errors[:, :3]):.3f}',
                         f'{np.rad2deg(rms(sigma[:, 3:])):.4f}',
                         f'{1000 * rms(sigma[:, :3]):.3f}'))
        report.judge(figures[motion][0] <= 1.02 * figures['general'][0]
                     and figures[motion][1] < figures['general'][1],
                     f'{motion}: error {figures[motion][0] / figures["general"][0]:.2f} and sigma '
                     f'{figures[motion][1] / figures["general"][1]:.2f} times those of the '
                     'general model')
    report.say('')
    report.table(('object moves', 'model', 'rotation rms °', 'translation rms mm',
                  'stated sigma °', 'mm'), rows)


def focal(report: Report, images: int) -> None:
    """A focal length that is wrong at the start, and one that changes."""
    report.section('Zoom: the focal length among the unknowns',
                   'True fx 520 px, started at 400 and 555 px; then lenses that zoom while the '
                   'object moves away.')
    rows = []
    recording = tracked_object(images, 'cube', 'general', seed=14)
    for first in (400.0, 555.0):
        K = recording.camera.K.copy()
        K[:2, :2] *= first / K[0, 0]
        camera = Camera(K, (), 640, 480)
        R, t = start_of(recording)
        # what a person who believes the wrong focal length would take for the distance
        start = R, t * [1, 1, first / 520]
        rows.append(_zoom_row(report, f'{first:.0f} px at the start', recording, camera, start,
                              np.full(images, 520.0)))
    for low, high in ((400.0, 555.0), (1500.0, 6000.0)):
        moving = tracked_object(images, 'cube', 'general', zoom_px=(low, high), background=False,
                                camera=_lens(low), seed=15)
        rows.append(_zoom_row(report, f'zooms from {low:.0f} to {high:.0f} px', moving,
                              moving.camera, None, moving.focal_px))
    report.say('')
    report.table(('', 'focal rms %', 'last image %', 'in stated sigmas, median', 'lost',
                  'weak perspective'), rows)


def _lens(focal_px: float) -> Camera:
    return Camera([[focal_px, 0, 319.5], [0, focal_px, 239.5], [0, 0, 1]], (), 640, 480)


def _zoom_row(report, name, recording, camera, start, true_px):
    """Track with the focal length; returns a row of the table and gives the verdict."""
    models = []
    images = [image for image, _ in recording.frames()]
    track = follow(images, recording.model, camera, start or start_of(recording),
                   TrackerOptions(camera_model='zoom'), recording.stamps_ns,
                   lambda _, seen: models.append(seen.camera_model))
    error = track.focal_px / true_px - 1
    late = error[len(error) // 3:]
    told = track.focal_sigma_px > 0
    sigmas = np.abs(track.focal_px - true_px)[told] / track.focal_sigma_px[told]
    report.verdict(f'{name}: rms error of the focal length after a third of the images',
                   100 * float(np.sqrt(np.mean(late**2))), 100 * FOCAL_FRACTION, '%')
    return (name, f'{100 * np.sqrt(np.mean(late**2)):.2f}', f'{100 * error[-1]:+.2f}',
            f'{np.median(sigmas):.2f}' if told.any() else '-', int(track.lost.sum()),
            models.count('weak'))
