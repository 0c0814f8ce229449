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
"""Which motion a calibration rests on, and why, in a sentence."""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.rotation import rotation_vector

#: Why a motion was taken where nothing was stated.
WHY = {'planar': '; motion about one axis explains the images',
       'circular': '; motion about one axis explains the images',
       'rotation': '; one homography explains every pair of images',
       'pivot': '; a point beside the camera keeps its place in all views',
       'general': '; no planar motion explains the images'}


def motion_text(result: Calibration, asked: str) -> str:
    """
    Say which motion the calibration took, and what the recovered path shows.

    Parameters
    ----------
    result : Calibration
        With its reconstruction.
    asked : str
        Motion of the command line.

    """
    turned, off_axis = axis_spread(result.reconstructed.cam_from_world)
    leave = (f'leave their best common axis by {np.degrees(off_axis):.2g} degrees (root mean '
             'square)' if off_axis > 1e-6 else 'keep one axis')
    evidence = f'the views turn by up to {np.degrees(turned):.1f} degrees and {leave}'
    if asked == 'auto':
        how = 'found from the images'
    elif asked == result.motion:
        how = 'as stated'
    else:
        how = f'stated as {asked}'
    why = WHY.get(result.motion, '') if asked == 'auto' else ''
    if result.motion == 'rotation':
        why += '; a camera that only rotates sees no depth, so there is no structure'
    return f'Motion: {result.motion}, {how}: {evidence}{why}.'


def axis_spread(cam_from_world: np.ndarray) -> tuple[float, float]:
    """
    Measure how far views turn, and how far they leave one axis.

    Parameters
    ----------
    cam_from_world : ndarray, shape (V, 3, 4)

    Returns
    -------
    turned : float
        Largest angle against the first view, radians.
    off_axis : float
        Root mean square of the part of the rotations that is not about the axis that fits best,
        radians; zero for planar motion.

    """
    R = np.asarray(cam_from_world)[:, :, :3]
    turns = rotation_vector(np.swapaxes(R[0] @ np.swapaxes(R, 1, 2), 1, 2))
    strengths = np.linalg.svd(turns, compute_uv=False)
    return (float(np.linalg.norm(turns, axis=1).max()),
            float(np.sqrt(np.sum(strengths[1:]**2) / len(turns))))
