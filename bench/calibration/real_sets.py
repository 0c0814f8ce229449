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
"""Recorded sets whose camera is known: images only, and the true aspect ratio as a fact."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import tempfile
import time

from bench.colmap_peer import calibrate_with_colmap, CONFIGURATIONS, is_installed
from bench.inputs import data_folder, grey_frames, image_files, truth_of
from bench.tables import percent, Report
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from selfcal_ros import calibrate, CameraFacts, Tracks
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES
from selfcal_ros.geometry.lenses.plumb_bob import PLUMB_BOB
from selfcal_ros.report.comparison import compare_cameras
from selfcal_ros.report.projection_uncertainty import parameter_effect

#: COLMAP runs in all configurations on sets of up to so many images.
MAX_FOR_ALL = 30


@dataclass(frozen=True)
class RecordedSet:
    """
    One set.

    Attributes
    ----------
    name : str
        Folder in shared/data.
    aspect_ratio : float
        True fy / fx.
    most_percent : float
        Largest error of the focal length that is allowed.
    numbers : tuple of int, optional
        Images used, from 1.

    """

    name: str
    aspect_ratio: float
    most_percent: float
    numbers: tuple | None = None


SETS = (RecordedSet('kuka_chess', 1.0, 1.0, (8, 9, 10, 11, 12, 15)),
        RecordedSet('kitti00_turn_a', 1.0, 2.0),
        RecordedSet('mb_temple_ring', 1525.9 / 1520.4, 4.0))


def run(report: Report, options) -> None:
    """Print one table a set."""
    for one in SETS:
        folder = data_folder(one.name)
        subset = f', images {", ".join(map(str, one.numbers))}' if one.numbers else ''
        report.section(f'{one.name}{subset}', 'Facts: aspect ratio '
                       f'{one.aspect_ratio:.4f}, skew 0. Distortion chosen by the data;',
                       'its coefficients are not judged, since the true lens may have more of '
                       'them. nearest lens:', 'the true camera as the chosen model can express '
                       'it.')
        if folder is None:
            report.say(f'Left out: ../shared/data/{one.name} is not there.')
            continue
        measure(report, one, folder, options)


def measure(report: Report, one: RecordedSet, folder: Path, options) -> None:
    """Calibrate one set from its images and compare with the truth."""
    truth, files = truth_of(folder), image_files(folder, one.numbers)
    began = time.perf_counter()
    extraction = extract_tracks(grey_frames(files))
    middle = time.perf_counter()
    result = calibrate(extraction.tracks,
                       facts=CameraFacts(aspect_ratio=one.aspect_ratio, skew=0.0))
    seconds = time.perf_counter() - began
    report.say(f'{len(extraction.tracks)} observations in {len(extraction.keyframes)} of '
               f'{len(files)} images, {extraction.mode} mode; features {middle - began:.1f} s, '
               f'estimate {began + seconds - middle:.1f} s\n')
    if not result:
        report.judge(False, f'{result}')
    else:
        report_result(report, one, truth, result, nearest_lens(truth, result, extraction.tracks))
        over_the_image(report, 'the published camera', result,
                       Camera(truth['K'], truth['dist'], *extraction.tracks.image_size))
        if (folder / 'corners.npz').is_file():
            report_corners(report, truth, folder, result)
    if options.peer and is_installed():
        compare(report, truth, files, result, seconds)


def report_corners(report: Report, truth: dict, folder: Path, result) -> None:
    """
    Calibrate from the board's corners that the truth was fitted to, but not from their places.

    What the images say when the board need not be flat or regular. If it differs from the
    published truth by more than its sigma, the truth carries the shape of the board.
    """
    with np.load(folder / 'corners.npz') as stored:
        xy = stored['image'].reshape(stored['image'].shape[0], -1, 2)
    frame, track = np.indices(xy.shape[:2])
    tracks = Tracks(frame.ravel(), track.ravel(), xy.reshape(-1, 2),
                    (result.camera.width, result.camera.height))
    free = calibrate(tracks, motion='general', facts=result.facts)
    report.say('\nThe corners that the truth was fitted to, all 30 images, their places on the '
               'board left free:')
    if not free:
        report.say(str(free))
        return
    true, own = truth['K'][0, 0], free.camera.K[0, 0]
    report.say(f'fx {own:.2f} ± {free.sigma["fx"]:.2f}, noise {free.noise_sigma_px:.3f} px (with '
               f'the board as drawn: fx {true:.2f}, rms 0.074 px): the published truth is off by '
               f'{percent(true, own):+.2f} %.')
    spread = np.hypot(result.sigma['fx'], free.sigma['fx'])
    report.verdict('fx against that one', abs(result.camera.K[0, 0] - own) / spread, 3.0,
                   'stated sigmas')
    over_the_image(report, 'that one', result, free.camera, free.covariance)


def nearest_lens(truth: dict, result, tracks) -> np.ndarray:
    """
    Parameters of the camera that is nearest to the true one, within the chosen distortion model.

    The true lens may have more coefficients than the result. Nearest: over the points of the
    tracks, in pixels, up to a small rotation, which no self-calibration can tell.
    """
    true = Camera(truth['K'], truth['dist'], *tracks.image_size)
    free = [PARAMETER_NAMES.index(name) for name in
            ('fx', 'cx', 'cy', *LENS_CHOICES[result.facts.distortion][1])]
    rays = true.normalised(tracks.xy)
    seen = np.isfinite(rays).all(axis=1)
    rays, xy = np.column_stack([rays, np.ones(len(rays))])[seen], tracks.xy[seen]
    aspect = truth['K'][1, 1] / truth['K'][0, 0]

    def camera(change):
        values = true.parameters
        values[5:] = 0
        values[free] += change[3:] * np.where(np.array(free) < 5, 100, 0.1)
        values[1] = aspect * values[0]
        return Camera.from_parameters(values)

    def misfit(change):
        turned = rays @ Rotation.from_rotvec(change[:3] / 100).as_matrix().T
        return (camera(change).project(turned) - xy).ravel()

    return camera(least_squares(misfit, np.zeros(3 + len(free))).x).parameters


def over_the_image(report: Report, what: str, result, other: Camera, covariance=None) -> None:
    """
    Compare projections, as `selfcal compare` does, and the shapes of the two lenses alone.

    Coefficients of models with unequal numbers of them say nothing by themselves. The shape is
    what is left after the best rotation, focal length and principal point; it is given in the
    stated sigmas of the result's own two coefficients.
    """
    spread = result.covariance + (0 if covariance is None else covariance)
    found = compare_cameras(result.camera, other, result.covariance, covariance)
    report.say(f'\nProjection over the image against {what}, after the best rotation: '
               f'{np.sqrt(np.nanmean(found.distance_px**2)):.2f} px rms, '
               f'{np.nanmax(found.distance_px):.2f} px at most; '
               f'{np.nanmedian(found.sigmas):.1f} stated sigmas in the median; all directions '
               f'at once: chi2 {found.chi2:.0f} with {found.freedom}.')
    effect = parameter_effect(result.camera, found.pixels)
    good = (np.isfinite(effect).all(axis=(1, 2)) & np.isfinite(found.difference_px).all(axis=1))
    effect = effect[good].reshape(-1, len(PARAMETER_NAMES))
    plain = np.column_stack([effect[:, 0] + effect[:, 1], effect[:, 2], effect[:, 3]])

    def without(columns):
        return columns - plain @ np.linalg.lstsq(plain, columns, rcond=None)[0]

    shape = without(found.difference_px[good].ravel())
    size = np.linalg.norm(shape.reshape(-1, 2), axis=1)
    free = [k for k in (5, 6) if spread[k, k] > 0]
    words = ''
    if free:
        change = np.linalg.lstsq(without(effect[:, free]), shape, rcond=None)[0]
        sigmas = np.sqrt(change @ np.linalg.solve(spread[np.ix_(free, free)], change))
        words = f', {sigmas:.1f} stated sigmas of the coefficients together'
    report.say(f'Shape of the lens alone: {np.sqrt(np.mean(size**2)):.2f} px rms, '
               f'{size.max():.2f} px at most{words}.')
    report.verdict(f'projection against {what}, largest over the image',
                   float(np.nanmax(found.sigmas)), 3.0, 'stated sigmas')


def report_result(report: Report, one: RecordedSet, truth: dict, result, nearest) -> None:
    """Print every parameter beside the truth."""
    K = truth['K']
    true = Camera(K, truth['dist']).parameters
    rows, worst = [], 0.0
    for k, name in enumerate(PARAMETER_NAMES):
        if result.status[name] != 'estimated':
            continue
        value, sigma = result.camera.parameters[k], result.sigma[name]
        away = (true[k] - value) / sigma
        # each coefficient depends on how many there are
        if name not in PLUMB_BOB.coefficients:
            worst = max(worst, abs(away))
        rows.append((name, f'{value:.5g}', f'{sigma:.2g}', f'{true[k]:.5g}',
                     f'{value - true[k]:+.3g}', f'{away:+.2f}', f'{nearest[k]:.5g}',
                     f'{(nearest[k] - value) / sigma:+.2f}'))
    report.table(('parameter', 'estimate', 'σ', 'truth', 'error', 'truth in σ', 'nearest lens',
                  'in σ'), rows)
    report.say(f'\nDistortion {result.facts.distortion}; motion {result.motion}; noise '
               f'{result.noise_sigma_px:.2f} px; {result.outlier_count} outliers. '
               + ' '.join(result.notes))
    error = percent(result.camera.K[0, 0], K[0, 0])
    report.verdict('focal length error', error, one.most_percent, '%')
    report.say(f'stated: ± {100 * result.sigma["fx"] / K[0, 0]:.2f} %')
    report.verdict('truth from the result, largest', worst, 3.0, 'stated sigmas')


def compare(report: Report, truth: dict, files, result, seconds: float) -> None:
    """Run COLMAP on the same images."""
    K, rows = truth['K'], []
    if result:
        own = result.camera.K
        rows.append(('selfcal_ros', f'{percent(own[0, 0], K[0, 0]):+.2f}',
                     f'{np.hypot(*(own[:2, 2] - K[:2, 2])):.1f}',
                     f'{len(result.frames)}/{len(files)}', f'{seconds:.1f}', '1'))
    # matching every pair of many images takes COLMAP minutes: its default alone has to do
    choice = CONFIGURATIONS if len(files) <= MAX_FOR_ALL else CONFIGURATIONS[:1]
    with tempfile.TemporaryDirectory() as work:
        for name, camera, registered, time_s in calibrate_with_colmap(
                files, Path(work) / 'peer', choice):
            error, away = '-', '-'
            if camera:
                error = f'{percent(camera["fx"], K[0, 0]):+.2f}'
                away = f'{np.hypot(camera["cx"] - K[0, 2], camera["cy"] - K[1, 2]):.1f}'
            rows.append((f'COLMAP {name}', error, away, f'{registered}/{len(files)}',
                         f'{time_s:.1f}', f'{time_s / seconds:.1f}'))
    report.say('')
    report.table(('method', 'fx error %', 'pp error px', 'views', 's', 'time / ours'), rows)
