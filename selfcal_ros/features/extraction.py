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
"""The way from images to tracks, by video tracking or by wide-baseline matching."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
import itertools
import os

import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.features.detection import detect, Features, most_features
from selfcal_ros.features.epipolar import sampler_seed
from selfcal_ros.features.freed_memory import return_freed_memory
from selfcal_ros.features.image_circle import within_circle
from selfcal_ros.features.klt import followed_share, KltTracker
from selfcal_ros.features.linking import link, registered_positions
from selfcal_ros.features.mask import ImageMask
from selfcal_ros.features.matching import match_pairs
from selfcal_ros.features.moving_part import MovingPart, PART_STEP
from selfcal_ros.features.pairs import propose_pairs
from selfcal_ros.features.selection import drop_static, KeyframeSelector, Verified, verify
from selfcal_ros.features.static_region import drop_static_regions
from selfcal_ros.features.still_features import still_features, without_still
from selfcal_ros.features.surplus import ENOUGH_POSITIONS, without_surplus
from selfcal_ros.features.video_curvature import KeptFrame, without_feigned_shifts
from selfcal_ros.findings.finding import Finding, sentences
from selfcal_ros.values.neighbours import Film, SeenPoints
from selfcal_ros.values.tracks import Tracks

_PROBE_FRAMES = 6
_MAX_IMAGES = 60
#: Median displacement between keyframes, as a share of the image diagonal.
_KEYFRAME_STEP = 0.03
#: Index of a frame, its grey image (H, W), and its stamp in nanoseconds.
Frame = tuple[int, np.ndarray, int]
#: What hears of the work: its text, and the number of frames or the share that is done.
Progress = Callable[[str, float], object]


@dataclass(frozen=True)
class Extraction:
    """
    Tracks and how they came about.

    Parameters
    ----------
    tracks : Tracks
        Keyframes only, with image_size and stamps_ns.
    keyframes : ndarray of int, shape (F,)
        Frame indices used.
    mode : {'video', 'wide'}
        How points were followed.
    findings : tuple of Finding
        What was dropped and why.

    """

    tracks: Tracks
    keyframes: np.ndarray
    mode: str
    findings: tuple[Finding, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings in words, one sentence each."""
        return sentences(self.findings)


def extract_tracks(frames: Iterable[Frame], mode: str = 'auto', progress: Progress | None = None,
                   max_keyframes: int = 40, rng: np.random.Generator | None = None,
                   mask: ImageMask | None = None) -> Extraction:
    """
    Find point tracks in a sequence of images.

    Parameters
    ----------
    frames : iterable of (int, ndarray of uint8 shape (H, W), int)
        Frame index, grey image and stamp in nanoseconds, in order of time; read once.
    mode : {'auto', 'video', 'wide'}
        'video' follows corners from frame to frame, 'wide' matches descriptors; 'auto' decides
        from the first frames whether corners can be followed.
    progress : callable, optional
        Called as progress(text, done), done the number of frames or the share of the matching.
    max_keyframes : int
        Upper limit of frames in the result.
    rng : numpy.random.Generator, optional
        Source of the samples that verification draws; the same seed gives the same tracks.
    mask : ImageMask, optional
        Where the images may be used; the circle of a fisheye lens narrows it by itself.

    Returns
    -------
    Extraction

    Raises
    ------
    ArgumentError
        If mode or max_keyframes is impossible.
    InputError
        If an image is not (H, W) uint8, its size changes, or the mask has another.

    """
    if mode not in ('auto', 'video', 'wide'):
        raise ArgumentError(f"mode must be 'auto', 'video' or 'wide', not {mode!r}.")
    if max_keyframes < 2:
        raise ArgumentError(f'max_keyframes must be at least 2, not {max_keyframes}.')
    seed = sampler_seed(rng)
    frames = _checked(frames, mask)
    probe = list(itertools.islice(frames, _PROBE_FRAMES))
    images = [grey for _, grey, _ in probe]
    frames = itertools.chain(probe, frames)
    mask, found = within_circle(images, mask)
    may_change = mode == 'auto'
    if may_change:
        mode, why = _choose_mode(images, mask)
        found.append(why)
    report = progress or (lambda text, done: None)
    album = _Album(max(_MAX_IMAGES, max_keyframes))
    if mode == 'video':
        remarks: list[Finding] = []
        tracks, keyframes = _video(frames, report, max_keyframes, seed, remarks, mask,
                                   album if may_change else None)
        if not album.images:
            return Extraction(tracks, keyframes, mode, (*found, *remarks))
        found.append(Finding('too_fast_to_follow'))
    else:
        album.fill(frames)
    tracks, keyframes = _wide(album, report, max_keyframes, seed, found, mask)
    return Extraction(tracks, keyframes, 'wide', tuple(found))


