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
"""Facts as measurements of named unknowns, whichever block owns them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

from selfcal_ros.calibration.bundle.lens import INTRINSIC_NAMES, Lens
from selfcal_ros.calibration.bundle.state import BundleState
from selfcal_ros.geometry.camera import CameraFacts, DISTORTION_MODELS
from selfcal_ros.geometry.lenses import plumb_bob


@dataclass(frozen=True)
class Prior:
    """One measurement of an unknown: value and sigma (0: fixed, infinite: nothing known)."""

    value: float
    sigma: float

    @property
    def is_soft(self) -> bool:
        """Tell whether it is a measurement like any other, neither exact nor void."""
        return 0 < self.sigma < float('inf')


Priors = dict[str, Prior]
StateT = TypeVar('StateT', bound=BundleState)


def priors_from_facts(facts: CameraFacts) -> Priors:
    """
    Translate facts to measurements of the lens block's unknowns; sigma 0 fixes one.

    A distortion model that is not chosen yet ('auto') counts as 'radial2'.
    """
    free = DISTORTION_MODELS.get(facts.distortion, DISTORTION_MODELS['radial2'])
    priors = {}
    if facts.aspect_ratio is not None:
        priors['aspect'] = Prior(facts.aspect_ratio, facts.aspect_ratio_sigma)
    if facts.skew is not None:
        priors['skew'] = Prior(facts.skew, facts.skew_sigma_px)
    if facts.principal_point is not None:
        priors['cx'] = Prior(facts.principal_point[0], facts.principal_point_sigma_px)
        priors['cy'] = Prior(facts.principal_point[1], facts.principal_point_sigma_px)
    for name in plumb_bob.COEFFICIENTS:
        if name not in free:
            priors[name] = Prior(0.0, 0.0)
    return priors


def all_fixed(lens: Lens) -> Priors:
    """Fix every unknown of a lens where it is."""
    return {name: Prior(lens[name], 0.0) for name in INTRINSIC_NAMES}


def with_fixed(state: StateT, priors: Priors) -> StateT:
    """Put the fixed unknowns of a state at the values that they are fixed at."""
    fixed = {name: prior.value for name, prior in priors.items() if prior.sigma == 0}
    return replace(state, lens=state.lens.with_values(fixed))
