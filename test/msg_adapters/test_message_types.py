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
"""The builders refuse or cast what rclpy would corrupt without a word."""

from array import array

from msg_adapters.message_types import PACKAGES, rosbags_types
from msg_adapters.stamps import copy_header, header_message, stamp_ns, time_message
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError


def test_every_builder_builds_a_message_of_zeros(types):
    for names in PACKAGES.values():
        for name in names:
            getattr(types, name)()
    assert types.Pose().orientation.w == 1.0


def test_scalars_are_cast(types):
    point = types.Point(x=1, y=np.float32(1.5), z=np.int64(-3))
    assert (point.x, point.y, point.z) == (1.0, 1.5, -3.0)
    assert all(type(value) is float for value in (point.x, point.y, point.z))
    image = types.Image(height=np.uint32(4), width=np.int64(5), encoding=np.str_('mono8'))
    assert type(image.height) is int and type(image.encoding) is str


@pytest.mark.parametrize('value', [-1, 2 ** 32, 1.5, 'a', None, np.nan])
def test_impossible_integers(types, value):
    with pytest.raises(ArgumentError, match='Image.height'):
        types.Image(height=value)


def test_matrices_are_flattened_and_counted(types):
    k = np.arange(9).reshape(3, 3).T
    msg = types.CameraInfo(k=k)
    assert np.asarray(msg.k).shape == (9,) and np.asarray(msg.k).tolist() == k.ravel().tolist()
    assert np.asarray(msg.k).dtype == np.float64
    for wrong in (np.zeros(8), np.zeros((3, 4)), 1.0):
        with pytest.raises(ArgumentError, match='9 values'):
            types.CameraInfo(k=wrong)


@pytest.mark.parametrize('data', [b'\x01\x02\xff', bytearray(b'\x01\x02\xff'), [1, 2, 255],
                                  array('B', [1, 2, 255]), memoryview(b'\x01\x02\xff'),
                                  np.array([1, 2, 255], np.uint8), np.array([1, 2, 255])])
def test_bytes_of_every_kind(types, data):
    assert bytes(bytearray(types.Image(data=data).data)) == b'\x01\x02\xff'


def test_numbers_that_are_no_bytes(types):
    for wrong in ([256], [-1], [0.5]):
        with pytest.raises(ArgumentError, match='uint8'):
            types.Image(data=wrong)


def test_unknown_names(types):
    with pytest.raises(ArgumentError, match='has no field'):
        types.Image(hight=3)
    with pytest.raises(AttributeError):
        types.Imago


def test_messages_own_their_data(types):
    data = np.arange(4, dtype=np.uint8)
    msg = types.Image(data=data)
    data[:] = 9
    assert list(msg.data) == [0, 1, 2, 3]


@pytest.mark.parametrize('nanoseconds', [0, 1, 999_999_999, 1_700_000_000_123_456_789, -1])
def test_stamps(types, nanoseconds):
    header = copy_header(header_message(nanoseconds, 'camera', types), types)
    assert stamp_ns(header.stamp) == nanoseconds and header.frame_id == 'camera'


def test_a_stamp_beyond_ros(types):
    with pytest.raises(ArgumentError, match='range'):
        time_message(2 ** 62, types)


def test_messages_survive_serialisation(types, header):
    msg = types.Image(header=header, height=2, width=3, encoding='mono8', step=3,
                      data=np.arange(6, dtype=np.uint8))
    if type(types).__name__ == '_RclpyTypes':
        from rclpy.serialization import deserialize_message, serialize_message
        again = deserialize_message(serialize_message(msg), type(msg))
    else:
        store = rosbags_types().store
        kind = 'sensor_msgs/msg/Image'
        again = store.deserialize_cdr(store.serialize_cdr(msg, kind), kind)
    assert list(again.data) == list(range(6)) and again.header.stamp.nanosec == 123_456_789


def test_ros1_headers_are_filled_in():
    from rosbags.typesys import Stores, get_typestore
    types = rosbags_types(get_typestore(Stores.ROS1_NOETIC))
    assert header_message(5, 'camera', types).seq == 0
