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
Replays a bag through bag_player and rorapid_tracker, as processes of their own.

The demo runs this as `python -m selfcal_ros.nodes.tracking_supervisor BAG --output FOLDER --model
MODEL --camera CAMERA.YAML --start-pose POSE`; it leaves node_poses.json in the folder: stamp,
pose (3x4) and covariance (6x6) of every pose that came.
"""

from __future__ import annotations

import argparse
from contextlib import ExitStack
import json
import os
from pathlib import Path
import sys
import time
from typing import Any, TypeAlias

from geometry_msgs.msg import PoseWithCovarianceStamped
from msg_adapters.message_types import Message
from msg_adapters.poses import pose_covariance, pose_matrix
from msg_adapters.stamps import stamp_ns
from rclpy.node import Node

from selfcal_ros.errors import SelfcalError
from selfcal_ros.nodes.node_processes import (end_silently, images_of, node_processes,
                                              ReplayTimeout, wait_for)
from selfcal_ros.nodes.quality_of_service import PER_IMAGE
from selfcal_ros.values.output_files import atomic_write

#: Nothing has come for so long after the end of the bag: nothing more will.
SILENCE_S = 2.0
#: Stamp in ns, pose (3, 4) and covariance (6, 6).
StampedPose: TypeAlias = tuple[int, list[list[float]], list[list[float]]]


class PoseListener(Node):
    """Gathers poses."""

    def __init__(self) -> None:
        super().__init__('tracking_supervisor')
        self.poses: list[StampedPose] = []
        self.heard = time.monotonic()
        self.create_subscription(PoseWithCovarianceStamped, 'pose', self._on_pose, PER_IMAGE)

    def _on_pose(self, msg: Message) -> None:
        self.poses.append((stamp_ns(msg.header.stamp), pose_matrix(msg)[:3].tolist(),
                           pose_covariance(msg).tolist()))
        self.heard = time.monotonic()


def replay_tracking(bag: str | Path, parameters: dict[str, Any], rate: float = 1.0,
                    timeout_s: float = 120.0) -> list[StampedPose]:
    """
    Replay a bag through the tracker, two processes over DDS.

    Parameters
    ----------
    bag : str or Path
    parameters : dict
        Of rorapid_tracker.
    rate : float
        Playback speed.
    timeout_s : float
        For each step, on top of the playing time.

    Returns
    -------
    list of (int, list, list)
        Stamp in ns, pose (3, 4) and covariance (6, 6) of every pose.

    Raises
    ------
    ReplayTimeout
        If the nodes do not come to an end in time, or one of them fails.
    InputError, ArgumentError
        If the bag or the rate cannot be used.

    """
    last_ns, playing_s = images_of(bag, rate)
    with node_processes() as processes, ExitStack() as stack:
        listener = PoseListener()
        stack.callback(listener.destroy_node)
        processes.start('rorapid_tracker', {'silence_s': 600.0, **parameters})
        wait_for(listener, lambda: processes.alive() and listener.count_publishers('pose') > 0
                 and listener.count_subscribers('image/compressed') > 0, timeout_s,
                 'connection between the nodes')
        player = processes.start('bag_player', {'bag': str(Path(bag).absolute()), 'rate': rate})
        wait_for(listener, lambda: processes.alive() and player.poll() is not None,
                 playing_s + timeout_s, 'end of the bag')
        listener.heard = time.monotonic()
        wait_for(listener, lambda: (listener.poses and listener.poses[-1][0] >= last_ns)
                 or time.monotonic() - listener.heard > SILENCE_S, timeout_s,
                 'end of the poses')
        return list(listener.poses)


def main(argv: list[str] | None = None) -> int:
    """Run from the command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('bag')
    parser.add_argument('--output', type=Path, required=True)
    for name in ('model', 'camera', 'start-pose'):
        parser.add_argument(f'--{name}', type=Path, required=True)
    parser.add_argument('--rate', type=float, default=1.0)
    parser.add_argument('--timeout', type=float, default=120.0)
    args = parser.parse_args(argv)
    end_silently()
    os.environ.setdefault('ROS_LOG_DIR', str(args.output / 'log'))
    parameters = {'model': str(args.model), 'camera_file': str(args.camera),
                  'start_pose': str(args.start_pose)}
    try:
        poses = replay_tracking(args.bag, parameters, args.rate, args.timeout)
    except ReplayTimeout as error:
        print(f'The nodes came to no poses: {error}.', file=sys.stderr)
        return 2
    except SelfcalError as error:
        print(error, file=sys.stderr)
        return 2
    atomic_write(args.output / 'node_poses.json', json.dumps(poses) + '\n')
    return 0 if poses else 1


if __name__ == '__main__':
    sys.exit(main())
