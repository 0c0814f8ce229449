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
Where the rotations of a camera that only turns start.

Homographies give them, and a camera in closed form; supposed focal lengths follow. A view that a
wrong homography leads astray is turned to where the others see its points: its errors are gross,
and no robust descent finds back.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.affine.infinite_homography_calibration import ConicCalibration
from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.centres import all_rays
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import MotionModel
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import priors_from_facts, with_fixed
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, Observations,
                                                       with_all_directions)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import SHARE_OF_COST, TO_COMPARE_ROUGHLY
from selfcal_ros.calibration.initialisation.pivot_start import completed_rotations
from selfcal_ros.calibration.observability import LEAST_NOISE_PX
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts, supposed_matrix
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import lengths

#: Focal lengths to start from where the closed form gives none, in longer image sides.
_FOCAL_SWEEP = (1.0, 0.65, 1.6, 2.6, 4.2)
#: Starts whose costs differ by less than this share led to one optimum. Where rotations leave
#: several times the noise nothing converges, and a rough optimum tells enough.
SAME_COST, SAME_COST_AFAR, AFAR = 0.01, 0.05, 4.0
#: A start that leaves less than so many times what homographies leave needs no other.
EXPLAINED_RATIO = 1.3
#: A view whose middle error is more than so many times the noise is lost.
LOST = 10.0


@dataclass(frozen=True)
class RotationProblem:
    """
    Views that rotations alone may explain, and what they start from.

    Attributes
    ----------
    observed : Observations
    frames : ndarray of int, shape (V,)
        Frame of each view.
    H : ndarray, shape (V - 1, 3, 3)
        Homographies from the reference, which is the first in `order`.
    order : ndarray of int, shape (V,)
    conic : ConicCalibration or NoEstimate
        The camera by these homographies.
    sigma_px : float
        Standard deviation of an image coordinate by them.
    size : (int, int)
        Width and height of the image, pixels.
    facts : CameraFacts

    """

    observed: Observations
    frames: np.ndarray
    H: np.ndarray
    order: np.ndarray
    conic: ConicCalibration | NoEstimate
    sigma_px: float
    size: tuple[int, int]
    facts: CameraFacts


def best_rotation_start(problem: RotationProblem, motion: MotionModel,
                        hopeless_px: float = np.inf) -> tuple[SceneState, float] | NoEstimate:
    """
    Start rotations with several cameras.

    Parameters
    ----------
    problem : RotationProblem
    motion : MotionModel
        Rotations, with a focal length that varies perhaps.
    hopeless_px : float
        Noise beyond which the first start is the last.

    Returns
    -------
    SceneState
        The best start.
    float
        The noise that it leaves, pixels.
        No estimate, `moved_not_rotated`, where a start leaves more than is hopeless.

    """
    facts, sigma_px = problem.facts, problem.sigma_px
    priors = priors_from_facts(facts)
    bundle = bundle_of(problem.observed, motion, priors, max(sigma_px, LEAST_NOISE_PX))
    best, least, best_px = None, np.inf, np.inf
    for K in _starting_cameras(problem):
        state = _start(K, problem, priors.lens.name)
        state = bundle.optimise(with_fixed(state, priors), iterations=6,
                                tolerance=TO_COMPARE_ROUGHLY)
        state = _with_lost_views(state, bundle, problem)
        # no finer than starts are told apart
        tolerance = max(TO_COMPARE_ROUGHLY, SHARE_OF_COST * bundle.cost(state))
        state = bundle.optimise(state, iterations=24, tolerance=tolerance)
        cost = bundle.cost(state)
        left_px = bundle.noise_sigma(state)
        # where no rotation is expected, two starts with one optimum speak for the others
        same = SAME_COST_AFAR if left_px > AFAR * sigma_px else SAME_COST
        agree = hopeless_px < np.inf and abs(cost - least) < same * cost
        if best is None or cost < least:
            best, least, best_px = state, cost, left_px
        if left_px > hopeless_px:
            return NoEstimate('moved_not_rotated', left_px=left_px, noise_px=sigma_px,
                              facts=facts)
        if agree or left_px < EXPLAINED_RATIO * sigma_px:
            break
    assert best is not None     # a range of focal lengths is always supposed
    return best, best_px


def _starting_cameras(problem: RotationProblem) -> Iterator[np.ndarray]:
    """Closed form first, then supposed focal lengths with the principal point in the middle."""
    if not isinstance(problem.conic, NoEstimate):
        yield problem.conic.K
    for share in _FOCAL_SWEEP:
        yield supposed_matrix(share * max(problem.size), problem.size, problem.facts)


def _start(K: np.ndarray, problem: RotationProblem, model: str) -> SceneState:
    """Rotations nearest to K^-1 H K, and mean directions of the points."""
    camera, observed = Camera(K, model=model), problem.observed
    U, _, Vt = np.linalg.svd(np.linalg.inv(K) @ problem.H @ K)
    R = np.concatenate([np.eye(3)[None], U @ Vt])[problem.order]
    turned = SceneState(Lens.of(camera), AxisPath.of_turns(R))
    found = with_all_directions(turned, observed)
    assert found is not None     # without coefficients a lens has a ray for every place
    return found


def _with_lost_views(state: SceneState, bundle: Bundle[SceneState],
                     problem: RotationProblem) -> SceneState:
    """Turn views that lost all their points to where the others see them, if there are such."""
    observed = problem.observed
    distance = lengths(bundle.residuals(state))
    middle = np.array([np.median(distance[observed.view == k]) for k in range(len(state.path))])
    # NaN, behind the camera: lost
    lost = ~(middle < LOST * max(bundle.noise_sigma(state), LEAST_NOISE_PX))
    rays = all_rays(state.camera(*problem.size), state.steadied(observed.xy, observed.view))
    if not lost.any() or not np.isfinite(rays).all():
        return state
    rotations = np.where(lost[:, None, None], np.nan, state.path.rotations())
    found = completed_rotations(bundle.blocks, rays, rotations)
    if found is None:
        return state
    turned = replace(state, path=AxisPath.of_turns(found))
    return with_all_directions(turned, observed) or state
