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
"""Start, spin and end of a node process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from importlib.util import find_spec
import os
import signal
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import FrameType

    from rclpy.executors import Executor
    from rclpy.node import Node
    from rclpy.task import Future

# nothing heavy here: until run_node is reached, Ctrl-C prints a traceback


class StopSignals:
    """
    SIGINT and SIGTERM while a node starts: the process ends, silently and with status 0.

    Loading the libraries and starting ROS takes a second. An exception in the middle of that is a
    traceback for a user who only pressed those keys. Once the node spins, `handed_over` leaves the
    signals to rclpy, which calls this handler before its own.
    """

    def __init__(self) -> None:
        self.handed_over = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._stop)

    def _stop(self, _: int, __: FrameType | None) -> None:
        if not self.handed_over:
            # no clean-up: half of what it would clean up is not there yet
            os._exit(0)
        # rclpy shuts its context down, which ends spin() between two callbacks; an exception from
        # here could hit rclpy in the middle of making an object, which then complains

    @staticmethod
    def ignore() -> None:
        """Let nothing break the teardown: a second Ctrl-C, or launch's own after the user's."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def usage(name: str) -> str:
    """Return what a node says when it is asked for help: topics, services and parameters."""
    import textwrap

    from selfcal_ros.nodes.interfaces import INTERFACES
    from selfcal_ros.nodes.parameters_table import literal, PARAMETERS
    names = list(PARAMETERS)
    lines = [f'usage: {name} --ros-args [-p NAME:=VALUE ...] [--params-file FILE] '
             '[-r TOPIC:=OTHER ...]', '']
    if name not in PARAMETERS:
        lines[0] = f'usage: all_nodes [{"] [".join(names)}] --ros-args ...'
        return '\n'.join([*lines, 'Runs these nodes in one process; each tells of its own '
                          'parameters: feature_tracker --help, for example.'])

    def entry(head: str, text: str) -> list[str]:
        return [f'  {head}', *textwrap.wrap(text, 90, initial_indent=' ' * 6,
                                            subsequent_indent=' ' * 6)]

    for end in INTERFACES[name]:
        lines += entry(f'{end.direction:8}{end.name}  ({end.type})', end.description)
    lines += ['', 'parameters (* changes while the node runs, by `ros2 param set`):']
    for one in fields(PARAMETERS[name]):
        star = ' *' if one.metadata['live'] else ''
        lines += entry(f'{one.name}:={literal(one.default)}{star}', one.metadata['description'])
    return '\n'.join(lines)


def plain_arguments(args: list[str]) -> list[str]:
    """Return what is not for ROS: all but what stands between --ros-args and --."""
    plain, is_for_ros = [], False
    for one in args:
        if one in ('--ros-args', '--'):
            is_for_ros = one == '--ros-args'
        elif not is_for_ros:
            plain.append(one)
    return plain


def refusal(name: str, args: list[str]) -> str:
    """Say what is wrong with arguments of a node that takes none but those of ROS; '' if none."""
    unknown = plain_arguments(args)
    if not unknown:
        return ''
    first, text = unknown[0], f'{name} takes no argument {unknown[0]!r:.60}'
    given = first.removeprefix('-p').strip()
    if ':=' in given:
        option = '-r' if given.startswith(('/', '_', 'image:=', 'camera_info:=')) else '-p'
        return f'{text}; say --ros-args {option} {given:.60}'
    return f'{text}; parameters follow --ros-args -p, and {name} --help lists them'


def spin_until(executor: Executor, finished: Future) -> None:
    """
    Spin until a future is done.

    The executor's own function of this kind adds a callback to the future at every wake-up.
    """
    finished.add_done_callback(lambda _: executor.wake())
    while executor.context.ok() and not finished.done():
        executor.spin_once()


def run_node(make_node: Callable[[], Node], args: list[str] | None = None) -> int:
    """Run one node until it is finished or told to stop; see `run_nodes`."""
    given = sys.argv[1:] if args is None else args
    name = program_name()
    if not asks_for_help(given) and refusal(name, given):
        print(f'{refusal(name, given)}.', file=sys.stderr)
        return 2
    return run_nodes(lambda: [make_node()], args)


def program_name() -> str:
    """Return the name of the node as the user has called it."""
    return os.path.splitext(os.path.basename(sys.argv[0]))[0]


def asks_for_help(given: list[str]) -> bool:
    """Tell whether a person asks what there is."""
    return bool({'-h', '--help'} & set(plain_arguments(given)))


def run_nodes(make_nodes: Callable[[], list[Node]], args: list[str] | None = None) -> int:
    """
    Run nodes in one executor until they are finished or told to stop.

    Parameters
    ----------
    make_nodes : callable
        Returns the nodes. If there is one only, and it has an attribute `finished` (a Future),
        its completion ends the run.
    args : list of str, optional
        Command line, sys.argv by default.

    Returns
    -------
    int
        Exit status: 0, or 2 when an input or a parameter is wrong, or there is no ROS.

    """
    signals = StopSignals()
    given = sys.argv[1:] if args is None else args
    if asks_for_help(given):
        print(usage(program_name()))
        return 0
    if find_spec('rclpy') is None:
        print(f"{program_name()} is a ROS node, and there is no ROS in this Python: source ROS 2, "
              "or pip install '.[ros-wheels]' in the clone.", file=sys.stderr)
        return 2
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    from selfcal_ros.errors import SelfcalError
    from selfcal_ros.nodes.parameter_words import in_parameters
    from selfcal_ros.nodes.shared_memory import sweep
    from selfcal_ros.nodes.start_failure import domain_problem, start_failure, unheard
    problem = domain_problem(os.environ.get('ROS_DOMAIN_ID', ''))
    if problem:
        print(problem, file=sys.stderr)
        return 2
    sweep()
    try:
        with unheard():
            rclpy.init(args=args)
    except Exception as error:  # RCLError is private
        print(start_failure(error), file=sys.stderr)
        return 2
    nodes: list[Node] = []
    try:
        # before the nodes: an executor whose making a signal interrupts complains as it goes
        executor = SingleThreadedExecutor()
        nodes = make_nodes()
        for node in nodes:
            executor.add_node(node)
        finished = getattr(nodes[0], 'finished', None) if len(nodes) == 1 else None
        signals.handed_over = True
        if finished is None:
            executor.spin()
        else:
            spin_until(executor, finished)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except SelfcalError as error:
        print(in_parameters(str(error)), file=sys.stderr)
        return 2
    except Exception:
        # SIGINT and SIGTERM can invalidate the context between two calls inside spin()
        if rclpy.ok():
            raise
    finally:
        signals.ignore()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
