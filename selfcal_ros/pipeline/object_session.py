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

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.pipeline.feature_session import ExtractedTracks, tracks_of_table
from selfcal_ros.pipeline.progress import Progress
from selfcal_ros.pipeline.sources import Excerpt, FrameSource, open_source
from selfcal_ros.values.tracks import Tracks

if TYPE_CHECKING:
    from selfcal_ros.features.mask import ImageMask
    from selfcal_ros.features.targets import Board, Target

#: More views add time and little accuracy.
MAX_VIEWS = 80
#: In a video a view counts as new when the points have moved by this share of the diagonal.
NEW_VIEW_FRACTION = 0.01
#: In a video so many images are searched thoroughly at least, where a quick look shows no object.
THOROUGH_LOOKS = 120
#: Names of images without the object that the result keeps at most.
MAX_NAMES = 500

#: Identities of points (N,), and where they are in the image, (N, 2).
_Points: TypeAlias = tuple[np.ndarray, np.ndarray]
#: The frame, and the points in it.
_View: TypeAlias = tuple[int, np.ndarray, np.ndarray]


def read_object_views(path: str | Path, target: Target, topic: str | None = None,
                      max_keyframes: int | None = None, image_size: tuple[int, int] | None = None,
                      progress: Progress | None = None, mask: ImageMask | None = None,
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
        # OpenCV loads here, not where the command line starts
        from selfcal_ros.features.targets import PointList
        if isinstance(target, PointList):
            raise InputError(f'{path} holds images, in which the points of a list cannot be '
                             'found; give a table of tracks (frame,track,x,y), where track is '
                             'the number of the point.')
        seen = _search(source, target, mask, progress)
        if not seen.views:
            raise InputError(f'The object was found in none of the {seen.looked} images of '
                             f'{path}; check its numbers of columns and rows (inner corners of '
                             'a board, tags, circles, squares of a Tsai grid), and that it is '
                             'seen whole and sharp.')
        views, findings = seen.views, (*seen.findings(source.kind == 'bag'), *source.losses())
        if len(views) > most:
            views = [views[k] for k in np.linspace(0, len(views) - 1, most).astype(int)]
            findings += (Finding('views_used', views=most),)
        indices = np.concatenate([np.full(len(identity), index) for index, identity, _ in views])
        tracks = Tracks(indices, np.concatenate([identity for _, identity, _ in views]),
                        np.concatenate([xy for *_, xy in views]), source.image_size,
                        seen.stamps_ns)
        return ExtractedTracks(tracks, source.description, findings, source.clock)


@dataclass
class _Seen:
    """
    Where an object was seen in a recording, and where not.

    Attributes
    ----------
    views : list of (int, ndarray of int (n,), ndarray (n, 2))
        Frame, identities of the points, and pixels.
    stamps_ns : dict of int to int
        Of the views, by frame.
    missed : list of (str, int)
        Images without the object: name and stamp.
    looked : int
        Images that were searched.

    """

    views: list[_View] = field(default_factory=list)
    stamps_ns: dict[int, int] = field(default_factory=dict)
    missed: list[tuple[str, int]] = field(default_factory=list)
    looked: int = 0

    def findings(self, with_stamps: bool) -> tuple[Finding, ...]:
        """Tell in how many images the object was seen, and in which it was not."""
        findings: tuple[Finding, ...] = () if len(self.views) == self.looked else (
            Finding('object_seen', views=len(self.views), images=self.looked),)
        if self.missed:
            names, at = zip(*self.missed[:MAX_NAMES])
            findings += (Finding('object_not_found', count=len(self.missed), names=list(names), **(
                {'stamps_ns': list(at)} if with_stamps else {})),)
        return findings


def _search(source: FrameSource, target: Board, mask: ImageMask | None,
            progress: Progress | None) -> _Seen:
    """Look for an object in all images; of a video only views that differ are kept."""
    moving = source.kind != 'images'
    apart = max((source.count or 0) // THOROUGH_LOOKS, 1) if moving else 1
    seen = _Seen()
    last: _Points | None = None
    source.leaves_out_damaged = source.deinterlaces = True
    for frame in source:
        identity, xy = _found(target, frame.image, seen.looked % apart == 0, mask)
        seen.looked += 1
        if progress:
            progress('Looking for the object', seen.looked, source.count)
        if not len(identity):
            seen.missed.append((frame.name or f'frame {frame.index}', frame.stamp_ns))
            continue
        step_px = NEW_VIEW_FRACTION * float(np.hypot(*frame.image.shape))
        if moving and not _moved(last, (identity, xy), step_px):
            continue
        last = identity, xy
        seen.views.append((frame.index, identity, xy))
        seen.stamps_ns[frame.index] = frame.stamp_ns
    # OpenCV is loaded by now
    from selfcal_ros.features.charuco import Charuco
    if isinstance(target, Charuco) and not target.is_read_alike:
        target.settle()
        seen.views = _found_again(source, target, mask, seen, progress)
    return seen


def _found_again(source: FrameSource, target: Board, mask: ImageMask | None, seen: _Seen,
                 progress: Progress | None) -> list[_View]:
    """Find the points of all views again, now that it is known how the board was drawn."""
    again = []
    for done, frame in enumerate(source.only(index for index, *_ in seen.views), start=1):
        identity, xy = _found(target, frame.image, True, mask)
        if len(identity):
            again.append((frame.index, identity, xy))
        else:
            seen.missed.append((frame.name or f'frame {frame.index}', frame.stamp_ns))
            del seen.stamps_ns[frame.index]
        if progress:
            progress('Looking for the object again', done, len(seen.views))
    return again


def _found(target: Board, image: np.ndarray, thorough: bool, mask: ImageMask | None) -> _Points:
    """Find the points of the object whose surroundings a mask leaves."""
    if mask is None:
        return target.find(image, thorough=thorough)
    identity, xy = target.find(mask.painted(image), thorough=thorough)
    clear = mask.allows(xy)
    return identity[clear], xy[clear]


def _moved(last: _Points | None, now: _Points, step_px: float) -> bool:
    """Tell whether the points have moved since the last view."""
    if last is None:
        return True
    _, a, b = np.intersect1d(last[0], now[0], assume_unique=True, return_indices=True)
    if len(a) < len(now[0]) / 2:
        return True
    return float(np.median(np.linalg.norm(last[1][a] - now[1][b], axis=1))) > step_px