def _checked(frames: Iterable[Frame], mask: ImageMask | None) -> Iterator[Frame]:
    """Pass images on, and stop at the first that cannot be used."""
    size = None
    for index, grey, stamp_ns in frames:
        grey = np.asarray(grey)
        if grey.ndim != 2 or grey.dtype != np.uint8:
            raise InputError(f'Frame {index} must be a grey image of 8 bits, not '
                             f'{grey.dtype} {grey.shape}.')
        if min(grey.shape) < 64:
            raise InputError(f'Frame {index} is {grey.shape[1]}x{grey.shape[0]} pixels; at least '
                             '64x64 are needed.')
        if size is not None and grey.shape != size:
            raise InputError(f'Frame {index} is {grey.shape[1]}x{grey.shape[0]} pixels, but the '
                             f'frames before are {size[1]}x{size[0]}; calibrate one size at a '
                             'time.')
        if size is None and mask is not None:
            mask.check(grey.shape)
        size = grey.shape
        yield int(index), grey, int(stamp_ns)


def _choose_mode(images: list[np.ndarray], mask: ImageMask | None) -> tuple[str, Finding]:
    """Video where corners survive there and back and move little, otherwise wide."""
    if len(images) < _PROBE_FRAMES:
        return 'wide', Finding('few_images', images=len(images))
    shares, steps = zip(*(followed_share(a, b, mask) for a, b in zip(images, images[1:])))
    diagonal = float(np.hypot(*images[0].shape))
    share, step = float(np.median(shares)), float(np.median(steps)) / diagonal
    if not np.isfinite(step):
        return 'wide', Finding('frames_far_apart')
    mode = 'video' if share > 0.8 and step < 0.04 else 'wide'
    return mode, Finding('mode_chosen', followed=share, step=step, mode=mode)


class _Album:
    """Images of a sequence, evenly spaced and no more than there is room for."""

    def __init__(self, limit: int):
        """Start without an image."""
        self.limit = limit
        self.indices: list[int] = []
        self.images: list[np.ndarray] = []
        self.stamps: dict[int, int] = {}
        self.stride = 1
        self._count = 0

    def add(self, index: int, grey: np.ndarray, stamp_ns: int) -> None:
        """Take the next image, if it is its turn."""
        self._count += 1
        if (self._count - 1) % self.stride:
            return
        self.indices.append(index)
        self.stamps[index] = stamp_ns
        self.images.append(grey)
        if len(self.images) > self.limit:
            self.stride *= 2
            self.indices, self.images = self.indices[::2], self.images[::2]

    def fill(self, frames: Iterable[Frame]) -> None:
        """Take all images."""
        for frame in frames:
            self.add(*frame)

    def clear(self) -> None:
        """Forget the images."""
        self.indices, self.images, self.stamps = [], [], {}


def _wide(album: _Album, report: Progress, max_keyframes: int, seed: int, findings: list[Finding],
          mask: ImageMask | None) -> tuple[Tracks, np.ndarray]:
    """Match descriptors between neighbours, loop closures and look-alikes."""
    indices, stamps, images, stride = album.indices, album.stamps, album.images, album.stride
    features: list[Features] = []
    if not images:
        raise InputError('There is no image in the input.')
    if len(images) > max_keyframes:
        chosen = np.unique(np.linspace(0, len(images) - 1, max_keyframes).round().astype(int))
        indices, images = [indices[k] for k in chosen], [images[k] for k in chosen]
    if stride > 1 or len(indices) < len(stamps):
        findings.append(Finding('frames_thinned', frames=len(indices)))
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        for found in pool.map(partial(detect, most=most_features(len(images)), mask=mask), images):
            features.append(found)
            report('features', len(features))
    size = images[0].shape[::-1]
    resting = still_features(features)
    if resting is not None:
        findings.append(Finding(
            'fixed_camera_features', features=int(np.median([one.sum() for one in resting])),
            share=float(np.mean(np.concatenate(resting)))))
        features = [one.select(~rests) for one, rests in zip(features, resting)]
    matches, bend, static = match_pairs(features, propose_pairs(features), size, seed,
                                        lambda share: report('matching', share))
    features = [Features.at_places(one.xy, one.size_px) for one in features]
    return_freed_memory()
    image, place, track, contradictory = link(features, matches)
    if not bend.straight:
        findings.append(Finding('division_model', distortion=float(bend.coefficients[0])))
    if static:
        findings.append(Finding('static_matches', matches=int(static)))
    if contradictory:
        findings.append(Finding('tracks_contradictory', tracks=int(contradictory)))
    keyframes = np.array(indices)
    stamps = {index: stamps[index] for index in indices}
    if not len(image):
        return Tracks([], [], np.empty((0, 2)), size, stamps), keyframes
    enough = _enough(image, track, findings, seed)
    image, place = image[enough], place[enough]
    track = np.unique(track[enough], return_inverse=True)[1]
    report('registration', 0)
    xy, good = registered_positions(features, images, image, place, track, matches)
    findings.append(Finding('positions_unregistered', dropped=int((~good).sum()),
                            positions=len(good)))
    tracks = Tracks(keyframes[image[good]], track[good], xy[good], size, stamps)
    return finish_tracks(tracks, findings, seed), keyframes


