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
"""Poses of the robot: what was written is read, chains are composed, and bad input is said."""

import cv2
from msg_adapters.body_poses import body_pose, transforms
from msg_adapters.message_types import rosbags_types
from msg_adapters.poses import pose_message, transform_message
from msg_adapters.stamps import header_message
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from scipy.spatial.transform import Rotation
from selfcal_ros.calibration.mount import MountFacts
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.pipeline.robot.pose_checks import PoseReading
from selfcal_ros.pipeline.robot.robot_mount import read_robot
from selfcal_ros.pipeline.robot.robot_source import RobotSource
from selfcal_ros.values.transform_tree import TransformTree

START_NS = 1_700_000_000_123_456_789
STEP_NS = 50_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = rosbags_types(STORE)


def course(count=21):
    """Return poses of a body that drives a curve, (N, 4, 4)."""
    turn = np.linspace(0, 1.2, count)
    poses = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    poses[:, :3, :3] = Rotation.from_euler('z', turn[:, None]).as_matrix()
    poses[:, :3, 3] = np.column_stack([np.sin(turn), 1 - np.cos(turn), 0 * turn])
    return poses


def stamps(count=21):
    return START_NS + STEP_NS * np.arange(count)


def of(name, **fields):
    """Build a message of rosbags of any type."""
    package, kind = name.split('/')
    return TYPES._builder(package, kind)(**fields)


def odometry(pose, stamp):
    both = TYPES.PoseWithCovariance(pose=pose_message(pose, TYPES))
    return of('nav_msgs/Odometry', header=header_message(stamp, 'odom', TYPES),
              child_frame_id='base_link', pose=both)


def tf(pose, stamp, parent, child):
    return of('tf2_msgs/TFMessage', transforms=[transform_message(
        pose, header_message(stamp, parent, TYPES), child, TYPES)])


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return a bag of images, odometry, poses and transforms."""
    path = tmp_path_factory.mktemp('robot') / 'drive'
    lifted = np.eye(4)
    lifted[:3, 3] = 0, 0, 0.3
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=STORE)
                       for topic, kind in (('/image', 'sensor_msgs/msg/Image'),
                                           ('/odom', 'nav_msgs/msg/Odometry'),
                                           ('/pose', 'geometry_msgs/msg/PoseStamped'),
                                           ('/tf', 'tf2_msgs/msg/TFMessage'),
                                           ('/tf_static', 'tf2_msgs/msg/TFMessage'))}

        def write(topic, stamp, message):
            connection = connections[topic]
            writer.write(connection, stamp, STORE.serialize_cdr(message, connection.msgtype))

        write('/tf_static', START_NS, tf(lifted, 0, 'base_link', 'lift'))
        for k, (pose, stamp) in enumerate(zip(course(), stamps().tolist())):
            header = header_message(stamp, 'odom', TYPES)
            write('/odom', stamp, odometry(pose, stamp))
            write('/pose', stamp, TYPES.PoseStamped(header=header,
                                                    pose=pose_message(pose, TYPES)))
            write('/tf', stamp, tf(pose, stamp, 'odom', 'base_link'))
            if k % 10 == 0:
                # what moves on the body is told less often
                turned = np.eye(4)
                turned[:3, :3] = Rotation.from_euler('z', 0.05 * k).as_matrix()
                write('/tf', stamp, tf(turned, stamp, 'lift', 'tip'))
                write('/image', stamp, of(
                    'sensor_msgs/Image', header=header, height=24, width=32, step=32,
                    encoding='mono8', data=np.full(24 * 32, k, np.uint8)))
    return path


def read(path, text, **reading):
    return read_robot(path, RobotSource.parse(text, PoseReading(**reading)), MountFacts()).poses


@pytest.mark.parametrize('name, kind', [('/odom', 'odometry'), ('odom', 'odometry'),
                                        ('/pose', 'absolute'),
                                        ('/tf:odom:base_link', 'odometry')])
def test_a_bag_tells_the_poses_that_went_in(bag, name, kind):
    found = read(bag, name)
    assert found.kind == kind and found.world_frame == 'odom'
    assert (found.stamps_ns == stamps()).all()
    assert np.allclose(found.position, course()[:, :3, 3])
    assert np.allclose(found.rotation, course()[:, :3, :3])


def test_a_chain_of_transforms_is_composed_and_interpolated(bag):
    found = read(bag, '/tf:odom:tip')
    assert (found.stamps_ns == stamps()).all()
    turn = np.linspace(0, 1.2, 21) + 0.05 * np.arange(21)
    expected = Rotation.from_euler('z', turn[:, None])
    assert np.allclose(found.rotation, expected.as_matrix())
    assert np.allclose(found.position, course()[:, :3, 3] + [0, 0, 0.3])
    back = read(bag, '/tf:tip:odom')
    product = np.einsum('nij,njk->nik', back.rotation, found.rotation)
    assert np.allclose(product, np.eye(3)) and back.kind == 'absolute'


def test_messages_of_rclpy_are_read_like_those_of_rosbags():
    nav, geometry = pytest.importorskip('nav_msgs.msg'), pytest.importorskip('geometry_msgs.msg')
    msg = nav.Odometry()
    msg.header.stamp.sec, msg.header.frame_id, msg.child_frame_id = 7, 'odom', 'base'
    msg.pose.pose.position.x = 1.5
    stamp, pose, world, body = body_pose(msg)
    assert (stamp, world, body, pose[0, 3]) == (7 * 10**9, 'odom', 'base', 1.5)
    one = geometry.TransformStamped()
    one.header.frame_id, one.child_frame_id, one.transform.translation.z = '/a', 'b', 2.0

    class Tf:
        transforms = [one]

    (_, matrix, parent, child), = transforms(Tf, pytest.fail, is_static=True)
    assert (matrix[2, 3], parent, child) == (2.0, 'a', 'b')


@pytest.mark.parametrize('name, words', [
    ('/odometry', ('/odometry', '/odom (21)', '/pose (21)', '/tf:FIXED:BODY',
                   '(frames base_link, lift, odom, tip)')),
    ('/image', ('carries sensor_msgs/msg/Image', '/odom (21)')),
    ('/tf:odom:wheel', ('no frame wheel', 'base_link, lift, odom, tip')),
    ('/tf:base_link:lift', ('moves in TF',))])
def test_what_a_bag_does_not_have_is_told_with_what_it_has(bag, name, words):
    with pytest.raises(InputError) as caught:
        read(bag, name)
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize('text', ['/tf', '/tf:odom', '/tf:odom:odom', '/odom:base_link', ' '])
def test_what_names_no_poses_is_refused(text):
    with pytest.raises(ArgumentError):
        RobotSource.parse(text)


def test_two_trees_have_no_chain():
    tree = TransformTree()
    tree.add(0, np.eye(4), 'a', 'b')
    tree.add(0, np.eye(4), 'c', 'd')
    with pytest.raises(InputError, match='No chain'):
        tree.poses('a', 'd')
    with pytest.raises(InputError, match='two parents'):
        tree.add(0, np.eye(4), 'c', 'b')


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder of images whose names are instants."""
    path = tmp_path_factory.mktemp('stamped')
    for stamp in stamps(3).tolist():
        cv2.imwrite(str(path / f'{stamp}.png'), np.zeros((24, 32), np.uint8))
    return path


