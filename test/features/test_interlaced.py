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
"""Interlaced images: told from others, and used by their even rows alone."""

import cv2
import numpy as np
import pytest
from selfcal_ros import CameraFacts
from selfcal_ros.features.interlaced import is_interlaced, of_even_rows
from selfcal_ros.pipeline.calibrate_input import calibrate_input, CalibrationSettings
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.synthetic.recordings import agv_drive
from test_support.feature_scenes import smooth_texture


def texture(seed):
    """Draw smooth texture, uint8 (240, 320)."""
    return smooth_texture(seed, (240, 320), 5).astype(np.uint8)


def combed(image, step):
    """Move the odd rows by some columns."""
    moved = image.copy()
    moved[1::2] = np.roll(image, step, axis=1)[1::2]
    return moved


@pytest.mark.parametrize('seed', range(3))
def test_rows_of_two_instants_are_told(seed):
    image, rng = texture(seed), np.random.default_rng(seed)
    noisy = (image + rng.normal(0, 5, image.shape)).clip(0, 255).astype(np.uint8)
    for step in (4, 12):
        assert is_interlaced(combed(image, step)) and is_interlaced(combed(noisy, step))
    noise = rng.integers(0, 255, image.shape, np.uint8)
    lines = np.tile(np.repeat([90, 150], 2)[:, None], (60, 320)).astype(np.uint8)
    for one in (image, noisy, noise, lines, combed(image, 0), image[:2], np.zeros_like(image),
                cv2.resize(image, (320, 480)), np.rot90(combed(image, 8))):
        assert not is_interlaced(np.ascontiguousarray(one))


@pytest.mark.parametrize('rows', [3, 4, 7, 48])
def test_even_rows_stay_and_the_others_lie_between(rows):
    ramp = np.repeat(np.arange(rows, dtype=np.uint8)[:, None], 6, axis=1)
    broken = ramp.copy()
    broken[1::2] = 200
    expected = ramp.copy()
    if rows % 2 == 0:
        expected[-1] = rows - 2
    assert np.array_equal(of_even_rows(broken), expected)
    assert np.array_equal(of_even_rows(np.dstack([broken] * 3)), np.dstack([expected] * 3))


@pytest.mark.long
def test_a_drive_of_an_interlaced_camera_is_calibrated(tmp_path):
    """With the odd rows, too, such drives were up to 6 sigmas off, or refused."""
    drive = agv_drive(28, (320, 240), distortion=(-0.1, 0.02, 0, 0, 0), noise_sigma=0.0, seed=7)
    renderer, rng = drive.renderer(2), np.random.default_rng(0)
    for index in range(0, len(drive), 2):
        fields = [renderer.intensity(drive.cam_from_world[k]) for k in (index, index + 1)]
        fields[0][1::2] = fields[1][1::2]
        image = (fields[0] + rng.normal(0, 1, fields[0].shape)).clip(0, 255).round()
        cv2.imwrite(str(tmp_path / f'{index:02d}.png'), image.astype(np.uint8))
    result, reading = calibrate_input(tmp_path, CalibrationSettings(facts=CameraFacts(1.0, 0.0)))
    told = next(one for one in reading.findings if one.kind == 'images_interlaced')
    assert told.values['count'] == 14
    for name, place in (('fx', (0, 0)), ('cx', (0, 2)), ('cy', (1, 2))):
        off = result.camera.K[place] - drive.camera.K[place]
        assert abs(off) < 3 * result.sigma[name] and abs(off) < 2
    # who copies images gets them as they are
    with open_source(tmp_path, colour=True) as source:
        assert is_interlaced(next(iter(source)).image) and not source.losses()
