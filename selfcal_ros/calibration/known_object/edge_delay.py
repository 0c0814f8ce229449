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
"""How fast lines are read, by the edges of an object that moves meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.information import Information
from selfcal_ros.calibration.bundle.object_model import KnownEdges
from selfcal_ros.calibration.bundle.shutter import LINE_DELAY
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.calibration.uncertainty.cluster_covariance import shared_sigma

#: A rolling shutter that nobody has stated is one when its line delay differs from 0 by so many
#: sigmas, as in `shutter_choice`.
CERTAIN_SIGMAS = 4.0
#: Edges are not found quite where they are, and some of that follows their motion: it may look
#: like displacements of this share of the noise.
ALIKE_FRACTION = 0.1


@dataclass(frozen=True)
class LineDelay:
    """
    A line delay that was estimated.

    Attributes
    ----------
    value_s, sigma_s : float
        Seconds from one line to the next; negative where the last is read first.

    """

    value_s: float
    sigma_s: float

    @property
    def is_certain(self) -> bool:
        """Tell whether lines are read one after the other."""
        return abs(self.value_s) > CERTAIN_SIGMAS * self.sigma_s

    @classmethod
    def of(cls, information: Information, bundle: Bundle[ObjectState], state: ObjectState,
           *labels: np.ndarray) -> LineDelay:
        """
        Read the line delay of an adjustment.

        Parameters
        ----------
        information : Information
            Of the adjustment.
        bundle : Bundle
            Of edges with `EdgeRows`.
        state : ObjectState
            Its optimum.
        labels : ndarray of int, shape (N,)
            Groups of edgels that may share errors, each a way of grouping; the worst counts.

        """
        edges = cast(KnownEdges, bundle.model)
        assert edges.rows is not None
        place = bundle.unknowns.places((LINE_DELAY,))[0]
        sigma = float(np.sqrt(information.covariance[place, place]))
        influence = information.influence[:, place]
        shared = max(sigma, *(shared_sigma(influence, sigma, label) for label in labels))
        normal = edges.normals(state, bundle.view, bundle.xy)
        moves = np.sqrt(np.mean(np.einsum('ni,ni->n', edges.rows.slope, normal)**2))
        return cls(state.line_delay_s,
                   float(np.hypot(shared, ALIKE_FRACTION * bundle.sigma_px / moves)))

    def readout(self, bundle: Bundle[ObjectState], size: tuple[int, int]) -> RowReadout:
        """Return it as a result says it, for images of a size (width, height)."""
        rows = cast(KnownEdges, bundle.model).rows
        assert rows is not None
        return RowReadout.in_time(self.value_s, self.sigma_s, 'estimated', rows.interval_s, size,
                                  rows.lines)
