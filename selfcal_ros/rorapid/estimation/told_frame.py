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
"""What the tracker says of an image: states of the object's middle become poses of its frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.rorapid.edges.control_points import ControlModel
from selfcal_ros.rorapid.estimation.filter_start import TURN_LAST
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.projection.motion_models import recentring
from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState

#: What a frame has for each place in the image.
_OF_PLACES = ('image_px', 'normal', 'edge_px', 'found', 'rejected', 'hidden', 'primitive',
              'texture_px')


def told_frame(control: ControlModel, measured: PoseMeasurement, state: ObjectPose,
               covariance: np.ndarray, accepted: bool, *, doubted: np.ndarray, shown: bool,
               told: TrackerState, reason: str, doubt: str, innovation: float,
               stamp_ns: int | None) -> TrackedFrame:
    """
    Put a result into the object's own frame.

    Parameters
    ----------
    control : ControlModel
    measured : PoseMeasurement
    state : ObjectPose
        Of the object's middle.
    covariance : ndarray, shape (size, size)
        Of a correction of it, (theta, Delta) first.
    accepted : bool
        The measurement confirms the state.
    doubted : ndarray, shape (6, 6)
        What a doubt adds to the covariance of (theta, Delta), whatever the camera model.
    shown : bool
        Its places in the image mean something: those of an object that was never seen do not.
    told, reason, doubt, innovation, stamp_ns
        See `TrackedFrame`.

    Returns
    -------
    TrackedFrame

    """
    projection = control.projection
    arm = state.rotation @ control.centre
    carry = recentring(arm)
    pose = carry @ (projection.covariance_of_pose(state, covariance) + doubted) @ carry.T
    view = measured.view
    if not (accepted and measured.with_prior):
        view = control.again(view, state)
    edge = measured.edge_px
    found = measured.found & accepted
    rms = float(np.sqrt(np.mean(edge[found]**2))) if found.any() else float('nan')
    focal = float(projection.camera.K[0, 0] * state.zoom)
    sigma = focal * float(np.sqrt(covariance[6, 6])) if len(covariance) == 7 else 0.0
    frame = TrackedFrame(
        state=told, reason=reason, rotation=state.rotation, translation=state.translation - arm,
        covariance=pose[TURN_LAST], focal_px=focal, focal_sigma_px=sigma,
        camera_model=projection.model, image_px=view.projected.pixels, normal=view.normal,
        edge_px=edge, found=found, rejected=np.isfinite(edge) & ~found, hidden=~view.searched,
        primitive=view.primitive, texture_px=measured.texture_px, rms_px=rms,
        share_found=measured.share, innovation=innovation, stamp_ns=stamp_ns, doubt=doubt)
    return frame if shown else replace(frame, **{name: getattr(frame, name)[:0]
                                                 for name in _OF_PLACES})
