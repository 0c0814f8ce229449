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
"""Many calibrations for a person and for a program: rows, sentences, JSON, and one HTML page."""

from __future__ import annotations

import base64
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from functools import lru_cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
import numpy as np
from selfcal_ros.calibration.result import Calibration

from selfcal_ros.pipeline.many_inputs import CameraSummary, Outcome, Summary
from selfcal_ros.report.comparison import compare_cameras, SAME_PX
from selfcal_ros.report.result_json import result_to_dict, to_jsonable
from selfcal_ros.values.measured_digits import with_sigma
from selfcal_ros.values.output_files import atomic_write

#: Columns of the table between the name and the status.
COLUMNS = ('fx', 'fy', 'cx', 'cy')
#: Focal lengths from features were off by this share on rendered drives (bench/README.md), the
#: same way in all recordings of a scene; no scatter shows it.
SHARED_FRACTION = 3e-4


@dataclass(frozen=True)
class HistoryRow:
    """One recording in the table; texts, empty where there is nothing to say."""

    name: str
    start: str
    values: tuple[str, ...]
    rms: str
    max_difference_px: str
    deviation: str
    status: str
    good: bool


def rows_of(camera: CameraSummary) -> list[HistoryRow]:
    """Return the table of a camera, a row a recording."""
    rows, apart = [], max_difference_px(camera)
    for number, outcome in enumerate(camera.outcomes):
        result, deviation, status = outcome.result, '', 'not calibrated'
        if result:
            status = 'calibrated'
            if camera.joint is not None and number in camera.members:
                place = camera.members.index(number)
                sigmas = camera.joint.deviation[place]
                deviation = f'{sigmas:.1f}' if sigmas == sigmas else ''
                if not camera.joint.used[place]:
                    status = 'contradicts the others'
            else:
                status = 'calibrated, not in the joint estimate'
        elif result is not None:
            status = f'{"hint" if result.is_hint else "not calibrated"}: {result.reason}'
        rows.append(HistoryRow(
            _name(outcome), _time(outcome.start_ns),
            tuple(_value(result, name) if result else '' for name in COLUMNS),
            f'{result.reprojection_rms_px:.3f}' if result else '',
            f'{apart[number]:.2f}' if number in apart else '', deviation, status,
            bool(result) and status == 'calibrated'))
    return rows


def _name(outcome: Outcome) -> str:
    return Path(outcome.path).name or outcome.path


def _time(start_ns: int | None) -> str:
    if start_ns is None:
        return ''
    return datetime.fromtimestamp(start_ns / 1e9, timezone.utc).strftime('%Y-%m-%d %H:%M:%S')


def _value(result: Calibration, name: str) -> str:
    """Write a parameter with its sigma."""
    values = dict(zip(result.sigma, result.camera.parameters.tolist()))
    known = result.status.get(name) == 'estimated'
    value, sigma = with_sigma(values[name], result.sigma[name] if known else 0.0)
    return f'{value} ± {sigma}' if sigma else value


@lru_cache(maxsize=64)
def max_difference_px(camera: CameraSummary) -> dict[int, float]:
    """Return the largest difference over the image from the joint estimate, by recording."""
    if camera.joint is None:
        return {}
    joint = camera.joint.calibration.camera
    return {number: float(np.nanmax(compare_cameras(joint, outcome.result.camera).distance_px))
            for number, outcome in enumerate(camera.outcomes) if outcome.result}


def is_settled(camera: CameraSummary) -> bool:
    """Tell whether the recordings agree, by chance or because nobody would notice."""
    return camera.joint is not None and (
        camera.joint.agree or max(max_difference_px(camera).values()) < SAME_PX)


def verdict_of(camera: CameraSummary) -> str:
    """Say in a few sentences what came of a camera, and whether its recordings agree."""
    sentence, joint = _comparison(camera), camera.joint
    if joint is not None and len(camera.members) > 1 and (
            joint.calibration.focal_sigma_share < SHARED_FRACTION):
        sentence += (' A sigma so small leaves out what all recordings share: features alone '
                     f'shift the focal length by up to {100 * SHARED_FRACTION:g} %.')
    return sentence


def _comparison(camera: CameraSummary) -> str:
    """Say what came of a camera, and whether its recordings agree."""
    total = len(camera.outcomes)
    good = sum(bool(outcome.result) for outcome in camera.outcomes)
    of_many = f'{good} of {total} recordings {"calibrates" if good == 1 else "calibrate"}'
    joint = camera.joint
    if joint is None:
        return f'None of {total} recordings calibrates.'
    figures = {name: _value(joint.calibration, name) for name in COLUMNS}
    if figures['fx'] == figures['fy']:
        figures = {'fx = fy': figures.pop('fy'), **figures}
        del figures['fx']
    listed = ', '.join(f'{name} = {value} px' for name, value in figures.items())
    sentence = f'{of_many}; together {listed}.'
    if len(camera.members) < 2:
        return f'{sentence} With one recording nothing can be compared.'
    chance = f'p = {joint.p_value:.2g}' if joint.p_value >= 1e-6 else 'p < 1e-6'
    test = f'chi2 {joint.chi2:.4g} with {joint.freedom} degrees of freedom, {chance}'
    left, most = int((~joint.used).sum()), max(max_difference_px(camera).values())
    if not joint.agree and most < SAME_PX:
        return (f'{sentence} The recordings scatter {joint.scatter:.2f} times as much as their '
                f'sigmas say ({test}), but by {most:.2g} px at most over the image, which nobody '
                'will notice. The joint sigma is widened.')
    if joint.agree:
        wide = (f'; they scatter {joint.scatter:.2f} times as much as their sigmas say, by which '
                'the joint sigma is widened' if joint.p_value < 0.001 else '')
        return f'{sentence} The recordings agree ({test}){wide}.'
    if left and (joint.p_value >= 0.001 or joint.scatter < 1.25):
        who = ('1 recording contradicts the others and is' if left == 1 else
               f'{left} recordings contradict the others and are')
        return f'{sentence} {who} left out; the rest agree ({test}).'
    return (f'{sentence} The recordings disagree ({test}): the camera has changed between them, '
            f'or some of them mislead. The joint sigma is widened {joint.scatter:.2f} times; look '
            'at the parameters over time before using it.')


