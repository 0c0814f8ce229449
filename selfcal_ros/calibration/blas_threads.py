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
"""
One thread for linear algebra while an estimate is made.

The estimator's matrices are small. Threads of BLAS only wait for each other there: on two cores
an estimate took four times the processor time, and twice the time on the clock.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

_Arguments = ParamSpec('_Arguments')
_Result = TypeVar('_Result')


def on_one_thread(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """
    Let BLAS use one thread inside of a function, and what it used before afterwards.

    Where `threadpoolctl` is not installed the threads stay as they are: set OMP_NUM_THREADS=1.

    Parameters
    ----------
    function : callable

    Returns
    -------
    callable
        The same function otherwise.

    """
    @wraps(function)
    def limited(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        try:
            from threadpoolctl import threadpool_limits
        except ImportError:
            return function(*args, **kwargs)
        with threadpool_limits(1, 'blas'):
            return function(*args, **kwargs)
    return limited
