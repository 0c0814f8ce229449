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
"""From an input that a user names to tracks: frames are read, followed and verified."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.findings.finding import Finding, sentences
from selfcal_ros.pipeline.file_sources import NOMINAL_RATE_HZ
from selfcal_ros.pipeline.frame_source import ClockName, OWN_CLOCKS
from selfcal_ros.pipeline.progress import Progress
from selfcal_ros.pipeline.sources import Excerpt, FrameSource, open_source
from selfcal_ros.values.tracks import Tracks

if TYPE_CHECKING:
    from selfcal_ros.features.mask import ImageMask

#: Frames of a table that are used by default: more cost time, and hardly lower the sigmas.
MAX_TABLE_FRAMES = 60
#: Points of a table reach beyond this share of the width or of the height.
LEAST_FILLED = 0.8
#: A larger share of the points of a table outside of its images means another size.
FEW_OUTSIDE = 0.01
#: A camera rests whose corners move by less than this share of the image diagonal.
_RESTING = 0.001
#: Displacement between keyframes as a share of the extent, and share of the tracks that may be
#: lost, each milder than the next.
_STEPS = ((0.02, 0.35), (0.04, 0.5), (0.08, 0.65), (0.12, 0.75))


@dataclass(frozen=True)
class ExtractedTracks:
    """
    Tracks of an input, and how they came about.

    Attributes
    ----------
    tracks : Tracks
    description : str
        The input in a few words.
    findings : tuple of Finding
        What a user should know.
    clock : str
        Where the stamps come from; see `FrameSource.clock`.

    """

    tracks: Tracks
    description: str
    findings: tuple[Finding, ...] = ()
    clock: ClockName = 'none'

    @property
    def stamps_ns(self) -> dict[int, int] | None:
        """When each image was taken; None where the input has no clock of its own."""
        return self.tracks.stamps_ns if self.clock in OWN_CLOCKS else None

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings in words, one sentence each."""
        return sentences(self.findings)


def tracks_of_table(source: FrameSource, mask: ImageMask | None = None,
                    max_keyframes: int | None = None) -> ExtractedTracks:
    """
    Return the tracks of a table; with a remark where nobody has told the size of the images.

    Parameters
    ----------
    source : FrameSource
    mask : ImageMask, optional
        Positions that it hides are left out.
    max_keyframes : int, optional
        Frames that are used at most; of more, those between which the points move most.

    Raises
    ------
    InputError
        If the mask has another size.

    """
    whole = whole_table(source, mask)
    frames, chosen = whole.tracks.frames, chosen_frames(whole.tracks, max_keyframes)
    if len(chosen) == len(frames):
        return whole
    return replace(whole, tracks=whole.tracks.in_frames(chosen), findings=(
        *whole.findings, Finding('keyframes_chosen', keyframes=len(chosen), frames=len(frames))))


def whole_table(source: FrameSource, mask: ImageMask | None = None) -> ExtractedTracks:
    """Return the tracks of a table in all its frames; else as `tracks_of_table`."""
    tracks = source.tracks()
    if mask is not None:
        width, height = tracks.image_size or mask.size
        mask.check((height, width))
        tracks = replace(tracks.select(mask.allows(tracks.xy, 0.0)), image_size=mask.size)
    return ExtractedTracks(tracks, source.description, _about_size(tracks))


def _about_size(tracks: Tracks) -> tuple[Finding, ...]:
    """Tell of a size of the images that is not stated, or that hardly can be."""
    if tracks.image_size is None:
        return Finding('image_size_not_stated'),
    right, bottom = tracks.xy.max(axis=0, initial=0.0)
    width, height = tracks.image_size
    outside = np.count_nonzero(((tracks.xy < -1) | (tracks.xy > (width, height))).any(axis=1))
    if outside > FEW_OUTSIDE * len(tracks):
        return Finding('points_outside', share=outside / len(tracks), width=width,
                       height=height),
    if right > LEAST_FILLED * width or bottom > LEAST_FILLED * height:
        return ()
    return Finding('image_size_doubtful', width=width, height=height, right=float(right),
                   bottom=float(bottom)),


def chosen_frames(tracks: Tracks, max_keyframes: int | None = None) -> np.ndarray:
    """Return the frames of a table that are used: where there are many, those that move most."""
    most = MAX_TABLE_FRAMES if max_keyframes is None else max_keyframes
    return tracks.frames if len(tracks.frames) <= most else _keyframes(tracks, most)


