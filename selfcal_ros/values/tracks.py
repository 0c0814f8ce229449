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
"""Point tracks: the one thing that calibration needs from images."""

from __future__ import annotations

from collections.abc import Iterable
import csv
from dataclasses import dataclass, replace
from functools import cached_property
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import InputError
from selfcal_ros.values.whole_numbers import whole_numbers

#: No image is wider; a position beyond it is no pixel.
LARGEST_PX = 1e6


def of_longest(view: np.ndarray, point: np.ndarray, per_view: int) -> np.ndarray:
    """
    Mark the observations of the longest tracks, so many in every view.

    Parameters
    ----------
    view, point : ndarray of int, shape (N,)
        Indices from zero.
    per_view : int

    Returns
    -------
    ndarray of bool, shape (N,)

    """
    length = np.bincount(point)[point]
    order = np.lexsort((point, -length, view))
    ordered = view[order]
    rank = np.arange(len(order)) - np.searchsorted(ordered, ordered)
    chosen = np.zeros(int(point.max(initial=-1)) + 1, dtype=bool)
    chosen[point[order[rank < per_view]]] = True
    longest: np.ndarray = chosen[point]
    return longest


def _size(size: Iterable[float]) -> tuple[int, int]:
    """Return width and height; InputError where they are none."""
    try:
        width, height = (int(side) for side in size)
    except (TypeError, ValueError, OverflowError):
        width = height = 0
    if not 0 < min(width, height) <= max(width, height) <= LARGEST_PX:
        raise InputError(f'The image size must be a positive width and height, not {size!r:.40}.')
    return width, height


