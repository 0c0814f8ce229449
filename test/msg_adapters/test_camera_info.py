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
"""CameraInfo against image_geometry's formulas and bit-exact headers."""

from msg_adapters.camera_info import (camera_from_info, camera_info_message,
                                      image_camera_from_info, ImageWindow, window_of)
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera

CAMERA = Camera([[1001.25, 0.5, 642.125], [0, 998.75, 481.0625], [0, 0, 1]],
                [-0.3, 0.1, 1e-5, -2e-4, 0.01], 1280, 960)


def test_round_trip(types, header):
    msg = camera_info_message(CAMERA, header, types)
    again = camera_from_info(msg)
    assert (again.K == CAMERA.K).all() and (again.distortion == CAMERA.distortion).all()
    assert (again.width, again.height) == (1280, 960)
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec, msg.header.frame_id) == (
        1_700_000_001, 123_456_789, 'camera_optical_frame')
    assert msg.distortion_model == 'plumb_bob' and len(msg.d) == 5
    assert np.asarray(msg.k).tolist() == CAMERA.K.ravel().tolist()
    assert np.asarray(msg.r).tolist() == np.eye(3).ravel().tolist()
    assert np.asarray(msg.p).tolist() == np.column_stack([CAMERA.K, np.zeros(3)]).ravel().tolist()


def test_uncalibrated_is_zeros(types, header):
    msg = camera_info_message(None, header, types, size=(640, 480))
    assert not any(np.any(getattr(msg, name)) for name in 'dkrp')
    assert (msg.width, msg.height) == (640, 480) and camera_from_info(msg) is None
    assert image_camera_from_info(msg) is None


def test_headers_cross_between_the_two_kinds(types, header):
    from msg_adapters.message_types import rosbags_types
    msg = camera_info_message(CAMERA, header, rosbags_types())
    assert msg.header.stamp.nanosec == 123_456_789


@pytest.mark.parametrize('window', [
    ImageWindow(), ImageWindow(2, 2), ImageWindow(1, 1, 100, 60, 640, 480, True),
    ImageWindow(2, 3, 100, 60, 640, 480, True)])
def test_binning_and_region_as_image_geometry_does(types, header, window):
    msg = camera_info_message(CAMERA, header, types, window=window)
    assert window_of(msg) == window
    image = image_camera_from_info(msg)
    bx, by = max(window.binning_x, 1), max(window.binning_y, 1)
    assert image.K[0, 0] == pytest.approx(CAMERA.K[0, 0] / bx, rel=1e-14)
    assert image.K[1, 1] == pytest.approx(CAMERA.K[1, 1] / by, rel=1e-14)
    assert image.K[0, 2] == pytest.approx((CAMERA.K[0, 2] - window.x_offset) / bx, rel=1e-14)
    assert image.K[1, 2] == pytest.approx((CAMERA.K[1, 2] - window.y_offset) / by, rel=1e-14)
    assert (image.width, image.height) == ((window.width or 1280) // bx,
                                           (window.height or 960) // by)
    full = window.full_camera(image, 1280, 960)
    assert np.allclose(full.K, CAMERA.K, rtol=1e-14) and full.width == 1280


def test_the_size_of_a_cropped_sensor_is_not_guessed():
    with pytest.raises(ArgumentError, match='full size'):
        ImageWindow(1, 1, 100, 60, 640, 480).full_camera(CAMERA)
    assert ImageWindow(2, 2).full_camera(CAMERA).width == 2560


def test_a_camera_without_size_needs_one(types, header):
    camera = Camera(np.eye(3))
    with pytest.raises(ArgumentError, match='image size'):
        camera_info_message(camera, header, types)
    assert camera_info_message(camera, header, types, size=(8, 6)).width == 8


@pytest.mark.parametrize('changed, words', [
    ({'distortion_model': 'equidistant', 'd': [0.1, 0.1, 0.1]}, 'has 4 coefficients, not 3'),
    ({'distortion_model': 'rational_polynomial', 'd': [0.1] * 12}, 'has 8 coefficients, not 12'),
    ({'distortion_model': 'magic', 'd': [0.1] * 4}, "'magic' is not supported"),
    ({'d': [np.nan] * 5}, 'all finite'),
    ({'k': [-5, 0, 3, 0, 5, 3, 0, 0, 1]}, 'K must be'),
    ({'k': [np.nan] * 9}, 'finite'),
])
def test_wrong_camera_infos(types, header, changed, words):
    good = {'header': header, 'width': 640, 'height': 480, 'distortion_model': 'plumb_bob',
            'd': np.zeros(5), 'k': CAMERA.K}
    with pytest.raises(InputError, match=words):
        camera_from_info(types.CameraInfo(**{**good, **changed}))


def test_short_and_padded_distortion(types, header):
    for model, d in (('plumb_bob', []), ('', []), ('plumb_bob', [0.1, 0.2]),
                     ('rational_polynomial', [0.1, 0.2, 0, 0, 0, 0, 0, 0])):
        msg = types.CameraInfo(header=header, width=640, height=480, distortion_model=model, d=d,
                               k=CAMERA.K)
        assert camera_from_info(msg).distortion[:2].tolist() == (list(d) + [0, 0])[:2]


@pytest.mark.parametrize('model, d', [
    ('equidistant', [-0.02, 0.006, -0.004, 5e-4]),
    ('rational_polynomial', [0.78, 0.07, 1e-3, -2e-3, 0.001, 1.11, 0.24, 0.002])])
def test_wide_lenses_come_back(types, header, model, d):
    camera = Camera(CAMERA.K, d, 640, 480, model)
    msg = camera_info_message(camera, header, types)
    assert msg.distortion_model == model and list(msg.d) == d
    back = camera_from_info(msg)
    assert back.model == model and back.distortion.tolist() == d
    half = ImageWindow(2, 2).image_camera(camera)
    assert half.model == model and ImageWindow(2, 2).full_camera(half).model == model


def test_a_lens_that_ros_does_not_know(types, header):
    with pytest.raises(ArgumentError, match='cannot hold the lens model fov'):
        camera_info_message(Camera(CAMERA.K, [0.9], 640, 480, 'fov'), header, types)


def test_a_region_outside_of_the_sensor(types, header):
    window = ImageWindow(1, 1, 1000, 0, 640, 480)
    with pytest.raises(InputError, match='outside'):
        window_of(camera_info_message(CAMERA, header, types, window=window))
