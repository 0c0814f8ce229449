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
Many recordings: one calibration each, and one joint calibration for each camera among them.

Cameras are told apart by image topic and image size. A recording that cannot be used, or kills
the process that reads it, is a line in the table, and no more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import glob
import logging
import os
from pathlib import Path
import time
from typing import TYPE_CHECKING, Unpack

import numpy as np

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import InputError, SelfcalError
from selfcal_ros.findings.finding import Finding, sentences
from selfcal_ros.pipeline.bag_source import BAG_SUFFIXES, image_topics, is_bag, is_bag_folder
from selfcal_ros.pipeline.calibrate_input import calibrate_input, CalibrationSettings
from selfcal_ros.pipeline.engines import CRASHED, EngineOptions, run_jobs
from selfcal_ros.pipeline.file_sources import IMAGE_SUFFIXES, natural_key, VIDEO_SUFFIXES
from selfcal_ros.pipeline.progress import Progress

if TYPE_CHECKING:
    from selfcal_ros.calibration.estimators.joint import JointCalibration
    from selfcal_ros.calibration.structure.camera_path import CameraPath

_LOGGER = logging.getLogger(__name__)
#: Files that are recordings when they lie in a folder of recordings.
_RECORDINGS = (*BAG_SUFFIXES, *VIDEO_SUFFIXES, '.csv')
#: Beside each film or table there may be so many pictures about it.
MOST_PICTURES = 3


@dataclass(frozen=True)
class Outcome:
    """
    What came of one camera in one recording.

    Attributes
    ----------
    path : str
    topic : str
        Image topic; empty where the recording has none.
    image_size : (int, int) or None
    result : Calibration, NotCalibrated or None
        Without reconstruction and residuals; None if the recording cannot be used.
    error : str
        Why it cannot.
    start_ns : int or None
        Time of the first image, where the recording has a clock.
    seconds : float
        Time that it took.
    findings : tuple of Finding
    camera_path : CameraPath or None
        Where the camera was.
    stamps_ns : dict of int to int, or None
        When each image was taken; None where the recording has no clock of its own.

    """

    path: str
    topic: str = ''
    image_size: tuple[int, int] | None = None
    result: Calibration | NotCalibrated | None = None
    error: str = ''
    start_ns: int | None = None
    seconds: float = 0.0
    findings: tuple[Finding, ...] = ()
    camera_path: CameraPath | None = None
    stamps_ns: dict[int, int] | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings in words, one sentence each."""
        return sentences(self.findings)

    @property
    def camera_key(self) -> tuple[str, tuple[int, int] | None]:
        """What tells cameras apart."""
        return self.topic, self.image_size


@dataclass(frozen=True, eq=False)
class CameraSummary:
    """
    All recordings of one camera.

    Attributes
    ----------
    topic : str
    image_size : (int, int)
    outcomes : tuple of Outcome
        In the order of time, or of the inputs where there is none.
    joint : JointCalibration or None
        None if no recording calibrates.
    members : tuple of int
        Which of the outcomes the joint estimate was offered, in its order.
    findings : tuple of Finding

    """

    topic: str
    image_size: tuple[int, int]
    outcomes: tuple[Outcome, ...]
    joint: JointCalibration | None = None
    members: tuple[int, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings in words, one sentence each."""
        return sentences(self.findings)


@dataclass(frozen=True)
class Summary:
    """Everything that came of many recordings; `failures` are those without any camera."""

    cameras: tuple[CameraSummary, ...]
    failures: tuple[Outcome, ...]
    seconds: float = 0.0


@dataclass(frozen=True)
class Job:
    """One recording, or one topic of it."""

    path: str
    settings: CalibrationSettings = field(default_factory=CalibrationSettings)


def find_recordings(inputs: Iterable[str | Path]) -> tuple[list[Path], bool]:
    """
    Find the recordings that inputs name.

    Parameters
    ----------
    inputs : iterable of str or Path
        Recordings, folders of recordings, or patterns such as 'drives/*.mcap'.

    Returns
    -------
    paths : list of Path
        In natural order within a folder or pattern, each once.
    many : bool
        Whether they name several, even if only one was found.

    Raises
    ------
    InputError
        If a pattern fits nothing, an input is empty, or all of them are single images.

    """
    inputs = list(inputs)
    found: list[Path] = []
    many = len(inputs) > 1
    for text in map(str, inputs):
        if not text.strip():
            # Path('') would be the current folder with all that lies in it
            raise InputError('An INPUT is empty; name a recording, or . for this folder.')
        path = Path(text)
        if not os.path.exists(text) and glob.has_magic(text):
            matches = sorted(map(Path, glob.glob(text, recursive=True)),
                             key=lambda match: natural_key(str(match)))
            if not matches:
                raise InputError(f'Nothing fits {text}.')
            found, many = found + matches, True
            continue
        inside = _recordings_inside(path)
        many = many or bool(inside)
        found += inside or [path]
    found = list(dict.fromkeys(found))
    if many and found and all(map(_is_single_image, found)):
        first, *others = found
        which = f'{first} is a single image' if not others else (
            f'{first} and {len(others)} more are single images')
        raise InputError(f'{which}; give the folder, {first.parent}, and not what lies in it.')
    return found, many


