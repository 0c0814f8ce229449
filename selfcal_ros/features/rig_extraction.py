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
"""From the images of cameras that move together to tracks that they may share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
import itertools

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.features.at_instant import at_instant, ImagesBeside
from selfcal_ros.features.detection import detect, Features
from selfcal_ros.features.epipolar import sampler_seed
from selfcal_ros.features.extraction import finish_tracks
from selfcal_ros.features.linking import link, registered_positions
from selfcal_ros.features.mask import ImageMask
from selfcal_ros.features.matching import ImagePairMatches, match_pairs
from selfcal_ros.features.pairs import propose_pairs
from selfcal_ros.features.still_features import still_features
from selfcal_ros.findings.finding import Finding
from selfcal_ros.values.tracks import Tracks

#: Instants at which it is tried whether two cameras see the same things.
TRIED_INSTANTS = 6


@dataclass(frozen=True)
class RigExtraction:
    """
    Tracks of every camera; equal numbers in two cameras are the same point.

    Attributes
    ----------
    tracks : mapping of str to Tracks
    shared : int
        Tracks that two cameras have.
    findings : tuple of Finding

    """

    tracks: Mapping[str, Tracks]
    shared: int
    findings: tuple[Finding, ...] = ()


def extract_rig_tracks(images: Mapping[str, Sequence[np.ndarray]], frames: Sequence[int],
                       stamps_ns: Mapping[int, int] | None = None,
                       progress: Callable[[str, float], object] | None = None,
                       rng: np.random.Generator | None = None,
                       mask: ImageMask | None = None,
                       beside: Mapping[str, Sequence[ImagesBeside | None]] | None = None,
                       ) -> RigExtraction:
    """
    Match the images of cameras that move together, each camera's and those of one instant.

    Parameters
    ----------
    images : mapping of str to sequence of ndarray of uint8, shape (H, W)
        Of every camera, one an instant.
    frames : sequence of int
        Number of each instant.
    stamps_ns : mapping of int to int, optional
        When they were.
    progress : callable, optional
        Called as progress(text, done); see `extract_tracks`.
    rng : numpy.random.Generator, optional
        Source of the samples that verification draws.
    mask : ImageMask, optional
        Where the images of all cameras may be used.
    beside : mapping of str to sequence of (ImagesBeside or None), optional
        Of cameras with clocks of their own, what lies around each instant; None where the image
        is of the instant.

    Returns
    -------
    RigExtraction

    Raises
    ------
    InputError
        If the images of a camera differ in size, or a mask is of another.

    """
    seed = sampler_seed(rng)
    report = progress or (lambda text, done: None)
    sizes = {name: _one_size(name, of_camera) for name, of_camera in images.items()}
    if mask is not None:
        for width, height in sizes.values():
            mask.check((height, width))
    count = len(images)
    features: list[Features] = [None] * (count * len(frames))       # type: ignore[list-item]
    matches: list[ImagePairMatches] = []
    for k, (name, of_camera) in enumerate(images.items()):
        own = []
        for image in of_camera:
            own.append(detect(image, mask=mask))
            report(f'features of {name}', len(own))
        resting = still_features(own)
        if resting is not None:
            own = [one.select(~rests) for one, rests in zip(own, resting)]

        def matched(share: float, name: str = name) -> None:
            report(f'matching of {name}', share)

        found, *_ = match_pairs(own, propose_pairs(own), sizes[name], seed, matched)
        # instants in a row, the cameras of each beside each other
        features[k::count] = own
        matches += [ImagePairMatches(one.first * count + k, one.second * count + k, one.a, one.b,
                                     one.F, one.lens) for one in found]
    matches += _across(features, list(sizes.values()), len(frames), seed)
    image, place, track, contradictory = link(features, matches)
    findings = [Finding('tracks_contradictory', tracks=contradictory)] if contradictory else []
    report('registration', 0)
    every = [one for instant in zip(*images.values()) for one in instant]
    xy, good = registered_positions(features, every, image, place, track, matches)
    for k, name in enumerate(images):
        for i, around in enumerate((beside or {}).get(name, ())):
            if around is not None:
                rows = np.flatnonzero(image == i * count + k)
                xy[rows], between = at_instant(images[name][i], around, xy[rows])
                good[rows] &= between
    tracks = {}
    for k, name in enumerate(images):
        rows = good & (image % count == k)
        if not rows.any():
            raise InputError(f'The images of {name} show nothing that can be found again; they '
                             'must overlap and show texture.')
        linked = Tracks(np.asarray(frames)[image[rows] // count], track[rows], xy[rows],
                        sizes[name], None if stamps_ns is None else dict(stamps_ns))
        said: list[Finding] = []
        tracks[name] = _with_own_names(finish_tracks(linked, said, seed), linked,
                                       (k + 1) * 2 * (int(track.max()) + 1))
        findings += [one.of_camera(name) for one in said]
    return RigExtraction(tracks, _shared(tracks), tuple(findings))


def _with_own_names(tracks: Tracks, linked: Tracks, beyond: int) -> Tracks:
    """Give what was cut off a track a number that no other camera has."""
    fresh = ~np.isin(tracks.track, linked.track)
    return replace(tracks, track=tracks.track + beyond * fresh)


def _one_size(name: str, images: Sequence[np.ndarray]) -> tuple[int, int]:
    """Return width and height of all images of a camera."""
    shapes = {image.shape for image in images}
    if len(shapes) != 1:
        raise InputError(f'The images of {name} must all have one size; there are {len(shapes)}.')
    height, width = shapes.pop()
    return width, height


def _across(features: list[Features], sizes: list[tuple[int, int]], instants: int, seed: int,
            ) -> list[ImagePairMatches]:
    """Match the cameras at every instant, where a few show that they see the same things."""
    count, matches = len(sizes), []
    tried = np.unique(np.linspace(0, instants - 1, TRIED_INSTANTS).astype(int))
    for a, b in itertools.combinations(range(count), 2):
        if sizes[a] != sizes[b]:
            # the geometry of a pair is verified in images of one size
            continue

        def pairs(some: Iterable[int], a: int = a, b: int = b) -> list[tuple[int, int]]:
            return [(int(i) * count + a, int(i) * count + b) for i in some]

        if len(match_pairs(features, pairs(tried), sizes[a], seed)[0]) * 2 > len(tried):
            matches += match_pairs(features, pairs(range(instants)), sizes[a], seed)[0]
    return matches


def _shared(tracks: Mapping[str, Tracks]) -> int:
    """Count the tracks that two cameras have."""
    _, count = np.unique(np.concatenate([np.unique(one.track) for one in tracks.values()]),
                         return_counts=True)
    return int(np.sum(count > 1))