HEAD = 'stamp_ns,tx,ty,tz,qw,qx,qy,qz\n'


def rows(count=3, scale=1.0, quaternion='1,0,0,0'):
    return ''.join(f'{stamp},{scale * 0.1 * k},0,0,{quaternion}\n'
                   for k, stamp in enumerate(stamps(count).tolist()))


def table(tmp_path, text):
    path = tmp_path / 'poses.csv'
    path.write_text(text, encoding='utf-8')
    return str(path)


def test_a_table_is_read_by_stamps_frames_and_names(folder, tmp_path):
    found = read(folder, table(tmp_path, HEAD + rows()))
    assert (found.stamps_ns == stamps(3)).all() and found.kind == 'absolute'
    names = sorted(path.name for path in folder.iterdir())
    found = read(folder, table(tmp_path, 'image,tx,ty,tz,rx,ry,rz\n' + ''.join(
        f'{name},{k},0,0,0,0,0.5\n' for k, name in reversed(list(enumerate(names))))))
    assert found.frames.tolist() == [0, 1, 2] and found.position[:, 0].tolist() == [0, 1, 2]
    assert np.allclose(found.rotation, Rotation.from_euler('z', 0.5).as_matrix())
    found = read(folder, table(tmp_path, 'frame,x,y,theta\n0,0,0,0\n2,1,2,0.3\n'))
    assert found.kind == 'odometry' and found.frames.tolist() == [0, 2]
    assert np.allclose(found.position[1], [1, 2, 0])
    found = read(folder, table(tmp_path, 'stamp_s' + HEAD[8:] + ''.join(
        f'{stamp // 10**9}.{stamp % 10**9:09d},{k},0,0,1,0,0,0\n'
        for k, stamp in enumerate(stamps(3).tolist()))))
    assert (found.stamps_ns == stamps(3)).all()


def test_cells_may_be_parted_by_semicolons(folder, tmp_path):
    found = read(folder, table(tmp_path, 'frame;x;y;theta\n0;0;0;0\n2;1;2;0.3\n'))
    assert found.frames.tolist() == [0, 2] and np.allclose(found.position[1], [1, 2, 0])


def test_decimals_may_follow_commas_where_semicolons_part_the_cells(folder, tmp_path):
    lines = (HEAD + rows(quaternion='0.8,0,0,-0.6')).replace(',', ';').replace('.', ',')
    found = read(folder, table(tmp_path, lines))
    assert found.position[:, 0] == pytest.approx([0, 0.1, 0.2])
    assert np.allclose(found.rotation, Rotation.from_quat([0, 0, -0.6, 0.8]).as_matrix())
    with pytest.raises(InputError, match='decimal points where commas part the cells'):
        read(folder, table(tmp_path, (HEAD + rows()).replace('.', ',')))


