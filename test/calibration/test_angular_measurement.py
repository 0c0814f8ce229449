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
"""Sigmas of angles that are measured in images, against sampling."""

import numpy as np
import pytest

from selfcal_ros import calibrate, CameraFacts, NotCalibrated, ray_angles
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.angular_measurement import (angles_between, central_angle,
                                                                   fields_of_view,
                                                                   measurement_sentences)
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.report.result_json import result_to_dict
from selfcal_ros.synthetic.scenes import sequence_si

#: Of a covariance of all parameters.
COVARIANCE_SHAPE = (len(PARAMETER_NAMES),) * 2

CAMERA = Camera([[520, 0.4, 328], [0, 523, 235], [0, 0, 1]], [-0.2, 0.05, 1e-3, -5e-4], 640, 480)


@pytest.fixture
def covariance():
    """Correlated, of the size that a short drive leaves."""
    root = np.random.default_rng(3).standard_normal(COVARIANCE_SHAPE)
    root *= np.array([2, 2, 1, 1, 0.3, 2e-3, 2e-3, 2e-4, 2e-4, 2e-3])[:, None] / 3
    return root @ root.T


def test_angles_scatter_as_stated(covariance):
    first = np.array([[319.5, 239.5], [0, 0], [40, 300], [100, 100]])
    second = np.array([[639, 479], [639, 479], [600, 250], [101, 100]])
    rng = np.random.default_rng(0)

    angle, sigma = angles_between(CAMERA, covariance, first, second)

    drawn = np.array([angles_between(Camera.from_parameters(
        CAMERA.parameters + step, 640, 480), covariance, first, second)[0]
        for step in rng.multivariate_normal(np.zeros(len(PARAMETER_NAMES)), covariance, 500)])
    np.testing.assert_allclose(np.mean(drawn, axis=0), angle, atol=4 * sigma.max() / 30)
    # the sigma of a sigma from 500 draws is 3 %
    np.testing.assert_allclose(np.std(drawn, axis=0), sigma, rtol=0.08)


def test_a_held_camera_measures_exactly():
    assert angles_between(CAMERA, np.zeros(COVARIANCE_SHAPE), [[0, 0]], [[639, 0]])[1] == 0
    plain = Camera([[320, 0, 319.5], [0, 320, 239.5], [0, 0, 1]], width=640, height=480)
    wide = fields_of_view(plain, np.zeros(COVARIANCE_SHAPE))['horizontal']
    assert wide.value == pytest.approx(90)
    # of a field of view, by hand: tan(a / 2) = 320 / f
    only_f = np.zeros(COVARIANCE_SHAPE)
    only_f[:2, :2] = 4.0
    sigma = fields_of_view(plain, only_f)['horizontal'].sigma
    assert sigma == pytest.approx(np.degrees(2 * 2 / (2 * 320)))


def test_what_cannot_be_told_is_left_out(covariance):
    folded = Camera([[300, 0, 320], [0, 300, 240], [0, 0, 1]], [-0.4, 0, 0, 0], 640, 480)
    angle = central_angle(folded, covariance)

    assert 'diagonal' not in fields_of_view(folded, covariance)
    assert angle.value == 30 and angle.sigma > 0
    assert measurement_sentences(Camera(np.diag([5.0, 5, 1])), covariance) == ()
    # a long lens does not see the common angle
    long = Camera([[3000, 0, 320], [0, 3000, 240], [0, 0, 1]], width=640, height=480)
    assert central_angle(long, covariance).value < 10


def test_sentences_and_json_say_the_same():
    result = calibrate(sequence_si(np.random.default_rng(0), 0.3, views=6).tracks,
                       facts=CameraFacts(1.0, 0.0, distortion='none'))
    assert isinstance(result, Calibration)
    stated = result_to_dict(result)['measurement']
    wide = stated['field_of_view_deg']['horizontal']
    words = measurement_sentences(result.camera, result.covariance, result.measured)

    true = 2 * np.degrees(np.arctan(result.camera.width / 2 / 900))
    assert abs(wide['value'] - true) < 4 * wide['sigma'] + 0.5
    assert f'± {stated["central_angle_deg"]["sigma"]:.2g} degrees' in words[1]
    assert 'horizontal field of view' in words[0]
    ends = [[-0.5, (result.camera.height - 1) / 2], [result.camera.width - 0.5,
                                                     (result.camera.height - 1) / 2]]
    np.testing.assert_allclose(np.degrees(ray_angles(result, *ends)).T,
                               [[wide['value'], wide['sigma']]])


def test_what_is_no_calibration_measures_nothing():
    result = calibrate(sequence_si(np.random.default_rng(0), 0.3, views=3).tracks,
                       facts=CameraFacts(1.0, 0.0, distortion='none'))
    with pytest.raises(ArgumentError):
        ray_angles(NotCalibrated('nothing moves.'), [0, 0], [1, 1])
    pixels = np.zeros((3, 2))
    for first, second in (([0, 0, 0], [1, 1, 1]), ([0, 0], 'ab'), (pixels[:2], pixels)):
        with pytest.raises(ArgumentError):
            ray_angles(result, first, second)
