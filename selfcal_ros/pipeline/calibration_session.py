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
"""A calibration that improves while tracks arrive; what the calibrator node drives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.features.moving_part import MovingPart, PART_STEP
from selfcal_ros.features.selection import KeyframeSelector
from selfcal_ros.pipeline.estimate_request import EstimateRequest, Keyframe, SessionSettings
from selfcal_ros.pipeline.session_state import (after, ESTIMATE_TRANSITIONS, EstimateState,
                                                Schedule, SCHEDULE_TRANSITIONS, SessionEvent,
                                                UNDER_WAY, WILL_BE_DROPPED)
from selfcal_ros.pipeline.stamp_order import stamp_order, StampOrder
from selfcal_ros.values.neighbours import Film, SeenPoints
from selfcal_ros.values.tracks import Tracks

#: With the memory full, an estimate whose focal length and principal point move no pixel further
#: than this share of the image diagonal (one pixel of 640x480) is not replaced by itself.
SETTLED_FRACTION = 0.00125
#: A frame with fewer points than this is no keyframe.
MINIMUM_POINTS = 8


@dataclass(frozen=True)
class SessionSnapshot:
    """State of a session, for diagnostics."""

    frames: int
    keyframes: int
    new_keyframes: int
    points: int
    image_size: tuple[int, int] | None
    estimates: int
    resets: int
    estimating: bool
    abandoned: bool
    calibration: Calibration | None
    failure: NotCalibrated | None


@dataclass(frozen=True)
class Interruption:
    """
    The tracks before and after have nothing in common.

    Attributes
    ----------
    reason : str
        A clause.
    forgets : bool
        Whether what was known is void: images of another size are those of another camera. A
        step of the clock says nothing about the camera.

    """

    reason: str
    forgets: bool


class CalibrationSession:
    """
    Keeps keyframes by parallax, says when an estimate is due, and holds the calibration in force.

    Estimates follow one another while they are of use: until one rests on as many keyframes as
    are kept and is precise (`SETTLED_FRACTION`). From then on the calibration stays until it is
    told to go. What may follow what is a table: see `selfcal_ros.pipeline.session_state`.

    Where the clock steps back, tracks begin anew, and with them the keyframes: a section ends.
    The calibration stays in force until one of a later section is at least as precise.

    The session does no work of its own beyond bookkeeping: `request` packs what an estimate
    needs, `EstimateRequest.run` computes in whatever thread the caller likes, and `accept` takes
    the result. A result that was requested before a reset is dropped.

    Parameters
    ----------
    settings : SessionSettings, optional

    """

    def __init__(self, settings: SessionSettings = SessionSettings()) -> None:
        self.settings = settings
        self._generation = 0
        self._clear()

    def _clear(self) -> None:
        self._section = 0
        self._begin_section()
        self._image_size: tuple[int, int] | None = None
        self._newest_ns: int | None = None
        self._frames = 0
        self._estimates = 0
        self._state = EstimateState.IDLE
        self._schedule = Schedule.AUTOMATIC
        self._calibration: Calibration | None = None
        # what the calibration in force came from
        self._source: EstimateRequest | None = None
        # where the next estimate starts: not from a calibration of other facts
        self._start: Calibration | None = None
        self._failure: NotCalibrated | None = None

    def _begin_section(self) -> None:
        """Forget the keyframes: what comes shares no tracks with them."""
        self._keyframes: list[Keyframe] = []
        self._film = Film()
        self._selector: KeyframeSelector | None = None
        self._part = MovingPart(0.0)
        self._newest_points = 0
        self._new_keyframes = 0

    def _happens(self, event: SessionEvent) -> None:
        self._state = after(ESTIMATE_TRANSITIONS, self._state, event)
        self._schedule = after(SCHEDULE_TRANSITIONS, self._schedule, event)

    def change(self, settings: SessionSettings) -> None:
        """
        Go on by other settings, with what has been gathered.

        After a change of motion or facts another estimate is due, and one under way is dropped;
        the calibration that there is stays until then.
        """
        old, self.settings = self.settings, settings
        if self._selector is not None:
            self._selector.displacement_px = self._parallax_px
            self._part.selector.displacement_px = PART_STEP * self._parallax_px
        self._thin_out()
        if (old.motion, old.facts) != (settings.motion, settings.facts):
            self._new_keyframes = len(self._keyframes)
            self._start = self._source = None
            self._happens(SessionEvent.OTHER_QUESTION)
        elif settings.max_keyframes > old.max_keyframes:
            self._happens(SessionEvent.MORE_ROOM)

    def reset(self) -> None:
        """Forget everything, also the estimate that may be on its way."""
        self._generation += 1
        self._clear()

    @property
    def calibration(self) -> Calibration | None:
        """The calibration in force, None before the first."""
        return self._calibration

    @property
    def newest(self) -> int:
        """Number of the newest frame, as those of the calibration are counted."""
        return max(self._frames - 1, 0)

    @property
    def keyframes(self) -> tuple[Keyframe, ...]:
        """The kept frames, oldest first."""
        return tuple(self._keyframes)

    def add_tracks(self, stamp_ns: int, ids: np.ndarray, xy: np.ndarray,
                   image_size: tuple[int, int]) -> Interruption | None:
        """
        Take the points of one frame.

        Parameters
        ----------
        stamp_ns : int
            Acquisition time.
        ids : array_like of int, shape (M,)
            Identity of each point.
        xy : array_like, shape (M, 2)
            Pixels.
        image_size : (int, int)
            Width and height.

        Returns
        -------
        Interruption or None
            Why tracks begin anew with this frame: the images changed size, or time jumped
            backward.

        """
        interruption = self.expect(stamp_ns, image_size)
        if self._newest_ns is not None and stamp_ns < self._newest_ns:
            return None
        self._frames += 1
        ids = np.asarray(ids, dtype=np.int64).ravel()
        xy = np.asarray(xy, dtype=float).reshape(-1, 2)
        finite = np.isfinite(xy).all(axis=1)
        # np.unique sorts, and keeps one of points that claim the same identity
        ids, first = np.unique(ids[finite], return_index=True)
        xy = xy[finite][first]
        self._film.add(SeenPoints(ids, xy, int(stamp_ns)))
        frame = Keyframe(self._frames - 1, int(stamp_ns), ids, xy)
        self._newest_points = len(ids)
        if self._selector is None:
            self._selector = KeyframeSelector(self._parallax_px)
            self._part = MovingPart(PART_STEP * self._parallax_px)
        # a nearly empty image (lens covered, motion blur) is no view of anything
        whole = len(ids) >= MINIMUM_POINTS and self._selector.offer(ids, xy)
        of_part = self._part.offer(ids, xy) and self._part.stood
        if not self._part.stood and any(one.of_part for one in self._keyframes):
            self._keyframes = [one for one in self._keyframes if not one.of_part]
        if whole or of_part:
            self._keyframes.append(replace(frame, filmed=self._film.keep(), of_part=not whole))
            self._new_keyframes += 1
            self._thin_out()
        return interruption

    def expect(self, stamp_ns: int, image_size: tuple[int, int]) -> Interruption | None:
        """
        Take note of a frame, whose points will follow with `add_tracks`.

        From here on `calibration` is what holds for this frame.

        Parameters
        ----------
        stamp_ns : int
            Acquisition time.
        image_size : (int, int)
            Width and height.

        Returns
        -------
        Interruption or None
            See `add_tracks`.

        """
        image_size = (int(image_size[0]), int(image_size[1]))
        interruption = self._interruption(int(stamp_ns), image_size)
        if interruption is None and self._newest_ns is not None and stamp_ns < self._newest_ns:
            # overtaken on the way
            return None
        if interruption is not None and interruption.forgets:
            self.reset()
        elif interruption is not None:
            self._section += 1
            self._begin_section()
        self._image_size, self._newest_ns = image_size, int(stamp_ns)
        return interruption

    def _interruption(self, stamp_ns: int, image_size: tuple[int, int]) -> Interruption | None:
        """Tell why what comes has nothing in common with what was before, if it has nothing."""
        if self._image_size not in (None, image_size):
            return Interruption(
                f'the images changed size from {self._image_size[0]}x{self._image_size[1]} to '
                f'{image_size[0]}x{image_size[1]}', forgets=True)
        if stamp_order(stamp_ns, self._newest_ns) is StampOrder.JUMPED_BACK:
            assert self._newest_ns is not None
            back_s = (self._newest_ns - stamp_ns) * 1e-9
            return Interruption(f'time jumped back by {back_s:.3f} s', forgets=False)
        return None

    @property
    def _parallax_px(self) -> float:
        assert self._image_size is not None
        return self.settings.parallax * float(np.hypot(*self._image_size))

    def _thin_out(self) -> None:
        """
        Drop the keyframes that are too many, first the one that is missed least.

        That is the one whose neighbours share the most points: the chain of views stays
        connected, and the views stay spread over the whole drive. Where every gap is too wide
        already, the oldest goes.
        """
        frames, most = self._keyframes, self.settings.max_keyframes
        if len(frames) <= most:
            return

        def shared_around(middle: int) -> int:
            return int(np.intersect1d(frames[middle - 1].ids, frames[middle + 1].ids,
                                      assume_unique=True).size)

        # of the neighbours of all but the first and the last
        shared = [shared_around(middle) for middle in range(1, len(frames) - 1)]
        while len(frames) > most:
            widest = int(np.argmax(shared))
            gone = widest + 1 if shared[widest] >= self.settings.min_common else 0
            del frames[gone], shared[max(gone - 1, 0)]
            for middle in (gone - 1, gone):
                if gone and 0 < middle < len(frames) - 1:
                    shared[middle - 1] = shared_around(middle)

    def is_due(self, idle: bool = False) -> bool:
        """
        Tell whether another estimate is worthwhile.

        Parameters
        ----------
        idle : bool
            No tracks have come for a while: use what has been gathered since the last estimate.

        """
        kept = len(self._keyframes)
        if self._state is EstimateState.WISHED:
            return kept >= 3
        if self._state is not EstimateState.IDLE or self._schedule is not Schedule.AUTOMATIC:
            return False
        if kept < self._enough or not self._new_keyframes:
            return False
        if idle or self._estimates == 0:
            return True
        return self._new_keyframes >= max(2, self.settings.growth * kept)

    @property
    def _enough(self) -> int:
        """Keyframes that make an estimate worthwhile: as many as an earlier section had."""
        if self._source is None or self._source.section == self._section:
            return self.settings.first_estimate
        return max(self.settings.first_estimate, self._source.keyframes)

    def hold(self) -> None:
        """Keep the calibration until `keep_since` or `reset`: no estimate comes by itself."""
        self._happens(SessionEvent.HOLD)

    def keep_since(self, index: int) -> None:
        """
        Forget the keyframes before one, and go on.

        Parameters
        ----------
        index : int
            Of a `Keyframe`; what came before shows another camera.

        """
        self._keyframes = [frame for frame in self._keyframes if frame.index >= index]
        self._new_keyframes = len(self._keyframes)
        # how precise the camera was known that is no more does not count
        self._source = None
        self._happens(SessionEvent.RELEASE)

    def request(self) -> EstimateRequest | None:
        """
        Pack what an estimate needs, and count it as begun.

        Returns
        -------
        EstimateRequest or None
            None while an estimate is under way, or with fewer than three keyframes. Where the
            result of the one under way will be dropped, another is due after it.

        """
        frames = self._keyframes
        if len(frames) < 3:
            self._happens(SessionEvent.TOO_FEW)
            return None
        if self._state in UNDER_WAY:
            self._happens(SessionEvent.WISH)
            return None
        self._happens(SessionEvent.START)
        self._new_keyframes = 0
        tracks = Tracks(np.repeat([f.index for f in frames], [len(f.ids) for f in frames]),
                        np.concatenate([f.ids for f in frames]),
                        np.concatenate([f.xy for f in frames]), self._image_size,
                        {f.index: f.stamp_ns for f in frames},
                        np.concatenate([f.neighbours for f in frames]))
        return EstimateRequest(tracks.with_at_least(2), self.settings, self._start,
                               self._generation, len(frames), self._section)

    def accept(self, request: EstimateRequest, result: Calibration | NotCalibrated) -> bool:
        """
        Take the result of a request.

        Returns
        -------
        bool
            Whether it was taken: not when the session was reset or held meanwhile, or asked
            something else. A failure leaves the calibration that there is, and so does one of
            another section that is less precise.

        """
        if request.generation != self._generation:
            return False
        taken = self._state is EstimateState.RUNNING
        self._happens(SessionEvent.RESULT)
        if not taken:
            return False
        self._estimates += 1
        if isinstance(result, NotCalibrated):
            self._failure = result
            # a hint is as good a start as any
            self._start = self._start or result.hint
            return True
        self._failure = None
        if self._calibration is not None and self._source is not None \
                and self._source.section != request.section \
                and imprecision_px(result) > imprecision_px(self._calibration):
            return True
        self._calibration = self._start = result
        self._source = request
        all_kept = request.keyframes >= self.settings.max_keyframes
        # a focal length that varies is to be followed
        settled = all_kept and result.focal is None and _is_precise(result)
        self._happens(SessionEvent.PRECISE if settled else SessionEvent.IMPRECISE)
        return True

    def snapshot(self) -> SessionSnapshot:
        """Return the state for diagnostics."""
        return SessionSnapshot(
            frames=self._frames, keyframes=len(self._keyframes),
            new_keyframes=self._new_keyframes, points=self._newest_points,
            image_size=self._image_size, estimates=self._estimates, resets=self._generation,
            estimating=self._state in UNDER_WAY, abandoned=self._state in WILL_BE_DROPPED,
            calibration=self._calibration, failure=self._failure)


def imprecision_px(calibration: Calibration) -> float:
    """Largest sigma, in pixels, that focal length and principal point leave in the image."""
    camera, sigma = calibration.camera, calibration.sigma
    edge = sigma['fx'] / camera.K[0, 0] * float(np.hypot(camera.width, camera.height)) / 2
    return float(max(edge, sigma['cx'], sigma['cy']))


def _is_precise(calibration: Calibration) -> bool:
    """Tell whether the sigmas are below `SETTLED_FRACTION` all over the image."""
    diagonal = float(np.hypot(calibration.camera.width, calibration.camera.height))
    return imprecision_px(calibration) <= SETTLED_FRACTION * diagonal
