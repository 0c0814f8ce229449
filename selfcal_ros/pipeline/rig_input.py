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
"""From the inputs of cameras that move together to their calibration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import reduce
import itertools
from pathlib import Path
import re
from typing import TYPE_CHECKING

import numpy as np

from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.calibration.rigs.result import RigCalibration
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.pipeline.bag_source import COMPRESSED, image_topics, is_bag
from selfcal_ros.pipeline.calibrate_input import CalibrationSettings
from selfcal_ros.pipeline.excerpt import Half
from selfcal_ros.pipeline.feature_session import (chosen_frames, ExtractedTracks, generator,
                                                  whole_table)
from selfcal_ros.pipeline.frame_source import ClockName
from selfcal_ros.pipeline.progress import Progress
from selfcal_ros.pipeline.rig_instants import at_instants, AtInstants
from selfcal_ros.pipeline.simultaneous import SAME_NS
from selfcal_ros.pipeline.sources import FrameSource, open_source
from selfcal_ros.values.tracks import Tracks

if TYPE_CHECKING:
    from selfcal_ros.features.mask import ImageMask

#: Instants that are used unless somebody says how many.
USUAL_INSTANTS = 40
#: Halves of an image that make a pair.
_PAIRS: tuple[tuple[Half, Half], ...] = (('left', 'right'), ('top', 'bottom'))
#: Fewer instants are no recording.
MIN_INSTANTS = 4


@dataclass(frozen=True)
class RigInput:
    """One camera of a rig: its name, and where its images are, or a half of each."""

    name: str
    path: str
    topic: str | None = None
    half: Half | None = None


@dataclass(frozen=True)
class RigReading:
    """
    Tracks of all cameras, and how they came about.

    Attributes
    ----------
    tracks : dict of str to Tracks
    shared : bool
        Whether equal numbers in two cameras are the same point.
    description : str
    findings : tuple of Finding
    topics : dict of str to str
    clock : str
        Where the stamps come from; see `FrameSource.clock`.

    """

    tracks: dict[str, Tracks]
    shared: bool
    description: str
    findings: tuple[Finding, ...]
    topics: dict[str, str]
    clock: ClockName = 'none'


def rig_inputs(paths: Sequence[str], cameras: str) -> list[RigInput]:
    """
    Tell which camera has which images.

    Parameters
    ----------
    paths : sequence of str
        One an input for every camera, a single bag, or a folder with one folder a camera. Or a
        recording whose images hold two views.
    cameras : str
        Names, separated by commas: 'left,right'; for a bag topics, or names that occur in them.
        'left=/front/image_raw' gives a topic a name, and 'left=cam0' a folder. Of two views in
        one image 'left,right' or 'top,bottom'.

    Raises
    ------
    ArgumentError, InputError
        If names and inputs do not fit together.

    """
    words = [word.strip() for word in cameras.split(',')]
    if len(words) < 2 or not all(words):
        raise ArgumentError('--cameras takes the names of two or more cameras, separated by '
                            'commas, such as left,right.')
    if len(paths) == 1:
        found = (_in_folder(paths[0], words) or _of_halves(paths[0], words)
                 or _of_bag(paths[0], words))
    elif len(paths) == len(words):
        parts = [word.partition('=') for word in words]
        found = [RigInput(name, path, topic or None)
                 for (name, _, topic), path in zip(parts, paths)]
    else:
        raise ArgumentError(f'--cameras names {len(words)} cameras, but there are {len(paths)} '
                            'INPUTs; give one for each, or a single bag that holds all.')
    for one in found:
        if not re.fullmatch(r'[A-Za-z0-9_]+', one.name):
            raise ArgumentError(f'The name {one.name!r:.60} of a camera is impossible; use '
                                'letters, digits and underscores.')
    if len({one.name for one in found}) < len(found):
        raise ArgumentError('Two cameras have the same name; give them names, such as '
                            'left=/one/image_raw,right=/two/image_raw.')
    if len({(Path(one.path).resolve(), (one.topic or '').removesuffix(COMPRESSED), one.half)
            for one in found}) < len(found):
        raise ArgumentError('Two cameras have the same images; give each camera its own INPUT '
                            'or topic.')
    return found


def _in_folder(path: str, words: list[str]) -> list[RigInput]:
    """Find a folder of images for each camera; none unless all are there."""
    if is_bag(Path(path)) or any('/' in word for word in words):
        return []
    places = [(name, Path(path) / (folder or name))
              for name, _, folder in (word.partition('=') for word in words)]
    return ([RigInput(name, str(place)) for name, place in places]
            if all(place.is_dir() for _, place in places) else [])


def _of_halves(path: str, words: list[str]) -> list[RigInput]:
    """Take two halves of each image; none where they are not named, or cameras have their own."""
    halves = next((pair for pair in _PAIRS if sorted(pair) == sorted(words)), ())
    if not halves or not Path(path).exists() or Path(path).suffix.lower() == '.csv':
        return []
    topics = list(image_topics(Path(path))) if is_bag(Path(path)) else ['']
    # a topic of the left camera alone has no halves: the right one was not recorded
    if len(topics) != 1 or set(words) & set(topics[0].split('/')):
        return []
    return [RigInput(half, path, half=half) for half in sorted(halves, key=words.index)]


def _of_bag(path: str, words: list[str]) -> list[RigInput]:
    """Find the topics of a bag that cameras are named by."""
    if not is_bag(Path(path)):
        if not Path(path).exists():
            raise ArgumentError(f'{path} does not exist, so it is no bag and holds no folder for '
                                'each camera of --cameras; check the path.')
        raise ArgumentError(f'{path} is no bag, and holds no folder for each camera of '
                            '--cameras: give one INPUT for each, or left,right or top,bottom '
                            'for the halves of each image.')
    topics = image_topics(Path(path))
    found = []
    for word in words:
        name, equals, topic = word.rpartition('=')
        if not equals and '/' not in topic:
            fits = [one for one in topics if topic in one.split('/')]
            if len(fits) != 1:
                raise InputError(f'{path} has {len(fits) or "no"} image topics of a camera '
                                 f'{topic}; its image topics are {", ".join(topics)}.')
            name, topic = topic, fits[0]
        found.append([name, topic])
    parts = [topic.strip('/').split('/') for _, topic in found]
    for words_here in itertools.zip_longest(*parts, fillvalue=''):
        # the first part of the topics that tells them apart is a name
        if len(set(words_here)) == len(found):
            found = [[name or word, topic] for (name, topic), word in zip(found, words_here)]
            break
    return [RigInput(name or re.sub(r'\W+', '_', topic).strip('_'), path, topic)
            for name, topic in found]


def calibrate_rig_input(inputs: Sequence[RigInput], settings: CalibrationSettings,
                        baseline: tuple[float, float] | None = None,
                        progress: Progress | None = None,
                        ) -> tuple[RigCalibration | NotCalibrated, RigReading]:
    """
    Read the images of cameras that move together, and calibrate them.

    Parameters
    ----------
    inputs : sequence of RigInput
    settings : CalibrationSettings
        Of all cameras; a robot tells where the first one sits on it, and the scale.
    baseline : (float, float), optional
        Distance of the first two cameras and its sigma, metres.
    progress : callable, optional
        Called as progress(text, done, total).

    Returns
    -------
    RigCalibration or NotCalibrated
    RigReading

    Raises
    ------
    InputError, ArgumentError
        If an input cannot be used.

    """
    from selfcal_ros.calibration.rigs.rig_calibration import calibrate_rig
    first, robot = inputs[0], None
    if settings.robot is not None:
        from selfcal_ros.pipeline.robot.robot_mount import read_robot
        robot = read_robot(first.path, settings.robot, settings.mount_facts, topic=first.topic,
                           image_size=settings.image_size, excerpt=settings.excerpt)
    with ExitStack() as stack:
        sources = [stack.enter_context(open_source(
            one.path, one.topic, settings.image_size,
            excerpt=replace(settings.excerpt, half=one.half or settings.excerpt.half)))
            for one in inputs]
        reading = _read(inputs, sources, settings, progress)
    result = calibrate_rig(reading.tracks, shared_tracks=reading.shared, motion=settings.motion,
                           facts=settings.facts, baseline=baseline,
                           rng=generator(settings.seed), progress=progress)
    if robot is not None and isinstance(result, RigCalibration):
        from selfcal_ros.calibration.rigs.on_robot import on_robot
        of_first = ExtractedTracks(reading.tracks[first.name], reading.description,
                                   reading.findings, reading.clock)
        result = on_robot(result, robot.mounted(result.cameras[first.name], of_first, progress))
    return replace(result, findings=(*reading.findings, *result.findings)), reading


def _read(inputs: Sequence[RigInput], sources: list[FrameSource], settings: CalibrationSettings,
          progress: Progress | None) -> RigReading:
    """Find the tracks of all cameras."""
    description = '; '.join(f'{one.name}: {source.description}'
                            for one, source in zip(inputs, sources))
    topics = {one.name: source.topic for one, source in zip(inputs, sources)}
    kinds = {source.kind for source in sources}
    for source in sources:
        if source.image_size is not None:
            settings.facts.check_for(source.image_size)
    mask = None
    if settings.mask is not None:
        from selfcal_ros.features.mask import read_mask
        mask = read_mask(settings.mask)
    if kinds == {'tracks'}:
        tracks, findings = _of_tables([whole_table(source, mask) for source in sources],
                                      settings.max_keyframes)
        return RigReading({one.name: table for one, table in zip(inputs, tracks)}, False,
                          description, findings, topics)
    if 'tracks' in kinds:
        raise InputError('Give the images of all cameras, or tables of tracks of all.')
    from selfcal_ros.features.rig_extraction import extract_rig_tracks
    chosen = _keyframes(inputs[0].name, sources[0], settings, progress, mask)
    first = {frame.index: frame.image for frame in sources[0].only(chosen)}
    timed = all(source.clock != 'nominal' for source in sources)
    found = [AtInstants(first, {}, 0.0)]
    for one, source in zip(inputs[1:], sources[1:]):
        if progress:
            progress(f'reading {one.name}', 0, None)
        found.append(at_instants(source, chosen, sources[0].count, timed))
    frames = sorted(set.intersection(*(set(one.images) for one in found)))
    if len(frames) < MIN_INSTANTS:
        far = [f'the nearest of {one.name} are {at.apart_ms:.3g} ms away (median)'
               for one, at in zip(inputs, found) if at.apart_ms > SAME_NS / 1e6]
        raise InputError(f'Only {len(frames)} images of {inputs[0].name} have one of the same '
                         f'instant in every other camera{": " if far else ""}{", ".join(far)}; '
                         'trigger the cameras together, or check their stamps.')

    def report(text: str, done: float) -> None:
        assert progress is not None
        total = 1.0 if isinstance(done, float) else len(frames)
        progress(text, done, total)

    extracted = extract_rig_tracks(
        {one.name: [at.images[frame] for frame in frames] for one, at in zip(inputs, found)},
        frames,
        {frame: chosen[frame][0] for frame in frames} if sources[0].clock != 'nominal' else None,
        progress=report if progress else None, mask=mask, rng=generator(settings.seed),
        beside={one.name: [at.beside.get(frame) for frame in frames]
                for one, at in zip(inputs, found) if at.own_clock})
    apart = tuple(Finding('rig_own_clock', camera=one.name, first=inputs[0].name,
                          apart_ms=at.apart_ms)
                  for one, at in zip(inputs, found) if at.own_clock)
    return RigReading(dict(extracted.tracks), extracted.shared > 0, description,
                      extracted.findings + apart + _halved(inputs), topics, sources[0].clock)


def _halved(inputs: Sequence[RigInput]) -> tuple[Finding, ...]:
    """Tell of images that hold the views of two cameras."""
    halves = [one.half for one in inputs if one.half]
    return (Finding('images_halved', first=halves[0], second=halves[1]),) if halves else ()


def _of_tables(tables: Sequence[ExtractedTracks], max_keyframes: int | None,
               ) -> tuple[list[Tracks], tuple[Finding, ...]]:
    """Choose the same frames of all tables, of those that all have."""
    findings = next((table.findings for table in tables if table.findings), ())
    tracks = [table.tracks for table in tables]
    common = reduce(np.intersect1d, (one.frames for one in tracks))
    chosen = chosen_frames(tracks[0].in_frames(common), max_keyframes)
    if len(chosen) == len(common):
        return tracks, findings
    return [one.in_frames(chosen) for one in tracks], (*findings, Finding(
        'keyframes_chosen', keyframes=len(chosen), frames=len(common)))


def _keyframes(name: str, source: FrameSource, settings: CalibrationSettings,
               progress: Progress | None, mask: ImageMask | None) -> dict[int, tuple[int, str]]:
    """Choose images of the first camera; stamp and name of each, by index."""
    from selfcal_ros.features.extraction import extract_tracks
    most = settings.max_keyframes or USUAL_INSTANTS
    seen: dict[int, tuple[int, str]] = {}

    def frames() -> Iterator[tuple[int, np.ndarray, int]]:
        for frame in source:
            seen[frame.index] = frame.stamp_ns, frame.name
            yield frame.index, frame.image, frame.stamp_ns

    total = source.count
    if total is not None and total <= 1.5 * most or settings.mode == 'wide':
        for _ in frames():
            pass
        indices = list(seen)
        if len(indices) > 1.5 * most:
            indices = [indices[k] for k in np.unique(
                np.linspace(0, len(indices) - 1, most).round().astype(int))]
    else:
        # followed from image to image, so that neighbours have enough in common
        indices = extract_tracks(
            frames(), mode='video', max_keyframes=most, mask=mask, rng=generator(settings.seed),
            progress=None if progress is None else lambda text, done: progress(
                f'{text} of {name}', done, total),
            ).keyframes.tolist()
    return {index: seen[index] for index in indices}
