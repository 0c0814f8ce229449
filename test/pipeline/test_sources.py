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
"""Sources: the frames that went in come out, and bad input is one clear sentence."""

from pathlib import Path
import shutil
import struct
import tracemalloc

import cv2
from msg_adapters.image import compressed_image_message, image_message
from msg_adapters.message_types import rosbags_types
from msg_adapters.stamps import header_message
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.calibrate_input import calibrate_input, CalibrationSettings
from selfcal_ros.pipeline.feature_session import MAX_TABLE_FRAMES, read_tracks
from selfcal_ros.pipeline.file_sources import natural_key
from selfcal_ros.pipeline.sources import Frame, open_source
from selfcal_ros.values.image_headers import is_turned
from selfcal_ros.values.tracks import Tracks

IMAGE, COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'
START_NS = 1_700_000_000_123_456_789
TOPIC = '/camera/image_raw'


def images(count=6, height=48, width=64):
    """Return images that differ from each other, smooth enough for jpeg."""
    y, x = np.mgrid[:height, :width]
    return [(x + 2 * y + 10 * k).astype(np.uint8) for k in range(count)]


def frames(count=6, **size):
    """Return frames 40 ms apart."""
    return [Frame(k, START_NS + 40_000_000 * k, image, 'front_optical')
            for k, image in enumerate(images(count, **size))]


def write_bag(path, messages, storage='mcap', store=None):
    """Write (topic, type, log time, message) to a rosbag2 folder."""
    store = store or get_typestore(Stores.ROS2_JAZZY)
    plugin = StoragePlugin.MCAP if storage == 'mcap' else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, kind, stamp, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            if message is not None:
                writer.write(connections[topic], stamp, store.serialize_cdr(message, kind))
    return path


def message(image, stamp=START_NS, types=None):
    """Build an Image of rosbags."""
    types = types or rosbags_types()
    return image_message(image, header_message(stamp, 'front_optical', types), types)


def refusal(path, **options):
    """Open and read a source to the end; return the sentence of its InputError."""
    with pytest.raises(InputError) as caught:
        with open_source(path, **options) as source:
            for _ in source:
                pass
    sentence = str(caught.value)
    assert sentence.endswith('.') and '\n' not in sentence and len(sentence) < 600
    return sentence


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('bare', [False, True])
def test_rosbag2(tmp_path, storage, bare):
    path = tmp_path / 'drive'
    assert write_image_bag(path, frames(), TOPIC, storage) == 6
    if bare:
        path = next(file for file in path.iterdir() if file.suffix in ('.mcap', '.db3'))
    with open_source(path) as source:
        assert (source.kind, source.topic, source.frame_id) == ('bag', TOPIC, 'front_optical')
        assert len(source) == source.count == 6 and source.image_size == (64, 48)
        assert source.clock == 'header' and 'drive' in source.description
        for _ in range(2):   # every iteration starts anew
            for frame, truth in zip(source, frames(), strict=True):
                assert (frame.image == truth.image).all() and frame.image.dtype == np.uint8
                assert (frame.index, frame.stamp_ns, frame.frame_id) == (
                    truth.index, truth.stamp_ns, truth.frame_id)
    with pytest.raises(InputError, match='closed'):
        next(iter(source))


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('codec, tolerance', [('jpeg', 3), ('png', 0)])
def test_compressed_images(tmp_path, storage, codec, tolerance):
    write_image_bag(tmp_path / 'bag', frames(), TOPIC, storage, compressed=codec)
    with open_source(tmp_path / 'bag', colour=True) as source:
        assert source.topic == TOPIC + '/compressed'
        for frame, truth in zip(source, images(), strict=True):
            assert np.abs(frame.image.astype(int) - truth).max() <= tolerance
            assert frame.bgr is None   # it has no colours


def test_the_name_of_a_topic_finds_its_compressed_images(tmp_path):
    write_image_bag(tmp_path / 'bag', frames(), TOPIC, compressed='png')
    with open_source(tmp_path / 'bag', topic=TOPIC) as source:
        assert source.topic == TOPIC + '/compressed'
        assert 'compressed_taken' in [one.kind for one in source.losses()]
    with open_source(tmp_path / 'bag', topic=TOPIC + '/compressed') as source:
        assert not source.losses()


