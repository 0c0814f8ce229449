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
"""From an input that a user names to the image points of a known object."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.pipeline.feature_session import ExtractedTracks, tracks_of_table
from selfcal_ros.pipeline.sources import Excerpt, open_source
from selfcal_ros.values.tracks import Tracks

if TYPE_CHECKING:
    from selfcal_ros.features.mask import ImageMask
    from selfcal_ros.features.targets import Target

#: More views add time and little accuracy.
MAX_VIEWS = 80
#: In a video a view counts as new when the points have moved by this share of the diagonal.
NEW_VIEW_FRACTION = 0.01
#: In a video so many images are searched thoroughly at least, where a quick look shows no object.
THOROUGH_LOOKS = 120
#: Names of images without the object that the result keeps at most.
MAX_NAMES = 500


def read_object_views(path, target: Target, topic: str | None = None,
                      max_keyframes: int | None = None,
                      image_size: tuple[int, int] | None = None,
                      progress: Callable | None = None,
                      mask: ImageMask | None = None,
                      excerpt: Excerpt = Excerpt()) -> ExtractedTracks:
    """
    Find a known object in an input of any kind that `open_source` knows.

    Parameters
    ----------
    path, topic, image_size, progress, excerpt
        See `selfcal_ros.pipeline.feature_session.read_tracks`. Tracks are taken as they are;
        their track numbers are those of the object's points.
    target : Chessboard, Charuco, AprilGrid, CirclesGrid, TsaiGrid or PointList
    max_keyframes : int, optional
        Views that the result may use at most.
    mask : ImageMask, optional
        Where the images may be used; the object is not looked for elsewhere.

    Returns
    -------
    ExtractedTracks
        Tracks whose identities are those of `target.known`.

    Raises
    ------
    InputError, ArgumentError
        If the input cannot be used, or shows no object; the sentence says what to do.

    """
    most = MAX_VIEWS if max_keyframes is None else max_keyframes
    with open_source(path, topic, image_size, excerpt=excerpt) as source:
        if source.kind == 'tracks':
            return tracks_of_table(source, mask, max_keyframes)
        if target.find is None:
            raise InputError(f'{path} holds images, in which the points of a list cannot be '
                             'found; give a table of tracks (frame,track,x,y), where track is '
                             'the number of the point.')
        moving = source.kind != 'images'
        apart = max((source.count or 0) // THOROUGH_LOOKS, 1) if moving else 1
        views, stamps, missed, looked, last = [], {}, [], 0, None
        source.leaves_out_damaged = True
        for frame in source:
            identity, xy = _found(target, frame.image, looked % apart == 0, mask)
            looked += 1
            if progress:
                progress('Looking for the object', looked, source.count)
            if not len(identity):
                missed.append((frame.name or f'frame {frame.index}', frame.stamp_ns))
            step = NEW_VIEW_FRACTION * float(np.hypot(*frame.image.shape))
            if not len(identity) or moving and not _moved(last, (identity, xy), step):
                continue
            last = identity, xy
            views.append((frame.index, identity, xy))
            stamps[frame.index] = frame.stamp_ns
        if not views:
            raise InputError(f'The object was found in none of the {looked} images of {path}; '
                             'check its numbers of columns and rows (inner corners of a board, '
                             'tags, circles, squares of a Tsai grid), and that it is seen whole '
                             'and sharp.')
        findings: tuple[Finding, ...] = () if len(views) == looked else (
            Finding('object_seen', views=len(views), images=looked),)
        findings += source.losses()
        if missed:
            names, at = zip(*missed[:MAX_NAMES])
            findings += (Finding('object_not_found', count=len(missed), names=list(names), **(
                {'stamps_ns': list(at)} if source.kind == 'bag' else {})),)
        if len(views) > most:
            views = [views[k] for k in np.linspace(0, len(views) - 1, most).astype(int)]
            findings += (Finding('views_used', views=most),)
        indices = np.concatenate([np.full(len(identity), index) for index, identity, _ in views])
        tracks = Tracks(indices, np.concatenate([identity for _, identity, _ in views]),
                        np.concatenate([xy for *_, xy in views]), source.image_size, stamps)
        return ExtractedTracks(tracks, source.description, findings, source.clock)


def _found(target, image, thorough: bool, mask: ImageMask | None):
    """Find the points of the object whose surroundings a mask leaves."""
    if mask is None:
        return target.find(image, thorough=thorough)
    identity, xy = target.find(mask.painted(image), thorough=thorough)
    clear = mask.allows(xy)
    return identity[clear], xy[clear]


def _moved(last, now, step_px: float) -> bool:
    """Tell whether the points have moved since the last view."""
    if last is None:
        return True
    _, a, b = np.intersect1d(last[0], now[0], assume_unique=True, return_indices=True)
    if len(a) < len(now[0]) / 2:
        return True
    return float(np.median(np.linalg.norm(last[1][a] - now[1][b], axis=1))) > step_px
