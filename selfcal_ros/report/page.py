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

Everything that comes from outside (names of topics, frames and files) is escaped by the template.
Figures are elements of the page without scripts; the one script, which turns the view of the
scene, gets numbers only, and the page allows no other by its hash.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable
import hashlib
from importlib.resources import files
from pathlib import Path
from typing import Any, TYPE_CHECKING

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from selfcal_ros.calibration.mount import Mount
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.report.camera_yaml import camera_yaml
from selfcal_ros.report.mounts.words import no_mount_sentence
from selfcal_ros.report.open_frames import OpenFrames
from selfcal_ros.report.page_table import PageTable
from selfcal_ros.report.phrases import facts_lines, parameter_rows, verdict
from selfcal_ros.report.provenance import bytes_text, Provenance
from selfcal_ros.report.ranked_notes import MOST_SHOWN, ranked_notes
from selfcal_ros.report.summary import distortion, matrix, px_text, quality
from selfcal_ros.values.output_files import atomic_write
from selfcal_ros.values.tracks import Tracks

if TYPE_CHECKING:
    from selfcal_ros.report.keyframe_pictures import Picture
    from selfcal_ros.report.style import Drawing


def write_page(path: str | Path, result: Calibration | NotCalibrated, text: str, source: str = '',
               figures: tuple[str, ...] = (), *, tracks: Tracks | None = None,
               camera_name: str = 'camera', notes: tuple[Finding | str, ...] = (),
               open_frames: OpenFrames | None = None, made: Provenance | None = None) -> Path:
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
        Those that were calibrated from; residuals, coverage and the scene need them.
    camera_name : str
        Name inside the camera file.
    notes : tuple of Finding or str
        Further ones, beside those of the result.
    open_frames : callable, optional
        Opens the images again (as a context manager), to show some of them with their tracks.
    made : Provenance, optional
        When, by which command and from what; without it the page does not say.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    return atomic_write(path, page_html(result, text, source, figures, tracks=tracks,
                                        camera_name=camera_name, notes=notes,
                                        open_frames=open_frames, made=made))


def page_html(result: Calibration | NotCalibrated, text: str, source: str = '',
              figures: tuple[str, ...] = (), *, tracks: Tracks | None = None,
              camera_name: str = 'camera', notes: tuple[Finding | str, ...] = (),
              open_frames: OpenFrames | None = None, made: Provenance | None = None) -> str:
    """Return the page as text; see `write_page` for the parameters."""
    # of a hint everything is shown but the camera file
    shown = result if result else result.hint or result
    pictures, scene = _images_and_scene(shown, tracks, open_frames)
    script = _script() if scene else None
    drawings, tables = _drawings(shown, tracks)
    said = ranked_notes(shown, notes)
    page = page_environment().get_template('page.html.j2').render(
        calibrated=bool(shown), result=result, text=text, source=source, grade=result.grade,
        no_mount=_no_mount(shown),
        drawings=drawings, of=lambda section: [name for name, drawing in drawings.items()
                                               if drawing['section'] == section],
        tables=lambda section: [table for table in tables if table.section == section],
        figures=[Markup(figure) for figure in figures],
        camera_name=camera_name, pictures=pictures, scene=scene, script=script,
        policy=_policy(script),
        verdict=unbroken(verdict(result)) if result else result.reason,
        quality=unbroken(quality(shown)) if shown else '',
        matrix=matrix(shown) if shown else [],
        distortion=distortion(shown) if shown else [],
        rows=parameter_rows(shown) if shown else [], lens=_lens(shown),
        facts=facts_lines(result.facts),
        notes=said[:MOST_SHOWN], folded=said[MOST_SHOWN:],
        made=made.rows(tracks) if made else [],
        numbers=_numbers(shown), yaml=_yaml(result, camera_name))
    # whatever comes from outside is escaped, so this mark is the template's own
    head, _, foot = page.rpartition('<!--size-->')
    return f'{head}{bytes_text(len(page.encode()))}{foot}'


