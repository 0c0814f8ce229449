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
"""Many seeded runs on two processes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
import multiprocessing
import os


def run_seeds(function: Callable, seeds, processes: int = 2) -> list:
    """
    Call function(seed) for every seed, in processes of their own.

    Parameters
    ----------
    function : callable
        Of a module, or a functools.partial of such a one; makes its Generator from the seed.
    seeds : iterable of int
    processes : int
        1 runs in this process.

    Returns
    -------
    list
        In the order of the seeds, whatever the number of processes.

    """
    seeds = list(seeds)
    processes = min(processes, len(seeds))
    if processes < 2:
        return [function(seed) for seed in seeds]
    # threads inside of processes only take turns
    os.environ.setdefault('OMP_NUM_THREADS', '1')
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(processes, context) as pool:
        return list(pool.map(function, seeds, chunksize=max(1, len(seeds) // (8 * processes))))
