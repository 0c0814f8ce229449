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
"""The camera model and the facts."""

import numpy as np
import pytest

from selfcal_ros import Camera, CameraFacts
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import PARAMETER_NAMES

K = [[520.0, 1.5, 328], [0, 530, 235], [0, 0, 1]]


def test_projection_follows_the_definition():
    camera = Camera(K, [-0.12, 0.05, 0.001, -0.002], 640, 480)
    X = np.array([0.3, -0.2, 1.5])
    x, y = X[:2] / X[2]
    r2 = x * x + y * y
    radial = 1 - 0.12 * r2 + 0.05 * r2 * r2
    xd = x * radial + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x)
    yd = y * radial + 0.001 * (r2 + 2 * y * y) - 2 * 0.002 * x * y

    np.testing.assert_allclose(camera.project(X), [520 * xd + 1.5 * yd + 328, 530 * yd + 235])


def test_undistortion_inverts_distortion_over_the_image():
    camera = Camera(K, [-0.3, 0.1, 0.002, 0.001, -0.01], 640, 480)
    pixels = np.stack(np.meshgrid(np.linspace(0, 639, 20), np.linspace(0, 479, 15)), axis=-1)

    np.testing.assert_allclose(camera.pixels(camera.normalised(pixels)), pixels, atol=1e-8)


def test_what_cannot_be_undistorted_is_nan():
    camera = Camera(K, [-0.5, 0, 0, 0])

    assert np.isnan(camera.normalised(np.array([5000.0, 4000.0]))).all()


def test_parameters_round_trip():
    values = [500, 510, 320, 240, 2, -0.1, 0.02, 0.001, -0.001, 0.003][:len(PARAMETER_NAMES)]

    np.testing.assert_allclose(Camera.from_parameters(values, 640, 480).parameters, values)


@pytest.mark.parametrize('bad', [np.eye(2), np.full((3, 3), np.nan), -np.eye(3),
                                 [[500, 0, 0], [1, 500, 0], [0, 0, 1]]])
def test_impossible_cameras_are_refused(bad):
    with pytest.raises(ArgumentError, match='K must be'):
        Camera(bad)


@pytest.mark.parametrize('fact', [{'aspect_ratio': 0.0}, {'aspect_ratio': float('nan')},
                                  {'skew': float('inf')}, {'principal_point': (1.0,)},
                                  {'distortion': 'fisheye'}, {'aspect_ratio_sigma': -1.0},
                                  {'skew': 0.0, 'skew_sigma_px': 1e-308}])
def test_impossible_facts_are_refused(fact):
    with pytest.raises(ArgumentError):
        CameraFacts(**fact)
