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
Long recordings: looked through sparsely, and followed where they say most of the camera.

Neighbouring images of a drive tell the same, and most of a long drive is straight on. So a pair of
images here and there tells how the image moves. The stretches that are worth most are followed
image by image and calibrated each. Their calibrations are combined by their information.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
import itertools
import logging
from typing import Any, TYPE_CHECKING

import numpy as np

from selfcal_ros.calibration.calibrate import calibrate
from selfcal_ros.calibration.estimators.joint import combine
from selfcal_ros.calibration.estimators.under_camera import under_camera
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import InputError
from selfcal_ros.features.extraction import extract_tracks, Extraction
from selfcal_ros.features.glance import Glance, glance, LEAST
from selfcal_ros.features.segments import choose_segments, Segment, stood
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.pipeline.feature_session import ExtractedTracks, generator
from selfcal_ros.pipeline.file_sources import NOMINAL_RATE_HZ
from selfcal_ros.pipeline.long_policy import LongRecordings
from selfcal_ros.pipeline.progress import Progress
from selfcal_ros.pipeline.sources import Frame, FrameSource
from selfcal_ros.values.tracks import Tracks
from selfcal_ros.version import SOFTWARE

if TYPE_CHECKING:
    from selfcal_ros.features.mask import ImageMask
    from selfcal_ros.pipeline.calibrate_input import CalibrationSettings

_LOGGER = logging.getLogger(__name__)
#: Where corners can be followed between so few of the pairs, these are photographs.
_FOLLOWED = 0.5
#: Refusals that more images of the same drive do not change: the best turns were tried.
_FINAL = ('no_motion', 'no_rotation')


@dataclass(frozen=True)
class FollowedSegment:
    """
    A segment, and what came of it.

    Attributes
    ----------
    segment : Segment
    result : Calibration or NotCalibrated
    used : bool
        Whether it has a part in the calibration.

    """

    segment: Segment
    result: Calibration | NotCalibrated
    used: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        part, result = self.segment, self.result
        return {'first': part.first, 'last': part.last, 'start_s': round(part.start_s, 3),
                'end_s': round(part.end_s, 3), 'why': part.why,
                'status': 'used' if self.used else 'left_out' if result else 'refused',
                'fx': float(result.camera.K[0, 0]) if result else None,
                'sigma_fx': float(result.sigma['fx']) if result else None,
                'reason': '' if result else result.reason}


@dataclass(frozen=True)
class Survey:
    """
    What was seen of a long recording, and what of it was used.

    Attributes
    ----------
    glances : tuple of Glance
    segments : tuple of FollowedSegment
        The most valuable first.
    began_ns : int
        Stamp of the first image of the recording.

    """

    glances: tuple[Glance, ...]
    segments: tuple[FollowedSegment, ...] = ()
    began_ns: int = 0


@dataclass(frozen=True)
class LongReading(ExtractedTracks):
    """The tracks of one segment of a long recording, and the survey of all of it."""

    survey: Survey | None = None


def calibrate_long(source: FrameSource, settings: CalibrationSettings, policy: LongRecordings,
                   mask: ImageMask | None = None, progress: Progress | None = None,
                   ) -> tuple[Calibration | NotCalibrated, LongReading] | None:
    """
    Calibrate from the segments of a long recording that say most.

    Parameters
    ----------
    source : FrameSource
    settings : CalibrationSettings
    policy : LongRecordings
    mask : ImageMask, optional
    progress : callable, optional
        Called as progress(text, done, total).

    Returns
    -------
    Calibration or NotCalibrated
    LongReading
        Its tracks are those of the segment that is most certain.
        None in place of both if the recording must be read as a whole: its images do not follow
        one another, the camera stands while something moves, or no segment calibrates.

    Raises
    ------
    InputError
        If an image cannot be used, or none has texture.

    """
    glances = list(_look_through(source, policy, mask, progress))
    if np.mean([one.texture < LEAST for one in glances]) > 0.95:
        raise InputError(f'No point could be followed through the images of {source.path}; they '
                         f'need texture and overlap{", also within the mask" if mask else ""}.')
    if stood(glances):
        return _refused(source, settings, glances)
    segments = choose_segments(glances, policy.images, policy.longest, policy.way,
                               policy.segments, source.began_ns)
    if not segments or np.mean([one.followed >= 0.5 for one in glances]) < _FOLLOWED:
        return None
    _LOGGER.info('%d of %d images are followed: %s', sum(one.images for one in segments),
                 source.count, ', '.join(f'{one.start_s:.1f} to {one.end_s:.1f} s'
                                         for one in segments))
    found = dict(_followed(source, settings, segments, mask, progress))
    followed = _calibrated(segments, found, settings, source, progress)
    hopeless = all(not one.result and one.result.kind in _FINAL for one in followed)
    if not (any(one.result for one in followed) or hopeless) and (
            source.count or 0) <= policy.whole:
        return None
    return _together(source, followed, found, glances)


