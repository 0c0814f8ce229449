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
"""One look for all figures, and their way into a page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
import io
import math
from typing import Any, TYPE_CHECKING
import warnings

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Colours that remain apart for colour-blind readers and in grey print (Okabe and Ito 2008).
INK, GREY, PALE, PAPER = '#222222', '#8a8f98', '#d9dce1', '#ffffff'
#: On pictures and coloured cells, which look the same on dark paper.
BLACK, WHITE = '#111111', '#fefefe'
BLUE, ORANGE, GREEN, RED, PURPLE = '#0072b2', '#d55e00', '#009e73', '#c0143c', '#8a3f8f'
#: Width of a figure; a page shows two beside each other, a telephone one.
PANEL_WIDTH_IN = 4.7
#: Colour map of quantities that start at zero.
SEQUENTIAL = 'viridis'

_STYLE = {
    'font.family': 'DejaVu Sans', 'font.size': 9, 'axes.titlesize': 9.5,
    'axes.titleweight': 'bold', 'axes.titlelocation': 'left', 'axes.labelsize': 9,
    'legend.fontsize': 8, 'axes.facecolor': PAPER, 'legend.facecolor': PAPER,
    'xtick.labelsize': 8, 'ytick.labelsize': 8, 'axes.edgecolor': GREY,
    'axes.labelcolor': INK, 'text.color': INK, 'xtick.color': GREY, 'ytick.color': GREY,
    'xtick.labelcolor': INK, 'ytick.labelcolor': INK, 'axes.linewidth': 0.7,
    'legend.frameon': True, 'legend.framealpha': 0.9, 'legend.edgecolor': PALE,
    'axes.axisbelow': True, 'svg.hashsalt': 'selfcal_ros', 'svg.fonttype': 'path',
    'savefig.dpi': 150, 'figure.dpi': 100, 'text.usetex': False,
    'axes.formatter.useoffset': False,
}
#: Settings that are no look; rc_context does not restore the backend.
_OF_THE_SESSION = {'backend', 'backend_fallback', 'interactive', 'toolbar', 'timezone', 'keymap',
                   'tk', 'webagg', 'datapath', 'animation', 'docstring', 'date'}


@dataclass(frozen=True)
class Drawing:
    """
    One or more figures that tell one thing, with name, title and a caption of a few sentences.

    Attributes
    ----------
    name : str
        For file names and anchors.
    title, caption : str
    panels : tuple of matplotlib.figure.Figure
        Side by side where there is room, else one below the other.
    section : str
        Part of the page that it stands in: 'seen', 'certainty', 'fit', 'scene', 'robot',
        'geometry', or 'still' for what a page without scripts shows.

    """

    name: str
    title: str
    caption: str
    panels: tuple[Figure, ...]
    section: str = 'fit'

    def svgs(self, words: bool = False) -> list[bytes]:
        """
        Return the panels as SVG documents; the same panel gives the same bytes.

        Parameters
        ----------
        words : bool
            Leave the text as text, in whatever font its reader has, instead of outlines.

        """
        return [_svg(panel, 'none' if words else 'path') for panel in self.panels]

    def pngs(self) -> list[bytes]:
        """Return the panels as PNG images."""
        return [_png(panel) for panel in self.panels]


# savefig draws twice, the first time for nothing: half of the time of a report
@contextmanager
def _for_a_file(figure: Figure, settings: dict[str, Any] | None = None) -> Iterator[None]:
    with styled(settings):
        screen_dpi, figure.dpi = figure.dpi, matplotlib.rcParams['savefig.dpi']
        figure.set_facecolor(PAPER)
        engine = figure.get_layout_engine()
        # where axes of a fixed aspect end is known once they have been laid out: without a second
        # time the label beside a square or upright image is cut off
        if engine and any(axes.get_aspect() != 'auto' for axes in figure.axes):
            engine.execute(figure)
        yield
        figure.dpi = screen_dpi


def _svg(figure: Figure, fonttype: str) -> bytes:
    stream = io.StringIO()
    with _for_a_file(figure, {'svg.fonttype': fonttype}):
        FigureCanvasSVG(figure).print_svg(stream, metadata={'Date': None, 'Creator': None})
    return stream.getvalue().encode('utf-8')


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    with _for_a_file(figure):
        FigureCanvasAgg(figure).print_png(stream)
    return stream.getvalue()


def styled(settings: dict[str, Any] | None = None) -> AbstractContextManager[None]:
    """Return a context in which Matplotlib draws in this look."""
    with warnings.catch_warnings():
        # reading settings that a version has deprecated warns
        warnings.simplefilter('ignore')
        plain = {key: matplotlib.rcParamsDefault[key] for key in matplotlib.rcParamsDefault
                 if key.partition('.')[0] not in _OF_THE_SESSION}
        chosen: dict[Any, Any] = {**plain, **_STYLE, **(settings or {})}
        return matplotlib.rc_context(chosen)


def new_panel(height_in: float = 3.4) -> Axes:
    """Return the axes of an empty figure as wide as a column, of the given height."""
    return Figure(figsize=(PANEL_WIDTH_IN, height_in), layout='constrained').subplots()


def legend_below(axes: Axes, columns: int, **more: Any) -> None:
    """Put the legend under axes, their numbers and their label."""
    # Matplotlib 3.6 has no "outside lower center"; the distance is in sizes of its letters
    axes.legend(loc='upper center', bbox_to_anchor=(0.5, 0), borderaxespad=4.2, ncol=columns,
                **more)


def figure_of(axes: Axes) -> Figure:
    """Return the whole figure that axes are in."""
    figure = axes.figure
    assert isinstance(figure, Figure)
    return figure


def counted_along_x(axes: Axes, what: str) -> None:
    """Label an axis along which images or recordings are counted: its ticks are whole numbers."""
    axes.xaxis.set_major_locator(MaxNLocator('auto', steps=[1, 2, 5, 10], integer=True))
    axes.set_xlabel(what)


def image_axes(axes: Axes, width: int, height: int) -> None:
    """Prepare axes to show the image plane, y down, in pixels."""
    axes.set_aspect('equal')
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_xlabel('u / px')
    axes.set_ylabel('v / px')


def image_height_in(width: int, height: int) -> float:
    """Return the height of a panel that shows one image of such a shape beside a scale."""
    return 0.45 + 0.82 * PANEL_WIDTH_IN * min(max(height / width, 0.2), 1.4)


def round_down(value: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that does not exceed the value."""
    power = 10.0 ** math.floor(math.log10(value))
    return float(power * max(m for m in (1, 2, 5) if m * power <= value * (1 + 1e-9)))
