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
"""What the diagnostics say of the tracking."""

from __future__ import annotations

from typing import Any

from msg_adapters.diagnostics import ERROR, OK, STALE, WARN
import numpy as np

from selfcal_ros.nodes.tracking_worker import ObjectInImage
from selfcal_ros.rorapid.tracked_frame import TrackerState

_LEVELS = {TrackerState.INITIALISING: WARN, TrackerState.TRACKING: OK,
           TrackerState.DEGRADED: WARN, TrackerState.LOST: ERROR}


def tracking_status(newest: ObjectInImage | None, camera_problem: str, dropped: int,
                    silent_s: float) -> tuple[int, str, dict[str, Any]]:
    """
    Describe how the tracking goes.

    Parameters
    ----------
    newest : ObjectInImage or None
    camera_problem : str
        Why the last camera_info could not be used.
    dropped : int
        Images that were overtaken.
    silent_s : float
        For how long no image has come, where that is too long.

    Returns
    -------
    level : OK, WARN, ERROR or STALE
    text : str
    values : dict

    """
    values: dict[str, Any] = {'images dropped': dropped}
    if newest is None:
        level, text = WARN, 'no image has been tracked yet'
    else:
        level, text = _describe(newest, values)
    if camera_problem:
        level, text = max(level, WARN), f'{camera_problem} {text}'
    if silent_s:
        level, text = STALE, f'no images for {silent_s:.0f} s; {text}'
    return level, text, values


def _describe(newest: ObjectInImage, values: dict[str, Any]) -> tuple[int, str]:
    """Put what the newest image gave into values; returns level and text."""
    snapshot, tracked = newest.snapshot, newest.tracked
    values.update({'images': snapshot.images, 'losses': snapshot.losses,
                   'resets': snapshot.resets, 'ms an image': 1000 * newest.seconds})
    values.update({f'images {state}': count for state, count in snapshot.by_state.items()})
    if tracked is None:
        return WARN if snapshot.waiting_for else ERROR, newest.problem
    values['state'] = tracked.state.value
    values['camera model'] = tracked.camera_model
    values['share found'] = float(tracked.share_found)
    if tracked.state is not TrackerState.LOST:
        sigma = np.sqrt(np.diag(tracked.covariance))
        values['reprojection rms px'] = float(tracked.rms_px)
        values['position sigma m'] = float(np.linalg.norm(sigma[:3]))
        values['rotation sigma rad'] = float(np.linalg.norm(sigma[3:]))
        values.update({f'seen by {name}': sees for name, sees in newest.sees.items()})
        # one camera cannot tell a larger object farther away; no sigma of a pose holds that
        values['size of the object'] = (
            'held against the distances between the cameras' if sum(newest.sees.values()) > 1
            else 'as the model says; not seen by one camera')
        values['focal length px'] = float(tracked.focal_px)
        values['focal length sigma px'] = float(tracked.focal_sigma_px)
    level, text = _LEVELS[tracked.state], tracked.reason or tracked.state.value
    # the image of another camera could not be used
    return (max(level, WARN), f'{newest.problem} {text}') if newest.problem else (level, text)
