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
"""Which images of a camera belong to the instants of another."""

import cv2
from msg_adapters.image import image_message
from msg_adapters.message_types import rosbags_types
from msg_adapters.stamps import header_message
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.pipeline.calibrate_input import CalibrationSettings
from selfcal_ros.pipeline.rig_input import calibrate_rig_input, RigInput
from selfcal_ros.pipeline.rig_instants import at_instants
from selfcal_ros.pipeline.sources import open_source

BEGAN_NS = 10**18


def _bag(folder, stamps_ms):
    """Write images that show their own number."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        types = get_typestore(Stores.ROS2_JAZZY)
        topic = writer.add_connection('/image_raw', 'sensor_msgs/msg/Image', typestore=types)
        for k, ms in enumerate(stamps_ms):
            stamp = BEGAN_NS + int(ms * 1e6)
            message = image_message(np.full((24, 32), k, np.uint8),
                                    header_message(stamp, 'camera', rosbags_types()),
                                    rosbags_types())
            writer.write(topic, stamp, types.serialize_cdr(message, topic.msgtype))
    return folder


def _found(folder, stamps_ms, instants_ms):
    chosen = {7 * k: (BEGAN_NS + int(ms * 1e6), f'image {k}') for k, ms in enumerate(instants_ms)}
    with open_source(_bag(folder, stamps_ms)) as source:
        return at_instants(source, chosen, 99, timed=True)


def test_of_a_camera_with_its_own_clock_the_images_around_an_instant_are_taken(tmp_path):
    found = _found(tmp_path / 'bag', np.arange(10) * 40.0, [95.0, 210.0, 300.0])
    assert found.own_clock and found.apart_ms == pytest.approx(15)
    assert {at: int(image[0, 0]) for at, image in found.images.items()} == {0: 2, 7: 5, 14: 7}
    late = [(round(one.late_s, 6), [(round(late, 6), int(image[0, 0])) for late, image in
                                    one.others]) for one in found.beside.values()]
    assert late == [(-0.015, [(-0.055, 1), (0.025, 3)]), (-0.01, [(-0.05, 4), (0.03, 6)]),
                    (-0.02, [(-0.06, 6), (0.02, 8)])]


def test_what_is_not_between_two_near_images_is_left_out(tmp_path):
    # before the first, beyond the last, in a gap, and at an image
    found = _found(tmp_path / 'bag', [0, 40, 80, 500, 540, 580], [-20, 600, 290, 62, 520, 40])
    assert sorted(found.images) == [21, 28, 35] and sorted(found.beside) == [21, 28]


def test_cameras_that_are_triggered_together_need_nothing_beside(tmp_path):
    # one image of the second camera was lost
    found = _found(tmp_path / 'bag', [0.4, 100.2, 300.6, 400.1], [0, 100, 200, 300, 400])
    assert not found.own_clock and sorted(found.images) == [0, 7, 21, 28]


def test_folders_that_lack_different_images_are_not_paired_by_their_places(tmp_path):
    for k in (0, 1, 2, 4):
        cv2.imwrite(str(tmp_path / f'image{k}.png'), np.full((24, 32), k, np.uint8))
    chosen = {at: (at, f'image{k}.png') for at, k in enumerate((0, 1, 3, 4))}
    with open_source(tmp_path) as source:
        found = at_instants(source, chosen, 4, timed=False)
    assert {at: int(image[0, 0]) for at, image in found.images.items()} == {0: 0, 1: 1, 3: 4}


def test_tables_of_tracks_are_thinned_to_the_same_frames(tmp_path, monkeypatch):
    # only what is read matters: a calibration would take seconds
    monkeypatch.setattr('selfcal_ros.calibration.rigs.rig_calibration.calibrate_rig',
                        lambda *_, **__: NotCalibrated('Not asked for.'))
    rng = np.random.default_rng(2)
    for name, frames in (('left', range(150)), ('right', range(3, 150))):
        start, speed = rng.uniform(80, 400, (40, 2)), rng.uniform(-0.5, 0.5, (40, 2))
        lines = [f'{frame},{track},{x:.2f},{y:.2f}\n' for frame in frames
                 for track, (x, y) in enumerate(start + frame * speed)]
        (tmp_path / f'{name}.csv').write_text('frame,track,x,y\n' + ''.join(lines))
    inputs = [RigInput(name, str(tmp_path / f'{name}.csv')) for name in ('left', 'right')]
    settings = CalibrationSettings(image_size=(640, 480), max_keyframes=20, motion='rotation')
    _, reading = calibrate_rig_input(inputs, settings)
    left, right = (reading.tracks[name].frames for name in ('left', 'right'))
    np.testing.assert_array_equal(left, right)
    assert 4 < len(left) <= 20 and left[0] >= 3
    assert [one.kind for one in reading.findings] == ['keyframes_chosen']
