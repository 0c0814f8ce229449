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
"""`selfcal watch`: the live page of the nodes that run, until Ctrl-C."""

from __future__ import annotations

import argparse
from importlib.util import find_spec
import subprocess
import sys

from selfcal_ros.cli.ros_environment import ros_environment
from selfcal_ros.errors import ArgumentError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `selfcal watch`."""
    parser.add_argument('--calibrator', metavar='NAME', default='',
                        help='node to watch, such as /left/planar_calibrator (default the first '
                             'that speaks)')
    parser.add_argument('--namespace', metavar='NAME', default='',
                        help='of the nodes to watch, where there are several')
    parser.add_argument('--host', metavar='ADDRESS', default='',
                        help='address to serve on (default 127.0.0.1: this machine only); of any '
                             'other the page asks for the token in the printed address')
    parser.add_argument('--port', type=int, default=None,
                        help='of the address; 0: any that is free (default 8765, or the next '
                             'that is free)')


def run(args: argparse.Namespace) -> int:
    """Run the node that serves the page; returns its exit status."""
    from selfcal_ros.cli.shared_files import shared_file
    if find_spec('rclpy') is None:
        raise ArgumentError('selfcal watch shows what ROS nodes do, and there is no ROS in this '
                            "Python: source ROS 2, or pip install '.[ros-wheels]' in the clone.")
    if args.port is not None and not 0 <= args.port < 65536:
        raise ArgumentError(f'--port must be from 0 to 65535, not {args.port}.')
    command = [sys.executable, '-m', 'selfcal_ros.nodes.calibration_page', '--ros-args']
    for name in ('calibrator', 'host', 'port'):
        value = getattr(args, name)
        if value not in ('', None):
            command += ['-p', f'{name}:={value}']
    if args.namespace:
        command += ['-r', f'__ns:=/{args.namespace.strip("/")}']
    # finds the other nodes at once
    environment = ros_environment(shared_file('config/fastdds.xml'))
    # what the node says is what the user waits for, the address above all
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True,
                          errors='replace') as node:
        assert node.stderr is not None
        try:
            for line in node.stderr:
                print(line, end='', file=sys.stderr, flush=True)
        except BaseException:
            # the terminal has told the node, too; whoever else stops us has not
            node.terminate()
            raise
    return node.returncode
