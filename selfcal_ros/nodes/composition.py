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
all_nodes: several nodes in one process, for the least latency from image to CameraInfo.

`all_nodes feature_tracker planar_calibrator --ros-args ...` runs these nodes in one executor; the
two are what runs by default. Names, topics, parameters and services are those of the nodes in
processes of their own; remappings and parameters on the command line hold for all of them, and
`-r planar_calibrator:camera_info:=...` for one.

Three things are different. Tracks go from the tracker to the calibrator without a message in
between. The CameraInfo of an image goes out before its points are followed. Estimates run in a
child process, where they cannot hold the interpreter while an image waits.
"""

from __future__ import annotations

from importlib import import_module
import sys
from typing import Any, TYPE_CHECKING

from selfcal_ros.nodes.entry_point import run_nodes

if TYPE_CHECKING:
    from rclpy.node import Node

#: What can be composed: the modules whose make_node() returns the node.
COMPOSABLE = ('feature_tracker', 'planar_calibrator', 'affine_calibrator', 'rorapid_tracker',
              'camera_info_publisher', 'calibration_page', 'bag_player')
DEFAULT = ('feature_tracker', 'planar_calibrator')


def wanted_nodes(arguments: list[str]) -> tuple[str, ...]:
    """
    Return the names on the command line that come before --ros-args.

    Raises
    ------
    ArgumentError
        If one is no node of ours, or is there twice.

    """
    from selfcal_ros.errors import ArgumentError
    end = arguments.index('--ros-args') if '--ros-args' in arguments else len(arguments)
    names = tuple(arguments[:end]) or DEFAULT
    for name in names:
        if name not in COMPOSABLE or names.count(name) > 1:
            raise ArgumentError(f'all_nodes takes each of {", ".join(COMPOSABLE)} at most once, '
                                f'not {" ".join(names)!r}.')
    return names


def make_nodes(names: tuple[str, ...]) -> list[Node]:
    """Make the nodes, and connect those that can talk without messages."""
    nodes = [import_module(f'selfcal_ros.nodes.{name}').make_node(**_options(name))
             for name in names]
    hand_over(nodes)
    return nodes


def _options(name: str) -> dict[str, type]:
    """Return what a node is made with when it has company."""
    if not name.endswith('_calibrator'):
        return {}
    from selfcal_ros.nodes.estimation_process import EstimationProcess
    return {'worker': EstimationProcess}


def hand_over(nodes: list[Any]) -> None:
    """
    Let trackers give their tracks to the calibrators among the nodes that subscribe to them.

    Their subscriptions end, or each of the tracks would come twice.
    """
    for tracker in nodes:
        for listener in nodes if hasattr(tracker, 'listeners') else ():
            if hasattr(listener, 'announce') and listener.tracks is not None \
                    and listener.tracks.topic_name == tracker.tracks.topic_name:
                tracker.listeners.append(listener)
                listener.listen_no_more()


def main(args: list[str] | None = None) -> int:
    """Run the nodes; returns the exit status."""
    arguments = sys.argv[1:] if args is None else list(args)
    return run_nodes(lambda: make_nodes(wanted_nodes(arguments)), args)


if __name__ == '__main__':
    sys.exit(main())