def _video(frames: Iterable[Frame], report: Progress, max_keyframes: int, seed: int,
           findings: list[Finding], mask: ImageMask | None, album: _Album | None = None,
           ) -> tuple[Tracks, np.ndarray]:
    """
    Follow corners, keep keyframes; where there are too many, ask for more parallax.

    The album keeps images if what moves before a camera that stands could not be followed.
    """
    tracker, selector, part, stamps = KltTracker(mask=mask, renews=False), None, None, {}
    kept: list[KeptFrame] = []
    of_part: list[KeptFrame] = []
    size = None
    film, filmed = Film(), {}
    for count, (index, grey, stamp_ns) in enumerate(frames):
        ids, xy = tracker.add(grey)
        report('tracking', count + 1)
        film.add(SeenPoints(ids, xy, stamp_ns))
        if selector is None or part is None:
            size = grey.shape[::-1]
            step_px = _KEYFRAME_STEP * float(np.hypot(*size))
            selector, part = KeyframeSelector(step_px), MovingPart(PART_STEP * step_px)
        lists = [(selector, kept)] if selector.offer(ids, xy) else []
        if part.is_possible:
            lists += [(part.selector, of_part)] if part.offer(ids, xy) else []
            if album is not None:
                album.add(index, grey, stamp_ns)
        elif of_part or album is not None:
            # the camera moves: what was chosen without it is of no use
            of_part.clear()
            if album is not None:
                album.clear()
                album = None
        if not lists:
            continue
        record = KeptFrame(index, ids, xy, tracker.appearances)
        # only here: what the old templates feign is known where their geometry is
        tracker.renew()
        filmed[index] = film.keep()
        stamps[index] = stamp_ns
        for chooser, chosen in lists:
            chosen.append(record)
            if len(chosen) > max_keyframes:
                chosen[:] = chosen[::2]
                chooser.displacement_px *= 2
                chooser.lost_share = min(0.7, 1.3 * chooser.lost_share)
    if size is None or part is None:
        raise InputError('There is no image in the input.')
    if album is not None and not part.is_too_fast:
        album.clear()
    if part.stood and len(of_part) >= 3:
        kept = of_part
    keyframes = np.array([one.index for one in kept], dtype=int)
    tracks = Tracks(np.repeat(keyframes, [len(one.ids) for one in kept]),
                    np.concatenate([one.ids for one in kept] or [np.empty(0)]),
                    np.concatenate([one.xy for one in kept] or [np.empty((0, 2))]),
                    size, {index: stamps[index] for index in keyframes.tolist()},
                    np.concatenate([filmed[index].neighbours for index in keyframes.tolist()]
                                   or [np.empty((0, 2, 3))]))
    findings.append(Finding('keyframes_chosen', keyframes=len(keyframes), frames=count + 1))
    tracks = tracks.with_at_least(2)
    tracks = tracks.select(_enough(tracks.frame, tracks.track, findings, seed))
    verified = _finished(tracks, findings, seed)
    return without_feigned_shifts(verified, kept), keyframes


def _enough(image: np.ndarray, track: np.ndarray, findings: list[Finding], seed: int,
            ) -> np.ndarray:
    """Tell which positions are used, shape (N,) of bool, and say where that is not all."""
    used = without_surplus(image, track, ENOUGH_POSITIONS, np.random.default_rng(seed))
    if not used.all():
        findings.append(Finding('positions_surplus', used=int(used.sum()), positions=len(used)))
    return used


def finish_tracks(tracks: Tracks, findings: list[Finding], seed: int) -> Tracks:
    """Drop static points, then what contradicts epipolar geometry."""
    return _finished(tracks, findings, seed).tracks


def _finished(tracks: Tracks, findings: list[Finding], seed: int) -> Verified:
    """As `finish_tracks`, with the geometry that was found."""
    # what is dropped keeps its number, which another camera may have for the same point
    fresh = int(tracks.track.max(initial=-1)) + 1
    whole, told = without_still(tracks)
    findings += told
    tracks, static = drop_static(whole)
    if static:
        findings.append(Finding('static_tracks', tracks=int(static)))
    tracks, regions = drop_static_regions(whole, tracks)
    findings += regions
    verified = verify(tracks, seed=seed, fresh=fresh)
    if verified.removed:
        findings.append(Finding('positions_contradictory', positions=int(verified.removed)))
    return verified
