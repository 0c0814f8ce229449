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
"""Our CameraInfo as image_geometry reads it; runs where that package is installed."""

import cv2
from msg_adapters.camera_info import camera_info_message, image_camera_from_info, ImageWindow
from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import header_message
import numpy as np
import pytest

from selfcal_ros.geometry.camera import Camera

image_geometry = pytest.importorskip('image_geometry')
TYPES = rclpy_types()
CAMERA = Camera(np.array([[520.0, 0, 321.5], [0, 521, 238], [0, 0, 1]]),
                [-0.1, 0.02, 0.001, -0.002, 0.003], 640, 480)
WINDOWS = [ImageWindow(), ImageWindow(2, 2), ImageWindow(1, 1, 100, 60, 320, 240),
           ImageWindow(2, 2, 100, 60, 320, 240)]


def model_of(window):
    """Return their model of our message, and the message."""
    info = camera_info_message(CAMERA, header_message(7, 'optical', TYPES), TYPES, window=window)
    model = image_geometry.PinholeCameraModel()
    getattr(model, 'from_camera_info', getattr(model, 'fromCameraInfo', None))(info)
    return model, info


@pytest.mark.parametrize('window', WINDOWS, ids=str)
def test_rectified_pixels_are_those_of_our_camera(window):
    model, info = model_of(window)
    ours = image_camera_from_info(info)
    project = getattr(model, 'project_3d_to_pixel', getattr(model, 'project3dToPixel', None))
    for point in ([0.3, -0.2, 2.0], [-0.5, 0.1, 3.0]):
        # the rectified image has no distortion and the same K
        expected = ours.K @ point
        assert np.allclose(project(point), expected[:2] / expected[2], atol=1e-9)


@pytest.mark.parametrize('window', WINDOWS, ids=str)
def test_rectification_undoes_our_distortion(window):
    model, info = model_of(window)
    ours = image_camera_from_info(info)
    point = np.array([0.25, -0.15, 1.0])
    raw, _ = cv2.projectPoints(point.reshape(1, 1, 3), np.zeros(3), np.zeros(3), ours.K,
                               ours.distortion)
    rectify = getattr(model, 'rectify_point', getattr(model, 'rectifyPoint', None))
    rectified = np.asarray(rectify(raw.ravel())).ravel()
    assert np.allclose(rectified, (ours.K @ point)[:2], atol=0.05)
