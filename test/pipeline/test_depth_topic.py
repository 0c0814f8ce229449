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
"""Depth images beside images: decoded, paired by their stamps, read from bags."""

from types import SimpleNamespace
import weakref

from msg_adapters.image import depth_metres, image_message
from msg_adapters.message_types import rosbags_types
from msg_adapters.stamps import header_message
import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from selfcal_ros.cli.main import main
from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.depth_pairing import DepthPairing, MOST_KEPT
from selfcal_ros.pipeline.depth_topic import DepthTopic, open_depths
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.pipeline.tracking_run import Target, track_objects
from selfcal_ros.report.camera_yaml import write_camera_yaml
from selfcal_ros.report.poses_csv import read_poses
from selfcal_ros.rorapid.model import write_model
from selfcal_ros.synthetic.depth_scenes import depth_of
from selfcal_ros.synthetic.objects import tracked_object

DEPTH = np.array([[0.5, 1.25, 0.0], [2.0, 0.001, 65.535]], np.float32)


def message(encoding, data, step, size=(3, 2), big=0):
    return SimpleNamespace(encoding=encoding, data=data, step=step, width=size[0], height=size[1],
                           is_bigendian=big)


@pytest.mark.parametrize('msg', (
    message('16UC1', np.rint(1000 * DEPTH).astype('<u2').tobytes(), 6),
    message('mono16', np.rint(1000 * DEPTH).astype('>u2').tobytes(), 6, big=1),
    message('32FC1', DEPTH.astype('<f4').tobytes(), 12),
    message('32FC1', DEPTH.astype('>f4').tobytes(), 12, big=1),
    message('32FC1', np.pad(DEPTH, ((0, 0), (0, 1))).astype('<f4').tobytes(), 16)),
    ids=('16UC1', 'mono16 big', '32FC1', '32FC1 big', '32FC1 padded'))
def test_depths_are_metres(msg):
    assert np.allclose(depth_metres(msg), DEPTH, rtol=1e-6)


@pytest.mark.parametrize('msg, words', (
    (message('rgb8', bytes(18), 9), '16UC1'), (message('32FC1', bytes(20), 12), 'holds 20 bytes'),
    (message('32FC1', bytes(24), 8), 'step 8'), (message('16UC1', bytes(5), 6), 'truncated'),
    (message('32FC1', bytes(24), 12, (0, 2)), 'says 0 x 2')))
def test_what_is_no_depth_image_is_said(msg, words):
    with pytest.raises(InputError, match=words):
        depth_metres(msg)


MS = 1_000_000


def test_depth_images_without_stamps_are_not_gathered():
    zero = SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0)))
    depths = DepthTopic(iter([(None, zero)] * 500))
    assert depths.at(10**18) is None and not depths._kept


def test_images_wait_for_their_depth_until_the_next_image():
    pairing = DepthPairing()
    assert pairing.image(0, 'a') == [('a', None)]
    assert pairing.depth(0, 'A') == []
    assert pairing.image(33 * MS, 'b') == []
    assert pairing.depth(35 * MS, 'B') == [('b', 'B')]
    # the depth comes first
    assert pairing.depth(66 * MS, 'C') == [] and pairing.image(66 * MS, 'c') == [('c', 'C')]
    # it never comes
    assert pairing.image(100 * MS, 'd') == []
    assert pairing.image(133 * MS, 'e') == [('d', None)]
    assert pairing.depth(133 * MS, 'E') == [('e', 'E')]
    # the depth camera fell silent: nothing waits
    assert pairing.image(2000 * MS, 'f') == [('f', None)]


@pytest.mark.parametrize('step_ns', [0, -1])
def test_depths_whose_stamps_stand_still_or_creep_back_are_not_gathered(step_ns):
    pairing = DepthPairing()
    depths = [np.zeros(1) for _ in range(3 * MOST_KEPT)]
    alive = [weakref.ref(one) for one in depths]
    for k in range(len(depths)):
        pairing.depth(step_ns * k, depths[k])
        depths[k] = None
    assert sum(one() is not None for one in alive) <= MOST_KEPT


@pytest.mark.parametrize('lead_ms', (0, 40, 50, 300, 450))
def test_depths_that_come_first_are_kept_for_their_images(lead_ms):
    pairing, paired = DepthPairing(), []
    arrivals = sorted([(33 * k + lead_ms, 'image', k) for k in range(1, 30)]
                      + [(33 * k, 'depth', k) for k in range(1, 45)])
    for _, what, k in arrivals:
        paired += getattr(pairing, what)(33 * k * MS, k)
    # with one clock the order of the two topics is open
    assert [depth for _, depth in paired[2:]] == [image for image, _ in paired[2:]]
    assert len(paired) >= 28