def _keyframes(tracks: Tracks, most: int) -> np.ndarray:
    """Choose so many frames at most, by how far points move from one to the next."""
    from selfcal_ros.features.selection import KeyframeSelector
    order = np.argsort(tracks.frame, kind='stable')
    frames, starts = np.unique(tracks.frame[order], return_index=True)
    rows = np.split(order, starts[1:])
    extent_px = float(np.hypot(*np.ptp(tracks.xy, axis=0)))
    kept: list[int] = []
    for step, lost in _STEPS:
        selector = KeyframeSelector(step * extent_px, lost)
        kept = [k for k, row in enumerate(rows) if selector.offer(tracks.track[row],
                                                                  tracks.xy[row])]
        if len(kept) <= most:
            return frames[kept]
    # so long a way takes more: the stretch that shows most, whose frames share points
    seen = np.cumsum([0, *(len(rows[k]) for k in kept)])
    first = int(np.argmax(seen[most:] - seen[:-most]))
    return frames[kept[first:first + most]]


def read_tracks(path: str | Path, topic: str | None = None, mode: str = 'auto',
                max_keyframes: int | None = None, image_size: tuple[int, int] | None = None,
                progress: Progress | None = None,
                mask: ImageMask | None = None, excerpt: Excerpt = Excerpt(),
                seed: int = 0) -> ExtractedTracks:
    """
    Read an input of any kind that `open_source` knows, and find point tracks in it.

    Parameters
    ----------
    path : str or Path
    topic : str, optional
        Image topic of a bag.
    mode : {'auto', 'video', 'wide'}
        How points are found again; see `selfcal_ros.features.extraction.extract_tracks`.
    max_keyframes : int, optional
        Images that the result may use at most.
    image_size : (int, int), optional
        Width and height in pixels, for tracks from a table.
    progress : callable, optional
        Called as progress(text, done, total); total is None where it is not known.
    mask : ImageMask, optional
        Where the images may be used.
    excerpt : Excerpt
        The part of the recording that is used.
    seed : int
        What is drawn at random is drawn from it.

    Returns
    -------
    ExtractedTracks

    Raises
    ------
    InputError, ArgumentError
        If the input cannot be used; the sentence says what to do.

    """
    with open_source(path, topic, image_size, excerpt=excerpt) as source:
        return tracks_of(source, mode, max_keyframes, progress, mask, seed)


def tracks_of(source: FrameSource, mode: str, max_keyframes: int | None,
              progress: Progress | None, mask: ImageMask | None, seed: int) -> ExtractedTracks:
    """Find point tracks in an input that is open; see `read_tracks`."""
    if source.kind == 'tracks':
        return tracks_of_table(source, mask, max_keyframes)
    # OpenCV loads here, not where the command line starts
    from selfcal_ros.features.extraction import extract_tracks
    total = source.count

    def report(text: str, done: float) -> None:
        # matching reports a share, reading a number of frames
        assert progress is not None
        progress(text, done, 1.0 if isinstance(done, float) else total)

    limit: dict[str, Any] = {} if max_keyframes is None else {'max_keyframes': max_keyframes}
    images = 0

    def frames() -> Iterator[tuple[int, np.ndarray, int]]:
        nonlocal images
        for frame in source:
            images += 1
            yield frame.index, frame.image, frame.stamp_ns

    found = extract_tracks(frames(), mode=mode, progress=report if progress else None, mask=mask,
                           rng=generator(seed), **limit)
    if images == 1:
        raise InputError(f'{source.path} gives one image, and a calibration needs three at '
                         'least, from different places.')
    if not len(found.tracks) and _rests(found.findings):
        still = Finding('nothing_moves', images=images)
        raise InputError(f'{source.path}: {still.clause}. {still.advice}')
    if not len(found.tracks):
        within = ', also within the mask' if mask else ''
        raise InputError(f'No point could be followed through the {images} images of '
                         f'{source.path}; they need texture and overlap{within}.')
    tracks = found.tracks
    if source.clock == 'nominal':
        tracks = tracks.unstamped(NOMINAL_RATE_HZ)
    return ExtractedTracks(tracks, source.description, (*found.findings, *source.losses()),
                           source.clock)


def _rests(findings: Sequence[Finding]) -> bool:
    """Whether corners were followed between the first images, and stayed where they were."""
    return any(finding.kind == 'mode_chosen' and finding.values['followed'] > 0.5
               and finding.values['step'] < _RESTING for finding in findings)


def generator(seed: int) -> np.random.Generator | None:
    """Return a generator of a seed; None for 0, where every step has a fixed seed of its own."""
    return np.random.default_rng(seed) if seed else None
