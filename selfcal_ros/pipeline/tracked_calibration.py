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
Self-calibration from a tracked object: track, measure the edges, adjust, and measure again.

The object is followed with a few supposed cameras, and some images are kept. Edges are measured
in them around the model at the poses of the last adjustment, ever closer, until the camera no
longer changes; several focal lengths are tried, because a wrong one makes the tracker believe
wrong edges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from selfcal_ros.calibration.known_object.edge_calibration import (adjust_to_edges,
                                                                   calibrate_from_edges)
from selfcal_ros.calibration.known_object.edge_views import EdgeViews
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts, supposed_matrix
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.pipeline.edge_measurement import (CONIC_POINTS, edge_misfit, LINE_POINTS,
                                                   measure_edges, PosedImage)
from selfcal_ros.pipeline.feature_session import ExtractedTracks
from selfcal_ros.pipeline.object_motion import PosesInTime
from selfcal_ros.pipeline.progress import Progress
from selfcal_ros.pipeline.sources import Excerpt, Frame, FrameSource, open_source
from selfcal_ros.pipeline.tracking_run import read_start
from selfcal_ros.pipeline.tracking_session import TrackingSession
from selfcal_ros.rorapid.options import ReadLines
from selfcal_ros.rorapid.tracker import TrackerOptions, TrackerState
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel
from selfcal_ros.values.tracks import Tracks
from selfcal_ros.values.wireframe import WireframeModel
from selfcal_ros.version import SOFTWARE

#: Focal lengths to begin with, over the longer side of the image.
FOCAL_FRACTIONS = (0.6, 0.75, 0.95, 1.2, 1.5, 1.9, 2.4, 3.2)
#: How often each is tried on the first image, from where the last trial has come to.
TRIALS = 5
#: An edge that is not found counts as one that lies so far off, pixels; and a trial may change
#: its focal length by this factor at most.
UNFOUND_PX, FOCAL_RANGE = 10.0, 2.0
#: Focal lengths that are tried on the images kept, over the one that tracked them.
FOCAL_FACTORS = (0.75, 0.85, 0.92, 1.0, 1.09, 1.18, 1.33)
#: Focal lengths that the object is followed with, over the one to begin with.
FOLLOW_FACTORS = (1.0, 0.87, 1.15)
#: Edges that lie nearer to the model than this (share of the diagonal) leave no doubt.
SURE_FRACTION = 0.0003
#: More views add time and little accuracy.
MAX_VIEWS = 60
#: Views that the focal lengths are compared on.
TRIAL_VIEWS = 20
#: How far from its edge an edgel is looked for, pixels, in each round; the last is repeated.
REACH_PX = (6, 5, 4, 3)
#: Rounds at most; they end when the focal length has changed by less than this share.
ROUNDS, SETTLED = 8, 5e-4


#: Object in the camera's frame: rotation (3, 3) and translation (3,), metres.
Pose = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class _Passage:
    """
    What following an object through a recording has given.

    Attributes
    ----------
    views : list of PosedImage
        Images that were kept.
    images, tracked : int
        How many could be read, and in how many of them the object was followed.
    reason : str
        Why the last image was not tracked.
    stamps_ns : dict of int to int
        Of the views, by frame.
    interval_s : float or None
        Between images, in the median.

    """

    views: list[PosedImage]
    images: int
    tracked: int
    reason: str
    stamps_ns: dict[int, int]
    interval_s: float | None


