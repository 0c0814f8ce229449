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
"""feature_tracker: one tracks message an image, whoever publishes the images, and how."""

import cv2
from msg_adapters.tracks import tracks_from_message
import numpy as np
import pytest
from rcl_interfaces.msg import Log
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from selfcal_ros.nodes.feature_tracker_node import FeatureTrackerNode
from sensor_msgs.msg import CompressedImage, Image, PointCloud2
from test_support import image_stream

STEP_PX = 4


def wall(frame):
    """Show a textured wall that slides to the left by STEP_PX a frame."""
    rng = np.random.default_rng(7)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (240, 900)).astype(np.float32), (0, 0), 2.0)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    return np.ascontiguousarray(texture[:, frame * STEP_PX:frame * STEP_PX + 320])


def image(frame, stamp_s=None):
    pixels = wall(frame)
    msg = Image(height=240, width=320, encoding='mono8', step=320)
    msg.data.frombytes(pixels.tobytes())
    return stamped(msg, frame, stamp_s)


def compressed(frame, stamp_s=None):
    msg = CompressedImage(format='mono8; png compressed')
    msg.data.frombytes(cv2.imencode('.png', wall(frame))[1].tobytes())
    return stamped(msg, frame, stamp_s)


def stamped(msg, frame, stamp_s):
    msg.header.frame_id = 'left_optical_frame'
    msg.header.stamp.sec = 100 + frame if stamp_s is None else stamp_s
    msg.header.stamp.nanosec = 123456789
    return msg


def play(graph, publisher, make, frames):
    """Publish one image at a time, and wait for its tracks."""
    tracks = graph.listen(PointCloud2, 'tracks')
    graph.wait_for(lambda: publisher.get_subscription_count() > 0, what='image subscription')
    sent = []
    for frame in frames:
        # the first may be lost while only one side knows of the other
        for _ in range(50):
            sent.append(make(frame))
            publisher.publish(sent[-1])
            known = len(tracks)
            try:
                graph.wait_for(lambda: len(tracks) > known, 0.5)
                break
            except AssertionError:
                continue
    return sent, tracks


@pytest.mark.parametrize('reliability', [ReliabilityPolicy.BEST_EFFORT,
                                         ReliabilityPolicy.RELIABLE])
@pytest.mark.parametrize('topic, message, make', [('image', Image, image),
                                                  ('image/compressed', CompressedImage,
                                                   compressed)])
def test_points_follow_the_wall(graph, reliability, topic, message, make):
    graph = graph()
    graph.add(FeatureTrackerNode())
    publisher = graph.probe.create_publisher(message, topic,
                                             QoSProfile(depth=5, reliability=reliability))
    sent, tracks = play(graph, publisher, make, range(5))
    assert [t.header for t in tracks[-5:]] == [msg.header for msg in sent[-5:]]
    first, last = (tracks_from_message(t) for t in (tracks[-5], tracks[-1]))
    assert first.image_size == (320, 240)
    common, a, b = np.intersect1d(first.track, last.track, return_indices=True)
    assert len(common) > 30
    moved = last.xy[b] - first.xy[a]
    assert np.abs(np.median(moved, axis=0) - (-4 * STEP_PX, 0)).max() < 0.05


def test_images_are_subscribed_to_only_while_somebody_listens(graph):
    graph = graph()
    graph.add(FeatureTrackerNode())
    publisher = graph.probe.create_publisher(Image, 'image', 5)
    graph.wait_for(lambda: graph.probe.count_publishers('tracks') > 0)
    graph.spin_for(0.5)
    assert publisher.get_subscription_count() == 0
    listener = graph.probe.create_subscription(PointCloud2, 'tracks', lambda msg: None, 10)
    graph.wait_for(lambda: publisher.get_subscription_count() > 0)
    graph.probe.destroy_subscription(listener)
    graph.wait_for(lambda: publisher.get_subscription_count() == 0)


