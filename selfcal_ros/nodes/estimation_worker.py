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
"""One thread that estimates, so that callbacks go on."""

from __future__ import annotations

from collections.abc import Callable
import queue
import threading

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.nodes.estimation_process import run_request
from selfcal_ros.pipeline.calibration_session import EstimateRequest


class EstimationWorker:
    """
    Runs requests one after the other; results are fetched by polling.

    The thread is a daemon: a process that is told to stop does not wait for an estimate.

    Parameters
    ----------
    prepare : callable
        Called in the thread as prepare(calibration, request), for what takes time after it.

    """

    def __init__(self, prepare: Callable):
        self._prepare = prepare
        self._requests = queue.Queue()
        self._results = queue.Queue()
        threading.Thread(target=self._work, daemon=True, name='estimation').start()

    def submit(self, request: EstimateRequest) -> None:
        """Queue a request."""
        self._requests.put(request)

    def poll(self) -> tuple[EstimateRequest, Calibration | NotCalibrated, object] | None:
        """Return a request that is done, its result, and what was prepared (or None)."""
        try:
            return self._results.get_nowait()
        except queue.Empty:
            return None

    def _work(self):
        while True:
            request = self._requests.get()
            self._results.put((request, *run_request(request, self._prepare)))
