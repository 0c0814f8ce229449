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
What would the camera be without some of the edges, or some of the images?

An edge is not quite where the model has it, and shading moves it, in all images alike. An object
has a dozen of them, too few for sums of influences to tell how large such errors are. So every
edge is left out in turn (delete-a-group jackknife; Efron 1982).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.calibration.known_object.edge_views import EdgeViews
from selfcal_ros.calibration.uncertainty.cluster_covariance import (jackknife_covariance,
                                                                    jackknife_excess)

#: Stretches of the sequence that are left out in turn.
SEGMENTS = 6
#: Where descents stop, in units of sigma².
_TOLERANCE = 1e-4


def segment_excess(views: EdgeViews, bundle: Bundle[ObjectState], state: ObjectState,
                   variance_inflation: float) -> tuple[float, np.ndarray]:
    """Return what leaving out a segment of images at a time tells; see `jackknife_excess`."""
    frames = views.frames
    if len(frames) < 3 * SEGMENTS:
        return 1.0, np.zeros((len(state.lens),) * 2)
    lens = bundle.unknowns.lens
    found = list(_without(views, bundle, state, (
        np.isin(views.frame, gone) for gone in np.array_split(frames, SEGMENTS))))
    return jackknife_excess(
        np.array([moved.lens.values - state.lens.values for _, moved in found]),
        np.array([part.ideal_covariance(moved)[lens, lens] for part, moved in found]),
        bundle.ideal_covariance(state)[lens, lens], variance_inflation)


def covariance_by_edges(views: EdgeViews, bundle: Bundle[ObjectState],
                        state: ObjectState) -> np.ndarray:
    """
    Return the covariance that leaving out an edge at a time tells.

    Parameters
    ----------
    views : EdgeViews
    bundle : Bundle
        Of these.
    state : ObjectState
        Its optimum.

    Returns
    -------
    ndarray, shape (k, k)
        Of the unknowns of the lens; zero where too few edges can be left out.

    """
    shifts = [moved.lens.values - state.lens.values for _, moved in _without(
        views, bundle, state, (views.primitive == one for one in np.unique(views.primitive)))]
    return jackknife_covariance(np.array(shifts).reshape(-1, len(state.lens)))


def _without(views: EdgeViews, bundle: Bundle[ObjectState], state: ObjectState,
             parts: Iterable[np.ndarray]) -> Iterable[tuple[Bundle[ObjectState], ObjectState]]:
    """Adjust the rest without each of some parts, masks (N,); nothing where too little is left."""
    for gone in parts:
        rest = views.select(~gone)
        if len(rest.frames) < 2:
            continue
        part = rest.bundle(bundle.priors, bundle.sigma_px)
        own = replace(state, path=state.path.of_views(np.isin(views.frames, rest.frames)))
        yield part, part.optimise(own, iterations=20, tolerance=_TOLERANCE)