@pytest.mark.parametrize('mode', [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_a_file_of_a_compressed_bag_needs_its_folder(tmp_path, mode):
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(TOPIC, IMAGE, typestore=store)
        for stamp, image in enumerate(images()):
            writer.write(connection, stamp, store.serialize_cdr(message(image), IMAGE))
    with open_source(tmp_path / 'bag') as source:
        assert sum(1 for _ in source) == 6
    file = next(one for one in (tmp_path / 'bag').iterdir() if one.name != 'metadata.yaml')
    assert f'compressed; give its folder, {tmp_path / "bag"}.' in refusal(file)


def test_ros1_bag(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    types = rosbags_types(store)
    path = tmp_path / 'old.bag'
    with Writer1(path) as writer:
        connection = writer.add_connection('/cam', IMAGE, typestore=store)
        for frame in frames():
            raw = store.serialize_ros1(message(frame.image, frame.stamp_ns, types), IMAGE)
            writer.write(connection, frame.stamp_ns, raw)
    with open_source(path) as source:
        assert source.description.startswith('ROS 1 bag') and source.count == 6
        for frame, truth in zip(source, frames(), strict=True):
            assert (frame.image == truth.image).all() and frame.stamp_ns == truth.stamp_ns
    whole = path.read_bytes()
    for size in (0, 5, 100, 4500, len(whole) // 2, len(whole) - 10):
        path.write_bytes(whole[:size])
        assert str(path) in refusal(path)


def test_headers_without_time_fall_back_to_the_log(tmp_path):
    write_bag(tmp_path / 'bag', [(TOPIC, IMAGE, START_NS + k, message(image, 0))
                                 for k, image in enumerate(images())])
    with open_source(tmp_path / 'bag') as source:
        assert source.clock == 'log'
        assert [frame.stamp_ns - START_NS for frame in source] == list(range(6))


def test_stamps_that_go_back_and_frames_that_change_are_told(tmp_path):
    def told(name, stamps, frames=('front',)):
        types = rosbags_types()
        path = write_bag(tmp_path / name, [
            (TOPIC, IMAGE, k + 1, image_message(image, header_message(
                stamp, frames[k % len(frames)], types), types))
            for k, (stamp, image) in enumerate(zip(stamps, images()))])
        with open_source(path) as source:
            for _ in range(2):
                list(source)
            return [(one.kind, one.sentence) for one in source.losses()]

    assert not told('good', range(1, 7))
    (kind, sentence), = told('back', [1, 2, 3, 2, 3, 4])
    assert kind == 'stamps_disordered' and sentence.startswith('1 image has no later stamp than')
    (kind, sentence), = told('still', [5] * 6)
    assert sentence.startswith('5 images have no later stamp than')
    (kind, sentence), = told('two', range(1, 7), ('left', 'right'))
    assert kind == 'frames_differ' and "such as 'left' and 'right'" in sentence


def test_a_principal_point_outside_of_the_images_is_told(tmp_path):
    few = 'frame,track,x,y\n' + ''.join(f'{frame},{track},{9 * track + frame},{5 * track}\n'
                                        for frame in range(3) for track in range(9))
    (tmp_path / 'tracks.csv').write_text(few, encoding='utf-8')
    for point, told in (((320, 240), False), ((1920, 1080), True)):
        result, reading = calibrate_input(tmp_path / 'tracks.csv', CalibrationSettings(
            facts=CameraFacts(principal_point=point), image_size=(640, 480)))
        assert not result
        assert ('The stated principal point (1920, 1080) lies outside of the images of 640x480: '
                'they may be of another size than it is of.' in reading.notes) == told


def test_the_choice_of_the_topic(tmp_path):
    types = rosbags_types()
    text = types.String(data='x')
    image = message(images()[0])
    many = write_bag(tmp_path / 'many', [
        ('/left', IMAGE, 1, image), ('/left', IMAGE, 2, image), ('/right', IMAGE, 3, image),
        ('/chatter', 'std_msgs/msg/String', 4, text), ('/none', IMAGE, 5, None)])
    sentence = refusal(many)
    assert '/left (2)' in sentence and '/right (1)' in sentence and '--topic' in sentence
    assert '/left (2)' in refusal(many, topic='/nope')
    sentence = refusal(many, topic='/chatter')
    assert 'std_msgs/msg/String' in sentence and '/right (1)' in sentence
    assert 'no messages' in refusal(many, topic='/none')
    for name in ('/left', 'left'):
        with open_source(many, topic=name) as source:
            assert source.topic == '/left' and sum(1 for _ in source) == 2
    # one topic with images and one without any is no ambiguity
    one = write_bag(tmp_path / 'one', [('/left', IMAGE, 1, image), ('/none', IMAGE, 5, None)])
    with open_source(one) as source:
        assert source.topic == '/left'
    without = write_bag(tmp_path / 'no', [('/chatter', 'std_msgs/msg/String', 4, text)])
    assert 'has no images' in refusal(without) and '/chatter' in refusal(without)
    empty = write_bag(tmp_path / 'empty', [('/none', IMAGE, 5, None)])
    assert 'its image topic /none holds no message' in refusal(empty)
    assert 'holds no images' in refusal(without, topic='/nope')


@pytest.mark.parametrize('raw, compressed, taken', [(3, 3, '/cam'), (2, 3, '/cam/compressed')])
def test_the_two_codings_of_image_transport_are_one_camera(tmp_path, raw, compressed, taken):
    types = rosbags_types()
    coded = compressed_image_message(images()[0], header_message(1, 'cam', types), types)
    both = [('/cam', IMAGE, k + 1, message(images()[0])) for k in range(raw)] + [
        ('/cam/compressed', IMAGE.replace('Image', 'CompressedImage'), k + 1, coded)
        for k in range(compressed)]
    path = write_bag(tmp_path / 'both', both)
    with open_source(path) as source:
        assert source.topic == taken
        said = [one.sentence for one in source.losses()]
    other = ({'/cam', '/cam/compressed'} - {taken}).pop()
    assert said == [f'The images are those of {taken}: {other} holds the same ones in another '
                    'coding.']
    for topic in ('/cam', '/cam/compressed'):
        with open_source(path, topic=topic) as source:
            assert source.topic == topic and not source.losses()
    # another camera is another camera
    two = write_bag(tmp_path / 'two', [*both, ('/right', IMAGE, 9, message(images()[0]))])
    assert 'has 2 image topics, choose one' in refusal(two) and '--cameras' in refusal(two)


def test_a_topic_without_its_namespace_or_with_a_slip_is_answered_with_what_is_there(tmp_path):
    path = write_bag(tmp_path / 'bag', [(topic, IMAGE, 1, message(images()[0])) for topic in (
        '/front/image_raw', '/rear/image_raw', '/front/image_rect')])
    for topic, meant in (('image_rect', '/front/image_rect'),
                         ('/rear/image_rwa', '/rear/image_raw')):
        assert refusal(path, topic=topic).endswith(f'; perhaps {meant} is meant.')
    assert 'perhaps' not in refusal(path, topic='/lidar')


@pytest.mark.parametrize('storage, suffix', [('mcap', '.mcap'), ('sqlite3', '.db3')])
def test_truncated_bags(tmp_path, storage, suffix):
    write_image_bag(tmp_path / 'bag', frames(40), TOPIC, storage)
    file = tmp_path / 'bag' / f'bag{suffix}'
    whole = file.read_bytes()
    for size in (0, 4, 50, 4096, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:size])
        for path in (file, file.parent):
            assert refusal(path)
    # damage in the middle
    file.write_bytes(whole[:len(whole) // 2] + b'\xa5' * 8000 + whole[len(whole) // 2 + 8000:])
    try:
        with open_source(file) as source:
            assert sum(1 for _ in source) == 40   # bytes of pixels only
    except InputError:
        pass


def test_a_bag_that_holds_less_than_it_announces(tmp_path):
    write_image_bag(tmp_path / 'bag', frames(), TOPIC)
    metadata = tmp_path / 'bag' / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace('message_count: 6', 'message_count: 9'))
    assert 'announces 9 images' in refusal(tmp_path / 'bag')
    metadata.write_text('[1, 2')
    assert refusal(tmp_path / 'bag')
    metadata.unlink()
    assert 'reindex' in refusal(tmp_path / 'bag')


def test_what_makes_a_folder_a_bag(tmp_path):
    # a data set of images may come with a metadata.yaml of its own
    (tmp_path / 'metadata.yaml').write_text('author: somebody\n')
    (tmp_path / 'a.png').write_bytes(cv2.imencode('.png', images()[0])[1].tobytes())
    with open_source(tmp_path) as source:
        assert source.kind == 'images'
    with pytest.raises(ArgumentError, match='another name'):
        write_image_bag(tmp_path / 'odd#name', frames(), storage='sqlite3')
    write_image_bag(tmp_path / 'odd', frames(), storage='sqlite3')
    (tmp_path / 'odd').rename(tmp_path / 'odd#name')
    assert 'rename' in refusal(tmp_path / 'odd#name')


def test_damaged_messages_in_a_bag(tmp_path):
    bad = message(images()[0])
    bad.step = 3
    path = write_bag(tmp_path / 'bag', [(TOPIC, IMAGE, 1, message(images()[0])),
                                        (TOPIC, IMAGE, 2, bad)])
    sentence = refusal(path)
    assert 'frame 1' in sentence and 'step 3' in sentence
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / 'raw', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(TOPIC, IMAGE, typestore=store)
        writer.write(connection, 1, b'\x00\x01\x00\x00' + b'\xff' * 30)
    assert refusal(tmp_path / 'raw')


def test_images_that_change_size(tmp_path):
    write_bag(tmp_path / 'bag', [(TOPIC, IMAGE, k, message(image)) for k, image in enumerate(
        images(3) + images(2, height=24))])
    sentence = refusal(tmp_path / 'bag')
    assert 'frame 3' in sentence and '64x48' in sentence and '64x24' in sentence
    assert 'split' in sentence
    with open_source(tmp_path / 'bag') as source:
        assert len([frame for _, frame in zip(range(3), source)]) == 3
    assert 'stated image size' in refusal(tmp_path / 'bag', image_size=(640, 480))


def test_sixteen_bit_images_in_a_bag(tmp_path):
    truth = np.linspace(0, 4095, 48 * 64).astype(np.uint16).reshape(48, 64)
    write_bag(tmp_path / 'bag', [(TOPIC, IMAGE, 1, message(truth))])
    with open_source(tmp_path / 'bag') as source:
        assert np.abs(next(iter(source)).image - truth / 4095 * 255).max() <= 0.5


def test_the_memory_does_not_grow_with_the_bag(tmp_path):
    big = {'height': 480, 'width': 640}
    write_image_bag(tmp_path / 'bag', (Frame(k, k, images(1, **big)[0]) for k in range(120)))
    tracemalloc.start()
    try:
        with open_source(tmp_path / 'bag') as source:
            assert sum(1 for _ in source) == 120
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # the bag holds 37 MB; a reader needs the chunk it is in and a few frames
    assert peak < 16e6


def test_natural_order():
    names = ['b1', 'img10.png', 'img9.png', 'img009b.png', 'IMG1.png', '2', '10', 'é']
    assert sorted(names, key=natural_key) == ['2', '10', 'b1', 'IMG1.png', 'img9.png',
                                              'img009b.png', 'img10.png', 'é']


def test_image_folder(tmp_path):
    suffixes = ['.png', '.bmp', '.tif', '.pgm', '.png', '.png', '.png', '.png', '.png', '.png',
                '.PNG']
    truth = images(11)
    for k, (image, suffix) in enumerate(zip(truth, suffixes)):
        (tmp_path / f'view{k}{suffix}').write_bytes(
            cv2.imencode(suffix.lower(), image)[1].tobytes())
    (tmp_path / 'notes.txt').write_text('not an image')
    (tmp_path / '._view3.png').write_text('hidden')
    with open_source(tmp_path) as source:
        assert (source.kind, source.count, source.clock) == ('images', 11, 'nominal')
        for k, frame in enumerate(source):
            assert (frame.image == truth[k]).all() and frame.name.startswith(f'view{k}.')
    assert 'no topic' in refusal(tmp_path, topic='/camera')
    bgr = np.dstack([truth[0], truth[1], truth[2]])
    (tmp_path / 'view5.png').write_bytes(cv2.imencode('.png', bgr)[1].tobytes())
    # colours with a transparent layer
    (tmp_path / 'view6.png').write_bytes(
        cv2.imencode('.png', np.dstack([bgr, truth[3]]))[1].tobytes())
    with open_source(tmp_path, colour=True) as source:
        colours = [frame.bgr for frame in source]
    assert [k for k, colour in enumerate(colours) if colour is not None] == [5, 6]
    assert (colours[5] == bgr).all() and (colours[6] == bgr).all()


def test_sixteen_bit_files_and_the_orientation_of_the_sensor(tmp_path):
    truth = np.linspace(0, 65535, 48 * 64).astype(np.uint16).reshape(48, 64)
    (tmp_path / 'deep.png').write_bytes(cv2.imencode('.png', truth)[1].tobytes())
    with open_source(tmp_path) as source:
        assert np.abs(next(iter(source)).image - truth / 65535 * 255).max() <= 0.5
    (tmp_path / 'deep.png').unlink()
    jpeg = cv2.imencode('.jpg', images()[0])[1].tobytes()
    # EXIF that says: rotated by 90 degrees
    exif = (b'Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0')
    segment = b'\xff\xe1' + (len(exif) + 2).to_bytes(2, 'big') + exif
    (tmp_path / 'phone.jpg').write_bytes(jpeg[:2] + segment + jpeg[2:])
    assert cv2.imread(str(tmp_path / 'phone.jpg')).shape[:2] == (64, 48)
    with open_source(tmp_path) as source:
        assert source.image_size == (64, 48)


def test_wrong_folders(tmp_path):
    assert 'is empty' in refusal(tmp_path)
    inner = tmp_path / 'images'
    inner.mkdir()
    (inner / 'a.png').write_bytes(cv2.imencode('.png', images()[0])[1].tobytes())
    assert str(inner) in refusal(tmp_path)
    (tmp_path / 'notes.txt').write_text('x')
    shutil.rmtree(inner)
    assert 'but only notes.txt.' in refusal(tmp_path)


def test_links_to_nothing_are_not_passed_over(tmp_path):
    for name in ('0.png', '1.png'):
        cv2.imwrite(str(tmp_path / name), images()[0])
    (tmp_path / '2.png').symlink_to(tmp_path / '0.png')
    with open_source(tmp_path) as source:
        assert source.count == 3
    (tmp_path / '3.png').symlink_to(tmp_path / 'nowhere.png')
    assert '3.png is a link to a file that is not there; restore' in refusal(tmp_path)
    (tmp_path / '4.png').symlink_to(tmp_path / 'nowhere.png')
    assert 'not there, as are 1 more; restore what the links lead to' in refusal(tmp_path)


def test_unreadable_images(tmp_path):
    good = cv2.imencode('.png', images()[0])[1].tobytes()
    (tmp_path / 'a1.png').write_bytes(good)
    jpeg = cv2.imencode('.jpg', images()[0])[1].tobytes()
    for name, data in (('a2.png', good[:len(good) // 2]), ('a2.jpg', jpeg[:len(jpeg) // 2]),
                       ('a2.png', b'hello'), ('a2.png', b'')):
        (tmp_path / name).write_bytes(data)
        assert name in refusal(tmp_path)
        (tmp_path / name).unlink()
    (tmp_path / 'a2.png').write_bytes(cv2.imencode('.png', images(1, height=20)[0])[1].tobytes())
    assert 'a2.png' in refusal(tmp_path) and 'change size' in refusal(tmp_path)


def test_video(tmp_path):
    path = tmp_path / 'drive.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*'MJPG'), 25, (64, 48))
    if not writer.isOpened():
        pytest.skip('this OpenCV cannot write MJPG')
    for image in images():
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    with open_source(path, colour=True) as source:
        assert (source.kind, source.clock, source.image_size) == ('video', 'video', (64, 48))
        for k, (frame, truth) in enumerate(zip(source, images(), strict=True)):
            assert frame.stamp_ns == k * 40_000_000 and frame.bgr.shape == (48, 64, 3)
            assert np.abs(frame.image.astype(int) - truth).mean() < 3
    assert 'stated image size' in refusal(path, image_size=(10, 10))
    for data in (b'', b'this is no video', path.read_bytes()[:300]):
        path.write_bytes(data)
        assert str(path) in refusal(path)


def with_orientation(jpeg, orientation, order='<'):
    """Return a jpeg that says in EXIF how it is to be turned."""
    head = (b'II*\0' if order == '<' else b'MM\0*') + struct.pack(order + 'I', 8)
    tags = struct.pack(order + 'HHHIHHI', 1, 0x112, 3, 1, orientation, 0, 0)
    exif = b'Exif\0\0' + head + tags
    return jpeg[:2] + b'\xff\xe1' + struct.pack('>H', len(exif) + 2) + exif + jpeg[2:]


def turned_images(path):
    """Return what a source says of a flag that turns images, and the shape of the first."""
    with open_source(path) as source:
        first, *_ = source
        return [one.values for one in source.losses() if one.kind == 'images_turned'
                ], first.image.shape


@pytest.mark.parametrize('order', '<>')
def test_a_flag_that_turns_photographs_is_told_and_not_applied(tmp_path, order):
    for k, image in enumerate(images(3)):
        jpeg = cv2.imencode('.jpg', image)[1].tobytes()
        (tmp_path / f'{k}.jpg').write_bytes(with_orientation(jpeg, (6, 1, 3)[k], order))
    assert cv2.imread(str(tmp_path / '0.jpg')).shape[:2] == (64, 48)
    assert turned_images(tmp_path) == ([{'count': 2, 'width': 64, 'height': 48}], (48, 64))
    (tmp_path / '0.jpg').write_bytes(with_orientation(jpeg, 1, order))
    (tmp_path / '2.jpg').write_bytes(jpeg)
    assert turned_images(tmp_path) == ([], (48, 64))
    # a flag that is cut off says nothing
    assert not is_turned(with_orientation(jpeg, 6, order)[:24])


def test_a_flag_that_turns_a_video_is_told_and_not_applied(tmp_path):
    path = tmp_path / 'upright.mp4'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*'mp4v'), 25, (64, 48))
    for image in images():
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    assert turned_images(path) == ([], (48, 64))
    content, quarter = bytearray(path.read_bytes()), struct.pack('>4i', 0, 65536, 0, -65536)
    matrix = content.index(b'tkhd') + 44
    content[matrix:matrix + 8], content[matrix + 12:matrix + 16] = quarter[:8], quarter[12:]
    content[matrix + 16:matrix + 20] = bytes(4)
    path.write_bytes(content)
    assert cv2.VideoCapture(str(path)).read()[1].shape[:2] == (64, 48)
    assert turned_images(path) == ([{'count': 6, 'width': 64, 'height': 48}], (48, 64))


def test_tracks(tmp_path):
    path = tmp_path / 'tracks.csv'
    path.write_text('frame,track,x,y\n0,5,1.5,2.5\n1,5,3,4\n')
    with open_source(path, image_size=(640, 480)) as source:
        assert source.kind == 'tracks' and source.count == 2
        assert source.tracks().image_size == (640, 480) and len(source.tracks()) == 2
        with pytest.raises(InputError, match='not images'):
            iter(source)


def test_a_stated_size_that_points_contradict_is_told(tmp_path):
    from selfcal_ros.pipeline.feature_session import whole_table
    path = tmp_path / 'tracks.csv'
    xy = np.random.default_rng(0).uniform(0, (639, 479), (300, 2))
    path.write_text('frame,track,x,y\n' + ''.join(f'{k % 3},{k // 3},{x},{y}\n'
                                                  for k, (x, y) in enumerate(xy)))
    doubtful = ['image_size_doubtful']
    for size, kinds in (((640, 480), []), ((700, 480), []), ((1280, 960), doubtful),
                        ((480, 640), ['points_outside']), ((320, 240), ['points_outside'])):
        with open_source(path, image_size=size) as source:
            assert [one.kind for one in whole_table(source).findings] == kinds


@pytest.mark.parametrize('text, words', [
    ('', 'columns'), ('frame,track,x,y\n', 'no observations'), ('a,b\n1,2\n', 'columns'),
    ('frame,track,x,y\n0,1,nan,3\n', 'line 2'), ('frame,track,x,y\n0,1,2\n', 'line 2'),
    ('frame,track,x,y\n0,1,2,3\n0,1,2,3\n', 'two observations'),
    ('frame,track,x,y\n0,99999999999999999999999,2,3\n', 'tracks.csv'),
    ('frame,track,x,y\n0,1,2,"' + 'x' * 200_000 + '\n', 'tracks.csv'), ('\0\0\0\0', 'tracks.csv')])
def test_wrong_tracks(tmp_path, text, words):
    path = tmp_path / 'tracks.csv'
    path.write_text(text)
    assert words in refusal(path)


def test_wrong_paths(tmp_path):
    assert 'does not exist' in refusal(tmp_path / 'missing.mcap')
    assert refusal('bad\0name') and refusal('x' * 5000)
    text = tmp_path / 'notes.txt'
    text.write_text('x')
    assert 'no known kind' in refusal(text)
    (tmp_path / 'drive').mkdir()
    (tmp_path / 'drive' / 'drive.mcap').touch()
    inside = tmp_path / 'drive' / 'metadata.yaml'
    inside.touch()
    assert refusal(inside).endswith(f'is a part of a bag; give its folder, {inside.parent}.')
    for name in ('a.mcap', 'a.db3', 'a.bag'):
        fake = tmp_path / name
        fake.write_text('I am no bag')
        assert 'is not' in refusal(fake)
    (tmp_path / 'one.png').write_bytes(cv2.imencode('.png', images()[0])[1].tobytes())
    assert 'folder' in refusal(tmp_path / 'one.png')
    assert refusal('/dev/null')
    with pytest.raises(ArgumentError, match='image size'):
        open_source(text, image_size=(0, 5))


def test_real_images():
    root = next((parent / 'shared' / 'data' for parent in Path(__file__).resolve().parents
                 if (parent / 'shared' / 'data').is_dir()), None)
    if root is None:
        pytest.skip('the real sequences (../shared/data) are not here')
    with open_source(root / 'kuka_chess' / 'images') as source:
        assert source.count == 30 and source.image_size == (1928, 1208)
        assert next(iter(source)).name == '01.jpg'
    with open_source(root / 'visp_tracking_videos' / 'images' / 'teabox.mp4') as source:
        assert source.image_size == (640, 480) and sum(1 for _ in source) == source.count


@pytest.mark.long
def test_a_long_table_is_thinned_to_frames_that_still_share_points(tmp_path):
    # 40 points a frame, each seen in 10 frames
    frame, track = (grid.ravel() for grid in np.mgrid[:900, :40])
    track = track + 4 * frame
    x = 600 - 60 * (frame - (track - 39) / 4)
    tracks = Tracks(frame, track, np.column_stack([x, track % 7 * 60.0]), (640, 480))
    tracks.to_csv(tmp_path / 'long.csv')
    for limit, most in ((None, MAX_TABLE_FRAMES), (30, 30)):
        found = read_tracks(tmp_path / 'long.csv', image_size=(640, 480), max_keyframes=limit)
        assert 3 <= len(found.tracks.frames) <= most and 'out of 900 frames' in found.notes[0]
    tracks.in_frames(range(MAX_TABLE_FRAMES)).to_csv(tmp_path / 'short.csv')
    found = read_tracks(tmp_path / 'short.csv', image_size=(640, 480))
    assert len(found.tracks.frames) == MAX_TABLE_FRAMES and not found.notes


def test_images_that_all_show_the_same_are_said_to(tmp_path):
    image = cv2.GaussianBlur(np.random.default_rng(2).integers(0, 255, (240, 320), np.uint8),
                             (0, 0), 2)
    for number in range(8):
        cv2.imwrite(str(tmp_path / f'{number}.png'), image)
    with pytest.raises(InputError, match='all show the same from one place'):
        read_tracks(tmp_path)
    for number in range(8):
        cv2.imwrite(str(tmp_path / f'{number}.png'), np.zeros((240, 320), np.uint8))
    with pytest.raises(InputError, match='need texture and overlap'):
        read_tracks(tmp_path)