def summary_to_dict(summary: Summary) -> dict[str, Any]:
    """
    Return everything as plain Python values that strict JSON can hold.

    Parameters
    ----------
    summary : Summary

    Returns
    -------
    dict
        'cameras' (each with 'topic', 'image_size', 'verdict', 'agree', 'chi2',
        'degrees_of_freedom', 'p_value', 'scatter', 'joint' as in result.json, 'notes' and
        'recordings'), 'failures' ('path', 'topic', 'error') and 'seconds'.

    """
    plain: dict[str, Any] = to_jsonable({
        'cameras': [_camera_to_dict(camera) for camera in summary.cameras],
        'failures': [{'path': outcome.path, 'topic': outcome.topic, 'error': outcome.error}
                     for outcome in summary.failures],
        'seconds': summary.seconds})
    return plain


def _camera_to_dict(camera: CameraSummary) -> dict[str, Any]:
    joint = camera.joint
    recordings = []
    for number, outcome in enumerate(camera.outcomes):
        place = camera.members.index(number) if number in camera.members else None
        recordings.append({
            'path': outcome.path, 'start_ns': outcome.start_ns, 'seconds': outcome.seconds,
            'result': None if outcome.result is None else result_to_dict(outcome.result),
            'notes': outcome.notes,
            'apart_px': max_difference_px(camera).get(number),
            'deviation_sigmas': None if joint is None or place is None else joint.deviation[place],
            'used': joint is not None and place is not None and bool(joint.used[place])})
    tested = joint if joint is not None and joint.freedom > 0 else None
    return {
        'topic': camera.topic, 'image_size': camera.image_size, 'verdict': verdict_of(camera),
        'agree': tested.agree if tested else None, 'chi2': tested.chi2 if tested else None,
        'degrees_of_freedom': tested.freedom if tested else None,
        'p_value': tested.p_value if tested else None,
        'scatter': tested.scatter if tested else None,
        'joint': None if joint is None else result_to_dict(joint.calibration),
        'notes': camera.notes, 'recordings': recordings}


def write_summary_page(path: str | Path, summary: Summary) -> Path:
    """
    Write one self-contained HTML page; it appears whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    cameras = [{'title': camera.topic or 'Camera', 'size': '{} × {} px'.format(*camera.image_size),
                **_headline(camera), **_table(rows_of(camera)),
                'notes': camera.notes, 'agree': is_settled(camera),
                'picture': _picture(camera)} for camera in summary.cameras]
    # whatever a topic or a file is called, it is text
    templates = Environment(loader=PackageLoader('selfcal_ros.report', 'templates'),
                            autoescape=True, undefined=StrictUndefined, trim_blocks=True,
                            lstrip_blocks=True)
    return atomic_write(path, templates.get_template('many.html.j2').render(
        cameras=cameras, failures=summary.failures,
        count=sum(len(camera.outcomes) for camera in summary.cameras) + len(summary.failures)))


def _headline(camera: CameraSummary) -> dict[str, str]:
    """Return the verdict of a page: its first sentence, and the rest in smaller letters."""
    first, dot, rest = verdict_of(camera).partition('. ')
    return {'verdict': _unbroken(first + dot.rstrip()), 'more': _unbroken(rest)}


def _table(rows: list[HistoryRow]) -> dict[str, Any]:
    """Return columns and rows of a page; equal focal lengths need one column."""
    columns: tuple[str, ...] = COLUMNS
    if all(row.values[0] == row.values[1] for row in rows):
        columns = ('fx = fy', *COLUMNS[2:])
        rows = [replace(row, values=row.values[1:]) for row in rows]
    return {'columns': columns, 'rows': rows}


def _unbroken(sentence: str) -> str:
    """Keep a number, its name, its sigma and its unit on one line."""
    for mark in ('±', '='):
        sentence = sentence.replace(f' {mark} ', f'\u00a0{mark}\u00a0')
    return sentence.replace(' px', '\u00a0px')


def _picture(camera: CameraSummary) -> str:
    """Return the parameters over time as the content of an image, empty where there is none."""
    # Matplotlib takes a while to load
    from selfcal_ros.report.parameter_history import parameter_history, picture
    figure = parameter_history(camera)
    return '' if figure is None else base64.b64encode(picture(figure, 'svg')).decode('ascii')