def test_clocks_whose_offset_is_stated_may_be_far_apart(folder, tmp_path):
    source = RobotSource.parse(table(tmp_path, HEAD + rows().replace('1700000000', '1699996400')))
    beside = read_robot(folder, source, MountFacts(time_offset=(3600.0, 0.1)))
    assert (beside.poses.stamps_ns == stamps(3) - 3600 * 10**9).all()


def test_the_frame_of_the_images_is_known_beside_the_poses(bag):
    assert read_robot(bag, RobotSource.parse('/pose'), MountFacts()).camera_frame == 'odom'


MIRROR = 'frame,tx,ty,tz,' + ','.join(f'r{i}{j}' for i in '123' for j in '123') + '\n'


@pytest.mark.parametrize('text, words', [
    (HEAD + rows(quaternion='2,0,0,0'), ('line 2', 'length 2')),
    (HEAD + rows().replace('0.1', 'nan'), ('line 3', 'tx is not finite')),
    (HEAD + rows().replace('0.1', 'here'), ('line 3', "'here'")),
    (HEAD + rows() + rows().splitlines()[-1], ('two poses', str(stamps(3)[-1]))),
    (HEAD + '\n'.join(reversed(rows().splitlines())), ('goes back',)),
    *((HEAD + rows(scale=scale), ('millimetres', '--robot-unit 0.001')) for scale in (8e2, 1e4)),
    (HEAD + rows().replace('1700000000', '1600000000'), ('end 100000000 s before', 'images from')),
    (HEAD + rows().replace('1700000000', '1700000009'), ('after the images end',)),
    (HEAD + rows().replace('1700000000', '1699996400'), ('end 3600 s before', 'time_offset=')),
    (HEAD + ''.join(f'{1700000000000 + 50 * k},{k},0,0,1,0,0,0\n' for k in range(3)),
     ('hardly nanoseconds', '50 ns apart', 'stamp_s')),
    (HEAD + ''.join(f'{17 * 10**14 + 10**5 * k},{0.02 * k},0,0,1,0,0,0\n' for k in range(3)),
     ('hardly nanoseconds', '1e+05 ns apart')),
    (HEAD + ''.join(f'0,{k},0,0,1,0,0,0\n' for k in range(3)), ('All poses', 'stamp_ns 0')),
    (HEAD + ''.join(f'17.5,{k},0,0,1,0,0,0\n' for k in range(3)), ('name the column stamp_s',)),
    (HEAD.replace('stamp_ns', 't') + rows(), ('it has the columns t, tx', 'stamp_ns')),
    (HEAD.replace('qw', 'w') + rows(), ('columns', 'qw,qx,qy,qz')),
    (HEAD.replace('stamp_ns', 'number') + rows(), ('stamp_ns, frame or image',)),
    (HEAD.replace('stamp_ns', 'image') + rows().replace('17000', 'x'), ('names no image',)),
    (HEAD.replace('stamp_ns', 'frame') + rows(), ('none has both',)),
    (MIRROR + ''.join(f'{k},0,0,0,1,0,0,0,1,0,0,0,-1\n' for k in (0, 1)), ('left-handed',)),
    (HEAD.replace('qw,qx,qy,qz', 'rx,ry,rz') + rows(quaternion='0,0,90'), ('degrees',)),
    (HEAD + '1,2\n3,4\n', ('2 cells',)), (HEAD, ('two poses at least',))])
def test_a_bad_table_is_one_sentence(folder, tmp_path, text, words):
    with pytest.raises(InputError) as caught:
        read(folder, table(tmp_path, text))
    sentence = str(caught.value)
    assert all(word in sentence for word in words), sentence
    assert sentence.endswith('.') and '\n' not in sentence


def test_absurd_units_and_places_are_refused(folder, tmp_path):
    for unit in (1e300, 1e-300, 0.0, float('nan')):
        with pytest.raises(ArgumentError, match='--robot-unit'):
            PoseReading(unit_m=unit)
    path = tmp_path / 'far.csv'
    path.write_text(HEAD + rows(scale=1e9))
    with pytest.raises(InputError, match='away'):
        read(folder, str(path), unit_m=1e3)


def test_a_unit_that_is_stated_is_not_doubted(folder, tmp_path):
    path = table(tmp_path, HEAD + rows(scale=1e3))
    assert read(folder, path, unit_m=0.001).position[1, 0] == pytest.approx(0.1)
    assert read(folder, path, unit_m=1.0).position[1, 0] == pytest.approx(100)
    found = read(folder, path, unit_m=1.0, kind='odometry', sigma_position_m=0.02)
    assert (found.kind, found.sigma_position_m) == ('odometry', 0.02)


def test_images_without_a_clock_need_frames(folder, tmp_path):
    images = tmp_path / 'plain'
    images.mkdir()
    for path in folder.iterdir():
        (images / f'a{path.name}').write_bytes(path.read_bytes())
    with pytest.raises(InputError, match='do not say when they were taken'):
        read(images, table(tmp_path, HEAD + rows()))
    with pytest.raises(InputError, match='is no bag, so it has no topic /odom'):
        read(images, '/odom')
