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
"""The example of a node of one's own: how far the points of an image have moved."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import header_message
from msg_adapters.tracks import tracks_message
import numpy as np

EXAMPLE = Path(__file__).resolve().parents[2] / 'examples' / 'motion_meter.py'


def test_the_node_measures_motion(graph, monkeypatch):
    spec = spec_from_file_location('motion_meter', EXAMPLE)
    example = module_from_spec(spec)
    spec.loader.exec_module(example)
    node, types, said = graph().add(example.MotionMeter()), rclpy_types(), []
    monkeypatch.setattr(node._motion, 'publish', said.append)
    points = np.random.default_rng(0).uniform(50, 400, (20, 2))
    for number, shift in enumerate((0.0, 3.0, 8.0)):
        # another point comes and one goes with every image
        node._on_tracks(tracks_message(np.arange(20) + number, np.roll(
            points, -number, axis=0) + [shift, 0], (640, 480),
            header_message(10**9 * (number + 1), 'camera', types), types))
    assert [round(one.data, 3) for one in said] == [3.0, 5.0]
