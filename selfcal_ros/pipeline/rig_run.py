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
"""Track objects through the recordings of several cameras, and summarise it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

from selfcal_ros.pipeline.frame_source import Frame, FrameSource
from selfcal_ros.pipeline.instant import Instant
from selfcal_ros.pipeline.progress import Progress
from selfcal_ros.pipeline.rig_session import RigSession
from selfcal_ros.pipeline.simultaneous import simultaneous
from selfcal_ros.pipeline.tracking_loop import (
    begin_sessions, check_source, follow_through, Target)
from selfcal_ros.pipeline.tracking_outcome import TrackingRun
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.several_cameras.rig_frame import RigFrame
from selfcal_ros.values.camera_rig import PlacedCamera


def track_in_rig(sources: Sequence[FrameSource], targets: Sequence[Target],
                 cameras: Sequence[PlacedCamera], options: TrackerOptions | None = None, *,
                 seed: int = 0, progress: Progress | None = None,
                 listeners: Iterable[Callable[[Sequence[Frame | None], Sequence[RigFrame]],
                                              object]] = ()) -> list[TrackingRun]:
    """
    Follow objects through the recordings of several cameras.

    Parameters
    ----------
    sources : sequence of FrameSource
        One a camera.
    targets : sequence of Target
        Starts are in the frame of the first camera.
    cameras : sequence of PlacedCamera
    options : TrackerOptions, optional
    seed : int
    progress : callable, optional
        Called as progress(text, done, total).
    listeners : iterable of callable
        Each is called as listener(frames, found) after every instant: a Frame or None of each
        camera, numbered by the instant, and a RigFrame of each object.

    Returns
    -------
    list of TrackingRun
        Of each object.

    Raises
    ------
    InputError
        If an input, a start pose or the size of the images is wrong.

    """
    description = '; '.join(f'{one.name}: {source.description}'
                            for one, source in zip(cameras, sources))
    # distances come from the places of the cameras
    runs = [TrackingRun(description=description, cameras={one.name: 0 for one in cameras})
            for _ in targets]
    sessions = [RigSession(target.model, cameras, options, seed) for target in targets]
    begin_sessions(sessions, targets)
    for source, one in zip(sources, cameras):
        check_source(source, one.camera)
    counts = [source.count for source in sources if source.count is not None]

    def of_frames(listener: Callable[[Sequence[Frame | None], Sequence[RigFrame]], object],
                  ) -> Callable[[Instant, Sequence[RigFrame]], object]:
        return lambda instant, found: listener(instant.frames, found)

    follow_through(_instants(sources), sessions, runs, word='Instant',
                   count=max(counts) if counts else None, progress=progress,
                   listeners=map(of_frames, listeners))
    return runs


def _instants(sources: Sequence[FrameSource]) -> Iterator[Instant]:
    """Bring the images of several cameras together; all are numbered by the instant."""
    timed = all(source.clock != 'nominal' for source in sources)
    for index, heads in enumerate(simultaneous(sources)):
        frames = tuple(head and replace(head, index=index) for head in heads)
        first = next(frame for frame in frames if frame is not None)
        yield Instant(index, frames, first.stamp_ns if timed else None)
