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
from collections.abc import Callable
import multiprocessing
from multiprocessing import resource_tracker
import os
import signal
import traceback

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.pipeline.calibration_session import EstimateRequest

#: The child yields to whoever has an image to follow.
NICENESS = 5


class EstimationProcess:
    """
    Does what `EstimationWorker` does, in a process of its own.

    A thread would share the interpreter: every call of the tracker that comes back from OpenCV
    would wait for up to five milliseconds until the estimate lets go.

    The child ends with this process, however that ends: it reads from a pipe whose other end
    nobody else holds.

    Parameters
    ----------
    prepare : callable
        Called in the child as prepare(calibration, request), for what takes time after it. It
        must be picklable, as a function of a module is.

    """

    def __init__(self, prepare: Callable):
        self._prepare = prepare
        self._waiting: deque[EstimateRequest] = deque()
        self._running: EstimateRequest | None = None
        self._start()

    def _start(self):
        context = multiprocessing.get_context('spawn')
        self._pipe, theirs = context.Pipe()
        child = context.Process(target=_work, args=(theirs, self._prepare), daemon=True,
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

    def submit(self, request: EstimateRequest) -> None:
        """Queue a request."""
        self._waiting.append(request)
        self._send()

    def _send(self):
        """Send the next request once the child is idle: it reads at once then."""
        if self._running is None and self._waiting:
            self._running = self._waiting.popleft()
            try:
                self._pipe.send(self._running)
            except OSError:
                # poll() finds out, too, and tells
                pass

    def poll(self) -> tuple[EstimateRequest, Calibration | NotCalibrated, object] | None:
        """Return a request that is done, its result, and what was prepared (or None)."""
        if self._running is None or not self._pipe.poll():
            return None
        request, self._running = self._running, None
        try:
            result, prepared = self._pipe.recv()
        except (EOFError, OSError):
            result, prepared = NotCalibrated(
                'The process of the estimate ended unexpectedly (out of memory?).',
                'The next estimate starts another one.'), None
            self._pipe.close()
            self._start()
        self._send()
        return request, result, prepared


def _work(pipe, prepare: Callable) -> None:
    """Serve requests until the other end of the pipe is closed."""
    _yield_to_others()
    # now, and not when the first request waits
    import selfcal_ros
    del selfcal_ros
    while True:
        try:
            request = pipe.recv()
        except (EOFError, OSError):
            return
        result, prepared = run_request(request, prepare)
        try:
            pipe.send((result, prepared))
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


def run_request(request: EstimateRequest, prepare: Callable) -> tuple:
    """
    Run one request, and prepare what follows from it.

    Returns
    -------
    result : Calibration or NotCalibrated
        A fault of the program is a NotCalibrated, too: who estimates must live, and the fault
        must be seen.
    prepared : object
        None where there is nothing, or its making failed.

    """
    prepared = None
    try:
        result = request.run()
    except Exception as error:
        traceback.print_exc()
        result = NotCalibrated(f'The estimate failed ({type(error).__name__}: {error}); '
                               'please report the lines on standard error.')
    try:
        prepared = prepare(result, request) if result else None
    except Exception:  # a calibration must not be lost to what is drawn from it
        traceback.print_exc()
    return result, prepared
