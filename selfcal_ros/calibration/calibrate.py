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
from dataclasses import replace
import logging
from typing import Any

import numpy as np

from selfcal_ros.calibration.affine.modulus import MIN_VIEWS
from selfcal_ros.calibration.blas_threads import on_one_thread
from selfcal_ros.calibration.estimators.acceptance import only_a_hint
from selfcal_ros.calibration.estimators.all_views import finish, NOT_CONSTANT, settled
from selfcal_ros.calibration.estimators.few_views import calibrate_few_views, spread_views
from selfcal_ros.calibration.estimators.motion_calibration import (calibrate_from_motion,
                                                                   MOTION_MODELS, problem_of,
                                                                   UNEXPLAINED)
from selfcal_ros.calibration.estimators.pivot import decide_pivot, left_by_turns
from selfcal_ros.calibration.estimators.repeated import (calibrate_repeated_objects,
                                                         refused_for_objects)
from selfcal_ros.calibration.estimators.rotation import (calibrate_rotating, fit_rotations,
                                                         judge_rotations, RotationFit)
from selfcal_ros.calibration.estimators.sliding_images import LONG
from selfcal_ros.calibration.estimators.translation import calibrate_translated
from selfcal_ros.calibration.estimators.turning_cameras import of_two_turning
from selfcal_ros.calibration.estimators.turning_views import better_without, frames_in_motion
from selfcal_ros.calibration.initialisation.mirrored import mirrored_views
from selfcal_ros.calibration.initialisation.one_plane import on_one_plane
from selfcal_ros.calibration.initialisation.supposed_lens import is_strong
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph, ViewGraph
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.two_view_tests import PARALLAX_RATIO
from selfcal_ros.values.still_tracks import find_still_tracks, StillTracks, TrackExtents
from selfcal_ros.values.track_labels import STATIC, TrackLabels
from selfcal_ros.values.tracks import Tracks
from selfcal_ros.version import __version__

_LOGGER = logging.getLogger(__name__)
#: With fewer views a small translation hides in the noise, yet moves the calibration by several
#: sigmas: that the camera only rotates must then be said.
ROTATION_MIN_VIEWS = 5
#: Below this ratio of homographies' misfit to that of epipolar geometry (which lens distortion
#: raises, too) it is tried whether rotation alone explains the images.
DOUBTFUL_PARALLAX = 10.0
#: Rotation alone is taken where it leaves no more than so many times the noise: depths that
#: rest on so little would lead the calibration astray.
ROTATION_NOISE = 1.2
#: So many times where that takes a long lens: over a plane that is nearly parallel to the image a
#: path leaves the focal length open, and a turn behind such a lens looks much the same.
LONG_LENS_NOISE = 1.02
#: So is whether it turns about a point where the pair in the middle has less. A lens that bends
#: lines leaves up to 20 where large turns show it: a head was taken for a free hand at 12.
USUAL_PARALLAX = 25.0
#: That is tried where rotation alone leaves less than so many times the noise, and the search for
#: a rotation ends where its first start leaves more than so many times.
PIVOT_RATIO, HOPELESS = 16.0, 20.0
#: The same of a turn about a fixed point, to be taken; and where it contradicts the facts, or
#: leaves so many times what pairs do, a free motion that leaves less than this share of its noise.
PIVOT_NOISE, WORSE_THAN_PAIRS, CLEARER = 1.5, 1.04, 0.97
#: So many times where no pair shows parallax: the noise of pairs is known to some 3 %, and a drive
#: with the smallest of steps is no turn.
HIDDEN_NOISE = 1.1
#: A path is short when its extent is less than this share of the points' depth. A longer one
#: shows in the images, and needs no model of its own.
SHORT_WAY = 0.3
#: A free path is weak where rotations alone, with the same lens, leave less than so many times the
#: noise in the middle. Heads with a lever of 8 cm leave 1 to 8, drives and hands 24 and more.
NEARLY_TURNS = 10.0
#: Where rotations leave less than so many times the noise, what moved was too little to change the
#: focal length by more than this share: those of heads with a lever were up to 4 % off.
AS_LITTLE, FAR_FROM_TURNS = 2.0, 0.1
#: Of two cameras, that of the first image is calibrated unless the other has so much more to show.
CLEARLY_MORE = 1.3
#: Refusals of circular motion, which name the fact that is missing.
OF_CIRCLES = ('flat_turntable', 'circle_undetermined')
#: Refusals of paths that explain the images, whatever the focal length is.
OF_OPEN_PATH = ('parameters_undetermined', 'unlike_rotations', *OF_CIRCLES)
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
        If `motion` is unknown, or `views` or `parallel_objects` does not suit it.

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
    rng = np.random.default_rng(0) if rng is None else rng
    try:
        return _calibrated(tracks, motion, facts, rng, start, translation_frames, views)
    except np.linalg.LinAlgError:
        _LOGGER.debug('equations without a solution', exc_info=True)
        return NotCalibrated.of(NoEstimate('equations_singular'), frames=tracks.frames,
                                facts=facts, software=f'selfcal_ros {__version__}')


