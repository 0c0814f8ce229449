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
"""Path and structure of one recording under the camera that several recordings gave."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import all_fixed
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, Observations, OUTLIER_SIGMAS
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_COMPARE
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.projective import lengths, rms_length
from selfcal_ros.values.tracks import Tracks


def under_camera(calibration: Calibration, camera: Camera, tracks: Tracks) -> Calibration:
    """
    Return a calibration with another camera, and with the path and the points that suit it.

    Without that, the same images would seem not to fit: path and points make up for their own
    camera. Where rows are read in turn, images are shifted or the focal length varies they stay
    as they are.

    Parameters
    ----------
    calibration : Calibration
    camera : Camera
        Of the same lens model.
    tracks : Tracks
        That the calibration was made from; what does not fit it has no part.

    """
    scene = calibration.reconstruction
    if scene is None or calibration.focal is not None or (
            scene.row_motion is not None or scene.shift_px is not None):
        return replace(calibration, camera=camera)
    known = tracks.in_frames(scene.frames)
    known = known.select(np.isin(known.track, scene.tracks))
    observations = Observations.of(known, scene.frames)
    place = np.argsort(scene.tracks)
    place = place[np.searchsorted(scene.tracks[place], observations.track)]
    lens, sigma_px = Lens.of(calibration.camera), calibration.noise_sigma_px
    state = SceneState(lens, AxisPath.of_poses(np.eye(3), scene.cam_from_world),
                       scene.points[place])
    own = bundle_of(observations, GENERAL, all_fixed(lens), sigma_px)
    # behind the camera it is NaN, and does not agree
    kept, points = observations.select(
        lengths(own.residuals(state)) < OUTLIER_SIGMAS * sigma_px)
    if len(np.unique(kept.view)) < len(scene.frames):
        return replace(calibration, camera=camera)
    lens = Lens.of(camera)
    bundle = bundle_of(kept, GENERAL, all_fixed(lens), sigma_px)
    state = bundle.optimise(replace(state, lens=lens, points=state.points[points]),
                            iterations=20, tolerance=TO_COMPARE)
    structure, residuals = scene.points.copy(), bundle.residuals(state)
    structure[place[points]] = state.points
    return replace(calibration, camera=camera, residuals=residuals,
                   reprojection_rms_px=rms_length(residuals),
                   reconstruction=replace(scene, cam_from_world=state.path.cam_from_world(),
                                          points=structure))
