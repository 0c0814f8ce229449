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
"""The rectified preview is what the lens says, and pictures stay small."""

import re

import cv2
import numpy as np
import pytest
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.rectified import rectified_preview
from selfcal_ros.report.small_jpeg import small_jpeg

K = np.array([[400.0, 0, 320], [0, 400, 240], [0, 0, 1]])


def drawn(camera):
    """Draw an image that is dark left of what the lens makes of the line x = 0.3, bright right."""
    u, v = np.meshgrid(np.arange(640.0), np.arange(480.0))
    flat = camera.normalised(np.stack([u, v], axis=-1))
    return np.where(flat[..., 0] > 0.3, 255, 0).astype(np.uint8)


@pytest.mark.parametrize('camera', [
    Camera(K, [-0.3, 0.08, 0.001, 0, 0], 640, 480),
    Camera(K, [0.02, 0, 0, 0], 640, 480, 'equidistant')])
def test_a_straight_line_comes_out_straight(camera):
    image = drawn(camera)
    found = rectified_preview(camera, image)
    after = cv2.imdecode(np.frombuffer(found.after, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert after.shape == (480, 640)
    edge = np.argmax(after > 128, axis=1)
    seen = after.max(axis=1) > 128
    assert seen.mean() > 0.8 and np.abs(edge[seen] - (320 + 0.3 * 400)).max() <= 1.5
    before = np.argmax(image > 128, axis=1)
    assert np.ptp(before) > 5       # bent by the lens


def test_beyond_the_fold_there_is_nothing():
    # a barrel that turns back at a normalised radius of 1 / sqrt(3 * 0.6)
    camera = Camera(K, [-0.6, 0, 0, 0, 0], 640, 480)
    found = rectified_preview(camera, np.full((480, 640, 3), 200, np.uint8))
    after = cv2.imdecode(np.frombuffer(found.after, np.uint8), cv2.IMREAD_GRAYSCALE)
    reach = 400 / np.sqrt(3 * 0.6)
    u, v = np.meshgrid(np.arange(640) - 320, np.arange(480) - 240)
    radius = np.hypot(u, v)
    assert after[radius < reach - 6].min() > 150 and after[radius > reach + 6].max() < 60
    assert found.filled == pytest.approx(float((radius < reach).mean()), abs=0.01)
    for path in (found.bent, found.straight):
        assert re.fullmatch(r'([ML]-?[0-9.]+ -?[0-9.]+)+', path)


def test_without_distortion_or_with_another_size_there_is_no_preview():
    image = np.zeros((480, 640), np.uint8)
    assert rectified_preview(Camera(K, (), 640, 480), image) is None
    assert rectified_preview(Camera(K, [0.1, 0, 0, 0, 0], 320, 240), image) is None


def test_even_noise_becomes_small():
    noise = np.random.default_rng(6).integers(0, 255, (600, 800, 3), dtype=np.uint8)
    data = small_jpeg(noise, 800, 60_000)
    assert 1000 < len(data) <= 60_000
    plain = cv2.imdecode(np.frombuffer(small_jpeg(np.zeros((90, 120), np.uint8), 800, 60_000),
                                       np.uint8), cv2.IMREAD_GRAYSCALE)
    assert plain.shape == (90, 120)
