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
"""A fisheye with decentred elements, which its model has no coefficients for."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import calibrate, Camera, CameraFacts
from selfcal_ros.calibration.uncertainty.hidden_decentring import DECENTRING, likely_decentring
from selfcal_ros.geometry.lenses.plumb_bob import tangential
from selfcal_ros.synthetic.special_scenes import drive, hand_held

FISHEYE = Camera([[260.0, 0, 322.0], [0, 260, 236], [0, 0, 1]], (0.02, -0.01, 0.002, 0.0), 640,
                 480, 'equidistant')


def decentred(p1, p2, seed):
    """Record a drive through that lens, and move the image as its elements would."""
    return moved(drive(np.random.default_rng(seed), 0.3, 14, 350, 10, FISHEYE).tracks, FISHEYE,
                 p1, p2)


def moved(tracks, camera, p1, p2):
    """Move the images of a camera as decentred elements would."""
    f = camera.K[0, 0]
    x, y = ((tracks.xy - camera.K[:2, 2]) / f).T
    return replace(tracks, xy=tracks.xy + f * np.column_stack(
        tangential(p1, p2, x, y, x * x + y * y)))


def errors(result, truth=FISHEYE):
    """Return fx, cx, cy off, in their sigmas."""
    K = result.camera.K - truth.K
    return np.array([K[0, 0] / result.sigma['fx'], K[0, 2] / result.sigma['cx'],
                     K[1, 2] / result.sigma['cy']])


@pytest.mark.long
def test_the_sigmas_hold_what_the_model_of_a_fisheye_lacks():
    square = CameraFacts(aspect_ratio=1.0, skew=0.0)
    plain = calibrate(decentred(0.0, 0.0, 3), facts=square)
    bent = calibrate(decentred(0.0012, -0.0008, 3), facts=square)
    told = [[one.kind for one in result.findings] for result in (plain, bent)]
    assert plain.camera.model == bent.camera.model == 'equidistant'
    assert np.abs(errors(plain)).max() < 3 and 'fisheye_decentred' not in told[0]
    assert np.abs(errors(bent)).max() < 3 and 'fisheye_decentred' in told[1]
    # what is held there, not what is true everywhere
    assert bent.sigma['cx'] > 1.5 * plain.sigma['cx']


@pytest.mark.long
@pytest.mark.parametrize('f, coefficients, seed, p', [
    (268, (0.133, 0.065, -0.106, 0.04), 1, 0.0005),
    (277, (0.174, -0.172, 0.132, -0.04), 0, 0.0005),
    (338, (-0.079, -0.032, -0.017, 0.035), 0, 0.0015)])
def test_a_decentred_fisheye_is_not_taken_for_a_rational_lens_that_has_p1_and_p2(
        f, coefficients, seed, p):
    """With the coefficients that its rival has for it, it was 3.8 to 6.2 sigmas off."""
    camera = Camera([[f, 0, 318], [0, f, 236], [0, 0, 1]], coefficients, 640, 480, 'equidistant')
    tracks = hand_held(np.random.default_rng(seed), 0.2, 20, 600, 12, camera).tracks
    result = calibrate(moved(tracks, camera, p, p), facts=CameraFacts(1.0, 0.0))
    assert result.camera.model == 'equidistant'
    assert np.abs(errors(result, camera)).max() < 3


@pytest.mark.long
def test_a_barrel_that_a_decentred_fisheye_explains_alike_keeps_its_sigmas():
    """The rival's camera counts with its decentring: without, sigma was 2.7 times as large."""
    camera = Camera([[540, 0, 328], [0, 540, 235], [0, 0, 1]], (-0.3, 0.1, 1e-3, 5e-4, 0), 640,
                    480)
    tracks = hand_held(np.random.default_rng(0), 0.2, 16, 600, 10, camera).tracks
    found, stated = (calibrate(tracks, facts=CameraFacts(1.0, 0.0, distortion=lens))
                     for lens in ('auto', 'plumb_bob'))
    assert found.camera.model == 'plumb_bob' and np.abs(errors(found, camera)).max() < 3
    assert all(found.sigma[name] < 1.3 * stated.sigma[name] for name in ('fx', 'cx', 'cy'))


def test_the_size_of_decentring_follows_the_images():
    sure = 1e-10 * np.eye(2)
    sizes = [likely_decentring(np.array([p, 0.0]), sure) for p in (0.0, 0.001, 0.004)]
    assert sizes[0] < 3 * DECENTRING[0] and sizes[0] < sizes[1] < sizes[2] <= DECENTRING[-1]
    # where they say nothing, any size may be
    blind = likely_decentring(np.zeros(2), 0.999 * DECENTRING[-1]**2 * np.eye(2))
    assert sizes[1] < blind < DECENTRING[-1]
