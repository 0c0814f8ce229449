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
Repeated structure: equal objects in one image are several views of one object (thesis 4.2.2).

Two equal objects that differ by a translation are a translated pair of views; a third one that
is turned against them is a rotated view. The camera is the same in all of them, so that the
affine chain applies as it stands.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.calibration.affine.affine_calibration import AffineCalibration, calibrate_affine
from selfcal_ros.calibration.affine.translation_groups import translation_groups
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.tracks import Tracks


def tracks_from_objects(objects: Sequence[ArrayLike], size: tuple[int, int] | None = None,
                        ) -> Tracks:
    """
    Tracks in which each object of one image is a frame, and each of its points a track.

    Parameters
    ----------
    objects : sequence of array_like, shape (n, 2)
        Images of corresponding points of equal objects, pixels, in the same order; NaN where a
        point is hidden.
    size : (int, int), optional
        Width and height of the image, pixels.

    Returns
    -------
    Tracks
        Any method for several views takes them.

    Raises
    ------
    InputError
        If the objects do not have equally many points.

    """
    places = [np.asarray(points, float) for points in objects]
    if len({points.shape for points in places}) != 1 or places[0].ndim != 2 \
            or places[0].shape[1] != 2:
        raise InputError('Equal objects need the same points in the same order, (n, 2) each; '
                         f'got {", ".join(str(points.shape) for points in places)}.')
    xy = np.stack(places)
    seen = np.isfinite(xy).all(axis=2)
    frame, track = np.nonzero(seen)
    return Tracks(frame, track, xy[seen], size)


def objects_from_tracks(tracks: Tracks) -> list[np.ndarray]:
    """
    Points of each object, the reverse of `tracks_from_objects`.

    Parameters
    ----------
    tracks : Tracks

    Returns
    -------
    list of ndarray, shape (n, 2)
        NaN where a point is hidden.

    """
    frames, view = np.unique(tracks.frame, return_inverse=True)
    names, point = np.unique(tracks.track, return_inverse=True)
    xy = np.full((len(frames), len(names), 2), np.nan)
    xy[view, point] = tracks.xy
    return list(xy)


def calibrate_repeated(objects: Sequence[ArrayLike], size: tuple[int, int],
                       facts: CameraFacts | None = None, translated: Sequence[int] | None = None,
                       ) -> AffineCalibration | NoEstimate:
    """
    Calibrate a camera from one image of equal objects.

    Parameters
    ----------
    objects : sequence of array_like, shape (n, 2)
        Three or more, see `tracks_from_objects`; undistorted pixels.
    size : (int, int)
        Width and height of the image, pixels.
    facts : CameraFacts, optional
        With one turned object zero skew or the aspect ratio is needed.
    translated : sequence of int, optional
        Objects that differ by translations; found from the image by default.

    Returns
    -------
    AffineCalibration or NoEstimate
        Its points are those of the first of the translated objects.

    """
    tracks = tracks_from_objects(objects, size)
    if translated is None:
        found = translation_groups(tracks, size, radial=(0.0, 0.0))
        if not found.groups:
            none = found.finding()
            assert isinstance(none, NoEstimate)
            return NoEstimate('no_translated_objects', **none.values) \
                if none.kind == 'no_translated_pair' else none
        translated = found.groups[0]
    return calibrate_affine(tracks, translated, size, facts)