def calibrate_tracked_object(path: str | Path, model: WireframeModel, facts: CameraFacts, *,
                             init: str | None, clicks: Sequence[float] | None = None,
                             start: Camera | None = None, topic: str | None = None,
                             max_keyframes: int | None = None, seed: int = 0,
                             progress: Progress | None = None, excerpt: Excerpt = Excerpt(),
                             lines: ReadLines = 'rows',
                             ) -> tuple[Calibration | NotCalibrated, ExtractedTracks]:
    """
    Calibrate a camera from a recording in which an object of known shape can be followed.

    Parameters
    ----------
    path : str or Path
        Anything that `open_source` knows and that holds images.
    model : WireframeModel
    facts : CameraFacts
    init, clicks
        Where the object is in the first image; see `read_start`. Clicks need no camera.
    start : Camera, optional
        What to begin with; by default focal lengths are tried.
    topic : str, optional
        Image topic of a bag.
    max_keyframes : int, optional
        Views to use at most.
    seed : int
    progress : callable, optional
        Called as progress(text, done, total).
    excerpt : Excerpt
        The part of the recording that is used.
    lines : {'rows', 'columns'}
        What is read one after the other where the shutter is rolling.

    Returns
    -------
    result : Calibration or NotCalibrated
    reading : ExtractedTracks
        The edgels as tracks, one a control point.

    Raises
    ------
    InputError, ArgumentError
        If an input is wrong.

    """
    most = MAX_VIEWS if max_keyframes is None else max_keyframes
    with open_source(path, topic, excerpt=excerpt) as source:
        if source.kind == 'tracks':
            raise InputError(f'{path} holds tracks, not images; the tracker needs images.')
        size = source.image_size
        assert size is not None, 'images have been seen'
        facts.check_for(size)
        _check_readout(facts, source)
        if start is not None and start.width and (start.width, start.height) != size:
            raise InputError(f'The images are {size[0]}x{size[1]}, the calibration to begin with '
                             f'is for {start.width}x{start.height} pixels.')
        if model.is_outlined:
            raise InputError('A mesh cannot calibrate a camera yet; give a wireframe of the '
                             'object (.cao or .yaml).')
        task = _Task(source, VisibleModel(model, LINE_POINTS, CONIC_POINTS), facts, most, seed,
                     progress, lines, facts.line_delay_s or 0.0)
        camera, pose = _begin(task, init, clicks, start)
        passage, result, edges = task.best_passage(camera, pose)
        if result and result.shutter is not None and source.clock != 'nominal':
            # the poses between which it moves are those of other instants now
            again = replace(task, line_delay_s=result.shutter.line_delay_s or 0.0).best_passage(
                result.camera, pose)
            if again[1]:
                passage, result, edges = again
        readout = task.readout(passage, result) if result else None
        if readout is not None and result:
            result = replace(result, shutter=readout,
                             findings=(*result.findings, readout.finding()))
        return result, _reading(source, passage, edges)


