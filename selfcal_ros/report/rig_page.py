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
"""The page of a rig: one self-contained HTML file, in the look of the page of a camera."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from markupsafe import Markup
import numpy as np

from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.calibration.rigs.result import PLACE, POSE, RigCalibration
from selfcal_ros.report.page import drawn, page_environment, unbroken
from selfcal_ros.report.page_table import PageTable
from selfcal_ros.report.provenance import Provenance
from selfcal_ros.report.rig_epipolar import epipolar_distances, WRONG_PX
from selfcal_ros.report.rig_files import rectification, rig_camera_yaml
from selfcal_ros.values.measured_digits import with_sigma
from selfcal_ros.values.output_files import atomic_write
from selfcal_ros.values.tracks import Tracks

#: Parameters in the table of cameras.
_COLUMNS = ('fx', 'fy', 'cx', 'cy')


def write_rig_page(path, result: RigCalibration | NotCalibrated, text: str, source: str = '',
                   tracks: Mapping[str, Tracks] | None = None, shared: bool = False,
                   made: Provenance | None = None) -> Path:
    """
    Write the page; it appears whole or not at all.

    Parameters
    ----------
    path : str or Path
    result : RigCalibration or NotCalibrated
    text : str
        The result as it is printed on a terminal.
    source : str
        What was calibrated from.
    tracks : mapping of str to Tracks, optional
        Those that were calibrated from.
    shared : bool
        Equal numbers of tracks in two cameras are the same point.
    made : Provenance, optional

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    drawings, tables, files = {}, [], {}
    if result:
        from selfcal_ros.report.rig_figure import epipolar_figure, rig_figure
        distances = epipolar_distances(result, tracks) if shared and tracks else {}
        drawings = drawn([one for one in (rig_figure(result), epipolar_figure(distances)) if one])
        tables = [_cameras(result), _poses(result), *_stereo(result), *_epipolar(distances)]
        files = {name: rig_camera_yaml(result, name, source) for name in result.cameras}
    return atomic_write(path, page_environment().get_template('rig.html.j2').render(
        calibrated=bool(result), source=source, text=text, tables=tables,
        drawings=list(drawings.values()), files=files,
        verdict=unbroken(verdict(result)) if result else result.reason,
        numbers=_numbers(result) if result else [], made=made.rows() if made else [],
        notes=[Markup('{}').format(one) for one in result.notes]))


def verdict(rig: RigCalibration) -> str:
    """Say in a sentence or two what came out."""
    names = list(rig.cameras)
    said = []
    for name in names[1:]:
        pose = rig.poses[name]
        place = pose.T_rig_camera[:3, 3]
        if not np.isfinite(place).all():
            said.append(f'Where {name} sits is partly open.')
            continue
        length = pose.baseline
        sigma = float(np.sqrt(place @ pose.covariance[:3, :3] @ place)) / max(length, 1e-300)
        factor, unit = (1e3, 'mm') if rig.unit == 'm' else (1.0, 'steps of the path')
        value, spread = with_sigma(factor * length, factor * sigma)
        said.append(f'{name} sits {value}{f" ± {spread}" if spread else ""} {unit} from '
                    f'{names[0]}.')
    return ' '.join(said)


def _numbers(rig: RigCalibration) -> list[tuple[str, str]]:
    """Return the numbers that say on what the result rests, with their names."""
    total = rig.observation_count + rig.outlier_count
    return [('motion', rig.motion), ('instants', str(len(rig.frames))),
            ('observations', str(rig.observation_count)),
            ('rejected', f'{100 * rig.outlier_count / max(total, 1):.1f} %'),
            ('reprojection rms', f'{rig.reprojection_rms_px:.3f} px'),
            ('image noise σ', f'{rig.noise_sigma_px:.3f} px')]


def _cell(value: float, sigma: float) -> str:
    """Write a value with its sigma."""
    number, spread = with_sigma(value, sigma)
    return f'{number} ± {spread}' if spread else number


def _cameras(rig: RigCalibration) -> PageTable:
    """Return K and lens of every camera, and its sigma by itself."""
    rows = []
    for name, one in rig.cameras.items():
        values = dict(zip(one.camera.parameter_names, one.camera.parameters.tolist()))
        alone = rig.alone.get(name)
        rows.append((name, *(_cell(values[key], one.sigma[key]) for key in _COLUMNS),
                     f'± {alone.sigma["fx"]:.2g}' if alone else 'not possible',
                     one.camera.model, ' '.join(f'{value:.4g}' for value in one.camera.distortion),
                     f'{one.reprojection_rms_px:.3f}'))
    return PageTable('cameras', 'Cameras', 'Pixels, with one standard deviation. The column '
                     'beside says what fx has from the images of that camera alone.',
                     ('camera', *_COLUMNS, 'fx alone', 'lens', 'distortion', 'rms'), tuple(rows))


def _poses(rig: RigCalibration) -> PageTable:
    """Return the poses of all cameras but the first."""
    factor, unit = (1e3, 'mm') if rig.unit == 'm' else (1.0, 'steps')
    rows = []
    for name, pose in list(rig.poses.items())[1:]:
        values = [*(factor * pose.T_rig_camera[:3, 3]), *np.degrees([*pose.angles.values()])]
        sigmas = [factor * pose.sigma[key] if key in PLACE else np.degrees(pose.angles_sigma[key])
                  for key in POSE]
        rows.append((name, *('open' if pose.status[key] == 'unobservable' else _cell(value, sigma)
                             for key, value, sigma in zip(POSE, values, sigmas)),
                     str(pose.shared_points)))
    return PageTable('poses', f'Poses in the frame of {next(iter(rig.cameras))}', 'Places in '
                     f'{unit}, turns in degrees about x (right), y (down) and z (ahead), with one '
                     'standard deviation. Shared points are those that another camera saw, too.',
                     ('camera', *POSE, 'shared points'), tuple(rows))


def _stereo(rig: RigCalibration) -> list[PageTable]:
    """Return R and P of a stereo pair."""
    pair = rectification(rig)
    if pair is None:
        return []
    rows = []
    for name, (R, P) in pair.items():
        rows += [(f'{name} {what}', *(f'{value:.{digits}f}' for value in row),
                  *[''] * (4 - len(row)))
                 for what, matrix, digits in (('R', R, 6), ('P', P, 4)) for row in matrix]
    return [PageTable('stereo', 'Rectification', 'R and P as stereo_image_proc takes them: rows '
                      'of both images are the same then.', ('', '', '', '', ''), tuple(rows))]


def _epipolar(distances: Mapping[tuple[str, str], np.ndarray]) -> list[PageTable]:
    """Return how far matches lie from the epipolar planes."""
    rows = []
    for (first, second), px in distances.items():
        near = px[np.abs(px) < WRONG_PX]
        rows.append((f'{first} and {second}', str(len(px)), f'{100 * len(near) / len(px):.1f} %',
                     f'{np.median(np.abs(px)):.3f} px',
                     f'{np.sqrt(np.mean(near**2)):.3f} px' if len(near) else ''))
    return [PageTable('matches', 'Matches of two cameras', 'First-order distance from the '
                      'epipolar curve, of pixels in both images together. The root mean square '
                      f'is of those below {WRONG_PX:g} px.',
                      ('cameras', 'matches', f'below {WRONG_PX:g} px', 'median', 'rms'),
                      tuple(rows))] if rows else []
