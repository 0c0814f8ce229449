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
"""What is computed off the callback thread: jobs, and their results with what they answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
import traceback
from typing import Any, Generic, Protocol, TypeVar

from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.geometry.no_estimate import NoEstimate


class JobKind(Enum):
    """What a job computes, and so who takes its result."""

    #: A calibration, from an `EstimateRequest`.
    ESTIMATE = 'estimate'
    #: The score of a window of keyframes, from a `ScoreRequest`.
    WINDOW_SCORE = 'window score'


class Request(Protocol):
    """Something that holds all that its computation needs, and computes."""

    def run(self) -> Any:
        """Compute."""


R = TypeVar('R', bound=Request)


@dataclass(frozen=True)
class Job(Generic[R]):
    """
    One request on its way through a worker.

    Attributes
    ----------
    kind : JobKind
    request : Request
    prepare : callable or None
        Called where the job runs as prepare(value, request), for what takes time after it; only
        of a value that is true. For a process it must be picklable, as a function of a module is.

    """

    kind: JobKind
    request: R
    prepare: Callable[[Any, R], Any] | None = None

    def run(self) -> tuple[Any, Any]:
        """
        Compute the value, and prepare what follows from it.

        Returns
        -------
        value : object
            A fault of the program is a NotCalibrated: who works must live, and the fault must be
            seen.
        prepared : object
            None where there is nothing, or its making failed.

        """
        prepared = None
        try:
            value = self.request.run()
        except Exception as error:
            traceback.print_exc()
            value = NotCalibrated.of(NoEstimate('estimate_failed',
                                                error=f'{type(error).__name__}: {error}'))
        try:
            prepared = self.prepare(value, self.request) if self.prepare and value else None
        except Exception:  # a calibration must not be lost to what is drawn from it
            traceback.print_exc()
        return value, prepared


def load_estimator() -> None:
    """Load what estimates: the package itself loads nothing before it is used."""
    import_module('selfcal_ros.calibration.calibrate')


@dataclass(frozen=True)
class JobResult(Generic[R]):
    """What became of a job: its value, and what was prepared from it (or None)."""

    job: Job[R]
    value: Any
    prepared: Any = None
