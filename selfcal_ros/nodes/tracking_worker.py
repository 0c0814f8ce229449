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
"""The thread that follows objects, so that a long search does not stop the node's ears."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
import threading
import time
import traceback
from typing import Any

import cv2
from msg_adapters.image import image_message, ImageDecoder
from msg_adapters.message_types import Message, rclpy_types
from msg_adapters.stamps import stamp_ns
import numpy as np

from selfcal_ros.errors import SelfcalError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.pipeline.tracking_session import TrackingSession, TrackingSnapshot
from selfcal_ros.report.overlay import draw_overlay
from selfcal_ros.rorapid.estimation.joint_search import Searching, together
from selfcal_ros.rorapid.tracked_frame import TrackedFrame
from std_msgs.msg import Header


@dataclass(frozen=True)
class ObjectInImage:
    """
    What an image gave of one object.

    Attributes
    ----------
    tracked : TrackedFrame or None
        None where the image could not be used.
    camera : Camera or None
    problem : str
        Why the image could not be used, or that of one of several cameras.
    seconds : float
        From taking up the image to the pose.
    snapshot : TrackingSnapshot
    sees : dict of str to bool
        Of several cameras: which of them see the object.

    """

    tracked: TrackedFrame | None
    camera: Camera | None
    problem: str
    seconds: float
    snapshot: TrackingSnapshot
    sees: dict[str, bool] = field(default_factory=dict)


@dataclass(frozen=True)
class InstantMessages:
    """
    What came of one instant, from one camera or several.

    Attributes
    ----------
    header : std_msgs/Header
        That poses get.
    images : tuple of sensor_msgs/Image or None
        Of each camera; or sensor_msgs/CompressedImage.
    drawn : sequence of bool
        Of which cameras an overlay is wanted.
    depth : ndarray, shape (H, W), or None
        Of a single camera, metres.

    """

    header: Header
    images: tuple[Message, ...]
    drawn: Sequence[bool]
    depth: np.ndarray | None = None


@dataclass(frozen=True)
class DecodedImages:
    """
    The same as arrays.

    Attributes
    ----------
    grey : tuple of ndarray, shape (H, W), or None
        Of each camera.
    stamp_ns : int
    problem : str
        Why an image is missing.
    bgr : ndarray, shape (H, W, 3), or None
        Of a single camera, where an object asks for colour.
    depth : ndarray, shape (H, W), or None

    """

    grey: tuple[np.ndarray | None, ...]
    stamp_ns: int
    problem: str
    bgr: np.ndarray | None = None
    depth: np.ndarray | None = None


@dataclass(frozen=True)
class TrackedImage:
    """
    What became of one image.

    Attributes
    ----------
    header : std_msgs/Header
        That of the image.
    objects : tuple of ObjectInImage or None
        None where an object began anew since.
    overlays : tuple of sensor_msgs/Image or None
        Of each camera.

    """

    header: Header
    objects: tuple[ObjectInImage | None, ...]
    overlays: tuple[Message, ...]


class TrackingWorker:
    """
    Runs sessions in a thread of its own: commands in order, and always the newest image.

    The thread is a daemon: a process that is told to stop does not wait for it. Several objects
    are followed in the same image, and their edges searched at once. Threads would make it slower:
    most of the time is spent where Python lets one work at a time.

    Parameters
    ----------
    sessions : sequence of TrackingSession
        One an object; they belong to the thread from now on.
    ready : callable
        Called in the thread when `poll` has something to fetch.
    names : sequence of str
        Of the objects, for the overlay.

    """

    def __init__(self, sessions: Sequence[TrackingSession], ready: Callable[[], object],
                 names: Sequence[str] = ('',)) -> None:
        self._sessions: tuple[Any, ...] = tuple(sessions)
        self._ready, self._names = ready, tuple(names)
        self._decoder = ImageDecoder()
        self._types = rclpy_types()
        self._wake = threading.Condition()
        self._commands: deque[Callable[[], object]] = deque()
        self._image: tuple[InstantMessages, tuple[int, ...]] | None = None
        self._results: deque[tuple[TrackedImage, tuple[int, ...]] | str] = deque()
        #: How often each object began anew.
        self._begun = (0,) * len(self._sessions)
        self._stopped = False
        self.dropped = 0
        self._thread = threading.Thread(target=self._work, daemon=True, name='tracking')
        self._thread.start()

    def command(self, action: Callable[[Any], object], which: int | None = None,
                anew: bool = False) -> None:
        """
        Queue action(session), to be done before the next image.

        Parameters
        ----------
        action : callable
        which : int, optional
            Number of the object; all without it.
        anew : bool
            It is a reset or another start: of images from before it nothing of the object comes
            out any more.

        """
        chosen = range(len(self._sessions)) if which is None else (which,)
        with self._wake:
            self._commands.extend(partial(action, self._sessions[k]) for k in chosen)
            if anew:
                self._begun = tuple(count + (k in chosen) for k, count in enumerate(self._begun))
                if self._image is not None and not self._current(self._image[1]).any():
                    self.dropped += 1
                    self._image = None
            self._wake.notify()

    def submit(self, seen: InstantMessages) -> None:
        """Hand over the images of an instant; what waits is dropped."""
        with self._wake:
            self.dropped += self._image is not None
            self._image = seen, self._begun
            self._wake.notify()

    def _current(self, begun: tuple[int, ...]) -> np.ndarray:
        """Which objects did not begin anew since, (N,) bool."""
        current: np.ndarray = np.array(begun) == self._begun
        return current

    def poll(self) -> TrackedImage | str | None:
        """Return what is done: an image, or the sentence of a command that failed."""
        with self._wake:
            while self._results:
                result = self._results.popleft()
                if isinstance(result, str):
                    return result
                image, begun = result
                kept = tuple(one if current else None
                             for one, current in zip(image.objects, self._current(begun)))
                if any(kept):
                    return replace(image, objects=kept)
        return None

    def stop(self) -> None:
        """End the thread; waits for the image at hand, but not for long."""
        with self._wake:
            self._stopped = True
            self._wake.notify()
        self._thread.join(1.0)

    def _work(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._stopped or self._commands or self._image)
                if self._stopped:
                    return
                commands = list(self._commands)
                self._commands.clear()
                job, self._image = self._image, None
            for action in commands:
                self._do(action)
            if job is not None:
                seen, begun = job
                done = self._track(seen, self._current(begun))
                self._tell((done, begun))
            if not self._stopped:
                self._ready()

    def _tell(self, result: tuple[TrackedImage, tuple[int, ...]] | str) -> None:
        """Hand a result over."""
        with self._wake:
            self._results.append(result)

    def _do(self, action: Callable[[], object]) -> None:
        try:
            action()
        except SelfcalError as error:
            self._tell(str(error))
        except Exception as error:  # the thread must live, and the fault must be seen
            traceback.print_exc()
            self._tell(fault(error))

    def _track(self, seen: InstantMessages, current: np.ndarray) -> TrackedImage:
        """Follow the objects of which an image is still wanted, (N,) bool, and draw them."""
        began = time.perf_counter()
        pictures = self._decoded(seen)
        chosen = np.flatnonzero(current).tolist()
        found = dict(zip(chosen, together([
            self._finding(self._sessions[k], pictures, began) for k in chosen])))
        objects = tuple(found.get(k) for k in range(len(self._sessions)))
        overlays = tuple(self._overlay(which, pictures, objects, seen) if wanted else None
                         for which, wanted in enumerate(seen.drawn))
        return TrackedImage(seen.header, objects, overlays)

    def _decoded(self, seen: InstantMessages) -> DecodedImages:
        """Decode the image; in colour where an object asks for it."""
        problem, grey, bgr, stamp, (msg,) = '', None, None, 0, seen.images
        try:
            stamp = stamp_ns(msg.header.stamp)
            if any(session.wants_colour for session in self._sessions):
                bgr = self._decoder.colour(msg)
            grey = self._decoder.grey(msg) if bgr is None else cv2.cvtColor(
                bgr, cv2.COLOR_BGR2GRAY)
        except SelfcalError as error:
            problem = str(error)
        except Exception as error:  # as above
            traceback.print_exc()
            problem = fault(error)
        return DecodedImages((grey,), stamp, problem, bgr, seen.depth)

    def _finding(self, session: Any, pictures: DecodedImages, began: float,
                 ) -> Searching[ObjectInImage]:
        """Find one object, or say why not; `began` is when the images were taken up, seconds."""
        sees: dict[str, bool] = {}
        tracked, problem = None, pictures.problem
        if any(picture is not None for picture in pictures.grey):
            try:
                tracked, sees = yield from self._looking(session, pictures)
            except SelfcalError as error:
                problem = str(error)
            except Exception as error:  # as above
                traceback.print_exc()
                problem = fault(error)
        return ObjectInImage(tracked, session.camera, problem, time.perf_counter() - began,
                             session.snapshot(), sees)

    def _looking(self, session: Any, pictures: DecodedImages,
                 ) -> Searching[tuple[TrackedFrame, dict[str, bool]]]:
        """Find one object; and which of several cameras see it."""
        grey, = pictures.grey
        image = pictures.bgr if session.wants_colour and pictures.bgr is not None else grey
        tracked = yield from session.finding(image, pictures.stamp_ns, pictures.depth)
        return tracked, {}

    def _overlay(self, which: int, pictures: DecodedImages,
                 objects: Sequence[ObjectInImage | None], seen: InstantMessages) -> Message | None:
        """Draw all objects over the image of one camera; None where that cannot be done."""
        picture = pictures.grey[which]
        if picture is None:
            return None
        try:
            return image_message(self._drawn(which, picture, objects), seen.images[which].header,
                                 self._types)
        except Exception:  # a pose must not be lost to its picture
            traceback.print_exc()
            return None

    def _drawn(self, which: int, picture: np.ndarray,
               objects: Sequence[ObjectInImage | None]) -> np.ndarray:
        """Draw all objects over an image (H, W); each has a line of text of its own."""
        for line, (session, one, name) in enumerate(zip(self._sessions, objects, self._names)):
            if one is not None:
                picture = draw_overlay(picture, one.tracked, session.model, session.camera,
                                       one.problem, line, name)
        return picture


def fault(error: Exception) -> str:
    """Say that the program is at fault."""
    return (f'The tracker failed ({type(error).__name__}: {error}); please report the lines on '
            'standard error.')