def _calibrated(tracks: Tracks, motion: str, facts: CameraFacts, rng: np.random.Generator,
                start: Camera | None, translation_frames: Sequence[int] | None,
                views: int | None) -> Calibration | NotCalibrated:
    """Calibrate by one motion or by the one that is found."""
    tracks = replace(tracks, image_size=tracks.image_size or _size_from(tracks))
    software = f'selfcal_ros {__version__}'
    # objects of one image are no views
    extents = TrackExtents.measured(tracks) if motion != 'repeated' else None
    still = None if extents is None else find_still_tracks(tracks, extents)
    if still is not None:
        rest = tracks.select(~np.isin(tracks.track, still.track))
        return _beside_still_tracks(calibrate(
            rest, motion=motion, facts=facts, rng=rng, start=start,
            translation_frames=translation_frames, views=views), rest, still)
    if extents is not None and extents.nothing_moves:
        return NotCalibrated.of(NoEstimate('nothing_moves', images=len(tracks.frames)),
                                frames=tracks.frames, facts=facts, software=software)
    if views is not None:
        tracks = spread_views(tracks, views)
    graph = build_view_graph(tracks, rng, straight=facts.distortion == 'none')
    if isinstance(graph, NoEstimate):
        refusal = refused_for_objects(graph) if motion == 'repeated' else graph
        return NotCalibrated.of(refusal, frames=tracks.frames, facts=facts, software=software)
    mirrored = mirrored_views(graph) if motion != 'repeated' else None
    if mirrored is not None:
        return NotCalibrated.of(NoEstimate('images_mirrored', mirrored=tuple(
            graph.frames[mirrored].tolist())), frames=graph.frames, facts=facts, software=software)
    result = _of_graph(graph, tracks, motion, facts, rng, start, translation_frames, views)
    if views is not None or motion not in MOTION_MODELS:
        return result
    return _beside_turns(result, tracks, motion=motion, facts=facts, rng=rng, start=start)


def _of_graph(graph: ViewGraph, tracks: Tracks, motion: str, facts: CameraFacts,
              rng: np.random.Generator, start: Camera | None,
              translation_frames: Sequence[int] | None, views: int | None,
              ) -> Calibration | NotCalibrated:
    """Calibrate from connected views by one motion or by the one that is found."""
    software = f'selfcal_ros {__version__}'
    size = tracks.image_size
    assert size is not None
    result: Calibration | NoEstimate
    if motion == 'rotation':
        result = calibrate_rotating(graph.tracks, size, facts)
    elif motion == 'translation':
        result = calibrate_translated(graph, size, facts, translation_frames)
    elif motion == 'repeated':
        result = calibrate_repeated_objects(graph, size, facts, translation_frames)
    elif views is not None:
        result = calibrate_few_views(graph, size, facts, [start] if start else [])
    else:
        result = _calibrate_moving(graph, size, facts, motion, [start] if start else [])
    if isinstance(result, NoEstimate):
        if result.kind == 'two_cameras' and result.values['all_views']:
            of_one = _of_one_camera(tracks, result, motion=motion, facts=facts, rng=rng,
                                    start=start)
            if of_one:
                return of_one
        return NotCalibrated.of(result, frames=graph.frames, facts=facts, software=software)
    result = replace(result, software=software)
    # the last gate is one for all motions
    hint = only_a_hint(result)
    return result if hint is None else NotCalibrated.of(hint, frames=result.frames,
                                                        software=software)