def _is_single_image(path: Path) -> bool:
    return path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()


def _recordings_inside(path: Path) -> list[Path]:
    """List the recordings of a folder that is none itself."""
    try:
        if not path.is_dir():
            return []
        entries = [entry for entry in path.iterdir() if not entry.name.startswith('.')]
        files = [entry for entry in entries if entry.suffix.lower() in _RECORDINGS
                 and entry.is_file()]
        bags = [entry for entry in files if entry.suffix.lower() in BAG_SUFFIXES]
        bags += [entry for entry in entries if _is_bag_folder(entry)]
        images = [entry for entry in entries if _is_single_image(entry)]
        if not bags and len(images) > MOST_PICTURES * len(files):
            # a table or a film beside so many images is about them
            return []
        files = bags + [entry for entry in files if entry not in bags]
        # a rosbag2 folder, or the remains of one that lost its metadata
        if (path / 'metadata.yaml').is_file() or [entry.suffix for entry in files] in (
                ['.mcap'], ['.db3']):
            return []
        return sorted(files, key=lambda entry: natural_key(entry.name))
    except (OSError, ValueError):
        # whoever opens it says what is wrong
        return []


def _is_bag_folder(path: Path) -> bool:
    """Tell whether that is a folder of a bag; one that may not be read is none."""
    try:
        return path.is_dir() and is_bag_folder(path)
    except OSError:
        return False


def calibrate_job(job: Job) -> list[Outcome]:
    """Calibrate every camera of a recording; what goes wrong is in the outcome."""
    path, settings = Path(job.path), job.settings
    topics: list[str | None] = [settings.topic]
    try:
        if settings.topic is None and is_bag(path):
            topics = list(image_topics(path)) or [None]
    except (SelfcalError, OSError, ValueError) as error:
        return [Outcome(job.path, error=_sentence(job.path, error))]
    return [_calibrate_topic(job.path, replace(settings, topic=topic)) for topic in topics]


def _calibrate_topic(path: str, settings: CalibrationSettings) -> Outcome:
    """Calibrate one camera of a recording."""
    began = time.monotonic()
    topic = settings.topic or ''
    try:
        result, reading = calibrate_input(path, settings)
    except (SelfcalError, OSError) as error:
        return Outcome(path, topic, error=_sentence(path, error), seconds=time.monotonic() - began)
    except Exception as error:
        # a fault of this program in one recording must not cost the others theirs
        return Outcome(path, topic, error=f'{path}: fault of selfcal_ros, please report: '
                       f'{type(error).__name__}: {error}', seconds=time.monotonic() - began)
    # it takes long to load
    from selfcal_ros.calibration.structure.camera_path import camera_path
    where = camera_path(result) if result and result.reconstruction is not None else None
    if result:
        # large, and of no use beyond its own process
        result = replace(result, reconstruction=None, residuals=None)
    elif result.hint is not None:
        result = replace(result, hint=None)
    stamps = reading.tracks.stamps_ns or {}
    start = min(stamps.values()) if stamps and reading.clock in ('header', 'log') else None
    size = reading.tracks.image_size or (
        (result.camera.width, result.camera.height) if result else None)
    return Outcome(path, topic, size, result, '', start, time.monotonic() - began,
                   reading.findings, where, reading.stamps_ns)


def _sentence(path: str, error: Exception) -> str:
    """Say of a recording why it cannot be used."""
    if isinstance(error, SelfcalError):
        return str(error)
    place = getattr(error, 'filename', None) or path
    return f'{place} cannot be read: {getattr(error, "strerror", None) or error}.'


