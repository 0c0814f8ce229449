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
"""planar_calibrator: calibrates a camera that moves in a plane; see `calibrator_node`."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from selfcal_ros.nodes.entry_point import run_node

if TYPE_CHECKING:
    from rclpy.node import Node
    from selfcal_ros.nodes.estimation_process import EstimationProcess
    from selfcal_ros.nodes.estimation_worker import EstimationWorker


def make_node(**options: type[EstimationWorker] | type[EstimationProcess]) -> Node:
    """Return the node; its imports take a second, hence not before they are wanted."""
    from selfcal_ros.nodes.calibrator_node import CalibratorNode
    from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
    return CalibratorNode('planar_calibrator', PlanarCalibratorParameters, **options)


def main(args: list[str] | None = None) -> int:
    """Run the node; returns the exit status."""
    return run_node(make_node, args)


if __name__ == '__main__':
    sys.exit(main())
