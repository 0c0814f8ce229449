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
A result as a small card of HTML, as notebooks show it, and as a few lines of text.

In the card everything that comes from outside is escaped. There is neither a script nor a style
sheet, and no figure: nothing has to be imported for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape

import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.values.measured_digits import with_sigma
from selfcal_ros.values.parameter_status import Status

#: A focal length with a larger share of uncertainty is not what most uses of a camera need.
COARSE_SIGMA = 0.01
#: Findings that a card shows; it says how many more there are.
MOST_FINDINGS = 7
#: Words and colours by grade; the colours can be read on light and on dark ground.
VERDICTS = {'good': ('Calibrated', '#00916b'), 'partial': ('Calibrated in part', '#b87503'),
            'coarse': ('Calibrated coarsely', '#b87503'),
            'hint': ('A hint, no calibration', '#b87503'), 'bad': ('Not calibrated', '#d1335b')}
#: What is drawn beside a matrix.
_BRACKETS = 'border-left:2px solid;border-right:2px solid;margin:4px 0'
_ENTRIES = (('fx', 'skew', 'cx'), ('', 'fy', 'cy'), ('', '', ''))


def grade_of(K: np.ndarray, covariance: np.ndarray, status: Mapping[str, Status]) -> str:
    """
    Grade a calibration: 'good', 'partial' or 'coarse'.

    Parameters
    ----------
    K : ndarray, shape (3, 3)
    covariance : ndarray, shape (k, k)
        Of the parameters, fx and fy first.
    status : dict
        Per parameter 'estimated', 'held' or 'unobservable'.

    """
    covariance = np.asarray(covariance, float)
    if 'unobservable' in status.values() or not np.isfinite(covariance).all():
        return 'partial'
    coarse = any(covariance[k, k] > (COARSE_SIGMA * K[k, k])**2 for k in (0, 1))
    return 'coarse' if coarse else 'good'


def calibration_card(grade: str, camera: Camera, sigma: Mapping[str, float],
                     status: Mapping[str, Status], facts: Iterable[str],
                     notes: Iterable[str]) -> str:
    """
    Show K and the lens with their sigmas, what the result rests on, and what was found.

    Parameters
    ----------
    grade : str
    camera : Camera
    sigma, status : dict
        Per parameter.
    facts : iterable of str
        Short, side by side under the title.
    notes : iterable of str
        Sentences.

    """
    values = dict(zip(camera.parameter_names, camera.parameters.tolist()))

    def entry(name: str, otherwise: str) -> str:
        return _measured(values[name], sigma[name], status[name]) if name else otherwise

    rows = ''.join('<tr>' + ''.join(
        f'<td style="text-align:center;padding:2px 12px">{entry(name, "01"[i == j == 2])}</td>'
        for j, name in enumerate(row)) + '</tr>' for i, row in enumerate(_ENTRIES))
    lens = ', '.join(f'{escape(name)} = {_measured(values[name], sigma[name], status[name])}'
                     for name in camera.lens.coefficients)
    return _card(grade, facts, (
        '<div style="display:flex;align-items:center;gap:8px"><i>K</i> ='
        f'<table style="{_BRACKETS}"><tbody>{rows}</tbody></table>px</div>'
        f'<div>{escape(camera.model)}: {lens}</div>'), notes)


def calibration_text(grade: str, camera: Camera, sigma: Mapping[str, float],
                     status: Mapping[str, Status], facts: Iterable[str],
                     notes: Iterable[str]) -> str:
    """Say in a few lines what a card of `calibration_card` shows."""
    words = {name: _measured_text(value, sigma[name], status[name])
             for name, value in zip(camera.parameter_names, camera.parameters.tolist())}
    lens = [name for name in camera.lens.coefficients if name in words]
    matrix = [name for name in words if name not in lens]
    rows = [f'{VERDICTS[grade][0]}: {", ".join(facts)}',
            ', '.join(f'{name} {words[name]}' for name in matrix) + ' (pixels)']
    if lens:
        rows.append(f'{camera.model}: ' + ', '.join(f'{name} {words[name]}' for name in lens))
    return '\n'.join([*rows, *dict.fromkeys(notes)])


def refusal_card(grade: str, reason: str, advice: str, facts: Iterable[str]) -> str:
    """Show why there is no calibration, and what would help."""
    helps = f'<div><b>What helps:</b> {escape(advice)}</div>' if advice else ''
    return _card(grade, facts, f'<div>{escape(reason)}</div>{helps}', ())


def _measured(value: float, sigma: float, status: str) -> str:
    text, remark = _in_words(value, sigma, status)
    if not remark:
        return text
    shown = f'<b>{text}</b>' if status == 'estimated' else text
    return f'{shown} <small>{remark}</small>'


def _measured_text(value: float, sigma: float, status: str) -> str:
    text, remark = _in_words(value, sigma, status)
    return f'{text} ({remark})' if status == 'unobservable' else f'{text} {remark}'.rstrip()


def _in_words(value: float, sigma: float, status: str) -> tuple[str, str]:
    """Write a value, and how well it is known; nothing where it is held."""
    text, spread = with_sigma(value, sigma if status == 'estimated' else 0.0)
    if status == 'unobservable':
        return text, 'not determined'
    return text, f'± {spread}' if spread else ''


def _card(grade: str, facts: Iterable[str], body: str, notes: Iterable[str]) -> str:
    words, colour = VERDICTS[grade]
    said = list(dict.fromkeys(notes))
    items = ''.join(f'<li>{escape(note)}</li>' for note in said[:MOST_FINDINGS])
    if len(said) > MOST_FINDINGS:
        items += f'<li>and {len(said) - MOST_FINDINGS} more</li>'
    found = f'<ul style="margin:4px 0;padding-left:20px">{items}</ul>' if items else ''
    return (f'<div style="border-left:5px solid {colour};padding:4px 14px;max-width:60em">'
            f'<div><b style="color:{colour}">{words}</b> '
            f'<small>{escape(" · ".join(facts))}</small></div>{body}{found}</div>')
