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
"""The estimates of a calibrator in a child process, where images must not wait for them."""

from __future__ import annotations

from collections import deque
import multiprocessing
from multiprocessing import resource_tracker
import os
import signal
from typing import Any, TYPE_CHECKING

from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.nodes.estimation_job import Job, JobResult, load_estimator
from selfcal_ros.pipeline.child_process import end_with

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

#: The child yields to whoever has an image to follow.
NICENESS = 5
#: What the child says once, when its libraries are loaded.
READY = 'ready'


class EstimationProcess:
    """
    Does what `EstimationWorker` does, in a process of its own.

    A thread would share the interpreter: every call of the tracker that comes back from OpenCV
    would wait for up to five milliseconds until the estimate lets go.

    The child ends with this process, however that ends. On Linux it does so at once, elsewhere
    after the job at hand: it reads from a pipe whose other end nobody else holds.
    """

    def __init__(self) -> None:
        self._waiting: deque[Job[Any]] = deque()
        self._running: Job[Any] | None = None
        self._start()

    def _start(self) -> None:
        self._is_ready = False
        context = multiprocessing.get_context('spawn')
        self._pipe, theirs = context.Pipe()
        child = context.Process(target=_work, args=(theirs, os.getpid()), daemon=True,
                                name='estimation')
        # it would be started on the way, and unblock the signals that are blocked below
        resource_tracker.ensure_running()
        # Ctrl-C in a terminal reaches children, too; this one is blocked for good, for it
        # inherits the mask, and ends with the pipe
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            child.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()

    def submit(self, job: Job[Any]) -> None:
        """Queue a job."""
        self._waiting.append(job)
        self._send()

    def _send(self) -> None:
        """Send the next job once the child is ready and idle: it reads at once then."""
        if self._is_ready and self._running is None and self._waiting:
            self._running = self._waiting.popleft()
            try:
                self._pipe.send(self._running)
            except OSError:
                # poll() finds out, too, and tells
                pass

    def poll(self) -> JobResult[Any] | None:
        """Return what became of the next job that is done; None if none is."""
        if not (self._running or self._waiting) or not self._pipe.poll():
            return None
        try:
            answer = self._pipe.recv()
        except (EOFError, OSError):
            # it may have ended while it loaded, too
            lost, self._running = self._running or self._waiting.popleft(), None
            self._pipe.close()
            self._start()
            return JobResult(lost, NotCalibrated.of(NoEstimate('process_ended')))
        if answer == READY:
            self._is_ready = True
            self._send()
            return None
        job, self._running = self._running, None
        self._send()
        return None if job is None else JobResult(job, *answer)


def _work(pipe: Connection, parent: int) -> None:
    """Run jobs until the other end of the pipe is closed, or the parent has ended."""
    end_with(parent)
    _yield_to_others()
    # now, and not when the first job waits
    load_estimator()
    try:
        # until it reads, a large job would hold up whoever sends it
        pipe.send(READY)
    except OSError:
        return
    while True:
        try:
            job = pipe.recv()
        except (EOFError, OSError):
            return
        answer = job.run()
        try:
            pipe.send(answer)
        except OSError:
            return


def _yield_to_others() -> None:
    """Run as what this is, a batch job, also where the nodes were given real-time priority."""
    try:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    except (AttributeError, OSError):
        # not Linux, or not permitted
        pass
    os.nice(NICENESS)