def _beside_turns(whole: Calibration | NotCalibrated, tracks: Tracks, **how: Any,
                  ) -> Calibration | NotCalibrated:
    """Leave frames out that turn on the spot, where they do more harm than good."""
    moving: Iterable[int] | None = None
    if isinstance(whole, NotCalibrated):
        moving = whole.values.get('in_motion')
    elif whole.reconstruction is not None:
        moving = frames_in_motion(whole.reconstruction, tracks)
    if moving is None:
        return whole
    others = calibrate(tracks.in_frames(moving), **how)
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


def _of_one_camera(tracks: Tracks, mixed: NoEstimate, **how: Any) -> Calibration | NotCalibrated:
    """Calibrate from the images of one of two cameras: of the one that has more to show."""
    groups = sorted((mixed.values['first'], mixed.values['second']))
    # the one of the first image, unless there is clearly more of the other
    first, other = (len(tracks.in_frames(frames)) for frames in groups)
    groups = groups if CLEARLY_MORE * first > other else groups[::-1]
    result = calibrate(tracks.in_frames(groups[0]), **how)
    if not result:
        return result
    left_out = Finding('other_camera_left_out', used=groups[0], left_out=groups[1])
    return replace(result, findings=(left_out, *result.findings))


def _calibrate_moving(graph: ViewGraph, size: tuple[int, int], facts: CameraFacts, motion: str,
                      proposals: list[Camera]) -> Calibration | NoEstimate:
    """Calibrate from planar or general motion, or what looks like it with little parallax."""
    enough = len(graph.frames) >= ROTATION_MIN_VIEWS
    little = enough and graph.parallax < DOUBTFUL_PARALLAX
    doubtful = little or (enough and graph.usual_parallax < USUAL_PARALLAX)
    turning: RotationFit | NoEstimate | None = None
    turned: Calibration | NoEstimate | None = None
    is_weak, turned_px = False, 0.0
    if doubtful and facts.focal != 'varying':
        # what a strong lens leaves of a rotation says nothing before the lens is fitted
        tried = graph.parallax < PARALLAX_RATIO or is_strong(graph.bend)
        turning = fit_rotations(graph.tracks, size, facts,
                                np.inf if little and tried else HOPELESS * graph.noise_px)
        if isinstance(turning, RotationFit):
            mixed = of_two_turning(turning, graph, size, facts)
            if mixed is not None:
                return mixed
            is_weak = turning.left_px < PIVOT_RATIO * max(turning.noise_px, graph.noise_px)
    if is_weak and isinstance(turning, RotationFit):
        turned, turned_px = _about_a_point(graph, size, facts, motion, turning)
        if turned is not None and not _may_be_another_path(turned, turned_px, graph):
            return turned
    elif doubtful:
        in_plane = on_one_plane(graph)
        if in_plane is not None:
            plane = calibrate_from_motion(in_plane, size, facts, [], MOTION_MODELS[motion],
                                          flat=True)
            if plane or plane.kind in OF_CIRCLES:
                return plane
    moving = _as_turns_say(calibrate_from_motion(
        graph, size, facts, proposals, MOTION_MODELS[motion], is_weak=is_weak), turning, graph)
    if (moving and enough and turning is None and facts.focal != 'varying'
            and left_by_turns(graph, moving.camera) < NEARLY_TURNS):
        # what pairs show beside a homography was no parallax
        nearly = fit_rotations(graph.tracks, size, facts, HOPELESS * graph.noise_px)
        if isinstance(nearly, RotationFit):
            turned, turned_px = _about_a_point(graph, size, facts, motion, nearly)
            if turned and not _may_be_another_path(turned, turned_px, graph):
                return turned
        moving = _as_turns_say(calibrate_from_motion(
            graph, size, facts, proposals, MOTION_MODELS[motion], is_weak=True), nearly, graph)
    if turned is not None:
        # a path that only looks like a turn contradicts the facts, too
        left_px = turned.noise_sigma_px if turned else turned_px
        clearer = moving and moving.noise_sigma_px < CLEARER * left_px
        return moving if clearer or (moving and _is_open(turned)) else turned
    if not little or (moving and turning is not None):
        return moving
    if turning is None:
        rotating = calibrate_rotating(graph.tracks, size, facts, not moving, may_miss=True)
    else:
        rotating = (judge_rotations(turning, size, facts, may_miss=True)
                    if isinstance(turning, RotationFit)
                    else turning)
    if rotating:
        simpler = not _hides_path(rotating, moving) and (
            not moving or rotating.noise_sigma_px <= ROTATION_NOISE * moving.noise_sigma_px)
        return rotating if motion == 'auto' and simpler else moving
    if not moving and graph.parallax < PARALLAX_RATIO:
        plane = calibrate_from_motion(graph, size, facts, [], MOTION_MODELS[motion], flat=True)
        # a plane that turns in itself is not for want of parallax
        return plane if plane or plane.kind in OF_CIRCLES else moving
    return moving


