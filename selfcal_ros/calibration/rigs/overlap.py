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
Which cameras of a rig see the same points, and what is open of those that do not.

Points join cameras to groups. Within a group points tell how the cameras sit to each other;
between groups only the common path does. And a path in a plane does not tell heights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from selfcal_ros.calibration.bundle.robust_fit import Observations, RobustFit

#: Fewer points than a camera needs that is placed by them join none.
LEAST_JOINING = 10
#: Tilts must have so many times the squares that errors feign, or they show no height.
ABOVE_NOISE = 3.0


@dataclass(frozen=True)
class Overlap:
    """
    What the cameras see together.

    Attributes
    ----------
    points : ndarray of int, shape (C,)
        Points that each camera shares with another.
    group : ndarray of int, shape (C,)
        Cameras that shared points join, directly or by others, have the same number.

    """

    points: np.ndarray
    group: np.ndarray

    @classmethod
    def of(cls, observations: Observations) -> Overlap:
        """Count what the observations of a rig share."""
        camera = observations.camera
        assert camera is not None, 'observations of a rig'
        seen = np.zeros((int(observations.point.max()) + 1, int(camera.max()) + 1), int)
        seen[observations.point, camera] = 1
        common = seen.T @ seen
        _, group = connected_components(csr_array(common >= LEAST_JOINING), directed=False)
        return cls(np.sum(seen[seen.sum(axis=1) > 1], axis=0), group)

    def links(self, i: int, k: int) -> bool:
        """Tell whether shared points join two cameras."""
        return bool(self.group[i] == self.group[k])


def unseen_heights(fit: RobustFit, overlap: Overlap, sigma_inflation: float,
                   ) -> list[tuple[list[int], np.ndarray]]:
    """
    Tell which cameras may sit at any height together, since the rig moved in a plane.

    Only tilts show how high cameras sit that share no points with the first. In a plane the
    information on it is rounding.

    Parameters
    ----------
    fit : RobustFit
    overlap : Overlap
    sigma_inflation : float
        Sigma with shared errors over that with independent ones.

    Returns
    -------
    list of (list of int, ndarray of shape (3,))
        Cameras that are up together, and the normal of the plane in the rig.

    """
    if not fit.motion.keeps_plane:
        return []
    path, unknowns = fit.state.path, fit.bundle.unknowns
    if fit.motion.tilt_sigma_rad:
        variances = fit.covariance.diagonal()[unknowns.of_views('tilt_x', 'tilt_y')]
        if np.sum(path.tilt**2) > ABOVE_NOISE * np.sum(variances) * sigma_inflation**2:
            return []
    others = set(overlap.group.tolist()) - {int(overlap.group[0])}
    return [(np.flatnonzero(overlap.group == one).tolist(), path.mount[:, 2])
            for one in sorted(others)]
