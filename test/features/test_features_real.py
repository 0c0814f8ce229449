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
"""Tracks of recorded images against their surveyed geometry."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from selfcal_ros.features.epipolar import sampson_distance
from selfcal_ros.features.extraction import extract_tracks


def _data(name):
    for parent in Path(__file__).resolve().parents:
        folder = parent / 'shared' / 'data' / name
        if folder.is_dir():
            return folder
    pytest.skip(f'the recorded images shared/data/{name} are not beside the repository')


@pytest.mark.long
def test_temple_ring():
    folder = _data('mb_temple_ring')
    truth = json.loads((folder / 'gt.json').read_text())
    views = truth['frames'][:8]
    images = [cv2.imread(str(folder / 'images' / view['file']), cv2.IMREAD_GRAYSCALE)
              for view in views]
    extraction = extract_tracks((k, image, k) for k, image in enumerate(images))
    assert extraction.mode == 'wide'
    inverse = np.linalg.inv(np.array(truth['K']))
    for gap, limit in ((1, 0.15), (3, 0.3)):
        residuals = []
        for k in range(len(views) - gap):
            a, b = views[k], views[k + gap]
            R = np.array(b['R']) @ np.array(a['R']).T
            t = np.array(b['t']) - R @ np.array(a['t'])
            cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
            _, xy_a, xy_b = extraction.tracks.matches(k, k + gap)
            residuals.append(sampson_distance(inverse.T @ cross @ R @ inverse, xy_a, xy_b))
        residuals = np.concatenate(residuals)
        assert len(residuals) > 150 * (len(views) - gap)
        assert 1.4826 * np.median(np.abs(residuals)) < limit
        assert np.mean(np.abs(residuals) > 2) < 0.01


def test_a_car_that_turns_is_followed_as_video():
    folder = _data('kitti00_turn_a')
    files = sorted((folder / 'images').glob('*.png'))[:12]
    images = (cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files)
    extraction = extract_tracks((k, image, k) for k, image in enumerate(images))
    assert extraction.mode == 'video'
    assert len(extraction.tracks) > 2000
