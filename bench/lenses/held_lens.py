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
"""What the same observations cost under another lens: published ones against those found."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import all_fixed, priors_from_facts, with_fixed
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, Observations, with_all_points
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.values.tracks import Tracks

#: Observations further off than so many sigmas are left out, once, by the result's own lens.
OUTLIER_SIGMAS = 4.5


@dataclass(frozen=True)
class HeldLens:
    """
    The optimum of poses and points under one lens, held or free.

    Attributes
    ----------
    camera : Camera
    cost : float
        Robust, in units of the result's own noise.
    noise_px : float
        Noise of one coordinate that the residuals say.
    centres : ndarray, shape (V, 3)
        Of the camera, in a world of its own.

    """

    camera: Camera
    cost: float
    noise_px: float
    centres: np.ndarray


def observations_of(result, tracks: Tracks) -> tuple[Observations, SceneState]:
    """Take the observations that a result explains, and its state."""
    made = result.reconstructed
    kept = np.isin(tracks.frame, made.frames) & np.isin(tracks.track, made.tracks)
    order = np.argsort(made.tracks)
    point = order[np.searchsorted(made.tracks, tracks.track[kept], sorter=order)]
    view = np.searchsorted(made.frames, tracks.frame[kept])
    xy = tracks.xy[kept]
    pose, X = made.cam_from_world[view], made.points[point]
    ahead = np.einsum('nij,nj->ni', pose, X) * np.sign(X[:, 3:])
    away = np.linalg.norm(result.camera.project(ahead) - xy, axis=1)
    good = away < OUTLIER_SIGMAS * result.noise_sigma_px
    rows = np.lexsort((view, point))
    rows = rows[good[rows]]
    all_of_them = Observations(view[rows], point[rows], xy[rows], made.tracks)
    some, points = all_of_them.select(np.ones(len(rows), bool))
    X = made.points[points]
    path = AxisPath.of_poses(made.cam_from_world[0][:, :3], made.cam_from_world)
    return some, SceneState(Lens.of(result.camera), path,
                            X / np.linalg.norm(X, axis=1, keepdims=True))


def under_lens(observations: Observations, state: SceneState, sigma_px: float,
               camera: Camera, facts: CameraFacts | None = None) -> HeldLens | None:
    """
    Adjust poses and points under one lens.

    Parameters
    ----------
    observations, state
        Of `observations_of`.
    sigma_px : float
        Noise that the costs count in.
    camera : Camera
        The lens that is held, or that the estimate of it starts from.
    facts : CameraFacts, optional
        With them the lens is free, as they say.

    Returns
    -------
    HeldLens or None
        None where the lens cannot see all observations.

    """
    lens = Lens.of(camera)
    priors = all_fixed(lens) if facts is None else priors_from_facts(facts)
    if lens.model is not state.lens.model or facts is None:
        state = with_all_points(replace(state, lens=lens), observations)
        if state is None:
            return None
    bundle = bundle_of(observations, GENERAL, priors, sigma_px)
    state = bundle.optimise(with_fixed(state, priors), iterations=60, tolerance=0.5)
    return HeldLens(state.camera(camera.width, camera.height), float(bundle.cost(state)),
                    float(bundle.noise_sigma(state)), state.path.centres())


def distance_after_similarity(places: np.ndarray, onto: np.ndarray) -> float:
    """Return the rms distance of points (N, 3) from others after the best similarity."""
    a, b = places - places.mean(axis=0), onto - onto.mean(axis=0)
    U, S, Vt = np.linalg.svd(a.T @ b)
    flip = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    scaled = (S @ flip) / np.sum(a**2) * a @ (U * flip) @ Vt
    return float(np.sqrt(np.mean(np.sum((scaled - b)**2, axis=1))))
