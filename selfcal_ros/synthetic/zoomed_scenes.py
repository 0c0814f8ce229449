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
"""Sequences through a lens that zooms, refocuses or warms up, with their truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.synthetic.scenes import PointSequence
from selfcal_ros.values.tracks import Tracks


def zoomed(sequence: PointSequence, scale: np.ndarray, rng: np.random.Generator,
           noise_px: float = 0.2) -> PointSequence:
    """
    Magnify every view about the principal point.

    Parameters
    ----------
    sequence : PointSequence
        Its camera is that of a magnification of one.
    scale : ndarray, shape (V,)
        Magnification of each view.
    rng : numpy.random.Generator
    noise_px : float
        Of the images as they are then.

    Returns
    -------
    PointSequence
        With what remains inside of the image.

    """
    tracks, centre = sequence.tracks, sequence.camera.K[:2, 2]
    pixels = centre + (sequence.true_pixels - centre) * np.asarray(scale)[:, None, None]
    xy = pixels[tracks.frame, tracks.track]
    xy = xy + noise_px * rng.standard_normal(xy.shape)
    size = (sequence.camera.width, sequence.camera.height)
    kept = ((xy >= -0.5) & (xy <= np.array(size) - 0.5)).all(axis=1)
    return replace(sequence, tracks=Tracks(tracks.frame[kept], tracks.track[kept], xy[kept],
                                           tracks.image_size),
                   true_pixels=pixels, outliers=np.zeros(int(kept.sum()), bool))
