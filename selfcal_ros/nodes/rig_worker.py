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
"""The thread that follows objects in the images of several cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import compress
import time
import traceback

from msg_adapters.image import image_message, ImageDecoder
from msg_adapters.stamps import stamp_ns
import numpy as np

from selfcal_ros.errors import SelfcalError
from selfcal_ros.nodes.tracking_worker import fault, ObjectInImage, TrackedImage, TrackingWorker
from selfcal_ros.pipeline.rig_session import RigSession
from selfcal_ros.report.overlay import draw_overlay


class RigWorker(TrackingWorker):
    """
    Runs sessions of several cameras in a thread of its own.

    What is submitted is (header, images): the header that poses get, and an image message or None
    of each camera; with it, of which cameras a picture is to be drawn.

    Parameters
    ----------
    sessions : sequence of RigSession
    ready : callable
    names : sequence of str
        Of the objects.
    cameras : sequence of str

    """

    def __init__(self, sessions: Sequence[RigSession], ready: Callable, names: Sequence[str],
                 cameras: Sequence[str]):
        self._cameras = list(cameras)
        self._decoders = [ImageDecoder() for _ in cameras]
        super().__init__(sessions, ready, names)

    def _track(self, msg, with_overlay, depth, current: np.ndarray) -> TrackedImage:
        began, (header, messages) = time.perf_counter(), msg
        pictures, problems = [], []
        for name, decoder, one in zip(self._cameras, self._decoders, messages):
            picture = None
            try:
                picture = None if one is None else decoder.grey(one)
            except SelfcalError as error:
                problems.append(f'{name}: {error}')
            except Exception as error:  # the thread must live, and the fault must be seen
                traceback.print_exc()
                problems.append(fault(error))
            pictures.append(picture)
        stamp = stamp_ns(header.stamp)

        def look(session: RigSession) -> ObjectInImage:
            tracked, wrong, sees = None, ' '.join(problems), {}
            if any(picture is not None for picture in pictures):
                try:
                    found = session.look(pictures, stamp)
                    tracked, sees = found.tracked, dict(zip(self._cameras, found.sees))
                except SelfcalError as error:
                    wrong = str(error)
                except Exception as error:  # as above
                    traceback.print_exc()
                    wrong = fault(error)
            return ObjectInImage(tracked, session.camera, wrong, time.perf_counter() - began,
                                 session.snapshot(), sees)

        objects = tuple(look(session) if is_current else None
                        for session, is_current in zip(self._sessions, current))
        overlays = tuple(self._picture(k, pictures[k], messages[k], objects) if wanted else None
                         for k, wanted in enumerate(with_overlay))
        return TrackedImage(header, objects, None, overlays)

    def _picture(self, which: int, picture, message, objects):
        """Draw all objects over the image of one camera."""
        if picture is None:
            return None
        try:
            line = 0
            for session, one, name in compress(zip(self._sessions, objects, self._names), objects):
                # without a pose of this instant there is one of an earlier image
                newest = session.newest_of_rig if one.tracked is not None else None
                if newest is not None and newest.views[which] is not None:
                    picture = draw_overlay(picture, newest.views[which], session.model,
                                           session.cameras[which].camera, one.problem, line, name)
                line += 1
            return image_message(picture, message.header, self._types)
        except Exception:  # a pose must not be lost to its picture
            traceback.print_exc()
            return None
