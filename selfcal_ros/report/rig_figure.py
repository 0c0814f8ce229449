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
"""A rig from above and from the side, and how far its matches lie from the epipolar planes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from selfcal_ros.calibration.rigs.result import RigCalibration
from selfcal_ros.report.rig_epipolar import WRONG_PX
from selfcal_ros.report.style import (BLUE, Drawing, figure_of, GREEN, INK, legend_below,
                                      new_panel, ORANGE, PURPLE, styled)

_COLOURS = (BLUE, ORANGE, GREEN, PURPLE)
#: Views: to the right on the paper, and upwards, as axis and sign.
_VIEWS = (('From above', 'x / {}, right', 'z / {}, ahead', (0, 1), (2, 1)),
          ('From the right', 'z / {}, ahead', 'y / {}, up', (2, 1), (1, -1)))


def rig_figure(rig: RigCalibration) -> Drawing | None:
    """Draw where the cameras sit and what they see; None where a pose is open."""
    poses = {name: pose.T_rig_camera for name, pose in rig.poses.items()}
    if not all(np.isfinite(T).all() for T in poses.values()):
        return None
    factor, unit = (1e3, 'mm') if rig.unit == 'm' else (1.0, 'steps')
    farthest = float(np.max([np.linalg.norm(T[:3, 3]) for T in poses.values()]))
    reach = 0.5 * factor * max(farthest, 1e-9)
    panels = []
    with styled():
        for title, right, up, (i, plus), (k, minus) in _VIEWS:
            axes = new_panel(3.2)
            for number, (name, T) in enumerate(poses.items()):
                colour = _COLOURS[number % len(_COLOURS)]
                place, camera = factor * T[:3, 3], rig.cameras[name].camera
                w, h = camera.width, camera.height
                edge = np.array([[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1], [0, 0]], float)
                rays = camera.rays(edge) @ T[:3, :3].T
                rays = np.nan_to_num(rays / np.linalg.norm(rays, axis=1, keepdims=True))
                corners = place + reach * rays
                axes.plot(plus * corners[:, i], minus * corners[:, k], color=colour, linewidth=1)
                for corner in corners[:4]:
                    axes.plot([plus * place[i], plus * corner[i]],
                              [minus * place[k], minus * corner[k]], color=colour, linewidth=0.8)
                axes.plot(plus * place[i], minus * place[k], 'o', color=colour, markersize=4,
                          label=name)
                # the optical axis
                tip = place + 1.25 * reach * T[:3, 2]
                axes.annotate('', (plus * tip[i], minus * tip[k]),
                              (plus * place[i], minus * place[k]), arrowprops={
                                  'arrowstyle': '-|>', 'color': colour, 'linewidth': 1.4,
                                  'shrinkA': 0, 'shrinkB': 0})
                axes.plot(plus * tip[i], minus * tip[k], alpha=0)
            axes.set_aspect('equal', adjustable='datalim')
            axes.margins(0.1)
            axes.set_xlabel(right.format(unit))
            axes.set_ylabel(up.format(unit))
            axes.set_title(title)
            axes.spines[['top', 'right']].set_visible(False)
            legend_below(axes, 4)
            panels.append(figure_of(axes))
    return Drawing('rig', 'The cameras to each other', 'In the optical frame of the first camera: '
                   'x right, y down, z ahead. Arrows are the optical axes; the pyramids '
                   'show what each camera sees.',
                   tuple(panels), 'scene')


def epipolar_figure(distances: Mapping[tuple[str, str], np.ndarray],
                    bent_px: float | None = None) -> Drawing | None:
    """
    Draw how distances from the epipolar planes are spread.

    Parameters
    ----------
    distances : mapping of (str, str) to ndarray, shape (N,)
        Pixels, of every two cameras.
    bent_px : float, optional
        By how much the lenses deviate from their models.

    Returns
    -------
    Drawing or None
        None without matches.

    """
    if not distances:
        return None
    panels = []
    with styled():
        for number, ((first, second), all_px) in enumerate(distances.items()):
            px = all_px[np.abs(all_px) < WRONG_PX]
            reach = max(float(np.quantile(np.abs(px), 0.995)), 1e-3) if len(px) else 1.0
            axes = new_panel(2.8)
            axes.hist(px, bins=61, range=(-reach, reach), color=_COLOURS[number % len(_COLOURS)])
            axes.axvline(0.0, color=INK, linewidth=0.7)
            axes.set_xlabel('distance / px')
            axes.set_ylabel('matches')
            beyond = 100 * float(np.mean(np.abs(all_px) > reach))
            axes.set_title(f'{first} and {second}; {beyond:.2g} % lie beyond the ends')
            axes.spines[['top', 'right']].set_visible(False)
            panels.append(figure_of(axes))
    caption = ('Distances of matches from the epipolar planes of this calibration. They should '
               'gather about zero, as narrow as the noise of the images.')
    if bent_px is not None:
        caption += (f' Where lenses deviate from their models, {bent_px:.2g} px here, they may '
                    'gather as far off zero.')
    return Drawing('epipolar', 'What two cameras see at once', caption, tuple(panels))
