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
Replays a bag through the real nodes, as processes of their own, and waits for the calibration.

The demo runs this as `python -m selfcal_ros.nodes.replay_supervisor BAG --output FOLDER`; it
leaves camera.yaml and result.json in the folder. Exit status as `selfcal calibrate`.
"""

from __future__ import annotations

import argparse
from contextlib import ExitStack
import json
import os
from pathlib import Path
import sys
import time
from typing import Any

from msg_adapters.stamps import stamp_ns
from rclpy.client import Client
from rclpy.node import Node
from selfcal_ros.errors import SelfcalError
from selfcal_ros.nodes.calibration_status import NOTHING_NEW, UNDER_WAY
from selfcal_ros.nodes.launch_arguments import CALIBRATORS
from selfcal_ros.nodes.node_processes import (end_silently, images_of, node_processes,
                                              ReplayTimeout, wait_for)
from selfcal_ros.nodes.quality_of_service import LATCHED, PER_IMAGE
from selfcal_ros.values.output_files import atomic_write
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import String
from std_srvs.srv import Trigger


class ReplaySupervisor(Node):
    """Listens to what the calibrator says, and tells when it has seen everything."""

    def __init__(self, calibrator: str = 'planar_calibrator') -> None:
        super().__init__('replay_supervisor')
        #: Stamp and K[0] of each.
        self.camera_infos: list[tuple[int, float]] = []
        self.results: list[dict[str, Any]] = []
        self.create_subscription(CameraInfo, 'camera_info', self._on_camera_info, PER_IMAGE)
        self.create_subscription(String, f'{calibrator}/result', self._on_result, LATCHED)
        self._calibrate = self.create_client(Trigger, f'{calibrator}/calibrate')
        self._save = self.create_client(Trigger, f'{calibrator}/save')
        self._heard = time.monotonic()

    def _on_camera_info(self, msg: CameraInfo) -> None:
        self.camera_infos.append((stamp_ns(msg.header.stamp), float(msg.k[0])))
        self._heard = time.monotonic()

    def _on_result(self, msg: String) -> None:
        self.results.append(json.loads(msg.data))

    def call(self, client: Client, timeout_s: float = 10.0) -> Trigger.Response:
        """Call a Trigger service and return its response."""
        wait_for(self, client.service_is_ready, timeout_s, f'service {client.srv_name}')
        future = client.call_async(Trigger.Request())
        wait_for(self, future.done, timeout_s, f'answer of {client.srv_name}')
        return future.result()

    def final_result(self, last_stamp_ns: int, timeout_s: float) -> dict[str, Any]:
        """Wait until the last image is through, then ask for an estimate from everything."""
        self._heard = time.monotonic()
        # the last image may have been dropped on a busy machine: then silence has to do
        wait_for(self, lambda: (self.camera_infos and self.camera_infos[-1][0] >= last_stamp_ns)
                 or time.monotonic() - self._heard > 2.0, timeout_s, 'end of the drive')
        while True:
            before = len(self.results)
            answer = self.call(self._calibrate)
            if answer.message == NOTHING_NEW:
                wait_for(self, self._calibrations, timeout_s, 'result')
                return self._calibrations()[-1]
            if answer.success:
                # what came until now is of estimates that had ended when this one began
                seen = len(self.results)
                wait_for(self, lambda: len(self.results) > seen, timeout_s, 'result')
                return self.results[-1]
            if answer.message not in UNDER_WAY:
                return self.results[-1] if self.results else {
                    'status': 'not_calibrated', 'reason': answer.message, 'advice': ''}
            # it may be of fewer images than there are: so ask again
            wait_for(self, lambda: len(self.results) > before, timeout_s, 'result')

    def _calibrations(self) -> list[dict[str, Any]]:
        return [result for result in self.results if result['status'] == 'calibrated']


def replay(bag: str | Path, output: Path, rate: float = 1.0, timeout_s: float = 120.0,
           calibrator: str = 'planar_calibrator',
           ) -> tuple[dict[str, Any], list[tuple[int, float]]]:
    """
    Replay a bag through feature_tracker and a calibrator, three processes over DDS.

    Parameters
    ----------
    bag : str or Path
    output : Path
        Folder for camera.yaml; it must exist.
    rate : float
        Playback speed.
    timeout_s : float
        For each step, on top of the playing time.
    calibrator : {'planar_calibrator', 'affine_calibrator'}

    Returns
    -------
    result : dict
        As in result.json.
    camera_infos : list of (int, float)
        Stamp and K[0] of each CameraInfo that came.

    Raises
    ------
    ReplayTimeout
        If the nodes do not come to a result in time, or one of them fails.
    InputError, ArgumentError
        If the bag or the rate cannot be used.

    """
    last_ns, playing_s = images_of(bag, rate)
    with node_processes() as processes, ExitStack() as stack:
        supervisor = ReplaySupervisor(calibrator)
        stack.callback(supervisor.destroy_node)
        # the silence after the end of the bag is no reason to warn
        processes.start(calibrator, {'output': str(Path(output) / 'camera.yaml'),
                                     'silence_s': 600.0})
        processes.start('feature_tracker', {'silence_s': 600.0})
        # nothing is played before everybody hears everybody
        wait_for(supervisor, lambda: processes.alive()
                 and supervisor.count_publishers('camera_info') > 0
                 and supervisor.count_subscribers('image/compressed') > 0,
                 timeout_s, 'connection between the nodes')
        player = processes.start('bag_player', {'bag': str(Path(bag).absolute()), 'rate': rate})
        wait_for(supervisor, lambda: processes.alive() and player.poll() is not None,
                 playing_s + timeout_s, 'end of the bag')
        result = supervisor.final_result(last_ns, timeout_s)
        if result['status'] == 'calibrated':
            supervisor.call(supervisor._save)
        return result, list(supervisor.camera_infos)


def main(argv: list[str] | None = None) -> int:
    """Run from the command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('bag')
    parser.add_argument('--output', type=Path, required=True)
    parser.add_argument('--rate', type=float, default=1.0)
    parser.add_argument('--timeout', type=float, default=120.0)
    parser.add_argument('--calibrator', choices=CALIBRATORS, default=CALIBRATORS[0])
    args = parser.parse_args(argv)
    end_silently()
    os.environ.setdefault('ROS_LOG_DIR', str(args.output / 'log'))
    try:
        result, _ = replay(args.bag, args.output, args.rate, args.timeout,
                           calibrator=args.calibrator)
    except ReplayTimeout as error:
        print(f'The nodes came to no result: {error}.', file=sys.stderr)
        return 2
    except SelfcalError as error:
        print(error, file=sys.stderr)
        return 2
    atomic_write(args.output / 'result.json', json.dumps(result, indent=2) + '\n')
    return 0 if result['status'] == 'calibrated' else 1


if __name__ == '__main__':
    sys.exit(main())
