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
"""The dinosaur on its turntable: steps of 10 degrees, and the fixed points of the motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import time

from bench.inputs import data_folder, grey_frames, image_files, truth_of
from bench.tables import Report
import numpy as np
from selfcal_ros import calibrate, CameraFacts, Tracks
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.geometry.projective import camera_centres

SIZE = (720, 576)
STEP_DEG, MAX_DEG = 10.0, 0.1
SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0)
#: What a user would add if square pixels alone do not suffice.
CENTRED = replace(SQUARE, principal_point=(359.5, 287.5), principal_point_sigma_px=50.0)
#: The published matrices count pixels from 1.
ORIGIN = 1.0


def published_tracks(path: Path) -> Tracks:
    """Read viff.xy: a row a track, x and y for each of the 36 views, -1 where it is not seen."""
    table = np.loadtxt(path)
    xy = table.reshape(len(table), -1, 2)
    track, frame = np.nonzero((xy > 0).all(axis=2))
    return Tracks(frame, track, xy[track, frame] - ORIGIN, SIZE)


def published_fixed_points(P: np.ndarray):
    """
    Horizon, axis and circular point of the published cameras (V, 3, 4).

    P turns about its third axis. So (1, ±i, 0, 0) are the circular points of the planes of motion
    in every view, whatever the metric along the axis. (0, 0, 1, 0) and (0, 0, 0, 1) lie on the
    axis. K is not needed.

    Returns
    -------
    horizon, axis : ndarray, shape (3,)
    circular : ndarray of complex, shape (2,)
        Pixels, from 0.

    """
    shift = np.array([[1, 0, -ORIGIN], [0, 1, -ORIGIN], [0, 0, 1]])
    P = shift @ P[0]
    i = P @ [1, 1j, 0, 0]
    return (np.cross(i.real, i.imag), np.cross(P[:, 2], P[:, 3]), i[:2] / i[2])


def steps_deg(result) -> np.ndarray:
    """Return the signed turn between successive frames about the common axis, degrees."""
    rotation = result.reconstruction.cam_from_world[:, :, :3]
    turn = np.swapaxes(rotation[1:], 1, 2) @ rotation[:-1]
    angle = np.degrees(np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1]))
    return angle * np.sign(np.median(angle))


def image_of_axis(result) -> np.ndarray:
    """Image line of the vertical that all cameras circle, from the path."""
    poses = result.reconstruction.cam_from_world
    centres = camera_centres(poses)[:, :2]
    system = np.column_stack([2 * centres, np.ones(len(centres))])
    middle = np.linalg.lstsq(system, (centres ** 2).sum(axis=1), rcond=None)[0][:2]
    ends = np.array([[*middle, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]])
    first, second = (result.camera.K @ poses[0] @ ends.T).T
    return np.cross(first, second)


def line_text(line, size=SIZE) -> tuple[float, float]:
    """Angle of a line in degrees, and its distance from the middle of the image in pixels."""
    angle = np.degrees(np.arctan2(-line[0], line[1]))
    angle = (angle + 90) % 180 - 90
    distance = (line @ [size[0] / 2, size[1] / 2, 1]) / np.hypot(*line[:2])
    return angle, abs(distance)


def run(report: Report, options) -> None:
    """Print steps and fixed points, from the published tracks and from the images."""
    folder = data_folder('vgg_dino')
    if folder is None:
        report.section('vgg_dino')
        report.say('Left out: ../shared/data/vgg_dino is not there.')
        return
    truth = truth_of(folder)
    for source in ('viff.xy', 'images'):
        report.section(f'vgg_dino from {source}', 'Facts: square pixels.')
        began = time.perf_counter()
        if source == 'images':
            tracks = extract_tracks(grey_frames(image_files(folder))).tracks
        else:
            tracks = published_tracks(folder / source)
        middle = time.perf_counter()
        result = calibrate(tracks, facts=SQUARE)
        report.say(f'{len(tracks)} observations; tracks {middle - began:.1f} s, estimate '
                   f'{time.perf_counter() - middle:.1f} s\n')
        if not result:
            report.say(f'{result}\n\nOnce more, with the principal point within '
                       f'{CENTRED.principal_point_sigma_px:g} px of the middle as a fact:\n')
            result = calibrate(tracks, facts=CENTRED)
        if result:
            show(report, result, truth)
        else:
            report.judge(False, str(result))


def show(report: Report, result, truth: dict) -> None:
    """Print what one calibration says of the turntable."""
    steps = steps_deg(result)
    report.table(('frames', 'mean step deg', 'spread deg', 'sum deg', 'noise px', 'fx', 'σ fx'),
                 [(len(result.frames), f'{steps.mean():.4f}', f'{steps.std(ddof=1):.3f}',
                   f'{steps.sum():.2f}', f'{result.noise_sigma_px:.2f}',
                   f'{result.camera.K[0, 0]:.0f}', f'{result.sigma["fx"]:.0f}')])
    horizon, axis, circular = published_fixed_points(truth['P'])
    found = result.fixed_points
    own_axis = image_of_axis(result)
    # the two circular points are conjugate: take the one on the same side
    i = found.circular_point[:2] / found.circular_point[2]
    i = i if np.linalg.norm(i - circular) < np.linalg.norm(i.conj() - circular) else i.conj()
    rows = []
    for name, ours, theirs in (('horizon', found.horizon, horizon),
                               ('image of the axis', own_axis, axis)):
        (a, d), (b, e) = line_text(ours), line_text(theirs)
        rows.append((name, f'{a:.3f} deg, {d:.1f} px from the middle',
                     f'{b:.3f} deg, {e:.1f} px from the middle',
                     f'{abs(a - b):.3f} deg, {abs(d - e):.1f} px'))
    rows.append(('circular point', np.array2string(i, precision=0), np.array2string(
        circular, precision=0), f'{np.linalg.norm(i - circular) / np.linalg.norm(circular):.2%}'))
    report.say('')
    report.table(('of', 'ours', 'published matrices', 'difference'), rows)
    report.say(f'\nMotion {result.motion}, distortion {result.facts.distortion}. '
               + ' '.join(result.notes))
    report.verdict('mean step from 10 degrees', float(steps.mean()) - STEP_DEG, MAX_DEG, 'deg')
