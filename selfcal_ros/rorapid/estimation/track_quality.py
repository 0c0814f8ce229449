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
"""Track quality: how far edges and corners of the texture determine and confirm a pose."""

from __future__ import annotations

import numpy as np
from selfcal_ros.geometry.scaled_inverse import is_regular

from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import Projection
from selfcal_ros.rorapid.texture.corner_fit import MIN_TEXTURE
from selfcal_ros.rorapid.texture.texture_memory import TextureMatches

#: A lost object is recognised by so many agreeing corners: fewer agree on a wrong pose by chance.
RECOGNISED_CORNERS = 10
#: ... by this share of the corners looked for: of more corners, more agree by chance ...
_RECOGNISED_FRACTION = 0.15
#: ... and by this share of those that were followed: a wrong pose has the larger part against it.
RECOGNISED_FOLLOWED = 0.6
#: With this share of the edges found the texture may be wrong.
EDGES_SUFFICIENT = 0.65
#: A lost object is recognised by this share of the edges, if they look as they are remembered.
_RECOGNISED_EDGES = 0.75
#: A texture of so many corners is rich enough to have the last word.
_RICH_TEXTURE = 24
#: The texture denies a pose where less of the corners followed agree with it.
_DENIED_FOLLOWED = 0.4
#: What edges count for where a rich texture denies the pose: all of them are less than the usual
#: `tracking_share` of 0.5.
_EDGES_AGAINST_RICH = 0.45
#: ... and where a poor texture does: sufficient edges track on (0.65 x 0.75 is nearly 0.5), fewer
#: are hardly more than the usual `lost_share` of 0.25.
_SUFFICIENT_AGAINST_POOR, _FEW_AGAINST_POOR = 0.75, 0.4
#: Less of the edges than this, and few corners: what is found may be found by chance, and counts
#: for half.
_FEW_EDGES, _BY_CHANCE = 0.3, 0.5
#: Smallest eigenvalue of an information matrix scaled to a unit diagonal; below, rounding decides.
RANK_TOLERANCE = 1e-6


def track_quality(options: TrackerOptions, edges: float, matches: TextureMatches | None,
                  agree: np.ndarray) -> tuple[float, bool]:
    """
    Judge from edges and corners how far a pose is confirmed.

    Parameters
    ----------
    options : TrackerOptions
    edges : float
        Share of the edges searched that were found.
    matches : TextureMatches or None
        Corners of the texture that were looked for.
    agree : ndarray of bool, shape (N,)
        Which of them agree with the pose.

    Returns
    -------
    share : float
        Share of what should be seen and is confirmed.
    recognised : bool
        Whether this would do to recognise a lost object.

    """
    looked_for = len(agree)
    if matches is None or looked_for < 2 * MIN_TEXTURE:
        return float(edges), edges >= max(options.tracking_share, EDGES_SUFFICIENT)
    count, followed = int(agree.sum()), int(matches.followed.sum())
    rich = looked_for >= _RICH_TEXTURE
    by_edges = edges > _RECOGNISED_EDGES and not rich
    if count < MIN_TEXTURE or count < _DENIED_FOLLOWED * followed:
        if rich:
            return _EDGES_AGAINST_RICH * float(edges), False
        sufficient = edges > EDGES_SUFFICIENT
        return (_SUFFICIENT_AGAINST_POOR if sufficient else _FEW_AGAINST_POOR) * float(
            edges), by_edges
    corners = count / looked_for
    share = max(corners, 0.5 * (corners + edges), options.lost_share)
    if count < RECOGNISED_CORNERS and edges < _FEW_EDGES:
        share *= _BY_CHANCE
    by_corners = (count >= max(RECOGNISED_CORNERS, _RECOGNISED_FRACTION * looked_for)
                  and count >= RECOGNISED_FOLLOWED * followed)
    return float(share), by_edges or by_corners


def determines_pose(projection: Projection, basis: np.ndarray, information: np.ndarray,
                    free: np.ndarray) -> bool:
    """
    Whether the information (m, m) of one image determines the pose.

    The focal length may stay open, and turns that a body of revolution does not show: free,
    (size, k).
    """
    along = basis.T @ free
    information = information + (along * (np.diagonal(information) @ along**2)) @ along.T
    if projection.model == 'zoom':
        information = (basis @ information @ basis.T)[:6, :6]
    return is_regular(information, RANK_TOLERANCE)


def focal_sigma(projection: Projection, basis: np.ndarray, information: np.ndarray,
                determined: bool) -> float:
    """Relative standard deviation of the focal length from one image; 0 where it is known."""
    if projection.model != 'zoom':
        return 0.0
    if not determined:
        return float('inf')
    row = basis[6]
    floor = np.diag(1e-9 * np.diagonal(information) + 1e-12)
    return float(np.sqrt(row @ np.linalg.solve(information + floor, row)))