def calibrate_many(paths: Sequence[str | Path], settings: CalibrationSettings, *,
                   each: Callable[[Outcome], None] | None = None,
                   progress: Progress | None = None, **engine: Unpack[EngineOptions]) -> Summary:
    """
    Calibrate many recordings, and each camera among them jointly.

    Parameters
    ----------
    paths : list of str or Path
    settings : CalibrationSettings
    each : callable, optional
        Called with every outcome as it comes, and again with one that another lens replaces.
    progress : callable, optional
        Called as progress(text, done, total).
    **engine
        engine, workers, scheduler; see `selfcal_ros.pipeline.engines.run_jobs`.

    Returns
    -------
    Summary

    """
    began = time.monotonic()
    found: list[list[Outcome]] = [[] for _ in paths]
    findable: Callable[..., str] = str
    if engine.get('engine') == 'dask':
        # workers of a cluster may run in another folder than this process
        settings, findable = _with_absolute_paths(settings), os.path.abspath
    jobs = [Job(findable(path), settings) for path in paths]
    for done, (number, value) in enumerate(run_jobs(calibrate_job, jobs, **engine), start=1):
        # under the name that it was given
        path = str(paths[number])
        found[number] = [
            replace(outcome, path=path, error=outcome.error.replace(jobs[number].path, path))
            for outcome in _outcomes(path, value)]
        for outcome in found[number]:
            if each:
                each(outcome)
            _LOGGER.info('%s %s: %s', outcome.path, outcome.topic, outcome.error or
                         ('calibrated' if outcome.result else 'not calibrated'))
        if progress:
            progress('Calibrating', done, len(jobs))
    outcomes = [outcome for group in found for outcome in group]
    groups: dict[tuple[str, tuple[int, int] | None], list[Outcome]] = {}
    for outcome in outcomes:
        if outcome.image_size:
            groups.setdefault(outcome.camera_key, []).append(outcome)
    cameras = tuple(_summarise(group, settings, engine, progress, findable, each)
                    for group in groups.values())
    failures = tuple(outcome for outcome in outcomes if not outcome.image_size)
    return Summary(cameras, failures, time.monotonic() - began)


def _with_absolute_paths(settings: CalibrationSettings) -> CalibrationSettings:
    """Name the files of settings so that they are found from every folder."""
    mask, known = (os.path.abspath(path) if path is not None and os.path.isfile(path) else path
                   for path in (settings.mask, settings.known_object))
    return replace(settings, mask=mask, known_object=known)


def _outcomes(path: str, value: list[Outcome] | BaseException | None) -> list[Outcome]:
    """Turn what `run_jobs` yields into outcomes, also where there is no value."""
    if isinstance(value, BaseException):
        why = ' '.join(f'{type(value).__name__}: {value}'.split())
        return [Outcome(path, error=f'{path}: it could not be run there ({why:.200}).')]
    return value or [Outcome(path, error=f'{path}: {CRASHED}')]


def _summarise(group: list[Outcome], settings: CalibrationSettings, engine: EngineOptions,
               progress: Progress | None, findable: Callable[..., str],
               each: Callable[[Outcome], None] | None) -> CameraSummary:
    """Combine the recordings of one camera; `findable` names them for those who read them."""
    if all(outcome.start_ns is not None for outcome in group):
        group = sorted(group, key=lambda outcome: outcome.start_ns or 0)
    group, first = list(group), group[0]
    empty = CameraSummary(first.topic, first.image_size or (0, 0), tuple(group))
    results = {number: outcome.result for number, outcome in enumerate(group) if outcome.result
               and np.isfinite(outcome.result.covariance).all()}
    good = list(results)
    if not good:
        return empty
    models = [result.facts.distortion for result in results.values()]
    # where recordings chose different distortion models, they are asked again for the usual one
    usual = max(sorted(set(models)), key=models.count)
    again = [number for number in good if results[number].facts.distortion != usual]
    findings: tuple[Finding, ...] = ()
    if again:
        facts = replace(settings.facts, distortion=usual)
        jobs = [Job(findable(group[number].path), replace(
            settings, facts=facts, topic=first.topic or settings.topic)) for number in again]
        for number in again:
            del results[number]
        for done, (place, value) in enumerate(run_jobs(calibrate_job, jobs, **engine), start=1):
            number, found = again[place], _outcomes(jobs[place].path, value)[0]
            if found.result and np.isfinite(found.result.covariance).all():
                results[number] = found.result
                # what is told of a recording is what counts
                group[number] = replace(found, path=group[number].path,
                                        seconds=group[number].seconds + found.seconds)
                if each:
                    each(group[number])
            if progress:
                progress(f'Again with distortion {usual}', done, len(jobs))
        findings = (Finding('recordings_asked_again', again=len(again), recordings=len(good),
                            model=usual),)
    members, copies = _distinct(results)
    findings += tuple(Finding('recordings_alike', copy=group[copy].path, of=group[one].path)
                      for copy, one in copies)
    from selfcal_ros.calibration.estimators.joint import combine
    joint = combine([results[number] for number in members])
    return replace(empty, outcomes=tuple(group), joint=joint, members=members,
                   findings=findings)


def _distinct(results: Mapping[int, Calibration]) -> tuple[tuple[int, ...],
                                                           list[tuple[int, int]]]:
    """Part recordings from copies, whose results are equal to the last digit."""
    first: dict[bytes, int] = {}
    copies = []
    for number, one in sorted(results.items()):
        same = first.setdefault(one.camera.parameters.tobytes() + one.covariance.tobytes(), number)
        if same != number:
            copies.append((number, same))
    return tuple(first.values()), copies
