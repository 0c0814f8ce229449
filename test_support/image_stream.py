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
"""Images of a wall that slides by, for tests that look at nodes from outside."""

from functools import cache

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image

STEP_PX = 4


def wall(frame, width=320, height=240):
    """Show a textured wall that slides to the left by STEP_PX an image."""
    return np.ascontiguousarray(_painted(width, height)[:, frame * STEP_PX:][:, :width])


@cache
def _painted(width, height):
    rng = np.random.default_rng(7)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (height, width + 600)).astype(np.float32),
                               (0, 0), 2.0)
    return cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def _stamped(msg, frame, frame_id):
    msg.header.frame_id = frame_id
    msg.header.stamp.sec, msg.header.stamp.nanosec = 100 + frame, 123456789
    return msg


def image(frame, width=320, height=240, frame_id='camera_optical_frame'):
    """Return one image."""
    msg = Image(height=height, width=width, encoding='mono8', step=width)
    msg.data.frombytes(wall(frame, width, height).tobytes())
    return _stamped(msg, frame, frame_id)


def compressed(frame, frame_id='camera_optical_frame'):
    """Return one image as a PNG."""
    msg = CompressedImage(format='mono8; png compressed')
    msg.data.frombytes(cv2.imencode('.png', wall(frame))[1].tobytes())
    return _stamped(msg, frame, frame_id)


def play(graph, publisher, make, heard, count, first=0):
    """
    Publish images one at a time, each after something with the stamp of the last was heard.

    The first ones may be lost while only one side knows of the other; they are sent again.
    """
    for frame in range(first, first + count):
        message, known = make(frame), len(heard)
        # nodes start slowly on a machine that has other work
        for _ in range(30 if frame > first else 120):
            publisher.publish(message)
            try:
                graph.wait_for(lambda: message.header.stamp in [
                    msg.header.stamp for msg in heard[known:]], 1.0 if frame > first else 0.3)
                break
            except AssertionError:
                continue
        else:
            raise AssertionError(f'nothing came of image {frame}')
