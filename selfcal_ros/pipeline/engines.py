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
Run one function over many jobs: in processes of this machine, or on a Dask cluster.

A job that fails is a value, also where it cannot even begin; one that takes its process with it
(out of memory, a crash in a decoder) costs its own result and nobody else's. Every process
computes with one thread: many jobs share the cores better than many threads in each.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, ExitStack
from functools import partial
import logging
import multiprocessing
from multiprocessing.connection import wait as wait_for_any
import os
import shutil
import signal
import tempfile
import threading
import time
from typing import Any, TYPE_CHECKING, TypedDict, TypeVar

from selfcal_ros.errors import ArgumentError, InputError

if TYPE_CHECKING:
    from dask.distributed import Client, Future as DaskFuture

ENGINES = ('processes', 'dask')
#: What a job is.
Job = TypeVar('Job')
#: What it gives.
Value = TypeVar('Value')
#: What NumPy's libraries read when they load.
_THREAD_LIMITS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS',
                  'VECLIB_MAXIMUM_THREADS', 'NUMEXPR_NUM_THREADS')
#: Settings of a cluster of our own. Dask makes the C library give memory back at every chance,
#: which costs half as much time again as computing with it, and samples what workers do.
_LOCAL_DASK = {'distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_': None,
               'distributed.worker.profile.enabled': False,
               # a job whose worker dies runs again, alone, and not four times among others
               'distributed.scheduler.allowed-failures': 0}
#: A cluster without any worker for so long is given up, seconds: some start them on demand.
NO_WORKERS_S = 60.0
#: How long to wait for a cluster's scheduler, and then for its first worker, seconds.
CONNECT_S, FIRST_WORKER_S = 10.0, 10.0
CRASHED = 'its process died, as for want of memory or from a file that crashes a decoder.'


class EngineOptions(TypedDict, total=False):
    """How jobs are run; see `run_jobs`."""

    engine: str
    workers: int | None
    scheduler: str | None


def core_count() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_jobs(function: Callable[[Job], Value], jobs: list[Job], *, engine: str = 'processes',
             workers: int | None = None, scheduler: str | None = None,
             ) -> Iterator[tuple[int, Value | BaseException | None]]:
    """
    Run a function over jobs, and yield the results as they come.

    Parameters
    ----------
    function : callable
        Of a module, of one job; returns a value and raises nothing.
    jobs : list
        Like the values, these travel between processes.
    engine : {'processes', 'dask'}
    workers : int, optional
        Processes; by default one a core.
    scheduler : str, optional
        Address of a Dask scheduler, tcp://host:8786 for example; its workers must see the same
        files under the same names. By default a cluster of this machine alone.

    Yields
    ------
    int
        Number of the job.
    object
        Its value; None if its process died, the exception if it raised one or could not be begun.

    Raises
    ------
    ArgumentError
        If the engine is unknown or not installed, or the options contradict each other.
    InputError
        If the scheduler cannot be reached, or it or all its workers are lost on the way.

    """
    if engine not in ENGINES:
        raise ArgumentError(f'The engine {engine!r} is unknown; choose one of '
                            f'{", ".join(ENGINES)}.')
    if workers is not None and workers < 1:
        raise ArgumentError(f'The number of processes must be positive, not {workers}.')
    if scheduler and engine != 'dask':
        raise ArgumentError('A scheduler belongs to --engine dask.')
    workers = min(workers or core_count(), max(len(jobs), 1))
    if engine == 'dask':
        yield from _on_dask(function, jobs, workers, scheduler)
    else:
        yield from _in_processes(function, jobs, workers)


def _prepare_process(temporary: str) -> None:
    """Make a process compute with one thread, leave Ctrl-C to its parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tempfile.tempdir = temporary
    threading.Thread(target=_end_with_parent, args=(temporary,), daemon=True).start()
    _one_thread()


def _end_with_parent(temporary: str) -> None:
    """End this process once its parent has ended in whatever way; nobody wants its result."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    # a pipe whose other end nobody but the parent holds
    wait_for_any([parent.sentinel])
    shutil.rmtree(temporary, ignore_errors=True)
    os._exit(1)


def _one_thread() -> None:
    """Keep OpenCV to one thread; NumPy's libraries know from the environment."""
    import cv2
    cv2.setNumThreads(1)