def _look_through(source: FrameSource, policy: LongRecordings, mask: ImageMask | None,
                  progress: Progress | None) -> Iterator[Glance]:
    """Compare pairs of neighbours; where little moved between them, the beginnings of two."""
    stride = max((source.count or 0) // policy.glances, 2)
    total = (source.count or 0) // stride
    frames, before = source.pairs(stride), None
    for done, (first, second) in enumerate(_in_pairs(frames), start=1):
        seen = glance(first.index, first.stamp_ns, first.image, second.image,
                      1e-9 * (second.stamp_ns - first.stamp_ns), mask)
        if seen.speed == 0.0 and before is not None:
            # a slow motion shows over a longer time
            slow = glance(before.index, before.stamp_ns, before.image, first.image,
                          1e-9 * (first.stamp_ns - before.stamp_ns), mask)
            if slow.followed > 0.5:
                seen = replace(slow, index=first.index, stamp_ns=first.stamp_ns)
        before = first
        if progress:
            progress('Looking through the recording', done, total)
        yield seen


def _in_pairs(frames: Iterable[Frame]) -> Iterator[tuple[Frame, Frame]]:
    """Put neighbours together; an excerpt may begin between two."""
    before = None
    for frame in frames:
        if before is not None and frame.index == before.index + 1:
            yield before, frame
            before = None
        else:
            before = frame


def _refused(source: FrameSource, settings: CalibrationSettings, glances: list[Glance],
             ) -> tuple[NotCalibrated, LongReading]:
    """Say that nothing ever moved."""
    refusal = NotCalibrated.of(NoEstimate('no_motion'), facts=settings.facts,
                               software=SOFTWARE)
    nothing = Tracks(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), source.image_size)
    return refusal, LongReading(nothing, source.description, (), source.clock,
                                Survey(tuple(glances), (), source.began_ns))


def _followed(source: FrameSource, settings: CalibrationSettings, segments: list[Segment],
              mask: ImageMask | None, progress: Progress | None,
              ) -> Iterator[tuple[Segment, Extraction]]:
    """Follow the segments image by image, in the order of the recording."""
    in_order = sorted(segments, key=lambda one: one.first)
    starts = np.array([one.first for one in in_order])
    total = sum(one.images for one in segments)
    frames = source.only(itertools.chain.from_iterable(
        range(one.first, one.last + 1) for one in in_order))
    limit = {} if settings.max_keyframes is None else {'max_keyframes': settings.max_keyframes}
    before = 0

    def report(text: str, done: float) -> None:
        if progress and text == 'tracking':
            progress('Following the segments', before + done, total)

    for number, group in itertools.groupby(
            frames, lambda frame: int(np.searchsorted(starts, frame.index, side='right')) - 1):
        images = ((frame.index, frame.image, frame.stamp_ns) for frame in group)
        yield in_order[number], extract_tracks(images, 'video', report, mask=mask,
                                               rng=generator(settings.seed), **limit)
        before += in_order[number].images


def _calibrated(segments: list[Segment], found: dict[Segment, Extraction],
                settings: CalibrationSettings, source: FrameSource, progress: Progress | None,
                ) -> list[FollowedSegment]:
    """Calibrate the segments each, all but the first with the lens model of the first."""
    facts, start, done = settings.facts, None, []
    for number, segment in enumerate(segments):
        if progress:
            progress('Calibrating the segments', number, len(segments))
        result = calibrate(_tracks(found[segment], source), motion=settings.motion, facts=facts,
                           start=start, rng=generator(settings.seed))
        _LOGGER.info('%.1f to %.1f s: %s', segment.start_s, segment.end_s,
                     f'fx {result.camera.K[0, 0]:.2f} ± {result.sigma["fx"]:.2f}' if result
                     else result.reason)
        if result and start is None:
            facts, start = result.facts, result.camera
        done.append(FollowedSegment(segment, result))
    return done


def _tracks(extraction: Extraction, source: FrameSource) -> Tracks:
    return (extraction.tracks.unstamped(NOMINAL_RATE_HZ) if source.clock == 'nominal'
            else extraction.tracks)


def _together(source: FrameSource, followed: list[FollowedSegment],
              found: dict[Segment, Extraction], glances: list[Glance],
              ) -> tuple[Calibration | NotCalibrated, LongReading]:
    """Combine what the segments say."""
    good = {one.segment: one.result for one in followed
            if one.result and np.isfinite(one.result.covariance).all()}
    # only what was estimated by one lens model can be combined
    models = [result.facts for result in good.values()]
    good = {segment: result for segment, result in good.items() if result.facts == models[0]}
    base, result = followed[0].segment, followed[0].result
    used: list[Segment] = list(good)
    findings: list[Finding] = []
    if good:
        joint = combine(list(good.values()))
        used = [segment for segment, use in zip(good, joint.used) if use]
        base = min(used, key=lambda segment: good[segment].sigma['fx'])
        result = good[base]
        if len(used) > 1:
            together = joint.calibration
            result = replace(under_camera(good[base], together.camera, found[base].tracks),
                             covariance=together.covariance, status=together.status,
                             identifiability=None)
            findings.append(Finding('segments_joint', segments=len(used), start_s=base.start_s,
                                    scatter=joint.scatter))
    followed = [replace(one, used=one.segment in used) for one in followed]
    findings.insert(0, Finding(
        'segments_followed', images=source.count, followed=sum(
            one.segment.images for one in followed), count=len(followed),
        when=[f'{one.segment.start_s:.0f} to {one.segment.end_s:.0f} s' for one in sorted(
            followed, key=lambda one: one.segment.start_s)],
        segments=[one.as_dict() for one in followed]))
    result = replace(result, findings=(*findings, *result.findings))
    return result, LongReading(_tracks(found[base], source), source.description,
                               (*found[base].findings, *source.losses()), source.clock,
                               Survey(tuple(glances), tuple(followed), source.began_ns))
