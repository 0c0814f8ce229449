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
Python modules as processes of their own, which end with the process that started them.

Each has a session of its own, so that Ctrl-C in a terminal reaches the parent alone, which then
ends them in order. Where the parent is killed, Linux tells them (`python -m
selfcal_ros.pipeline.child_process PARENT MODULE ...` asks for that, and becomes the module).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from typing import IO

#: A process that does not end by itself gets so long before it is killed, seconds.
GRACE_S = 5.0
#: The number of PR_SET_PDEATHSIG in <linux/prctl.h>.
_SET_PARENT_DEATH_SIGNAL = 1


def start_module(module: str, arguments: Iterable[str] = (),
                 environment: Mapping[str, str] | None = None,
                 stderr: int | None = None) -> subprocess.Popen[bytes]:
    """
    Start `python -m module`.

    Parameters
    ----------
    module : str
    arguments : iterable of str
    environment : mapping of str to str, optional
        By default that of this process.
    stderr : int, optional
        As of `subprocess.Popen`; by default that of this process.

    Returns
    -------
    subprocess.Popen
        It gets SIGTERM when the thread that called this ends; see also `end_processes`.

    """
    return subprocess.Popen([sys.executable, '-m', __name__, str(os.getpid()), module, *arguments],
                            env=environment, stderr=stderr, start_new_session=True)


def end_processes(processes: Iterable[subprocess.Popen[bytes]], grace_s: float = GRACE_S) -> None:
    """
    End processes together, gently at first.

    Parameters
    ----------
    processes : iterable of subprocess.Popen
    grace_s : float
        From SIGTERM to SIGKILL, seconds.

    """
    processes = list(processes)
    deadline = time.monotonic() + grace_s
    for process in processes:
        # of one that has ended this does nothing
        process.terminate()
    try:
        for process in processes:
            with suppress(subprocess.TimeoutExpired):
                process.wait(max(deadline - time.monotonic(), 0.01))
    finally:
        for process in processes:
            if process.poll() is None:
                process.kill()
                process.wait()


def run_module(module: str, arguments: Iterable[str] = (),
               environment: Mapping[str, str] | None = None) -> int:
    """
    Run `python -m module` to its end; whatever breaks that off ends the process.

    What it and its own processes write to standard error is passed on, until it is broken off:
    libraries of C that are ended in the middle of something complain.

    Parameters
    ----------
    module : str
    arguments : iterable of str
    environment : mapping of str to str, optional

    Returns
    -------
    int
        Its exit status; negative: the signal that ended it.

    """
    process = start_module(module, arguments, environment, subprocess.PIPE)
    assert process.stderr is not None
    broken_off = threading.Event()
    relay = threading.Thread(target=_pass_on, args=(process.stderr, broken_off), daemon=True)
    relay.start()
    try:
        status = process.wait()
        # a process that it has left behind may keep the pipe open
        relay.join(GRACE_S)
        return status
    except BaseException:
        broken_off.set()
        # it ends its own processes first, and may need GRACE_S for that
        end_processes([process], 2 * GRACE_S)
        raise


def _pass_on(stream: IO[bytes], broken_off: threading.Event) -> None:
    """Write lines to our standard error; those that come later are read, and not written."""
    with stream:
        for line in stream:
            if not broken_off.is_set():
                with suppress(OSError):
                    print(line.decode(errors='replace'), end='', file=sys.stderr, flush=True)


def end_with(parent: int) -> None:
    """
    Ask for SIGTERM when the parent ends, which also holds for what this process becomes.

    Parameters
    ----------
    parent : int
        Number of the process that should be the parent. Where it has ended meanwhile, this one
        ends at once.

    """
    with suppress(AttributeError, OSError, TypeError):
        # where there is no prctl, the parent's own end must do
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, int(signal.SIGTERM), 0, 0, 0)
    if os.getppid() != parent:
        # it has ended in the meantime
        sys.exit(1)


def main() -> None:
    """Become the module that the command line names."""
    parent, *words = sys.argv[1:]
    end_with(int(parent))
    os.execv(sys.executable, [sys.executable, '-m', *words])


if __name__ == '__main__':
    main()