def test_depths_of_another_run_of_the_recording_are_forgotten():
    pairing = DepthPairing()
    pairing.depth(300 * MS, 'old')
    assert pairing.image(300 * MS, 'a') == [('a', 'old')]
    # played again: the depths come first, and the one of the image is missing
    assert pairing.depth(33 * MS, 'B') == [] and pairing.image(33 * MS, 'b') == [('b', 'B')]
    assert pairing.image(300 * MS, 'c') == []
    assert pairing.depth(300 * MS, 'C') == [('c', 'C')]
    # far ahead of the depths, or far behind them, none is waited for
    assert pairing.image(5000 * MS, 'd') == [('d', None)]
    assert pairing.depth(9000 * MS, 'E') == [] and pairing.image(0, 'e') == [('e', None)]


@pytest.fixture(scope='module')
def made():
    made = tracked_object(14, shape='l_block', size=(320, 240), supersampling=2, seed=6)
    renderer = made.renderer()
    images = [made.frame(k, renderer) for k in range(14)]
    corners = 1 / 1.05 * made.model.vertices[made.model.triangles]
    poses = made.cam_from_world.copy()
    poses[:, :, 3] /= 1.05
    return made, images, [depth_of(corners, pose, made.camera, np.random.default_rng(k), 1.5)
                          for k, pose in enumerate(poses)]


def write(path, made, images, depths, late_ns=0):
    store = get_typestore(Stores.ROS2_JAZZY)
    types, kind = rosbags_types(store), 'sensor_msgs/msg/Image'
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = [writer.add_connection(name, kind, typestore=store)
                  for name in ('/image', '/depth')]
        for stamp, image, depth in zip(made.stamps_ns.tolist(), images, depths):
            grey = image_message(image, header_message(stamp, 'camera', types), types)
            far = image_message(np.rint(1000 * depth).astype(np.uint16),
                                header_message(stamp + late_ns, 'camera', types), types, '16UC1')
            # depths are recorded a little later
            writer.write(topics[0], stamp, store.serialize_cdr(grey, kind))
            writer.write(topics[1], stamp + 20 * MS, store.serialize_cdr(far, kind))
    return path


def test_a_bag_with_depths_says_that_the_model_is_too_large(made, tmp_path, capsys):
    made, images, depths = made
    bag = write(tmp_path / 'bag', made, images, depths)
    with open_depths(next(bag.glob('*.mcap')), 'depth') as topic:
        assert topic.at(int(made.stamps_ns[0]) - 10**9) is None
        assert np.allclose(topic.at(int(made.stamps_ns[3])), depths[3], atol=6e-4)
    write_camera_yaml(tmp_path / 'camera.yaml', made.camera, 'camera')
    from selfcal_ros.geometry.rotation import rotation_vector
    start = ' '.join(f'{x:.6f}' for x in (*made.translations[0],
                                          *rotation_vector(made.rotations[0])))
    command = ['track', str(bag), '--topic', '/image', '--depth-topic', '/depth', '--init', start,
               '--model', str(write_model(made.model, tmp_path / 'block.yaml')), '--camera',
               str(tmp_path / 'camera.yaml'), '--output', str(tmp_path / 'poses.csv')]
    assert main(command) == 0
    assert 'The depth images say that the model is 5.' in capsys.readouterr().out
    assert (read_poses(tmp_path / 'poses.csv')['state'] == 'degraded').any()
    command[command.index('/depth')] = '/image_raw'
    assert main(command) == 2
    assert "no images on '/image_raw'; there are /depth, /image" in capsys.readouterr().err
    with pytest.raises(InputError, match='is no bag, so it has no topic /depth of depths'):
        with open_depths(tmp_path, '/depth'):
            pass


@pytest.mark.long
def test_depths_of_other_times_are_not_used_in_silence(made, tmp_path, capsys):
    made, images, depths = made
    bag = write(tmp_path / 'bag', made, images, depths, late_ns=16 * MS)
    write_camera_yaml(tmp_path / 'camera.yaml', made.camera, 'camera')
    assert main(['track', str(bag), '--topic', '/image', '--depth-topic', '/depth', '--init',
                 '0 0 0.5 0 0 0', '--model', str(write_model(
                     made.model, tmp_path / 'block.yaml')), '--camera',
                 str(tmp_path / 'camera.yaml'), '--output', str(tmp_path / 'poses.csv')]) == 2
    assert 'No image has a depth image of its time' in capsys.readouterr().err


def test_a_depth_message_that_cannot_be_used_is_told_and_the_run_goes_on(made, tmp_path):
    made, images, depths = made
    folder = tmp_path / 'images'
    folder.mkdir()
    for k, image in enumerate(images[:6]):
        cv2.imwrite(str(folder / f'frame{k}.png'), image)

    class Depths:
        asked = -1

        def at(self, stamp):
            self.asked += 1
            if self.asked == 2:
                raise InputError('A depth image must be 16UC1.')
            return depths[self.asked]

    with open_source(folder) as source:
        run, = track_objects(source, [Target(made.model, (
            made.rotations[0], made.translations[0]))], made.camera, depths=Depths())
    assert run.images == 6 and run.by_state == {'tracking': 6}
    said = 'frame2.png was tracked without its depth image: A depth image must be 16UC1.'
    assert run.remarks == [said] and said in run.text()