def _images_and_scene(result: Calibration | NotCalibrated, tracks: Tracks | None,
                      open_frames: OpenFrames | None,
                      ) -> tuple[list[Picture], dict[str, Any] | None]:
    """Return what the template shows of images and of the scene."""
    if tracks is None:
        return [], None
    from selfcal_ros.report.keyframe_pictures import pictures_and_colours
    from selfcal_ros.report.scene import scene_of
    pictures: list[Picture] = []
    colours: dict[int, tuple[int, int, int]] = {}
    if open_frames is not None:
        pictures, colours = pictures_and_colours(result, tracks, open_frames)
    scene = scene_of(result, tracks, colours) if result else None
    if scene is None:
        return pictures, None
    from selfcal_ros.report.scene_figure import scene_figure
    return pictures, {'json': scene.as_json(), 'unit': scene.unit, 'views': len(scene.frames),
                      'points': len(scene.points), 'path': scene.path,
                      'still': drawn([scene_figure(scene)])['still']}


def _drawings(result: Calibration | NotCalibrated, tracks: Tracks | None,
              ) -> tuple[dict[str, Any], list[PageTable]]:
    """Return the figures as elements of a page, by name, and the tables."""
    # Matplotlib takes a while to load, and most runs write no page
    from selfcal_ros.report.figures import draw_figures, draw_tables
    return drawn(draw_figures(result, tracks)), draw_tables(result, tracks)


def drawn(drawings: Iterable[Drawing]) -> dict[str, Any]:
    """Return figures as elements of a page, by name."""
    from selfcal_ros.report.inline_svg import inline_svg
    return {drawing.name: {
        'name': drawing.name, 'title': drawing.title, 'caption': drawing.caption,
        'section': drawing.section,
        'panels': [inline_svg(svg, f'{drawing.name}-{k}', drawing.title)
                   for k, svg in enumerate(drawing.svgs(words=True))]
    } for drawing in drawings}


def _script() -> Markup:
    """Return the viewer, which is a file of this package."""
    return Markup(files('selfcal_ros.report').joinpath('templates', 'viewer.js')
                  .read_text(encoding='utf-8'))


def _policy(script: str | None) -> str:
    """Allow what the page brings along, and no script but the one that has this hash."""
    policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
    if script:
        digest = base64.b64encode(hashlib.sha256(script.encode('utf-8')).digest()).decode('ascii')
        policy += f"; script-src 'sha256-{digest}'"
    return policy


def unbroken(sentence: str) -> str:
    """Keep a number, its sigma and its unit on one line."""
    for words in (' ± ', ' px', ' = ', '± ', ' mm', ' cm', ' 10 m'):
        sentence = sentence.replace(words, words.replace(' ', '\u00a0'))
    return sentence


def page_environment() -> Environment:
    """Escape whatever the name of the template: a bag may name its topic <script>."""
    environment = Environment(loader=PackageLoader('selfcal_ros.report', 'templates'),
                              autoescape=True, undefined=StrictUndefined, trim_blocks=True,
                              lstrip_blocks=True)
    environment.filters['base64'] = lambda data: base64.b64encode(data).decode('ascii')
    return environment


def _no_mount(result: Calibration | NotCalibrated) -> str:
    """Say why it is not known where the camera sits, where a robot was given."""
    if not result or result.mount is None or isinstance(result.mount, Mount):
        return ''
    return no_mount_sentence(result.mount)


def _lens(result: Calibration | NotCalibrated) -> str:
    """Say which of ROS's models the distortion is of, and what it is a function of."""
    if not result:
        return ''
    of = 'normalised coordinates' if result.camera.lens.is_perspective else 'angles from the axis'
    return f'ROS\'s {result.camera.model}, on {of}'


def _numbers(result: Calibration | NotCalibrated) -> list[tuple[str, str]]:
    """Return the numbers that say on what the result rests, with their names."""
    numbers = [('motion', result.motion.replace('-', ' ')), ('views', str(len(result.frames)))]
    if result:
        total = result.observation_count + result.outlier_count
        share = 100 * result.outlier_count / max(total, 1)
        numbers += [('observations', str(result.observation_count)),
                    ('rejected', f'{share:.1f} %'),
                    ('reprojection rms', px_text(result.reprojection_rms_px)),
                    ('image noise σ', px_text(result.noise_sigma_px)),
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
