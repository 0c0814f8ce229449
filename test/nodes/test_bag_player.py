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
"""bag_player: what was recorded comes out, byte for byte and in its own time."""

import time

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from selfcal_ros.errors import InputError
from selfcal_ros.nodes.player_node import BagPlayer
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.pipeline.replay import ImageRecording
from sensor_msgs.msg import CompressedImage, Image

START_NS = 1_700_000_000_000_000_000
STEP_NS = 50_000_000


@pytest.fixture
def bag(tmp_path):
    """Write 12 small images, 50 ms apart."""
    rng = np.random.default_rng(1)
    frames = [Frame(k, START_NS + k * STEP_NS, rng.integers(0, 256, (48, 64), np.uint8), 'cam')
              for k in range(12)]
    write_image_bag(tmp_path / 'bag', frames)
    return tmp_path / 'bag'


def recorded(bag, message=Image):
    with ImageRecording(bag) as recording:
        return [deserialize_message(raw, message) for _, raw in recording.messages()]


def test_every_image_comes_as_it_was_recorded_and_in_its_time(graph, bag):
    graph = graph('-p', f'bag:={bag}', '-p', 'rate:=2.0')
    images = graph.listen(Image, 'image')
    clock = graph.listen(Clock, '/clock')
    began = time.monotonic()
    player = graph.add(BagPlayer())
    graph.wait_for(player.finished.done)
    took = time.monotonic() - began
    graph.wait_for(lambda: len(images) == 12)
    assert images == recorded(bag)
    assert took >= 11 * 0.05 / 2, 'twice the speed of the recording, not faster'
    times = [c.clock.sec * 10 ** 9 + c.clock.nanosec for c in clock]
    assert times == sorted(times)
    assert times[0] >= START_NS and times[-1] <= START_NS + 11 * STEP_NS
    assert len(times) >= 12


def test_playing_waits_for_a_subscriber(graph, bag):
    graph = graph('-p', f'bag:={bag}', '-p', 'rate:=10.0')
    player = graph.add(BagPlayer())
    graph.spin_for(0.5)
    assert not player.finished.done()
    images = graph.listen(Image, 'image')
    graph.wait_for(player.finished.done)
    graph.wait_for(lambda: len(images) == 12)


def test_nobody_is_waited_for_when_that_is_said(graph, bag):
    graph = graph('-p', f'bag:={bag}', '-p', 'rate:=10.0', '-p', 'wait_for_subscribers_s:=0')
    player = graph.add(BagPlayer())
    graph.wait_for(player.finished.done, 10)


def test_a_start_offset_skips_and_a_loop_starts_there_again(graph, bag):
    graph = graph('-p', f'bag:={bag}', '-p', 'rate:=10.0', '-p', 'start_offset:=0.275',
                  '-p', 'loop:=true')
    images = graph.listen(Image, 'image', 100)
    player = graph.add(BagPlayer())
    graph.wait_for(lambda: len(images) >= 14)
    assert images[:12] == recorded(bag)[6:] * 2
    assert not player.finished.done()


def test_an_offset_beyond_the_end_is_an_error(graph, bag):
    graph = graph('-p', f'bag:={bag}', '-p', 'start_offset:=60.0')
    graph.listen(Image, 'image')
    player = graph.add(BagPlayer())
    with pytest.raises(InputError, match='start_offset'):
        graph.wait_for(player.finished.done, 10)


def test_a_bag_must_be_named_and_exist(graph, tmp_path):
    graph = graph('-p', f'bag:={tmp_path / "none"}')
    with pytest.raises(InputError, match='none'):
        BagPlayer()


def test_compressed_images_go_to_the_compressed_topic(graph, bag, tmp_path):
    frames = [Frame(k, START_NS + k * STEP_NS, np.full((48, 64), 20 * k, np.uint8), 'cam')
              for k in range(3)]
    write_image_bag(tmp_path / 'small', frames, compressed='png')
    graph = graph('-p', f'bag:={tmp_path / "small"}', '-p', 'rate:=10.0')
    images = graph.listen(CompressedImage, 'image/compressed')
    player = graph.add(BagPlayer())
    graph.wait_for(player.finished.done)
    graph.wait_for(lambda: len(images) == 3)
    assert images == recorded(tmp_path / 'small', CompressedImage)


def test_a_player_that_has_finished_stays_so_and_says_so(graph, bag):
    graph = graph('-p', f'bag:={bag}', '-p', 'rate:=20.0')
    images = graph.listen(Image, 'image', 100)
    player = graph.add(BagPlayer())
    graph.wait_for(player.finished.done)
    graph.wait_for(lambda: len(images) == 12)
    for values in ({'loop': True}, {'rate': 1.0}):
        refused, = graph.set_parameters('bag_player', **values)
        assert 'played to its end' in refused
    # in company it lives on
    graph.spin_for(0.3)
    assert len(images) == 12