@dataclass(frozen=True)
class Tracks:
    """
    Image positions of scene points over frames, one row an observation.

    Parameters
    ----------
    frame : array_like of int, shape (N,)
        Frame index of each observation.
    track : array_like of int, shape (N,)
        Identity of the scene point; (frame, track) pairs are unique.
    xy : array_like of float, shape (N, 2)
        Pixels, (0, 0) at the centre of the top-left pixel.
    image_size : (int, int), optional
        Width and height in pixels.
    stamps_ns : dict of int to int, optional
        Acquisition time of each frame index.
    neighbours : ndarray, shape (N, 2, 3), optional
        Of a video: pixels of the point in the images just before and after, and seconds from
        here to there; NaN where it was not followed. They tell how fast the camera moves.

    Raises
    ------
    InputError
        If shapes differ, a value is not finite, or a (frame, track) pair occurs twice.

    Examples
    --------
    >>> from selfcal_ros import Tracks
    >>> tracks = Tracks(frame=[0, 0, 1, 1], track=[7, 8, 7, 8],
    ...                 xy=[(10, 20), (30, 40), (12, 20), (33, 40)], image_size=(640, 480))
    >>> points, before, after = tracks.matches(0, 1)
    >>> points
    array([7, 8])
    >>> after - before
    array([[2., 0.],
           [3., 0.]])

    """

    frame: np.ndarray
    track: np.ndarray
    xy: np.ndarray
    image_size: tuple[int, int] | None = None
    stamps_ns: dict[int, int] | None = None
    neighbours: np.ndarray | None = None

    if TYPE_CHECKING:
        # what may be given; the fields say what is kept
        def __init__(self, frame: ArrayLike, track: ArrayLike, xy: ArrayLike,
                     image_size: tuple[int, int] | None = None,
                     stamps_ns: dict[int, int] | None = None,
                     neighbours: np.ndarray | None = None) -> None: ...

    def __post_init__(self) -> None:
        """Check the rows and sort them by track, then frame."""
        frame = whole_numbers(self.frame, 'frames of tracks')
        track = whole_numbers(self.track, 'numbers of tracks')
        try:
            xy = np.asarray(self.xy, dtype=float)
        except (TypeError, ValueError):
            raise InputError('The positions xy of tracks must be numbers.') from None
        if xy.ndim != 2 or xy.shape[1] != 2 or not frame.size == track.size == len(xy):
            raise InputError('Tracks need frame (N,), track (N,) and xy (N, 2) of one length; got '
                             f'{frame.shape}, {track.shape} and {xy.shape}.')
        if not np.isfinite(xy).all():
            bad = int(np.flatnonzero(~np.isfinite(xy).all(axis=1))[0])
            raise InputError(f'Track observation {bad} (frame {frame[bad]}, track {track[bad]}) '
                             'is not finite; remove such rows.')
        if len(xy) and np.abs(xy).max() > LARGEST_PX:
            bad = int(np.argmax(np.abs(xy).max(axis=1)))
            raise InputError(f'Track observation {bad} (frame {frame[bad]}, track {track[bad]}) '
                             f'is {np.abs(xy[bad]).max():.3g} pixels off the image; remove such '
                             'rows.')
        order = np.lexsort((frame, track))
        frame, track, xy = frame[order], track[order], np.ascontiguousarray(xy[order])
        twice = (np.diff(frame) == 0) & (np.diff(track) == 0)
        if twice.any():
            k = int(np.flatnonzero(twice)[0])
            raise InputError(f'Track {track[k]} has two observations in frame {frame[k]}; '
                             'keep one.')
        size = self.image_size
        if size is not None:
            size = _size(size)
        if self.neighbours is not None:
            beside = np.asarray(self.neighbours, float)
            if beside.shape != (len(order), 2, 3):
                raise InputError(f'Neighbours of {len(order)} observations need the shape '
                                 f'({len(order)}, 2, 3), not {beside.shape}.')
            beside = beside[order]
            beside.flags.writeable = False
            object.__setattr__(self, 'neighbours', beside)
        for array in (frame, track, xy):
            array.flags.writeable = False
        object.__setattr__(self, 'frame', frame)
        object.__setattr__(self, 'track', track)
        object.__setattr__(self, 'xy', xy)
        object.__setattr__(self, 'image_size', size)

    def __len__(self) -> int:
        """Count the observations."""
        return len(self.frame)

    @property
    def frames(self) -> np.ndarray:
        """Frame indices that occur, ascending."""
        return np.unique(self.frame)

    def select(self, mask: np.ndarray) -> Tracks:
        """Keep the observations where mask (N,) is true."""
        return Tracks(self.frame[mask], self.track[mask], self.xy[mask], self.image_size,
                      self.stamps_ns, None if self.neighbours is None else self.neighbours[mask])

    def unstamped(self, rate_hz: float) -> Tracks:
        """Drop stamps that were made up at a rate; neighbours are then so many frames away."""
        beside = None if self.neighbours is None else self.neighbours * [1, 1, rate_hz]
        return replace(self, stamps_ns=None, neighbours=beside)

    def in_frames(self, frames: Iterable[int]) -> Tracks:
        """Keep the observations of the given frames."""
        return self.select(np.isin(self.frame, np.asarray(list(frames))))

    def with_at_least(self, views: int) -> Tracks:
        """Keep the tracks that have at least so many observations."""
        _, inverse, counts = np.unique(self.track, return_inverse=True, return_counts=True)
        return self.select(counts[inverse] >= views)

    def narrowest_px(self) -> np.ndarray:
        """Root mean square distance of each frame's points from the line nearest them, (V,)."""
        _, view, count = np.unique(self.frame, return_inverse=True, return_counts=True)

        def mean(values: np.ndarray) -> np.ndarray:
            total: np.ndarray = np.bincount(view, values) / count
            return total

        x, y = (self.xy - np.column_stack([mean(axis) for axis in self.xy.T])[view]).T
        along, across, both = mean(x * x), mean(y * y), mean(x * y)
        least = (along + across) / 2 - np.hypot((along - across) / 2, both)
        narrowest: np.ndarray = np.sqrt(np.maximum(least, 0))
        return narrowest

    def longest(self, per_view: int) -> Tracks:
        """Keep the longest tracks, so many in every view; whole, wherever they are seen."""
        view = np.unique(self.frame, return_inverse=True)[1]
        point = np.unique(self.track, return_inverse=True)[1]
        return self.select(of_longest(view, point, per_view))

    def thinned(self, per_view: int) -> Tracks:
        """Keep every second track, or every third and so on, so that so many a view are left."""
        point = np.unique(self.track, return_inverse=True)[1]
        every = len(self) // (per_view * max(len(self.frames), 1))
        return self.select(point % every == 0) if every > 1 else self

    def __getstate__(self) -> dict[str, object]:
        """Leave out what is found again, for who sends tracks to another process."""
        return {name: value for name, value in vars(self).items() if name != '_rows'}

    @cached_property
    def _rows(self) -> dict[int, np.ndarray]:
        """Which observations are of each frame: pairs of frames are asked for by thousands."""
        order = np.argsort(self.frame, kind='stable')
        frames, first = np.unique(self.frame[order], return_index=True)
        return dict(zip(frames.tolist(), np.split(order, first[1:])))

    def matches(self, frame_a: int, frame_b: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return the points seen in both frames.

        Returns
        -------
        track : ndarray of int, shape (M,)
        xy_a, xy_b : ndarray, shape (M, 2)

        """
        none = np.zeros(0, int)
        in_a, in_b = (self._rows.get(int(frame), none) for frame in (frame_a, frame_b))
        track, a, b = np.intersect1d(self.track[in_a], self.track[in_b], assume_unique=True,
                                     return_indices=True)
        return track, self.xy[in_a[a]], self.xy[in_b[b]]

    @classmethod
    def from_csv(cls, path: str | Path, image_size: tuple[int, int] | None = None) -> Tracks:
        """
        Read a CSV file with the columns frame, track, x, y.

        Raises
        ------
        InputError
            If the header or a row is wrong; the sentence names the line.

        """
        path = Path(path)
        rows = []
        with path.open(newline='', encoding='utf-8-sig', errors='replace') as stream:
            reader = csv.reader(stream)
            header = [name.strip().lower() for name in next(reader, [])]
            if header[:4] != ['frame', 'track', 'x', 'y']:
                raise InputError(f'{path} must start with the columns frame,track,x,y, '
                                 f'not {",".join(header)[:80]!r}.')
            for line, row in enumerate(reader, start=2):
                if not row:
                    continue
                try:
                    rows.append((int(row[0]), int(row[1]), float(row[2]), float(row[3])))
                except (ValueError, IndexError):
                    raise InputError(f'{path}, line {line}: expected frame,track,x,y as two '
                                     f'integers and two numbers, not {",".join(row)[:80]!r}.'
                                     ) from None
                if not (np.isfinite(rows[-1][2]) and np.isfinite(rows[-1][3])):
                    raise InputError(f'{path}, line {line}: the position is not finite; '
                                     'remove the row.')
        if not rows:
            raise InputError(f'{path} holds no observations.')
        frame, track, x, y = zip(*rows)
        return cls(np.array(frame), np.array(track), np.column_stack([x, y]), image_size)

    def to_csv(self, path: str | Path) -> None:
        """Write the columns frame, track, x, y; the file appears whole or not at all."""
        path = Path(path)
        temporary = path.with_name(path.name + '.part')
        try:
            with temporary.open('w', newline='', encoding='utf-8') as stream:
                writer = csv.writer(stream)
                writer.writerow(['frame', 'track', 'x', 'y'])
                for frame, track, (x, y) in zip(self.frame, self.track, self.xy):
                    writer.writerow([int(frame), int(track), repr(float(x)), repr(float(y))])
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
