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
"""Tracks and structure as point clouds."""

from msg_adapters.clouds import cloud_message, cloud_records, points_from_cloud, structure_cloud
from msg_adapters.tracks import (collect_tracks, FrameTracks, tracks_from_message,
                                 tracks_message)
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError


def test_tracks_keep_their_precision_at_4000_pixels(types, header):
    rng = np.random.default_rng(1)
    xy = rng.uniform(-5, 4095, (5000, 2))
    track = rng.choice(2 ** 32, 5000, replace=False)
    again = tracks_from_message(tracks_message(track, xy, (4096, 3000), header, types))
    assert np.abs(again.xy - xy).max() < 0.001
    assert (again.track == track).all() and again.image_size == (4096, 3000)
    assert again.stamp_ns == 1_700_000_001_123_456_789
    assert again.frame_id == 'camera_optical_frame'


def test_the_layout_is_the_documented_one(types, header):
    msg = tracks_message([7, 8], [[1.5, 2.5], [3, 4]], (640, 480), header, types)
    assert [(f.name, f.offset, f.datatype, f.count) for f in msg.fields] == [
        ('x', 0, 7, 1), ('y', 4, 7, 1), ('id', 8, 6, 1), ('image_width', 12, 4, 1),
        ('image_height', 14, 4, 1)]
    assert (msg.height, msg.width, msg.point_step, msg.row_step) == (1, 2, 16, 32)
    assert bytes(bytearray(msg.data))[16:24] == np.array([3, 4], '<f4').tobytes()


def test_an_image_without_tracks(types, header):
    again = tracks_from_message(tracks_message([], np.zeros((0, 2)), (640, 480), header, types))
    assert len(again.track) == 0 and again.xy.shape == (0, 2) and again.image_size is None


@pytest.mark.parametrize('track, xy, size', [
    ([1], [[np.nan, 1]], (640, 480)), ([1, 2], [[1, 1]], (640, 480)),
    ([-1], [[1, 1]], (640, 480)), ([2 ** 32], [[1, 1]], (640, 480)),
    ([1.5], [[1, 1]], (640, 480)), ([1], [[1, 1]], (0, 480)), ([1], [[1, 1]], (70000, 480))])
def test_impossible_tracks(types, header, track, xy, size):
    with pytest.raises(ArgumentError):
        tracks_message(track, xy, size, header, types)


def foreign(types, header, big_endian=False, **values):
    """Build a cloud as another program might: other order, doubles, big endian, padding."""
    mark = '>' if big_endian else '<'
    layout = np.dtype({'names': ['id', 'y', 'x'], 'formats': [mark + 'i4', mark + 'f8',
                                                              mark + 'f8'],
                       'offsets': [0, 8, 16], 'itemsize': 32})
    records = np.zeros(4, layout)
    records['x'], records['y'] = [1, 2, 3, 4], [5, 6, 7, 8]
    records['id'] = [9, 8, 7, 6]
    for name, value in values.items():
        records[name][2] = value
    fields = [types.PointField(name=name, offset=layout.fields[name][1],
                               datatype=5 if name == 'id' else 8, count=1)
              for name in layout.names]
    # two rows of two points and 16 bytes of padding each
    data = np.pad(np.frombuffer(records.tobytes(), np.uint8).reshape(2, 64), ((0, 0), (0, 16)))
    return types.PointCloud2(header=header, height=2, width=2, fields=fields,
                             is_bigendian=big_endian, point_step=32, row_step=80,
                             data=data.ravel(), is_dense=True)


@pytest.mark.parametrize('big_endian', [False, True])
def test_clouds_of_other_programs(types, header, big_endian):
    again = tracks_from_message(foreign(types, header, big_endian))
    assert again.xy.tolist() == [[1, 5], [2, 6], [3, 7], [4, 8]]
    assert again.track.tolist() == [9, 8, 7, 6] and again.image_size is None


def test_wrong_tracks_messages(types, header):
    with pytest.raises(InputError, match='Point 2 .* not finite'):
        tracks_from_message(foreign(types, header, x=np.nan))
    with pytest.raises(InputError, match='twice'):
        tracks_from_message(foreign(types, header, id=9))
    with pytest.raises(InputError, match='lacks the field id; it has x, y, z'):
        tracks_from_message(structure_cloud(np.zeros((3, 3)), header, types))
    floats = np.zeros(2, [('x', 'f4'), ('y', 'f4'), ('id', 'f4')])
    with pytest.raises(InputError, match='integer'):
        tracks_from_message(cloud_message(floats, header, types))
    mixed = np.zeros(2, [('x', 'f4'), ('y', 'f4'), ('id', 'u4'), ('image_width', 'u2'),
                         ('image_height', 'u2')])
    mixed['id'], mixed['image_width'], mixed['image_height'] = [1, 2], [5, 6], 7
    with pytest.raises(InputError, match='disagree'):
        tracks_from_message(cloud_message(mixed, header, types))


@pytest.mark.parametrize('name, value', [
    ('width', 3), ('height', 2 ** 32 - 1), ('point_step', 8), ('row_step', 4),
    ('point_step', 2 ** 32 - 1)])
def test_clouds_that_contradict_themselves(types, header, name, value):
    msg = tracks_message([7, 8], [[1.5, 2.5], [3, 4]], (640, 480), header, types)
    setattr(msg, name, value)
    with pytest.raises(InputError, match='contradicts'):
        tracks_from_message(msg)


def test_unknown_datatypes(types, header):
    msg = tracks_message([7], [[1.5, 2.5]], (640, 480), header, types)
    msg.fields[0].datatype = 99
    with pytest.raises(InputError, match='datatype 99'):
        cloud_records(msg, ('x',))


def test_a_stream_becomes_tracks():
    frames = [FrameTracks(np.array([4, 2]), np.array([[1., 2], [3, 4]]), (640, 480), 10),
              FrameTracks(np.array([], int), np.zeros((0, 2)), None, 20),
              FrameTracks(np.array([2]), np.array([[5., 6]]), (640, 480), 30)]
    tracks = collect_tracks(frames, first_index=5)
    assert tracks.frame.tolist() == [5, 7, 5] and tracks.track.tolist() == [2, 2, 4]
    assert tracks.xy.tolist() == [[3, 4], [5, 6], [1, 2]]
    assert tracks.image_size == (640, 480) and tracks.stamps_ns == {5: 10, 6: 20, 7: 30}
    assert len(collect_tracks([])) == 0
    with pytest.raises(InputError, match='size changes'):
        collect_tracks([*frames, FrameTracks(np.array([1]), np.zeros((1, 2)), (320, 240))])


def test_structure(types, header):
    points = np.array([[2, 4, 6, 2], [1, 1, 1, 0], [-3, 0, 9, 1], [np.nan, 0, 0, 1]])
    colours = np.array([[255, 128, 1], [0, 0, 0], [10, 20, 30], [0, 0, 0]], np.uint8)
    msg = structure_cloud(points, header, types, colours)
    assert points_from_cloud(msg).tolist() == [[1, 2, 3], [-3, 0, 9]]
    packed = cloud_records(msg, ('rgb',))['rgb'].view(np.uint32)
    assert packed.tolist() == [0xff8001, 0x0a141e]
    assert [f.name for f in msg.fields] == ['x', 'y', 'z', 'rgb']
    with pytest.raises(ArgumentError, match='Colours'):
        structure_cloud(points, header, types, colours[:2])
    with pytest.raises(ArgumentError, match='Points'):
        structure_cloud(points[:, :2], header, types)
