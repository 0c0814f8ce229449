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
"""How a known object was held: from how far it was seen, and how steeply."""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.report.style import BLUE, Drawing, figure_of, GREY, new_panel, PALE, styled

#: Tilts between these tell the focal length best: less looks like another distance, more is
#: measured badly, degrees.
GOOD_TILTS_DEG = (20.0, 60.0)
#: A board is flat to this share of its size.
_FLAT = 0.02


def distance_and_tilt(result: Calibration) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Return the distances (V,), metres, and the tilts (V,), degrees, of a flat object.

    The tilt is the angle between the ray to its middle and its normal; None for what is no flat
    object, or has less than two views.
    """
    shape = result.reconstruction
    if result.motion != 'known-object' or shape is None or len(shape.cam_from_world) < 2:
        return None
    points = np.asarray(shape.points, float)
    points = points[:, :3] / points[:, 3:]
    if len(points) < 3 or not np.isfinite(points).all():
        return None
    middle = points.mean(axis=0)
    _, size, axes = np.linalg.svd(points - middle, full_matrices=False)
    if not size[0] > 0 or size[2] > _FLAT * size[0]:
        return None
    poses = np.asarray(shape.cam_from_world, float)
    ray = poses[:, :, :3] @ middle + poses[:, :, 3]
    distance = np.linalg.norm(ray, axis=1)
    across = np.abs(np.einsum('vi,vi->v', ray, poses[:, :, :3] @ axes[2])) / distance
    return distance, np.degrees(np.arccos(np.clip(across, 0, 1)))


def object_views_figure(result: Calibration) -> Drawing | None:
    """
    Draw the views of a flat object by tilt and distance.

    Parameters
    ----------
    result : Calibration

    Returns
    -------
    Drawing or None
        None for any other calibration.

    """
    found = distance_and_tilt(result)
    if found is None:
        return None
    distance, tilt = found
    with styled():
        axes = new_panel(2.9)
        axes.axvspan(*GOOD_TILTS_DEG, color=PALE, alpha=0.6, linewidth=0, zorder=0)
        axes.plot(tilt, distance, 'o', color=BLUE, markersize=4)
        for frame, x, y in zip(result.reconstructed.frames, tilt, distance):
            axes.annotate(str(frame), (x, y), (4, 2), textcoords='offset points', fontsize=7,
                          color=GREY)
        axes.set_xlim(0, 90)
        axes.set_ylim(0, 1.15 * float(distance.max()))
        axes.set_xlabel('tilt of the object / degrees')
        axes.set_ylabel('distance / m')
        axes.set_title('Views of the object')
        axes.spines[['top', 'right']].set_visible(False)
    steep = np.mean((tilt > GOOD_TILTS_DEG[0]) & (tilt < GOOD_TILTS_DEG[1]))
    return Drawing('views', 'How the object was held', f'{100 * steep:.0f} % of the views are '
                   'tilted by 20 to 60 degrees (grey), which tell the focal length best. A board '
                   'that is seen from the front alone could as well be nearer, and the focal '
                   'length shorter.', (figure_of(axes),), 'scene')
