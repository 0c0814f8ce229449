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
"""Nodes as processes of their own, for whoever plays a bag through them and waits for the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack
import json
import os
from pathlib import Path
import signal
import subprocess
import threading
import time
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_default_context
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.nodes.parameters import BagPlayerParameters
from selfcal_ros.pipeline.child_process import end_processes, start_module
from selfcal_ros.pipeline.replay import ImageRecording

#: The signals that have come while nodes run.
_CAME: list[int] = []


class ReplayTimeout(Exception):
    """The nodes did not come to a result in time."""


class StoppedBySignal(Exception):
    """SIGINT, SIGTERM or SIGHUP came; `node_processes` ends the nodes and passes it on."""


class NodeProcesses:
    """
    The processes that have been started.

    Parameters
    ----------
    domain_id : int, optional
        Where their nodes meet; by default where the environment says.

    """

    def __init__(self, domain_id: int | None = None) -> None:
        self._environment = None if domain_id is None else {
            **os.environ, 'ROS_DOMAIN_ID': str(domain_id)}
        self._started: list[tuple[str, subprocess.Popen[bytes]]] = []

    def start(self, module: str, parameters: dict[str, Any]) -> subprocess.Popen[bytes]:
        """Start `selfcal_ros.nodes.MODULE` with parameters."""
        words = ['--ros-args']
        for name, value in parameters.items():
            words += ['-p', f'{name}:={json.dumps(value)}']
        process = start_module(f'selfcal_ros.nodes.{module}', words, self._environment)
        self._started.append((module, process))
        return process

    def alive(self) -> bool:
        """
        Return True while every node runs, or has ended with status 0.

        Raises
        ------
        ReplayTimeout
            If one has failed.

        """
        for module, process in self._started:
            if process.poll() not in (None, 0):
                raise ReplayTimeout(f'{module} ended with status {process.returncode}')
        return True

    def end(self) -> None:
        """End them all, gently at first."""
        end_processes(process for _, process in self._started)


@contextmanager
def node_processes() -> Iterator[NodeProcesses]:
    """
    Start ROS in this process, and let nodes be started; all of it ends with the block.

    ROS that runs here already is used, with its domain, and goes on.

    SIGINT, SIGTERM and SIGHUP end `wait_for`, and do what they would have done after the block.
    """
    with _signals_kept(), ExitStack() as stack:
        if not rclpy.ok():
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            stack.callback(rclpy.try_shutdown)
        processes = NodeProcesses(get_default_context().get_domain_id())
        stack.callback(processes.end)
        yield processes


def wait_for(node: Node, condition: Callable[[], object], timeout_s: float, what: str) -> None:
    """
    Spin a node until a condition holds.

    Raises
    ------
    ReplayTimeout
        If it does not in time.

    """
    deadline = time.monotonic() + timeout_s
    while not condition():
        if _CAME:
            raise StoppedBySignal
        if time.monotonic() > deadline:
            raise ReplayTimeout(f'no {what} within {timeout_s:.0f} s')
        rclpy.spin_once(node, timeout_sec=0.05)


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Keep what would end the process until its nodes have ended, then let it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _CAME.clear()
    before = {}
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        # whoever is ignored, as under nohup, stays so
        if signal.getsignal(number) != signal.SIG_IGN:
            before[number] = signal.signal(number, lambda came, _: _CAME.append(came))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if _CAME:
            os.kill(os.getpid(), _CAME[0])


def end_silently() -> None:
    """Let Ctrl-C end the process without a traceback where it has nothing to clean up."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def images_of(bag: str | Path, rate: float) -> tuple[int, float]:
    """
    Look through the images of a bag before anything starts.

    Parameters
    ----------
    bag : str or Path
    rate : float
        Playback speed.

    Returns
    -------
    last_ns : int
        Stamp of the last image.
    playing_s : float
        How long it takes to play them.

    Raises
    ------
    InputError, ArgumentError
        If there are none, the bag cannot be read, or bag_player does not know such a rate.

    """
    allowed = BagPlayerParameters.__dataclass_fields__['rate'].metadata
    if not allowed['low'] <= rate <= allowed['high']:
        raise ArgumentError(f'The playback speed must be from {allowed["low"]:g} to '
                            f'{allowed["high"]:g}, not {rate:g}.')
    with ImageRecording(bag) as recording:
        logged = [stamp for stamp, _ in recording.messages()]
        stamps = [frame.stamp_ns for frame in recording]
    if not logged or not stamps:
        raise InputError(f'{bag} holds no image that can be read; choose another bag.')
    return stamps[-1], (logged[-1] - logged[0]) * 1e-9 / rate
