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
import traceback

from msg_adapters.image import ImageDecoder
from msg_adapters.stamps import stamp_ns
import numpy as np

from selfcal_ros.errors import SelfcalError
from selfcal_ros.nodes.tracking_worker import (
    DecodedImages, fault, InstantMessages, ObjectInImage, TrackingWorker)
from selfcal_ros.pipeline.rig_session import RigSession
from selfcal_ros.report.overlay import draw_overlay
from selfcal_ros.rorapid.estimation.joint_search import Searching
from selfcal_ros.rorapid.tracked_frame import TrackedFrame


class RigWorker(TrackingWorker):
    """
    Runs sessions of several cameras in a thread of its own.

    Parameters
    ----------
    sessions : sequence of RigSession
    ready : callable
    names : sequence of str
        Of the objects.
    cameras : sequence of str

    """

    def __init__(self, sessions: Sequence[RigSession], ready: Callable[[], object],
                 names: Sequence[str], cameras: Sequence[str]) -> None:
        self._cameras = list(cameras)
        self._decoders = [ImageDecoder() for _ in cameras]
        super().__init__(sessions, ready, names)

    def _decoded(self, seen: InstantMessages) -> DecodedImages:
        """Decode the images that are there, each for itself."""
        pictures: list[np.ndarray | None] = []
        problems = []
        for name, decoder, one in zip(self._cameras, self._decoders, seen.images):
            picture = None
            try:
                picture = None if one is None else decoder.grey(one)
            except SelfcalError as error:
                problems.append(f'{name}: {error}')
            except Exception as error:  # the thread must live, and the fault must be seen
                traceback.print_exc()
                problems.append(fault(error))
            pictures.append(picture)
        return DecodedImages(tuple(pictures), stamp_ns(seen.header.stamp), ' '.join(problems))

    def _looking(self, session: RigSession, pictures: DecodedImages,
                 ) -> Searching[tuple[TrackedFrame, dict[str, bool]]]:
        """Find one object; and which of the cameras see it."""
        yield from ()
        found = session.look(pictures.grey, pictures.stamp_ns)
        return found.tracked, dict(zip(self._cameras, found.sees))

    def _drawn(self, which: int, picture: np.ndarray,
               objects: Sequence[ObjectInImage | None]) -> np.ndarray:
        """Draw all objects over the image (H, W) of one camera."""
        shown = ((session, one, name) for session, one, name in zip(
            self._sessions, objects, self._names) if one is not None)
        for line, (session, one, name) in enumerate(shown):
            # without a pose of this instant there is one of an earlier image
            newest = session.newest_of_rig if one.tracked is not None else None
            if newest is not None and newest.views[which] is not None:
                picture = draw_overlay(picture, newest.views[which], session.model,
                                       session.cameras[which].camera, one.problem, line, name)
        return picture