def test_a_tracker_that_is_started_again_gives_other_ids(graph):
    graph = graph()
    tracks = graph.listen(PointCloud2, 'tracks')
    camera = graph.probe.create_publisher(Image, 'image', 5)
    seen = []
    for run in range(2):
        node = graph.add(FeatureTrackerNode())
        image_stream.play(graph, camera, image_stream.image, tracks, 2, first=2 * run)
        seen.append(set(tracks_from_message(tracks[-1]).track.tolist()))
        graph.executor.remove_node(node)
        graph.nodes.remove(node)
        node.destroy_node()
    # points of two runs that bear one id would be one point to a calibrator
    assert min(map(len, seen)) > 30 and not seen[0] & seen[1]


def test_time_that_jumps_back_gives_new_points_only(graph):
    graph = graph()
    graph.add(FeatureTrackerNode())
    publisher = graph.probe.create_publisher(Image, 'image', 5)
    _, tracks = play(graph, publisher, image, range(3))
    before = tracks_from_message(tracks[-1])
    play(graph, publisher, lambda frame: image(frame, 50), [3])
    after = tracks_from_message(tracks[-1])
    assert len(after.track) > 30
    assert not np.intersect1d(before.track, after.track).size


def test_an_image_that_cannot_be_read_is_dropped_and_the_next_is_used(graph):
    graph = graph()
    graph.add(FeatureTrackerNode())
    publisher = graph.probe.create_publisher(Image, 'image', 5)
    _, tracks = play(graph, publisher, image, range(2))
    count = len(tracks)
    for wrong in ({'encoding': 'secret'}, {'height': 2 ** 31}, {'step': 1}):
        msg = image(2)
        for name, value in wrong.items():
            setattr(msg, name, value)
        publisher.publish(msg)
    tiny = Image(height=1, width=1, encoding='mono8', step=1)
    tiny.data.append(7)
    publisher.publish(tiny)
    graph.spin_for(0.3)
    assert len(tracks) == count
    play(graph, publisher, image, [4])
    assert len(tracks) > count


def test_images_that_no_camera_sees_at_once_are_told(graph):
    """Two views beside each other, and odd rows of another instant: both are said, once each."""
    def odd(frame):
        pixels = np.hstack([wall(frame), wall(frame + 6)])
        pixels[1::2] = np.hstack([wall(frame + 3), wall(frame + 9)])[1::2]
        msg = Image(height=240, width=640, encoding='mono8', step=640)
        msg.data.frombytes(pixels.tobytes())
        return stamped(msg, frame, None)

    graph = graph()
    graph.add(FeatureTrackerNode())
    said = graph.listen(Log, '/rosout')
    publisher = graph.probe.create_publisher(Image, 'image', 5)
    _, tracks = play(graph, publisher, odd, range(24))
    graph.wait_for(lambda: sum(one.level == 30 for one in said) >= 2, what='warnings')
    for text in ('holds two views of one scene, left and right', 'interlaced'):
        assert sum(text in one.msg for one in said) == 1
    assert len(tracks_from_message(tracks[-1]).track) > 20


def test_no_point_is_followed_behind_a_mask_which_may_change(graph, tmp_path):
    usable = np.full((240, 320), 255, np.uint8)
    usable[120:] = 0
    cv2.imwrite(str(tmp_path / 'upper.png'), usable)
    cv2.imwrite(str(tmp_path / 'small.png'), usable[:100])
    graph = graph()
    node = graph.add(FeatureTrackerNode())
    publisher = graph.probe.create_publisher(Image, 'image', 5)
    _, tracks = play(graph, publisher, image, range(2))
    assert (tracks_from_message(tracks[-1]).xy[:, 1] > 130).sum() > 20

    def change(path):
        result, = node.set_parameters([Parameter('mask', value=str(path))])
        return result.reason

    assert change(tmp_path / 'upper.png') == ''
    _, tracks = play(graph, publisher, image, range(2, 5))
    low = tracks_from_message(tracks[-1]).xy[:, 1]
    assert len(low) > 20 and low.max() < 120
    assert 'none.png cannot be read' in change(tmp_path / 'none.png')
    # the size is known with the next image, which is dropped then
    assert change(tmp_path / 'small.png') == ''
    known = len(tracks)
    publisher.publish(image(6))
    graph.spin_for(0.5)
    assert len(tracks) == known
    assert change('') == ''
    _, tracks = play(graph, publisher, image, range(7, 9))
    assert (tracks_from_message(tracks[-1]).xy[:, 1] > 130).sum() > 20