def _as_turns_say(result: Calibration | NoEstimate, turning: RotationFit | NoEstimate | None,
                  graph: ViewGraph) -> Calibration | NoEstimate:
    """Refuse a path beside which rotations alone leave as little, with quite another camera."""
    if (not isinstance(turning, RotationFit) or isinstance(result, NoEstimate)
            or turning.left_px > AS_LITTLE * graph.noise_px):
        return result
    turned_px, focal_px = turning.lens.fit.state.lens['f'], float(result.camera.K[0, 0])
    if abs(np.log(focal_px / turned_px)) < FAR_FROM_TURNS:
        return result
    return NoEstimate('unlike_rotations', focal_px=focal_px, turned_px=float(turned_px),
                      left_px=result.noise_sigma_px, motion=result.motion, facts=result.facts,
                      status=result.status)


def _hides_path(rotating: Calibration, moving: Calibration | NoEstimate) -> bool:
    """Tell whether a path explains what a turn behind a long lens only seems to."""
    if moving:
        left_px = moving.noise_sigma_px
    elif moving.kind in OF_OPEN_PATH:
        left_px = moving.values.get('left_px', np.inf)
    else:
        return False
    camera = rotating.camera
    is_long = camera.K[0, 0] > LONG * max(camera.width, camera.height)
    return bool(is_long and rotating.noise_sigma_px > LONG_LENS_NOISE * left_px)


def _may_be_another_path(turned: Calibration | NoEstimate, left_px: float, graph: ViewGraph,
                         ) -> bool:
    """Tell whether a turn contradicts facts or lens, or leaves more than pairs of images do."""
    if turned:
        return left_px > WORSE_THAN_PAIRS * graph.noise_px
    return turned.kind in ('fact_contradicted', 'smooth_misfit') or _is_open(turned)


def _is_open(turned: Calibration | NoEstimate) -> bool:
    """Tell whether a turn leaves parameters of the camera open, as a path may not."""
    return isinstance(turned, NoEstimate) and turned.kind == 'parameters_undetermined'


def _about_a_point(graph: ViewGraph, size: tuple[int, int], facts: CameraFacts, motion: str,
                   turning: RotationFit) -> tuple[Calibration | NoEstimate | None, float]:
    """
    Try whether the camera only turns, about its centre or a point beside it.

    Returns
    -------
    Calibration or NoEstimate or None
        None if it does not.
    float
        Noise that a turn leaves, pixels.

    """
    hidden = graph.parallax < PARALLAX_RATIO
    if hidden and turning.left_px < ROTATION_NOISE * graph.noise_px:
        return None, 0.0
    problem = problem_of(graph, size, facts, turns=True)
    if isinstance(problem, NoEstimate):
        return None, 0.0
    decided = decide_pivot(problem, graph, turning)
    if isinstance(decided, NoEstimate):
        return None, 0.0
    problem, decision = decided
    noise_px = decision.model.fit.bundle.sigma_px
    if decision.is_rotation and motion == 'auto':
        rotating = judge_rotations(turning, size, facts, may_zoom=False, may_miss=True)
        if rotating:
            return rotating, noise_px
    # a lever that no pair shows has to explain all that rotations leave
    explained = noise_px < (HIDDEN_NOISE if hidden else PIVOT_NOISE) * problem.noise_px
    if decision.holds and explained and decision.moved_share < SHORT_WAY:
        result = _as_turns_say(finish(settled(problem, decision.model), decision.model, graph,
                                      facts), turning, graph)
        # a focal length that varies is for the free motions
        if result or result.kind not in (NOT_CONSTANT, *UNEXPLAINED):
            return result, noise_px
    return None, noise_px


def _size_from(tracks: Tracks) -> tuple[int, int]:
    """Suppose an image just large enough for the tracks, where its size is not stated."""
    if not len(tracks):
        return (1, 1)
    width, height = np.ceil(tracks.xy.max(axis=0) + 1).astype(int)
    return (max(int(width), 1), max(int(height), 1))
