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
"""A calibration in words and tables, for a page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.angular_measurement import fields_of_view
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.values.measured_digits import with_sigma

#: What each parameter of the calibration matrix is.
_MATRIX_MEANING = {
    'fx': 'focal length along x, px', 'fy': 'focal length along y, px',
    'cx': 'principal point, x, px', 'cy': 'principal point, y, px', 'skew': 'skew, px'}
#: What the coefficients of a family are, by the first letters of their names.
_LENS_MEANING = {
    'plumb_bob': {'k': 'radial distortion', 'p': 'tangential distortion'},
    'rational_polynomial': {'k4': 'radial distortion, below the line',
                            'k5': 'radial distortion, below the line',
                            'k6': 'radial distortion, below the line',
                            'k': 'radial distortion', 'p': 'tangential distortion'},
    'equidistant': {f'k{j}': f'distortion, θ{power}' for j, power in enumerate('³⁵⁷⁹', 1)}}


@dataclass(frozen=True)
class Row:
    """One line of the table of parameters."""

    name: str
    meaning: str
    value: str
    sigma: str
    share: str
    status: str
    held_by: str = ''


def meaning(model: str, name: str) -> str:
    """Say what a parameter of a camera is, with its unit if it has one."""
    if name in _MATRIX_MEANING:
        return _MATRIX_MEANING[name]
    return next((words for start, words in _LENS_MEANING.get(model, {}).items()
                 if name.startswith(start)), 'lens coefficient')


def verdict(result: Calibration) -> str:
    """Say in a sentence or two what was found, and how good it is."""
    sigma, K = _sigma(result), result.camera.K
    words = []
    for name, value in (('fx', K[0, 0]), ('fy', K[1, 1]), ('cx', K[0, 2]), ('cy', K[1, 2])):
        status = result.status.get(name)
        if status == 'unobservable':
            continue
        text, spread = with_sigma(value, sigma[name] if status == 'estimated' else 0.0)
        words.append([name, f'{text} ± {spread} px' if spread else f'{text} px (held)'])
    if len(words) > 1 and [w[0] for w in words[:2]] == ['fx', 'fy'] and words[0][1] == words[1][1]:
        words[:2] = [['fx = fy', words[0][1]]]
    source = ('a known object' if result.motion == 'known-object'
              else f'{result.motion} motion')
    sentence = f'Calibrated from {source}: {", ".join(map(" = ".join, words)) or "in part"}.'
    return ' '.join((sentence, *open_parameters(result)))


def open_parameters(result: Calibration) -> list[str]:
    """Say in sentences which parameters the images leave open, if there are such."""
    weak = [name for name, status in result.status.items() if status == 'unobservable']
    of_matrix = [name for name in weak if name in MATRIX_PARAMETERS]
    of_lens = [name for name in weak if name not in MATRIX_PARAMETERS]
    findings = [Finding(kind, missing=names) for kind, names in (
        ('parameters_unobservable', of_matrix), ('coefficients_open', of_lens)) if names]
    return [str(finding) for finding in findings]


def rests_on(result: Calibration) -> dict[str, str]:
    """Name the stated fact that an estimated parameter rests on, where no image checks it."""
    return {name: one.values['fact'] for one in result.findings
            if one.kind == 'fact_unchecked' for name in one.values.get('moves', ())}


def parameter_rows(result: Calibration) -> list[Row]:
    """Return the parameters, then what follows from them."""
    sigma, supposed = _sigma(result), rests_on(result)
    values = dict(zip(result.parameter_names, result.camera.parameters.tolist()))
    rows = []
    for name, value in values.items():
        status = result.status.get(name, 'estimated')
        text, spread = with_sigma(value, sigma[name] if status == 'estimated' else 0.0)
        share = ''
        if name in ('fx', 'fy') and spread:
            share = f'{100 * sigma[name] / value:.2g} %'
        rows.append(Row(name, meaning(result.camera.model, name), text,
                        'not determined' if status == 'unobservable' else spread, share, status,
                        _condition(result, name, status, supposed)))
    return rows + _derived_rows(result) + _shutter_rows(result)


def _condition(result: Calibration, name: str, status: str, supposed: dict[str, str]) -> str:
    """Say what holds a parameter, or what its value is conditional on."""
    if status == 'held':
        return result.held_by.get(name, '')
    if status == 'estimated' and name in supposed:
        return f'if the {supposed[name]} is exact'
    return ''


def _shutter_rows(result: Calibration) -> list[Row]:
    """Return the time in which all rows are read, where that takes one."""
    shutter = result.shutter
    if shutter is None:
        return []
    if shutter.line_delay_s is None or shutter.sigma_s is None:
        unit = 'intervals between frames'
        value, spread = shutter.intervals, shutter.intervals_sigma
    else:
        unit, per_line = 'ms', 1e3 * shutter.rows
        value, spread = per_line * shutter.line_delay_s, per_line * shutter.sigma_s
    text, sigma = with_sigma(value, spread)
    return [Row('readout', f'time in which all {shutter.lines} are read, {unit}', text, sigma, '',
                shutter.status)]


def _derived_rows(result: Calibration) -> list[Row]:
    """Return aspect ratio and field of view, with first-order sigmas."""
    camera, C = result.camera, np.asarray(result.covariance, float)
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    slope = np.zeros(len(C))
    slope[0], slope[1] = -fy / fx**2, 1 / fx
    spread = _spread(slope, C)
    facts = result.facts
    held = facts.aspect_ratio is not None and facts.aspect_ratio_sigma == 0
    text, sigma = with_sigma(fy / fx, 0.0 if held or spread < 1e-9 else spread)
    rows = [Row('fy / fx', 'aspect ratio', text, sigma, '', 'held' if held else 'derived',
                f'aspect ratio = {facts.aspect_ratio:g}' if held else '')]
    if camera.width > 0 and camera.height > 0:
        fields = fields_of_view(camera, C)
        for name in ('horizontal', 'vertical'):
            if name in fields:
                text, sigma = with_sigma(fields[name].value, fields[name].sigma)
                rows.append(Row('FoV', f'{name} field of view, degrees', text, sigma, '',
                                'derived'))
    return rows


def facts_lines(facts: CameraFacts) -> list[str]:
    """Say what was taken as known, a line each."""
    def spread(sigma: float, unit: str = '') -> str:
        return 'exact' if sigma == 0 else f'σ = {sigma:g}{unit}'

    lines = []
    if facts.aspect_ratio is not None:
        lines.append(f'aspect ratio fy / fx = {facts.aspect_ratio:g} '
                     f'({spread(facts.aspect_ratio_sigma)})')
    if facts.skew is not None:
        lines.append(f'skew = {facts.skew:g} px ({spread(facts.skew_sigma_px, " px")})')
    if facts.principal_point is not None:
        lines.append('principal point = ({:g}, {:g}) px '.format(*facts.principal_point)
                     + f'({spread(facts.principal_point_sigma_px, " px")})')
    lens = facts.distortion + ('' if facts.lens_population else ', whatever real lenses are like')
    if facts.trusted:
        lines.append('declared exact, whatever the images say')
    if facts.focal != 'auto':
        lines.append(f'focal length: {facts.focal}')
    if facts.line_delay_s is not None:
        lines.append(f'rows {1e6 * facts.line_delay_s:g} µs apart '
                     f'({spread(1e6 * facts.line_delay_sigma_s, " µs")})')
    elif facts.shutter != 'auto':
        lines.append(f'{facts.shutter} shutter')
    return lines + [f'lens model: {lens}']


def _sigma(result: Calibration) -> dict[str, float]:
    """Return the sigmas; rounding can leave a variance of zero slightly negative."""
    variance = np.diag(np.asarray(result.covariance, float))
    return {name: _root(value) for name, value in zip(result.parameter_names, variance)}


def _spread(slope: np.ndarray, covariance: np.ndarray) -> float:
    """Return the sigma of a quantity with the given derivative; infinite where unknown."""
    if not np.isfinite(covariance).all():
        return np.inf
    return _root(slope @ covariance @ slope)


def _root(variance: float) -> float:
    return float(np.sqrt(max(variance, 0.0))) if not np.isnan(variance) else np.inf
