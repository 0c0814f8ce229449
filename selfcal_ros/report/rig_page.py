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
from selfcal_ros.report.phrases import facts_lines
from selfcal_ros.report.provenance import Provenance
from selfcal_ros.report.rig_epipolar import epipolar_distances, WRONG_PX
from selfcal_ros.report.rig_files import rectification, rig_camera_yaml, rig_facts
from selfcal_ros.values.measured_digits import with_sigma
from selfcal_ros.values.output_files import atomic_write
from selfcal_ros.values.tracks import Tracks

#: Parameters of every camera, before those of its lens.
_OF_ALL = ('fx', 'fy', 'cx', 'cy')
#: What the degrees of freedom of a pose point to.
_WAYS = {'x': 'right', 'y': 'down', 'z': 'ahead', 'roll': 'about x', 'pitch': 'about y',
         'yaw': 'about z'}


def write_rig_page(path: str | Path, result: RigCalibration | NotCalibrated, text: str,
                   source: str = '', tracks: Mapping[str, Tracks] | None = None,
                   shared: bool = False, made: Provenance | None = None,
                   baseline: tuple[float, float] | None = None) -> Path:
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
    baseline : (float, float), optional
        As it was stated, with its standard deviation, metres.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    drawings, tables, files, matrices = {}, [], {}, []
    if result:
        from selfcal_ros.report.rig_figure import epipolar_figure, rig_figure
        distances = epipolar_distances(result, tracks) if shared and tracks else {}
        bent_px = next((one.values['rms_px'] for one in result.findings
                        if one.kind == 'lens_deviates'), None)
        figures = rig_figure(result), epipolar_figure(distances, bent_px)
        drawings = drawn([one for one in figures if one])
        tables = [_cameras(result), _poses(result), *_epipolar(distances)]
        matrices = _stereo(result)
        files = {name: rig_camera_yaml(result, name, source) for name in result.cameras}
    return atomic_write(path, page_environment().get_template('rig.html.j2').render(
        calibrated=bool(result), source=source, text=text, tables=tables,
        drawings=list(drawings.values()), matrices=matrices, files=files,
        metric=bool(result) and result.unit == 'm',
        verdict=unbroken(verdict(result)) if result else result.reason,
        numbers=_numbers(result) if result else [],
        facts=rig_facts(result, baseline) if result else facts_lines(result.facts),
        made=made.rows() if made else [],
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
    """Return K and lens of every camera, a column each, and its sigma by itself."""
    values = {name: dict(zip(one.camera.parameter_names, one.camera.parameters.tolist()))
              for name, one in rig.cameras.items()}
    of_lenses = dict.fromkeys(key for one in rig.cameras.values()
                              for key in one.camera.lens.coefficients)

    def row(key: str) -> tuple[str, ...]:
        return key, *(_cell(values[name][key], one.sigma[key]) if key in values[name] else ''
                      for name, one in rig.cameras.items())

    alone = (rig.alone.get(name) for name in rig.cameras)
    rows = [*map(row, _OF_ALL),
            ('σ of fx, alone', *(f'± {one.sigma["fx"]:.2g}' if one else 'not possible'
                                 for one in alone)),
            ('lens', *(one.camera.model for one in rig.cameras.values())), *map(row, of_lenses),
            ('rms', *(f'{one.reprojection_rms_px:.3f}' for one in rig.cameras.values()))]
    words = ('Pixels, with one standard deviation; the coefficients of the lens have no unit. '
             'Alone: from the images of that camera only.')
    if any(by_itself and rig.cameras[name].sigma['fx'] > by_itself.sigma['fx']
           for name, by_itself in rig.alone.items() if name in rig.cameras):
        words += (' A sigma that is larger together holds errors that only the cameras '
                  'together show.')
    return PageTable('cameras', 'Cameras', words, ('', *rig.cameras), tuple(rows))


def _poses(rig: RigCalibration) -> PageTable:
    """Return the poses of all cameras but the first, a column each."""
    factor, unit = (1e3, 'mm') if rig.unit == 'm' else (1.0, 'steps')
    poses = dict(list(rig.poses.items())[1:])
    columns = []
    for pose in poses.values():
        values = [*(factor * pose.T_rig_camera[:3, 3]), *np.degrees([*pose.angles.values()])]
        sigmas = [factor * pose.sigma[key] if key in PLACE else np.degrees(pose.angles_sigma[key])
                  for key in POSE]
        columns.append([*('open' if pose.status[key] == 'unobservable' else _cell(value, sigma)
                          for key, value, sigma in zip(POSE, values, sigmas)),
                        str(pose.shared_points)])
    heads = [*(f'{key}, {_WAYS[key]}, {unit if key in PLACE else "degrees"}' for key in POSE),
             'shared points']
    return PageTable('poses', f'Poses in the frame of {next(iter(rig.cameras))}',
                     'With one standard deviation. Shared points are those that another camera '
                     'saw, too.', ('', *poses), tuple(zip(heads, *columns)))


def _stereo(rig: RigCalibration) -> list[tuple[str, str, list[list[str]]]]:
    """Return R and P of a stereo pair: symbol, camera and rows of each."""
    pair = rectification(rig)
    return [] if pair is None else [
        (symbol, name, [[f'{value + 0.0:.{digits}f}' for value in row.round(digits)]
                        for row in matrix])
        for name, both in pair.items() for symbol, matrix, digits in zip('RP', both, (6, 4))]


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
