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
"""Many seeded runs on two processes; single runs can be kept in a file."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
import json
import multiprocessing
import os
from pathlib import Path


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


def kept_runs(function: Callable, tasks, folder, processes: int = 2) -> dict[tuple, dict]:
    """
    Run the tasks that a folder has no run of; each line is written at once.

    Parameters
    ----------
    function : callable
        (task) -> dict of numbers, texts, lists and arrays; of a module, or a partial.
    tasks : iterable of tuple
    folder : path or None
        Without one all are run and none is kept.
    processes : int

    Returns
    -------
    dict
        By task, of all that lie there, those of other tasks, too. Arrays are lists.

    """
    if folder is None:
        lines = run_seeds(partial(_line, function), tasks, processes)
        return dict(map(_parsed, lines))
    file = Path(folder) / 'runs.jsonl'
    file.parent.mkdir(parents=True, exist_ok=True)
    kept = _read(file)
    run_seeds(partial(_keep, function, file), [task for task in tasks if task not in kept],
              processes)
    return _read(file)


def _line(function: Callable, task: tuple) -> str:
    return json.dumps(function(task) | {'task': task}, default=lambda value: value.tolist())


def _keep(function: Callable, file: Path, task: tuple) -> None:
    line = _line(function, task) + '\n'
    with file.open('a', encoding='utf-8') as out:
        out.write(line)


def _parsed(line: str) -> tuple[tuple, dict]:
    fields = json.loads(line)
    return tuple(fields.pop('task')), fields


def _read(file: Path) -> dict[tuple, dict]:
    if not file.exists():
        return {}
    return dict(map(_parsed, file.read_text(encoding='utf-8').splitlines()))
