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
A page for a person: one self-contained HTML file that needs no network.

Everything that comes from outside (names of topics, frames and files) is escaped by the template;
figures are images inside the page, in which nothing can run.
"""

from __future__ import annotations

import base64
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.calibration.tracks import Tracks
from selfcal_ros.errors import ArgumentError
from selfcal_ros.report.camera_yaml import camera_yaml
from selfcal_ros.report.files import atomic_write
from selfcal_ros.report.wording import facts_lines, parameter_rows, verdict


def write_page(path, result: Calibration | NotCalibrated, text: str, source: str = '',
               figures: tuple[str, ...] = (), *, tracks: Tracks | None = None,
               camera_name: str = 'camera', notes: tuple[str, ...] = ()) -> Path:
    """
    Write the page; it appears whole or not at all.

    Parameters
    ----------
    path : str or Path
    result : Calibration or NotCalibrated
    text : str
        The result as it is printed on a terminal.
    source : str
        What was calibrated from.
    figures : tuple of str
        Further SVG elements, from this program alone: they are put in as they are.
    tracks : Tracks, optional
        Those that were calibrated from; residuals over the image and coverage need them.
    camera_name : str
        Name inside the camera file.
    notes : tuple of str
        Further sentences, beside those of the result.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    return atomic_write(path, page_html(result, text, source, figures, tracks=tracks,
                                        camera_name=camera_name, notes=notes))


def page_html(result: Calibration | NotCalibrated, text: str, source: str = '',
              figures: tuple[str, ...] = (), *, tracks: Tracks | None = None,
              camera_name: str = 'camera', notes: tuple[str, ...] = ()) -> str:
    """Return the page as text; see `write_page` for the parameters."""
    # Matplotlib takes a while to load, and most runs write no page
    from selfcal_ros.report.figures import draw_figures
    drawings = [{'name': drawing.name, 'title': drawing.title, 'caption': drawing.caption,
                 'data': base64.b64encode(drawing.svg()).decode('ascii'),
                 'width': round(96 * drawing.figure.get_figwidth())}
                for drawing in draw_figures(result, tracks)]
    calibrated = bool(result)
    return _environment().get_template('page.html.j2').render(
        calibrated=calibrated, result=result, text=text, source=source, drawings=drawings,
        figures=[Markup(figure) for figure in figures], camera_name=camera_name,
        verdict=_unbroken(verdict(result)) if calibrated else result.reason,
        rows=parameter_rows(result) if calibrated else [],
        facts=facts_lines(result.facts),
        notes=list(dict.fromkeys([*(result.notes if calibrated else ()), *notes])),
        numbers=_numbers(result), yaml=_yaml(result, camera_name))


def _unbroken(sentence: str) -> str:
    """Keep a number, its sigma and its unit on one line."""
    return sentence.replace(' ± ', '\u00a0±\u00a0').replace(' px', '\u00a0px')


def _environment() -> Environment:
    """Escape whatever the name of the template: a bag may name its topic <script>."""
    return Environment(loader=PackageLoader('selfcal_ros.report', 'templates'), autoescape=True,
                       undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)


def _numbers(result: Calibration | NotCalibrated) -> list[tuple[str, str]]:
    """Return the numbers that say on what the result rests, with their names."""
    numbers = [('motion', result.motion), ('views', str(len(result.frames)))]
    if result:
        total = result.observation_count + result.outlier_count
        share = 100 * result.outlier_count / max(total, 1)
        numbers += [('observations', str(result.observation_count)),
                    ('rejected', f'{share:.1f} %'),
                    ('reprojection rms', f'{result.reprojection_rms_px:.3g} px'),
                    ('image noise σ', f'{result.noise_sigma_px:.3g} px'),
                    ('image size', f'{result.camera.width} × {result.camera.height} px')]
    return numbers


def _yaml(result: Calibration | NotCalibrated, name: str) -> str:
    """Return the camera file, or nothing where there is none."""
    if not result:
        return ''
    try:
        return camera_yaml(result.camera, name)
    except ArgumentError:
        return ''
