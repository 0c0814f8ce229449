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
"""The one entry: tracks and facts in, a calibration or the reason for its absence out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
import logging

import numpy as np

from selfcal_ros.calibration.affine.modulus import MIN_VIEWS
from selfcal_ros.calibration.blas_threads import on_one_thread
from selfcal_ros.calibration.estimators.acceptance import only_a_hint
from selfcal_ros.calibration.estimators.few_views import calibrate_few_views, spread_views
from selfcal_ros.calibration.estimators.motion_calibration import MOTION_MODELS
from selfcal_ros.calibration.estimators.motion_choice import calibrate_moving
from selfcal_ros.calibration.estimators.moving_camera import MovingCamera
from selfcal_ros.calibration.estimators.repeated import (calibrate_repeated_objects,
                                                         refused_for_objects)
from selfcal_ros.calibration.estimators.stated_rotation import calibrate_said_to_rotate
from selfcal_ros.calibration.estimators.stated_shutter import with_tested_shutter
from selfcal_ros.calibration.estimators.translation import calibrate_translated
from selfcal_ros.calibration.estimators.turning_views import better_without, frames_in_motion
from selfcal_ros.calibration.initialisation.mirrored import mirrored_views
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph, ViewGraph
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.still_tracks import find_still_tracks, StillTracks, TrackExtents
from selfcal_ros.values.track_labels import STATIC, TrackLabels
from selfcal_ros.values.tracks import Tracks
from selfcal_ros.version import SOFTWARE

#: Where no more than this share of the views is connected, it is said.
MOST_CONNECTED = 0.7
_LOGGER = logging.getLogger(__name__)
#: Of two cameras, that of the first image is calibrated unless the other has so much more to show.
CLEARLY_MORE = 1.3
METHODS = (*MOTION_MODELS, 'translation', 'rotation', 'repeated')


@on_one_thread
def calibrate(tracks: Tracks, *, motion: str = 'auto', facts: CameraFacts | None = None,
              rng: np.random.Generator | None = None, start: Camera | None = None,
              translation_frames: Sequence[int] | None = None, views: int | None = None,
              parallel_objects: Sequence[int] | None = None) -> Calibration | NotCalibrated:
    """
    Calibrate a camera from tracks of scene points.

    Parameters
    ----------
    tracks : Tracks
    motion : {'auto', 'planar', 'general', 'translation', 'rotation', 'repeated'}
        How the camera moved; 'auto' tries a plane first, and a camera that only rotates where
        the images show no parallax. 'translation': some views are related by pure translation.
        'repeated': the frames are equal objects in one image.
    facts : CameraFacts, optional
        What is known of the camera; nothing by default.
    rng : numpy.random.Generator, optional
        For RANSAC between images; a fixed seed by default, so that the same tracks give the same
        result. What sorts things that move by themselves always draws from a fixed seed.
    start : Camera, optional
        A calibration to try first, for example that of a while ago. The result does not depend
        on it, the time does.
    translation_frames : sequence of int, optional
        With motion 'translation', the frames that are related by pure translation; found from
        the images by default. With motion 'repeated', an older name of `parallel_objects`.
    views : int, optional
        With motion 'general', use so few views, four or more: those that share many points and
        differ much. The modulus constraint proposes the start.
    parallel_objects : sequence of int, optional
        With motion 'repeated', the objects that stand parallel; the images tell by default.

    Returns
    -------
    Calibration or NotCalibrated

    Raises
    ------
    ArgumentError
        If `motion` is unknown, `views` or `parallel_objects` does not suit it, or the lens of
        `start` is of a model that is never estimated.

    References
    ----------
    M. N. Armstrong (1996), Self-Calibration from Image Sequences: chapters 4 (translation), 5 and
    6 (planar motion). R. Hartley and A. Zisserman (2004), chapter 18: bundle adjustment.

    Examples
    --------
    Three views of a camera that turns on a plane, in pixels with noise of 0.1:

    >>> import numpy as np
    >>> from selfcal_ros import calibrate, CameraFacts
    >>> from selfcal_ros.synthetic.scenes import sequence_si
    >>> scene = sequence_si(np.random.default_rng(0), noise_px=0.1)
    >>> result = calibrate(scene.tracks, facts=CameraFacts(aspect_ratio=1.0, distortion='none'))
    >>> if result:
    ...     error = result.camera.parameters[:5] - scene.camera.parameters[:5]
    ...     print(bool((np.abs(error[:4]) < 0.05 * scene.camera.K[0, 0]).all()))
    True

    """
    if motion not in METHODS:
        raise ArgumentError(f'Motion {motion!r} is unknown; choose one of {", ".join(METHODS)}.')
    if views is not None and (motion != 'general' or views < MIN_VIEWS):
        raise ArgumentError(f'A number of views is for motion general, and must be at least '
                            f'{MIN_VIEWS}; got {views} for motion {motion}.')
    if parallel_objects is not None:
        if motion != 'repeated' or translation_frames is not None:
            raise ArgumentError('Parallel objects are for motion repeated, and are stated once: '
                                'leave translation frames out.')
        translation_frames = parallel_objects
    facts = CameraFacts() if facts is None else facts
    if len(tracks):
        facts.check_for(tracks.image_size or _size_from(tracks))
    return _guarded(tracks, _Request(
        motion, facts,
        np.random.default_rng(0) if rng is None else rng, start, translation_frames, views))


@dataclass(frozen=True)
class _Request:
    """
    What is asked of the tracks; see `calibrate`.

    Attributes
    ----------
    motion : str
        One of `METHODS`.
    facts : CameraFacts
    rng : numpy.random.Generator
    start : Camera, optional
        A calibration to try first.
    translation_frames : sequence of int, optional
        Of motion 'translation'; of motion 'repeated' the parallel objects.
    views : int, optional
        How many to use, of motion 'general'.

    """

    motion: str
    facts: CameraFacts
    rng: np.random.Generator
    start: Camera | None
    translation_frames: Sequence[int] | None
    views: int | None

    @property
    def is_one_image(self) -> bool:
        """Tell whether frames are objects of one image, and no views."""
        return self.motion == 'repeated'

    @property
    def proposals(self) -> list[Camera]:
        """The camera to try first, with a lens that can be estimated."""
        if self.start is None:
            return []
        models = {model.name for model, _ in LENS_CHOICES.values()}
        return [self.start if self.start.model in models else self.start.as_model('equidistant')]

    def of_all_views(self) -> _Request:
        """Return the same, without a choice of views or frames."""
        return replace(self, translation_frames=None, views=None)

    def refused(self, why: NoEstimate, frames: Iterable[int]) -> NotCalibrated:
        """Return a refusal for the caller."""
        return NotCalibrated.of(why, frames=frames, facts=self.facts, software=SOFTWARE)


def _guarded(tracks: Tracks, request: _Request) -> Calibration | NotCalibrated:
    """Calibrate; a singular system of equations, wherever it comes up, is a refusal."""
    try:
        return _calibrated(tracks, request)
    except np.linalg.LinAlgError:
        _LOGGER.debug('equations without a solution', exc_info=True)
        return request.refused(NoEstimate('equations_singular'), tracks.frames)


def _calibrated(tracks: Tracks, request: _Request) -> Calibration | NotCalibrated:
    """Calibrate from the tracks that move, of all views and then of those that help."""
    tracks = replace(tracks, image_size=tracks.image_size or _size_from(tracks))
    extents = None if request.is_one_image else TrackExtents.measured(tracks)
    still = None if extents is None else find_still_tracks(tracks, extents)
    if still is not None:
        rest = tracks.select(~np.isin(tracks.track, still.track))
        return _beside_still_tracks(_guarded(rest, request), rest, still)
    if extents is not None and extents.nothing_moves:
        return request.refused(NoEstimate('nothing_moves', images=len(tracks.frames)),
                               tracks.frames)
    if request.views is not None:
        tracks = spread_views(tracks, request.views)
    graph = build_view_graph(tracks, request.rng, straight=request.facts.distortion == 'none')
    if isinstance(graph, NoEstimate):
        return request.refused(refused_for_objects(graph) if request.is_one_image else graph,
                               tracks.frames)
    mirrored = None if request.is_one_image else mirrored_views(graph)
    if mirrored is not None:
        return request.refused(NoEstimate('images_mirrored', mirrored=tuple(
            graph.frames[mirrored].tolist())), graph.frames)
    result = _of_graph(graph, tracks, request)
    if request.views is not None or request.motion not in MOTION_MODELS:
        return result
    return _beside_turns(result, tracks, request.of_all_views())


def _of_graph(graph: ViewGraph, tracks: Tracks, request: _Request) -> Calibration | NotCalibrated:
    """Calibrate from connected views."""
    result = with_tested_shutter(
        lambda facts: _by_motion(graph, tracks, replace(request, facts=facts)), request.facts)
    if isinstance(result, NoEstimate):
        if result.kind == 'two_cameras' and result.values['all_views']:
            of_one = _of_one_camera(tracks, result, request.of_all_views())
            if of_one:
                return of_one
        return request.refused(result, graph.frames)
    views, used = len(tracks.frames), len(graph.frames)
    alone = () if used > MOST_CONNECTED * views else (
        Finding('views_unconnected', views=views, used=used),)
    result = replace(result, software=SOFTWARE, findings=(*alone, *result.findings))
    # the last gate is one for all motions
    hint = only_a_hint(result)
    return result if hint is None else NotCalibrated.of(hint, frames=result.frames,
                                                        software=SOFTWARE)


def _by_motion(graph: ViewGraph, tracks: Tracks, request: _Request) -> Calibration | NoEstimate:
    """Calibrate by the motion that is stated, or by the one that is found."""
    size, facts = tracks.image_size, request.facts
    assert size is not None
    if request.motion == 'translation':
        return calibrate_translated(graph, size, facts, request.translation_frames)
    if request.motion == 'repeated':
        return calibrate_repeated_objects(graph, size, facts, request.translation_frames)
    if request.views is not None:
        return calibrate_few_views(graph, size, facts, request.proposals)
    if request.motion == 'rotation':
        return calibrate_said_to_rotate(MovingCamera(graph, size, facts, 'auto',
                                                     request.proposals))
    return calibrate_moving(MovingCamera(graph, size, facts, request.motion, request.proposals))


def _beside_turns(whole: Calibration | NotCalibrated, tracks: Tracks, request: _Request,
                  ) -> Calibration | NotCalibrated:
    """Leave frames out that turn on the spot, where they do more harm than good."""
    moving: Iterable[int] | None = None
    if isinstance(whole, NotCalibrated):
        moving = whole.values.get('in_motion')
    elif whole.reconstruction is not None:
        moving = frames_in_motion(whole.reconstruction, tracks)
    if moving is None:
        return whole
    others = _guarded(tracks.in_frames(moving), request)
    if not others or (whole and not better_without(whole, others)):
        return whole
    left_out = Finding('turning_left_out',
                       left_out=np.setdiff1d(whole.frames, others.frames).tolist())
    return replace(others, findings=(left_out, *(
        one for one in others.findings if one.kind != left_out.kind)))


def _beside_still_tracks(result: Calibration | NotCalibrated, rest: Tracks, still: StillTracks,
                         ) -> Calibration | NotCalibrated:
    """Tell with a result what stood still in the image, and had no part in it."""
    findings = (still.finding(), *result.findings)
    if not result:
        return replace(result, findings=findings)
    names = np.unique(rest.track)
    labels = result.labels or TrackLabels(names, np.full(len(names), STATIC))
    return replace(result, findings=findings, labels=labels.with_still(still.track))


def _of_one_camera(tracks: Tracks, mixed: NoEstimate, request: _Request,
                   ) -> Calibration | NotCalibrated:
    """Calibrate from the images of one of two cameras: of the one that has more to show."""
    groups = sorted((mixed.values['first'], mixed.values['second']))
    # the one of the first image, unless there is clearly more of the other
    first, other = (len(tracks.in_frames(frames)) for frames in groups)
    groups = groups if CLEARLY_MORE * first > other else groups[::-1]
    result = _guarded(tracks.in_frames(groups[0]), request)
    if not result:
        return result
    left_out = Finding('other_camera_left_out', used=groups[0], left_out=groups[1])
    return replace(result, findings=(left_out, *result.findings))


def _size_from(tracks: Tracks) -> tuple[int, int]:
    """Suppose an image just large enough for the tracks, where its size is not stated."""
    if not len(tracks):
        return (1, 1)
    width, height = np.ceil(tracks.xy.max(axis=0) + 1).astype(int)
    return (max(int(width), 1), max(int(height), 1))
