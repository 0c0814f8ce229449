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
"""A calibration in words and a table, for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.calibration.structure.angular_measurement import measurement_sentences
from selfcal_ros.report.mounts.words import mount_lines
from selfcal_ros.report.phrases import open_parameters, rests_on

if TYPE_CHECKING:
    from selfcal_ros.geometry.camera_facts import CameraFacts

#: Parameters in pixels get three decimals, the distortion coefficients five.
_PIXELS = ('fx', 'fy', 'cx', 'cy', 'skew')


def facts_text(facts: CameraFacts) -> str:
    """Say in one line what was taken as known."""
    def spread(sigma: float) -> str:
        return 'held' if sigma == 0 else f'sigma {sigma:g}'

    known = []
    if facts.aspect_ratio is not None:
        known.append(f'aspect ratio {facts.aspect_ratio:g} ({spread(facts.aspect_ratio_sigma)})')
    if facts.skew is not None:
        known.append(f'skew {facts.skew:g} px ({spread(facts.skew_sigma_px)})')
    if facts.principal_point is not None:
        u, v = facts.principal_point
        known.append(f'principal point ({u:g}, {v:g}) ({spread(facts.principal_point_sigma_px)})')
    if facts.line_delay_s is not None:
        known.append(f'line delay {facts.line_delay_s:g} s ({spread(facts.line_delay_sigma_s)})')
    elif facts.shutter != 'auto':
        known.append(f'{facts.shutter} shutter')
    lens = facts.distortion + ('' if facts.lens_population else ', whatever real lenses are like')
    trusted = ', declared exact' if facts.trusted else ''
    if facts.focal != 'auto':
        lens += f'; focal length {facts.focal}'
    return f'Facts: {", ".join(known) or "none"}; lens {lens}{trusted}.'


def result_text(result: Calibration | NotCalibrated, truth: dict[str, float] | None = None,
                notes: tuple[str, ...] = (), mount_facts: frozenset[str] = frozenset()) -> str:
    """
    Return the result for a person.

    Parameters
    ----------
    result : Calibration or NotCalibrated
    truth : dict, optional
        True value of each parameter, to be shown beside the estimate and in sigmas.
    notes : tuple of str
        Further sentences.
    mount_facts : set of str
        What was stated of the mount.

    """
    if not result:
        return '\n'.join([str(result), facts_text(result.facts), *notes])
    lines = [_verdict(result), '']
    header = f'{"":>6} {"value":>12}   {"sigma":>9}'
    if truth:
        header += f' {"truth":>12} {"error":>10} {"sigmas":>7}'
    lines.append(header + '   status')
    values = dict(zip(result.sigma, result.camera.parameters.tolist()))
    supposed = rests_on(result)
    for name, value in values.items():
        status = result.status.get(name, 'estimated')
        held = result.held_by.get(name)
        if status == 'held' and value == 0 and name.startswith(('k', 'p')) and not truth:
            continue
        decimals = 3 if name in _PIXELS else 5
        sigma = result.sigma[name]
        spread = {'held': '-', 'unobservable': 'unknown'}.get(status, f'{sigma:.{decimals}f}')
        row = f'{name:>6} {value:>z12.{decimals}f} ± {spread:>9}'
        if truth:
            row += _beside(value, sigma if status == 'estimated' else 0.0, truth.get(name),
                           decimals)
        remark = ''
        if status == 'held' and held:
            remark = f' by {held}'
        elif status == 'estimated' and name in supposed:
            remark = f', if the {supposed[name]} is exact'
        lines.append(f'{row}   {status}{remark}')
    lines += ['', facts_text(result.facts)]
    lines += list(result.notes) + list(notes)
    if result.identifiability is not None:
        lines += result.identifiability.sentences()
    lines += measurement_sentences(result.camera, result.covariance, result.measured)
    return '\n'.join(lines + mount_lines(result, mount_facts))


def _beside(value: float, sigma: float, true: float | None, decimals: int) -> str:
    """Show the truth beside a value, and how far away it is."""
    if true is None:
        return f' {"-":>12} {"-":>10} {"-":>7}'
    error = value - true
    sigmas = f'{abs(error) / sigma:.1f}' if sigma > 0 else '-'
    return f' {true:>12.{decimals}f} {error:>+10.{decimals}f} {sigmas:>7}'


def _verdict(result: Calibration) -> str:
    """Say in a sentence what was found, and how good it is."""
    camera = result.camera
    share = 100 * result.focal_sigma_share
    known = f'± {share:.2g} %' if share < 100 else '(sigma unknown)'
    views = f'{len(result.frames)} view{"s" if len(result.frames) != 1 else ""}'
    scene = ('of a known object' if result.motion == 'known-object'
             else f'under {result.motion} motion')
    sentence = (f'Calibrated from {views} {scene}: focal length {camera.K[0, 0]:.1f} px '
                f'{known}, reprojection '
                f'{result.reprojection_rms_px:.3f} px rms over {result.observation_count} '
                f'observations ({result.outlier_count} rejected).')
    return ' '.join((sentence, *open_parameters(result)))
