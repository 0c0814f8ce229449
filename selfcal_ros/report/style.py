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

from dataclasses import dataclass
import io
import warnings

import matplotlib
from matplotlib.figure import Figure

#: Colours that remain apart for colour-blind readers and in grey print (Okabe and Ito 2008).
INK, GREY, PALE = '#222222', '#8a8f98', '#d9dce1'
BLUE, ORANGE, GREEN, RED, PURPLE = '#0072b2', '#d55e00', '#009e73', '#c0143c', '#8a3f8f'
#: Colour map of quantities that start at zero.
SEQUENTIAL = 'viridis'

_STYLE = {
    'font.family': 'DejaVu Sans', 'font.size': 8.5, 'axes.titlesize': 9.5,
    'axes.titlelocation': 'left', 'axes.labelsize': 8.5, 'legend.fontsize': 7.5,
    'xtick.labelsize': 7.5, 'ytick.labelsize': 7.5, 'axes.edgecolor': GREY,
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
    A figure with its name, its title and a caption of one sentence or two.

    Attributes
    ----------
    name : str
        For file names and anchors.
    title, caption : str
    figure : matplotlib.figure.Figure

    """

    name: str
    title: str
    caption: str
    figure: Figure

    def svg(self) -> bytes:
        """Return the figure as an SVG document; the same figure gives the same bytes."""
        return self._save('svg', metadata={'Date': None, 'Creator': None})

    def png(self) -> bytes:
        """Return the figure as a PNG image."""
        return self._save('png')

    def _save(self, kind: str, **options) -> bytes:
        stream = io.BytesIO()
        with styled():
            self.figure.savefig(stream, format=kind, facecolor='white', **options)
        return stream.getvalue()


def styled():
    """Return a context in which Matplotlib draws in this look."""
    with warnings.catch_warnings():
        # reading settings that a version has deprecated warns
        warnings.simplefilter('ignore')
        plain = {key: matplotlib.rcParamsDefault[key] for key in matplotlib.rcParamsDefault
                 if key.partition('.')[0] not in _OF_THE_SESSION}
        return matplotlib.rc_context({**plain, **_STYLE})


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure of the given size in inches."""
    return Figure(figsize=(width_in, height_in), layout='constrained')


def image_axes(axes, width: int, height: int) -> None:
    """Prepare axes to show the image plane, y down, in pixels."""
    axes.set_aspect('equal')
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_xlabel('u / px')
    axes.set_ylabel('v / px')


def image_height_in(width: int, height: int) -> float:
    """Return the height of a figure 5.4 inches wide that shows one image of such a shape."""
    return 5.0 * min(max(height / width, 0.2), 1.4)
