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
"""What was used of a long recording, and why: the motion of the image over time."""

from __future__ import annotations

from markupsafe import Markup
from matplotlib.figure import Figure
import numpy as np

from selfcal_ros.pipeline.long_recording import FollowedSegment, Survey
from selfcal_ros.report.inline_svg import inline_svg
from selfcal_ros.report.style import BLUE, Drawing, GREEN, GREY, ORANGE, PALE, PURPLE, RED, styled

#: Rates are shown as medians over so many pieces of the recording at most.
PIECES = 240
#: Size of the figure in inches; it is as wide as the page.
SIZE_IN = (9.6, 2.9)


def timeline_figure(survey: Survey) -> Drawing:
    """
    Draw how fast the image turned, grew and showed depth, and the segments that were followed.

    Parameters
    ----------
    survey : Survey
        With two glances or more.

    """
    glances = survey.glances
    time_s = 1e-9 * np.array([one.stamp_ns - survey.began_ns for one in glances])
    in_minutes = time_s[-1] > 180
    unit, word = (60.0, 'min') if in_minutes else (1.0, 's')
    rates = np.array([[np.hypot(*one.shift), abs(one.growth), one.parallax] for one in glances])
    piece = max(len(glances) // PIECES, 1)
    with styled():
        figure = Figure(figsize=SIZE_IN, layout='constrained')
        axes = figure.subplots()
        for values, colour, label in zip(rates.T, (BLUE, ORANGE, PURPLE), (
                'turning and moving across', 'coming nearer', 'parallax')):
            axes.plot(_medians(time_s, piece) / unit, _medians(values, piece), color=colour,
                      linewidth=1, label=label)
        blind = np.array([one.followed < 0.5 for one in glances])
        if blind.any():
            axes.fill_between(time_s / unit, 0, 1, where=blind, color=PALE, linewidth=0,
                              transform=axes.get_xaxis_transform(), label='cannot be followed')
        for used, colour, label in ((True, GREEN, 'followed and used'),
                                    (False, RED, 'followed, not used')):
            parts = [one.segment for one in survey.segments if one.used == used]
            for number, part in enumerate(parts):
                axes.axvspan(part.start_s / unit, part.end_s / unit, color=colour, alpha=0.25,
                             linewidth=0, label=None if number else label)
        axes.set_xlim(time_s[0] / unit, time_s[-1] / unit)
        axes.set_ylim(bottom=0)
        axes.set_xlabel(f'time / {word}')
        axes.set_ylabel('image diagonals, 1 / s')
        axes.spines[['top', 'right']].set_visible(False)
        axes.legend(loc='upper left', bbox_to_anchor=(1.0, 1.0), handlelength=1.4,
                    edgecolor=GREY)
    return Drawing('timeline', 'What was used, and why', _caption(survey), (figure,))


def timeline_html(survey: Survey) -> Markup:
    """Return the figure with its words, as an element of a page."""
    drawing = timeline_figure(survey)
    svg = inline_svg(drawing.svgs(words=True)[0], drawing.name, drawing.title)
    rows = [Markup('<tr><td>{}</td><td>{}</td><td>{}</td></tr>').format(
        f'{one.segment.start_s:.1f} to {one.segment.end_s:.1f} s', one.segment.why, _outcome(one))
        for one in survey.segments]
    table = Markup('<table><thead><tr><th>segment</th><th>chosen for</th><th>what it says</th>'
                   '</tr></thead><tbody>{}</tbody></table>').format(Markup('').join(rows))
    return Markup('<h3 id="timeline">{}</h3>{}<figcaption>{}</figcaption>{}').format(
        drawing.title, svg, drawing.caption, table if rows else '')


def _outcome(one: FollowedSegment) -> str:
    """Say what came of a segment."""
    if not one.result:
        return f'not used: {one.result.reason}'
    says = f'fx {one.result.camera.K[0, 0]:.1f} ± {one.result.sigma["fx"]:.2g} px'
    return says if one.used else f'{says}, not used'


def _caption(survey: Survey) -> str:
    used = sum(one.used for one in survey.segments)
    return (f'How fast the image moved, at {len(survey.glances)} pairs of images. '
            f'{len(survey.segments)} segments were followed image by image; {used} of them '
            '(green) made the calibration.')


def _medians(values: np.ndarray, piece: int) -> np.ndarray:
    """Medians of successive pieces."""
    whole = len(values) // piece * piece
    return np.asarray(np.median(values[:whole].reshape(-1, piece), axis=1))
