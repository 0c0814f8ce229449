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
"""How far edges and corners of the texture determine and confirm a pose."""

from __future__ import annotations

import numpy as np

from selfcal_ros.rorapid.texture.corner_fit import LEAST_TEXTURE

#: An object is recognised by so many agreeing corners, if most of those followed agree.
CERTAIN = 10
#: ... and by so many of those looked for: of more, more agree by chance.
CERTAIN_SHARE = 0.15
#: With so many edges found the texture may be wrong.
EDGES_DO = 0.65
#: A texture of so many corners is rich enough to be the judge.
_RICH = 24
#: An object is recognised by so many edges, if they look as they are remembered.
_EDGES_CERTAIN = 0.75


def confirmation(options, edges: float, matches, agree) -> tuple[float, bool]:
    """
    Judge from edges and corners how far a pose is confirmed.

    Returns
    -------
    share : float
    certain : bool
        Whether this would do to recognise a lost object.

    """
    if matches is None or len(agree) < 2 * LEAST_TEXTURE:
        return float(edges), edges >= max(options.tracking_share, EDGES_DO)
    count, followed = int(agree.sum()), int(matches.followed.sum())
    if count < LEAST_TEXTURE or count < 0.4 * followed:
        # edges alone, where the texture says no; a rich texture has the last word
        if len(agree) >= _RICH:
            return 0.45 * float(edges), False
        return ((0.75 if edges > EDGES_DO else 0.4) * float(edges),
                edges > _EDGES_CERTAIN)
    share = max(count / len(agree), 0.5 * (count / len(agree) + edges),
                options.lost_share)
    if count < CERTAIN and edges < 0.3:
        share *= 0.5
    return float(share), (edges > _EDGES_CERTAIN and len(agree) < _RICH) or (
        count >= max(CERTAIN, CERTAIN_SHARE * len(agree)) and count >= 0.6 * followed)


def determines_pose(projection, basis: np.ndarray, information: np.ndarray) -> bool:
    """Whether the information (m, m) of one image determines the pose; the focal may stay open."""
    if projection.model == 'zoom':
        information = (basis @ information @ basis.T)[:6, :6]
    scale = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    return bool(np.linalg.eigvalsh(information / np.outer(scale, scale))[0] > 1e-6)


def focal_sigma(projection, basis: np.ndarray, information: np.ndarray,
                determined: bool) -> float:
    """Relative standard deviation of the focal length from one image; 0 where it is known."""
    if projection.model != 'zoom':
        return 0.0
    if not determined:
        return float('inf')
    row = basis[6]
    floor = np.diag(1e-9 * np.diagonal(information) + 1e-12)
    return float(np.sqrt(row @ np.linalg.solve(information + floor, row)))
