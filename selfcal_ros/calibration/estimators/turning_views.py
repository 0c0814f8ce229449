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
Views in which the camera turns on the spot, in a recording in which it moves elsewhere.

Their points have hardly any depth. Where an estimate puts them on the wrong side of infinity, it
is off by many of its sigmas. So it is made from the other views alone, too.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.estimators.turning_stretch import (stretches_of,
                                                                turning_stretches,
                                                                usual_inverse_depths)
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.values.tracks import Tracks

#: Steps on the spot, as a share of the longest one, and of the usual depth.
ON_THE_SPOT = (0.1, 0.01)
#: So many other views at least can tell.
LEAST_OTHERS = 6
#: Both estimates differ by chance up to so many sigmas of their difference. Its variance is that
#: of one less that of the other (Hausman 1978), its sigma this share of the larger one at least.
BY_CHANCE, LEAST_SHARE = 3.0, 0.5
#: A focal length that others know no better than this share of it tells nothing.
VAGUE = 0.01


def frames_in_motion(scene: Reconstruction, tracks: Tracks) -> np.ndarray | None:
    """
    Find the frames without those in which the camera turns on the spot.

    Parameters
    ----------
    scene : Reconstruction
    tracks : Tracks
        From which it was made.

    Returns
    -------
    ndarray of int, or None
        None where it turns on the spot nowhere, or too few others remain.

    """
    R = scene.cam_from_world[:, :, :3]
    centres = camera_centres(scene.cam_from_world)
    seen = tracks.select(np.isin(tracks.frame, scene.frames) & np.isin(tracks.track, scene.tracks))
    view = np.searchsorted(scene.frames, seen.frame)
    points = scene.points[np.searchsorted(scene.tracks, seen.track)]
    usual = usual_inverse_depths(points, view, centres)
    return _in_motion(scene.frames, stretches_of(centres, R, usual, *ON_THE_SPOT))


def saying_what_moves(refusal: NoEstimate, fit: RobustFit, frames: np.ndarray) -> NoEstimate:
    """
    Return a refusal with the frames of `frames_in_motion`, where there are such.

    Parameters
    ----------
    refusal : NoEstimate
    fit : RobustFit
        That was refused.
    frames : ndarray of int, shape (V,)

    """
    moving = _in_motion(frames, turning_stretches(fit, *ON_THE_SPOT))
    return refusal if moving is None else refusal.saying(in_motion=tuple(moving.tolist()))


def _in_motion(frames: np.ndarray, stretches: list[tuple[int, int]]) -> np.ndarray | None:
    """Return the frames outside of stretches, where enough remain."""
    moves = np.ones(len(frames), bool)
    for first, last in stretches:
        # a view at an end stands where the motion begins
        moves[first + (first > 0):last + (last == len(moves) - 1)] = False
    return frames[moves] if not moves.all() and moves.sum() >= LEAST_OTHERS else None


def better_without(whole: Calibration, others: Calibration) -> bool:
    """
    Tell whether views that turn on the spot had better be left out.

    Where the motion is free, their translations are unknowns that hardly show, and bias an
    estimate by more than its sigmas say. On a plane they do not, unless it contradicts the others
    beyond chance.

    Parameters
    ----------
    whole, others : Calibration
        From all views, and from the others alone.

    Returns
    -------
    bool

    """
    # a focal length that varies has no one value to compare, and all views tell it best
    if whole.focal is not None or others.focal_sigma_share > VAGUE:
        return False
    if whole.motion == 'general':
        return True
    pairs = zip(MATRIX_PARAMETERS, whole.camera.parameters, others.camera.parameters)
    for name, one, other in pairs:
        wide, narrow = others.sigma[name], whole.sigma[name]
        sigma = max(np.sqrt(max(wide**2 - narrow**2, 0.0)), LEAST_SHARE * wide)
        if sigma > 0 and abs(one - other) > BY_CHANCE * sigma:
            return True
    return False
