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
Do the images only slide and turn in themselves? Then they tell nothing of the focal length.

A camera that looks straight at a plane, and moves along it, sees such images whatever its focal
length is. Rotations explain them, too: by a focal length so long that a small turn is a slide. A
true camera with a long lens shows perspective, which must exclude a camera at infinity.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.priors import Prior
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_MEASURE

#: The focal length grows by this factor in a step, and by so many steps in all. Perspective falls
#: with its square: to a hundredth.
STEP, STEPS = 1.5, 6
#: A camera at infinity is excluded where it raises twice the cost by four sigmas squared.
EXCLUDED = 16.0
#: Shorter focal lengths than so many longer sides, known better than this, exclude it.
LONG, DOUBTFUL = 2.0, 0.02
#: By which power of the focal length coefficients grow that bend an image alike; those of a
#: denominator begin anew.
POWERS = {'f': 1, 'k1': 2, 'k2': 4, 'k3': 6, 'k4': 8, 'p1': 1, 'p2': 1}
OF_DENOMINATOR = {'k4': 2, 'k5': 4, 'k6': 6}


def only_slides(fit: RobustFit, size: tuple[int, int], focal_sigma_px: float,
                variance_inflation: float) -> bool:
    """
    Tell whether a camera at infinity explains turning views as well as the one that was found.

    Parameters
    ----------
    fit : RobustFit
        Of rotations alone, at its optimum.
    size : (int, int)
        Width and height, pixels.
    focal_sigma_px : float
        Of the focal length.
    variance_inflation : float
        Variance of the estimate over that with independent errors.

    Returns
    -------
    bool

    """
    focal_px = fit.state.lens['f']
    if focal_px < LONG * max(size) and focal_sigma_px < DOUBTFUL * focal_px:
        return False
    # what lenses are like says nothing of one at infinity
    priors = replace(fit.bundle.priors, population=None)
    bundle = bundle_of(fit.observations, fit.motion, priors, fit.bundle.sigma_px)
    state = bundle.optimise(fit.state, iterations=30, tolerance=TO_MEASURE)
    cost = bundle.cost(state)
    for _ in range(STEPS):
        state = _farther(state, STEP)
        held = bundle_of(fit.observations, fit.motion,
                         priors.updated({'f': Prior(state.lens['f'], 0.0)}), fit.bundle.sigma_px)
        state = held.optimise(held.refine_points(state), iterations=20, tolerance=TO_MEASURE)
        if not 2 * (held.cost(state) - cost) < EXCLUDED * variance_inflation:
            return False
    return True


def _farther(state: SceneState, factor: float) -> SceneState:
    """Lengthen the focal length, and turn and bend by so much less that images stay alike."""
    lens, path = state.lens, state.path
    powers = {**POWERS, **OF_DENOMINATOR} if 'k6' in lens.names else POWERS
    grown = factor ** np.array([powers.get(name, 0) for name in lens.names])
    points = state.points / np.array([factor, factor, 1.0, 1.0])
    points /= np.linalg.norm(points[:, :3], axis=1, keepdims=True)
    return replace(state, lens=replace(lens, values=lens.values * grown),
                   path=replace(path, tilt=path.tilt / factor), points=points)
