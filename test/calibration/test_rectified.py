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
"""Rectified images of a vehicle: nothing checks their pixels, which are not square."""

import cv2
import numpy as np
import pytest
from selfcal_ros import calibrate, Camera, CameraFacts
from selfcal_ros.calibration.estimators.rectified import LEAST_DISTORTION, most_distorted
from selfcal_ros.synthetic.special_scenes import drive

RAW = Camera([[470, 0, 328], [0, 470, 235], [0, 0, 1]], (-0.2, 0.06, 0, 0, 0), 640, 480)
#: As `image_proc` has it from a calibration of OpenCV, without black borders.
RECTIFIED = Camera(cv2.getOptimalNewCameraMatrix(RAW.K, RAW.distortion, (640, 480), 0)[0], (),
                   640, 480)


def kinds(result):
    """Return what was found."""
    return [one.kind for one in result.findings]


@pytest.fixture(scope='module')
def tracks():
    """Drive with the rectified images."""
    return drive(np.random.default_rng(1), 0.2, 20, 500, 10, RECTIFIED).tracks


@pytest.mark.long
def test_square_pixels_of_rectified_images_are_doubted(tracks):
    assert abs(RECTIFIED.K[1, 1] / RECTIFIED.K[0, 0] - 1) > 0.04
    result = calibrate(tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
    # far off, which no image of a level vehicle shows: so it has to be said
    assert abs(result.camera.K[1, 2] - RECTIFIED.K[1, 2]) > 4 * result.sigma['cy']
    assert 'images_rectified' in kinds(result)
    told = next(one for one in result.findings if one.kind == 'images_rectified')
    assert told.values['share'] < LEAST_DISTORTION and 'raw images' in told.advice
    # with what P of the rectified topic says the camera is right
    stated = CameraFacts(aspect_ratio=RECTIFIED.K[1, 1] / RECTIFIED.K[0, 0], skew=0.0)
    result = calibrate(tracks, facts=stated)
    for name, place in (('fx', (0, 0)), ('cx', (0, 2)), ('cy', (1, 2))):
        assert abs(result.camera.K[place] - RECTIFIED.K[place]) < 3 * result.sigma[name]


@pytest.mark.long
def test_raw_images_and_lenses_that_are_stated_are_no_rectified_ones(tracks):
    raw = drive(np.random.default_rng(1), 0.2, 20, 500, 10, RAW).tracks
    assert 'images_rectified' not in kinds(calibrate(raw, facts=CameraFacts(1.0, 0.0)))
    stated = CameraFacts(1.0, 0.0, distortion='none')
    assert 'images_rectified' not in kinds(calibrate(tracks, facts=stated))


def test_the_largest_distortion_is_that_of_the_corner():
    farthest = np.linalg.solve(RAW.K, [0, 479, 1])
    r = np.hypot(*farthest[:2])
    assert abs(most_distorted(RAW) - abs(-0.2 * r**2 + 0.06 * r**4)) < 0.005
    assert most_distorted(RECTIFIED) < 1e-12
