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
"""Images that cannot be decoded are left out of a calibration, counted and named once."""

import cv2
from msg_adapters.message_types import rosbags_types
from msg_adapters.stamps import header_message
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.errors import DamagedImage, InputError
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.pipeline.calibrate_input import calibrate_input, CalibrationSettings
from selfcal_ros.pipeline.sources import open_source

KIND = 'sensor_msgs/msg/CompressedImage'
DAMAGED = (3, 7)


def jpegs(count=12):
    """A texture that drifts; two of the files are truncated."""
    rng = np.random.default_rng(5)
    wide = cv2.GaussianBlur(rng.uniform(0, 255, (160, 300)).astype(np.float32), (0, 0), 2)
    wide = cv2.normalize(wide, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    files = [cv2.imencode('.jpg', wide[:, 4 * k:4 * k + 200])[1].tobytes() for k in range(count)]
    return [data[:len(data) // 2] if k in DAMAGED else data for k, data in enumerate(files)]


def write_folder(path, files):
    path.mkdir()
    for k, data in enumerate(files):
        (path / f'{k:02}.jpg').write_bytes(data)
    return path


def write_bag(path, files):
    store = get_typestore(Stores.ROS2_JAZZY)
    types = rosbags_types(store)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/image/compressed', KIND, typestore=store)
        for k, data in enumerate(files):
            stamp = 10**18 + k * 10**8
            message = types.CompressedImage(header=header_message(stamp, 'camera', types),
                                            format='jpeg', data=np.frombuffer(data, np.uint8))
            writer.write(connection, stamp, store.serialize_cdr(message, KIND))
    return path


@pytest.mark.parametrize('write, name', [(write_folder, '03.jpg'), (write_bag, 'frame 3')])
def test_damaged_images_are_passed_over_and_counted_once(tmp_path, write, name):
    with open_source(write(tmp_path / 'input', jpegs())) as source:
        with pytest.raises(DamagedImage, match='truncated'):
            list(source)
        source.leaves_out_damaged = True
        for _ in range(2):
            assert [frame.index for frame in source] == [
                k for k in range(12) if k not in DAMAGED]
        found, = source.losses()
    assert found.kind == 'images_damaged' and found.values['count'] == len(DAMAGED)
    assert name in found.sentence and 'truncated' in found.sentence


def test_a_calibration_says_what_it_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr('selfcal_ros.calibration.calibrate.calibrate', lambda *_, **options: (
        NotCalibrated.of(NoEstimate('no_motion'), facts=options['facts'])))
    folder = write_folder(tmp_path / 'input', jpegs())
    _, reading = calibrate_input(folder, CalibrationSettings(mode='video'))
    assert not set(DAMAGED) & set(reading.tracks.frames)
    assert [one.values['count'] for one in reading.findings
            if one.kind == 'images_damaged'] == [2]


def test_a_video_that_ends_before_its_frames_is_told(tmp_path):
    rng = np.random.default_rng(0)
    path = tmp_path / 'whole.avi'
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), 10, (160, 120))
    for _ in range(60):
        video.write(rng.integers(0, 256, (120, 160, 3), np.uint8))
    video.release()
    data = path.read_bytes()
    (tmp_path / 'cut.avi').write_bytes(data[:len(data) // 3])
    counts = []
    for name in ('whole.avi', 'cut.avi'):
        with open_source(tmp_path / name) as source:
            counts.append(len(list(source)))
            found = source.losses()
    assert counts[0] == 60 and counts[1] < 25
    told, = found
    assert (told.kind, told.values) == ('video_ends_early', {'frames': counts[1],
                                                             'announced': 60})
    with open_source(tmp_path / 'whole.avi') as source:
        assert len(list(source)) == 60 and not source.losses()


def test_an_input_that_begins_damaged_is_refused(tmp_path):
    with pytest.raises(InputError, match='00.jpg: The image is truncated'):
        open_source(write_folder(tmp_path / 'input', [jpegs()[3], *jpegs()[8:]]))