@dataclass(frozen=True)
class _Task:
    """
    A recording of an object, and how a camera is calibrated from it.

    Attributes
    ----------
    source : FrameSource
    fine : VisibleModel
        The object, with as many control points as edges are measured at.
    facts : CameraFacts
    most_views : int
    seed : int
        Of the tracker.
    progress : callable, optional
        Called as progress(text, done, total).
    lines : {'rows', 'columns'}
        What is read one after the other where the shutter is rolling.
    line_delay_s : float
        Seconds from one line to the next that the object is followed with.

    """

    source: FrameSource
    fine: VisibleModel
    facts: CameraFacts
    most_views: int
    seed: int
    progress: Progress | None
    lines: ReadLines = 'rows'
    line_delay_s: float = 0.0

    def readout(self, passage: _Passage, result: Calibration) -> RowReadout | None:
        """Return how lines are read, as was said or found; None where all are read at once."""
        found, stated_s = result.shutter, self.facts.line_delay_s
        if found is not None and self.source.clock == 'nominal':
            return replace(found, line_delay_s=None, sigma_s=None)
        if not stated_s or passage.interval_s is None:
            return found
        return RowReadout.in_time(stated_s, 0.0, 'held', passage.interval_s,
                                  self.source.image_size or (0, 0), self.lines)

    def best_passage(self, camera: Camera, pose: Pose,
                     ) -> tuple[_Passage, Calibration | NotCalibrated, EdgeViews | None]:
        """
        Follow the object with several cameras, and choose the passage whose edges fit best.

        A tracker with a wrong focal length may believe wrong edges all the way, and what is
        measured around its poses then agrees with it.
        """
        best, least = None, np.inf
        for factor in FOLLOW_FACTORS:
            trial = _with_focal(camera, factor * camera.K[0, 0])
            depth = float(pose[0][2] @ self.fine.model.centre + pose[1][2])
            start = pose[0], pose[1] + [0.0, 0.0, (factor - 1) * depth]
            passage = self.follow(trial, start)
            if len(passage.views) >= 2:
                result, edges = self.refined(*self.best_focal(trial, passage.views),
                                             passage.interval_s)
            else:
                why = passage.reason.rstrip('.')
                result, edges = self.refused('object_not_followed', why=why), None
            # a refusal is worth less than any calibration, and the first the more than a later
            cost = result.noise_sigma_px if result else np.inf
            if best is None or cost < least:
                best, least = (passage, result, edges), cost
            if cost < SURE_FRACTION * float(np.hypot(camera.width, camera.height)):
                break
        assert best is not None, 'there is a factor to try'
        return best

    def refused(self, kind: str, **values: object) -> NotCalibrated:
        """Return a refusal for the caller."""
        return NotCalibrated.of(NoEstimate(kind, **values), motion='known-object',
                                facts=self.facts, software=SOFTWARE)

    def follow(self, camera: Camera, pose: Pose) -> _Passage:
        """Follow the object through all images, and keep some of them."""
        source, most = self.source, self.most_views
        # that the camera is wrong is known here
        options = TrackerOptions(doubt=False, line_delay_s=self.line_delay_s, lines=self.lines)
        session = TrackingSession(self.fine.model, options, camera, self.seed)
        session.start(*pose)
        step = max(1, (source.count or 2 * most) // (2 * most))
        views: list[PosedImage] = []
        images, good, reason = 0, 0, 'no image could be used'
        stamps: dict[int, int] = {}
        path = PosesInTime()
        timed = source.clock != 'nominal'
        for frame in source:
            try:
                tracked = session.add(frame.image, frame.stamp_ns if timed else None)
            except InputError as error:
                reason = str(error)
                continue
            images += 1
            path.add(frame.stamp_ns, (tracked.rotation, tracked.translation)
                     if tracked.state is TrackerState.TRACKING else None)
            if self.progress:
                self.progress('Tracking', images, source.count)
            if tracked.state is not TrackerState.TRACKING:
                reason = tracked.reason or reason
                continue
            if good % step == 0:
                stamps[frame.index] = frame.stamp_ns
                views.append(PosedImage(frame.index, frame.image, tracked.rotation,
                                        tracked.translation))
            good += 1
            if len(views) > 4 * most:
                # a source that does not tell its length: every second will do from here on
                views, step = views[::2], 2 * step
        if self.facts.shutter != 'global':
            views = _read_with([replace(view, move=path.move_a_second(stamps[view.index]),
                                        lines=self.lines) for view in views], self.line_delay_s)
        if len(views) > most:
            views = [views[k] for k in np.linspace(0, len(views) - 1, most).astype(int)]
        return _Passage(views, images, good, reason, stamps, path.interval_s)

    def best_focal(self, camera: Camera, views: list[PosedImage],
                   ) -> tuple[Camera, list[PosedImage]]:
        """Return the camera and the views that explain the images best, of several lengths."""
        few = [views[k]
               for k in np.unique(np.linspace(0, len(views) - 1, TRIAL_VIEWS).astype(int))]
        # the rest is held: a wrong edge must not bend it
        held = CameraFacts(aspect_ratio=camera.K[1, 1] / camera.K[0, 0], skew=camera.K[0, 1],
                           principal_point=tuple(camera.K[:2, 2]), distortion='none')
        best, least = (camera, views), np.inf
        for factor in FOCAL_FACTORS:
            trial, moved = _refocused(self.fine.model, camera, few, factor)
            for reach in REACH_PX[:2]:
                edges = measure_edges(self.fine, trial, moved, reach)
                if edges is None:
                    break
                adjusted = adjust_to_edges(edges, trial, held)
                if isinstance(adjusted, NoEstimate):
                    break
                trial, poses = adjusted
                moved = _posed(moved, poses)
            score = edge_misfit(self.fine, trial, moved)
            if score < least:
                least = score
                best = _refocused(self.fine.model, camera, views, trial.K[0, 0] / camera.K[0, 0])
        return best

    def refined(self, camera: Camera, views: list[PosedImage], interval_s: float | None,
                ) -> tuple[Calibration | NotCalibrated, EdgeViews | None]:
        """Measure and adjust in turn; returns the result and the edgels that it rests on."""
        result: Calibration | NotCalibrated | None = None
        edges = None
        for number in range(ROUNDS):
            if self.progress:
                self.progress('Measuring edges', number, ROUNDS)
            found = measure_edges(self.fine, camera, views,
                                  REACH_PX[min(number, len(REACH_PX) - 1)], interval_s)
            if found is None:
                break
            edges = found
            # only the last round needs a covariance, but nobody knows which will be the last
            result = calibrate_from_edges(edges, camera, facts=self.facts)
            if not result:
                adjusted = adjust_to_edges(edges, camera, self.facts)
                if isinstance(adjusted, NoEstimate):
                    break
                before, (camera, poses) = camera, adjusted
            else:
                before, camera = camera, result.camera
                poses = dict(zip(result.reconstructed.frames.tolist(),
                                 result.reconstructed.cam_from_world))
                if self.facts.line_delay_s is None:
                    views = _read_with(views, 0.0 if result.shutter is None
                                       else result.shutter.line_delay_s or 0.0)
            views = _posed(views, poses)
            settled = abs(camera.K[0, 0] / before.K[0, 0] - 1) < SETTLED
            if number >= len(REACH_PX) and settled:
                break
        return self.refused('edges_not_measured') if result is None else result, edges


def _refocused(model: WireframeModel, camera: Camera, views: list[PosedImage], factor: float,
               ) -> tuple[Camera, list[PosedImage]]:
    """Return camera and views at another focal length: the object looks alike, but for depth."""
    moved = []
    for view in views:
        depth = float(view.rotation[2] @ model.centre + view.translation[2])
        moved.append(replace(
            view, translation=view.translation + [0.0, 0.0, (factor - 1) * depth],
            move=None if view.move is None else view.move * [1, 1, 1, 1, 1, factor]))
    return _with_focal(camera, factor * camera.K[0, 0]), moved


def _posed(views: list[PosedImage], poses: Mapping[int, np.ndarray]) -> list[PosedImage]:
    """Return the views at adjusted poses [R | t], by frame; others keep theirs."""
    return [view if view.index not in poses else replace(
        view, rotation=poses[view.index][:, :3], translation=poses[view.index][:, 3])
        for view in views]


def _read_with(views: list[PosedImage], line_delay_s: float) -> list[PosedImage]:
    """Return views whose lines are read so fast; those of unknown motion only if all at once."""
    return [replace(view, line_delay_s=line_delay_s) for view in views
            if view.move is not None or not line_delay_s]


def _check_readout(facts: CameraFacts, source: FrameSource) -> None:
    """Refuse what is said of a rolling shutter and could not be heeded."""
    if facts.line_delay_sigma_s:
        raise ArgumentError('--track takes the line delay for exact: leave --line-delay-sigma '
                            'out.')
    if facts.line_delay_s and source.clock == 'nominal':
        raise InputError(f'{source.path} has no stamps, so that nobody knows how far the object '
                         'moves from row to row: give a bag or a video, or leave --line-delay out '
                         'and move slowly.')


def _begin(task: _Task, init: str | None, clicks: Any, start: Camera | None,
           ) -> tuple[Camera, Pose]:
    """Return the camera and the pose to begin with."""
    if not init:
        raise ArgumentError('--track needs to know where the object is in the first image: '
                            '--init "tx ty tz rx ry rz", or --init FILE.init with --clicks.')
    if start is not None:
        return start, read_start(init, clicks, start)
    frame, size = next(iter(task.source), None), task.source.image_size
    best: tuple[Camera, Pose] | None = None
    least, problem = np.inf, None
    for share in FOCAL_FRACTIONS if frame is not None else ():
        assert frame is not None and size is not None
        camera = _guess(size, share, task.facts)
        try:
            score, camera, pose = _trial(frame, task, camera, read_start(init, clicks, camera))
        except InputError as error:
            problem = error
            continue
        if score < least:
            best, least = (camera, pose), score
    if best is None:
        raise InputError(f'{problem or "There are no images."} Or state the camera to begin with '
                         '(--camera).')
    return best


def _guess(size: tuple[int, int], share: float, facts: CameraFacts) -> Camera:
    """Return a camera from facts and a focal length over the longer side."""
    return Camera(supposed_matrix(share * max(size), size, facts), np.zeros(0), *size)


def _trial(frame: Frame, task: _Task, camera: Camera, pose: Pose) -> tuple[float, Camera, Pose]:
    """Return how badly a camera fits the first image (the less, the better), camera and pose."""
    options = TrackerOptions(camera_model='zoom', recovery=False, doubt=False)
    session = TrackingSession(task.fine.model, options, camera, task.seed)
    session.start(*pose)
    for _ in range(TRIALS):
        tracked = session.add(frame.image)
    rms_px = tracked.rms_px if np.isfinite(tracked.rms_px) else UNFOUND_PX
    score = UNFOUND_PX * (1 - tracked.share_found) + rms_px
    if tracked and 1 / FOCAL_RANGE < tracked.focal_px / camera.K[0, 0] < FOCAL_RANGE:
        return (score, _with_focal(camera, tracked.focal_px),
                (tracked.rotation, tracked.translation))
    return score, camera, pose


def _with_focal(camera: Camera, focal_px: float) -> Camera:
    K = camera.K.copy()
    K[:2, :2] *= focal_px / K[0, 0]
    return Camera(K, camera.distortion, camera.width, camera.height, camera.model)


def _reading(source: FrameSource, passage: _Passage, edges: EdgeViews | None) -> ExtractedTracks:
    """Return the edgels as tracks, one a control point, for the report."""
    findings = (Finding('object_followed', tracked=passage.tracked, images=passage.images,
                        measured=len(passage.views)),)
    if edges is None:
        nothing = Tracks(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), source.image_size)
        return ExtractedTracks(nothing, source.description, findings)
    return ExtractedTracks(Tracks(edges.frame, edges.point, edges.xy, edges.image_size,
                                  passage.stamps_ns), source.description, findings,
                           source.clock)
