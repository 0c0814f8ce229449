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
"""The thread that follows the object, so that a long search does not stop the node's ears."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
import threading
import time
import traceback
from typing import Any

from msg_adapters.image import image_message, ImageDecoder
from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import stamp_ns

from selfcal_ros.errors import SelfcalError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.pipeline.tracking_session import TrackingSession, TrackingSnapshot
from selfcal_ros.report.overlay import draw_overlay
from selfcal_ros.rorapid.tracked_frame import TrackedFrame


@dataclass(frozen=True)
class TrackedImage:
    """
    What became of one image.

    Attributes
    ----------
    header : std_msgs/Header
        That of the image.
    tracked : TrackedFrame or None
        None where the image could not be used.
    camera : Camera or None
    problem : str
        Why the image could not be used.
    overlay : sensor_msgs/Image or None
    seconds : float
        From taking up the image to the pose.
    snapshot : TrackingSnapshot

    """

    header: object
    tracked: TrackedFrame | None
    camera: Camera | None
    problem: str
    overlay: object
    seconds: float
    snapshot: TrackingSnapshot


class TrackingWorker:
    """
    Runs a session in a thread of its own: commands in order, and always the newest image.

    The thread is a daemon: a process that is told to stop does not wait for it.

    Parameters
    ----------
    session : TrackingSession
        Belongs to the thread from now on.
    ready : callable
        Called in the thread when `poll` has something to fetch.

    """

    def __init__(self, session: TrackingSession, ready: Callable):
        self._session, self._ready = session, ready
        self._decoder = ImageDecoder()
        self._types = rclpy_types()
        self._wake = threading.Condition()
        self._commands: deque[Callable] = deque()
        self._image: tuple[Any, bool] | None = None
        self._results: deque[TrackedImage | str] = deque()
        self._begun = 0
        self._stopped = False
        self.dropped = 0
        self._thread = threading.Thread(target=self._work, daemon=True, name='tracking')
        self._thread.start()

    def command(self, action: Callable, anew: bool = False) -> None:
        """
        Queue action(session), to be done before the next image.

        Parameters
        ----------
        action : callable
        anew : bool
            It is a reset or another start: of images from before it nothing comes out any more.

        """
        with self._wake:
            self._commands.append(action)
            if anew:
                self._begun += 1
                self.dropped += self._image is not None
                self._image = None
                self._results = deque(one for one in self._results if isinstance(one, str))
            self._wake.notify()

    def submit(self, msg, with_overlay: bool) -> None:
        """Hand over an image; one that still waits is dropped for it."""
        with self._wake:
            self.dropped += self._image is not None
            self._image = msg, with_overlay
            self._wake.notify()

    def poll(self) -> TrackedImage | str | None:
        """Return what is done: an image, or the sentence of a command that failed."""
        with self._wake:
            return self._results.popleft() if self._results else None

    def stop(self) -> None:
        """End the thread; waits for the image at hand, but not for long."""
        with self._wake:
            self._stopped = True
            self._wake.notify()
        self._thread.join(1.0)

    def _work(self):
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._stopped or self._commands or self._image)
                if self._stopped:
                    return
                commands = list(self._commands)
                self._commands.clear()
                job, self._image = self._image, None
                begun = self._begun
            for action in commands:
                self._do(action)
            if job is not None:
                self._tell(self._track(*job), begun)
            if not self._stopped:
                self._ready()

    def _tell(self, result, begun: int | None = None):
        """Hand a result over, unless it is of an image from before a new beginning."""
        with self._wake:
            if begun in (None, self._begun):
                self._results.append(result)

    def _do(self, action):
        try:
            action(self._session)
        except SelfcalError as error:
            self._tell(str(error))
        except Exception as error:  # the thread must live, and the fault must be seen
            traceback.print_exc()
            self._tell(_fault(error))

    def _track(self, msg, with_overlay: bool) -> TrackedImage:
        began, tracked, problem, picture = time.perf_counter(), None, '', None
        session = self._session
        try:
            picture = self._decoder.grey(msg)
            tracked = session.add(picture, stamp_ns(msg.header.stamp))
        except SelfcalError as error:
            problem = str(error)
        except Exception as error:  # as above
            traceback.print_exc()
            problem = _fault(error)
        seconds = time.perf_counter() - began
        overlay = None
        if with_overlay and picture is not None:
            try:
                overlay = image_message(
                    draw_overlay(picture, tracked, session.model, session.camera, problem),
                    msg.header, self._types)
            except Exception:  # a pose must not be lost to its picture
                traceback.print_exc()
        return TrackedImage(msg.header, tracked, session.camera, problem, overlay, seconds,
                            session.snapshot())


def _fault(error: Exception) -> str:
    """Say that the program is at fault."""
    return (f'The tracker failed ({type(error).__name__}: {error}); please report the lines on '
            'standard error.')