@contextmanager
def _thread_limits() -> Iterator[None]:
    """Let processes that start meanwhile inherit an environment of one thread."""
    before = {name: os.environ.get(name) for name in _THREAD_LIMITS}
    os.environ.update(dict.fromkeys(_THREAD_LIMITS, '1'))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of processes; what is left of them ends with the block, whatever ends that."""
    others = set(multiprocessing.active_children())
    with _thread_limits(), tempfile.TemporaryDirectory(
            prefix='selfcal-', ignore_cleanup_errors=True) as temporary:
        # a forked process would inherit locks of the parent's threads
        pool = ProcessPoolExecutor(workers, initializer=_prepare_process, initargs=(temporary,),
                                   mp_context=multiprocessing.get_context('spawn'))
        try:
            yield pool
        except BrokenProcessPool:
            raise
        except BaseException:
            # Ctrl-C: nobody waits for the rest
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _in_processes(function: Callable[[Job], Value], jobs: list[Job], workers: int,
                  ) -> Iterator[tuple[int, Value | BaseException | None]]:
    """Run in a pool; after a crash those that were running run again, each alone."""
    waiting = deque(range(len(jobs)))
    suspects: deque[int] = deque()
    while waiting or suspects:
        alone = bool(suspects)
        queue = deque([suspects.popleft()]) if alone else waiting
        running: dict[Future[Value], int] = {}
        try:
            with _process_pool(1 if alone else workers) as pool:
                yield from _ended(pool, function, jobs, queue, running, workers)
        except BrokenProcessPool:
            if alone:
                yield from ((number, None) for number in running.values())
            else:
                suspects.extend(running.values())


def _ended(pool: ProcessPoolExecutor, function: Callable[[Job], Value], jobs: list[Job],
           queue: deque[int], running: dict[Future[Value], int], workers: int,
           ) -> Iterator[tuple[int, Value | BaseException]]:
    """
    Yield number and result, or exception, of each job of a queue as it ends.

    `queue` and `running` are kept up to date, for the case that a process crashes.
    """
    while queue or running:
        # no more than there are processes: what is running at a crash is suspect
        while queue and len(running) < workers:
            future = pool.submit(function, jobs[queue[0]])
            running[future] = queue.popleft()
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            failure = future.exception()
            if isinstance(failure, BrokenProcessPool):
                raise failure
            yield running.pop(future), failure or future.result()


def _on_dask(function: Callable[[Job], Value], jobs: list[Job], workers: int,
             scheduler: str | None) -> Iterator[tuple[int, Value | BaseException | None]]:
    """Run on a cluster; jobs whose worker died run again, each alone."""
    try:
        import dask
        from dask.distributed import Client, KilledWorker, LocalCluster
    except ImportError:
        raise ArgumentError('--engine dask needs Dask, which is not installed: pip install '
                            "'.[dask]' in the clone (or sudo apt install "
                            'python3-distributed).') from None
    with ExitStack() as stack:
        if scheduler:
            client = _connected(Client, scheduler)
        else:
            stack.enter_context(_thread_limits())
            stack.enter_context(dask.config.set(_LOCAL_DASK))
            # its web page is empty and at any free port; what fails we say ourselves
            cluster = stack.enter_context(LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address='127.0.0.1:0',
                scheduler_kwargs={'dashboard': False}, silence_logs=logging.CRITICAL))
            client = Client(cluster)
        stack.enter_context(client)
        try:
            client.run(_one_thread)
        except ImportError as error:
            raise InputError(f'The workers of {scheduler} cannot compute: {error}; install '
                             'selfcal_ros there.') from None
        suspects = []
        futures = client.map(partial(_run_with_one_thread, function), jobs, pure=False, retries=0)
        numbers = {future.key: number for number, future in enumerate(futures)}
        arriving = _arriving(client, futures, scheduler)
        # each result is let go of as soon as it is here
        del futures
        for key, value in arriving:
            if isinstance(value, KilledWorker):
                # also those that only waited on a worker when another job took it away
                suspects.append(numbers[key])
            else:
                yield numbers[key], value
        for number in suspects:
            future = client.submit(_run_with_one_thread, function, jobs[number], pure=False,
                                   retries=0)
            for _, value in _arriving(client, [future], scheduler):
                yield number, None if isinstance(value, KilledWorker) else value


def _connected(make_client: Callable[..., Client], scheduler: str) -> Client:
    """Connect to a scheduler that has workers."""
    try:
        client = make_client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise InputError(f'The Dask scheduler {scheduler} cannot be reached '
                         f'({" ".join(str(error).split())[:120]}).') from None
    try:
        client.wait_for_workers(1, timeout=FIRST_WORKER_S)
    except TimeoutError:
        client.close()
        raise InputError(f'The Dask scheduler {scheduler} has no workers; start some: dask '
                         f'worker {scheduler} --nworkers auto --nthreads 1') from None
    return client


def _arriving(client: Client, futures: list[DaskFuture], scheduler: str | None,
              ) -> Iterator[tuple[str, Any]]:
    """Yield key, and value or exception, of each job that ends, while there is who runs it."""
    from dask.distributed import as_completed, CancelledError
    name = scheduler or 'of this machine'
    # not with their results: as_completed forgets a job that had ended, whose worker died before
    # the result was fetched, and which then fails when it runs again
    ending = as_completed(futures)
    ended: list[DaskFuture] = []
    looked = seen = time.monotonic()
    while ended or not ending.is_empty():
        while ending.has_ready():
            ended.append(next(ending))
        future = next((one for one in ended if one.done()), None)
        if future is None:
            time.sleep(0.02)
        else:
            try:
                value, here = future.result(timeout=NO_WORKERS_S), True
            except (Exception, CancelledError) as error:
                # where it was not fetched in time, or went with its worker, the job runs again
                value, here = error, future.status == 'error' or (
                    future.done() and not isinstance(error, TimeoutError))
            if future.cancelled():
                raise InputError(f'The Dask scheduler {name} was lost on the way; what was '
                                 'finished before is there.')
            if here:
                ended.remove(future)
                yield future.key, value
                continue
        now = time.monotonic()
        if now - looked > 1:
            looked = now
            if client.scheduler_info()['workers']:
                seen = now
            elif now - seen > NO_WORKERS_S:
                raise InputError(f'The Dask scheduler {name} has had no workers for '
                                 f'{NO_WORKERS_S:.0f} s; start some and run again. What was '
                                 'finished before is there.')


def _run_with_one_thread(function: Callable[[Job], Value], job: Job) -> Value:
    """Run a job on a worker, which may have been started anew since it was prepared."""
    _one_thread()
    return function(job)
