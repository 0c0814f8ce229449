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

import queue
import sys
import threading
from typing import Any

from selfcal_ros.nodes.estimation_job import Job, JobResult, load_estimator

#: The interpreter changes threads after so long, seconds: a message waits so long for an estimate
#: at every step of its answer. By default it is ten times as long.
SWITCH_S = 5e-4


class EstimationWorker:
    """
    Runs jobs one after the other; results are fetched by polling.

    The thread is a daemon: a process that is told to stop does not wait for an estimate.
    """

    def __init__(self) -> None:
        # now, and not when the first job waits; here, for a thread that loads libraries must not
        # be ended
        load_estimator()
        sys.setswitchinterval(SWITCH_S)
        self._jobs: queue.Queue[Job[Any]] = queue.Queue()
        self._results: queue.Queue[JobResult[Any]] = queue.Queue()
        threading.Thread(target=self._work, daemon=True, name='estimation').start()

    def submit(self, job: Job[Any]) -> None:
        """Queue a job."""
        self._jobs.put(job)

    def poll(self) -> JobResult[Any] | None:
        """Return what became of the next job that is done; None if none is."""
        try:
            return self._results.get_nowait()
        except queue.Empty:
            return None

    def _work(self) -> None:
        while True:
            job = self._jobs.get()
            self._results.put(JobResult(job, *job.run()))
