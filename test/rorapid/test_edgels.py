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
"""Edge search along normals: place, contrast, order, and what is not there."""

import cv2
import numpy as np
import pytest

from selfcal_ros.rorapid.edges.edgels import find_edgels, sample_normals


def step_image(place, angle_rad=0.0, low=60.0, high=160.0, size=64, samples=8):
    """Render a straight edge through (32 + place, 32), exactly filtered over each pixel."""
    fine = (np.arange(size * samples) + 0.5) / samples - 0.5
    x, y = np.meshgrid(fine, fine)
    side = (x - 32 - place) * np.cos(angle_rad) + (y - 32) * np.sin(angle_rad) > 0
    image = np.where(side, high, low).reshape(size, samples, size, samples).mean(axis=(1, 3))
    return cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.6).round().astype(np.uint8)


@pytest.mark.parametrize('place', np.linspace(-3.4, 3.4, 9))
def test_an_edge_is_placed_to_a_tenth_of_a_pixel(place):
    image = step_image(place)
    profile = sample_normals(image, np.array([[32.0, 32.0]]), np.array([[1.0, 0.0]]), 8)
    edgels = find_edgels(profile)
    assert abs(edgels.offset[0, 0] - place) < 0.1
    assert 50 < edgels.contrast[0, 0] < 101


def test_oblique_edges_and_the_sign_of_the_contrast():
    for angle in np.linspace(0, 6, 13):
        image = step_image(1.3, angle)
        normal = np.array([[np.cos(angle), np.sin(angle)]])
        centre = np.array([[32.0, 32.0]])
        truth = 1.3 * np.cos(angle)
        there = find_edgels(sample_normals(image, centre, normal, 8))
        back = find_edgels(sample_normals(image, centre, -normal, 8))
        assert abs(there.offset[0, 0] - truth) < 0.12
        assert abs(back.offset[0, 0] + truth) < 0.12
        assert there.contrast[0, 0] > 0 > back.contrast[0, 0]


def two_edges():
    row = np.full(80, 50.0)
    row[30:] = 90
    row[52:] = 200
    return np.tile(row, (20, 1)).astype(np.uint8)


def test_several_candidates_come_strongest_first():
    profile = sample_normals(two_edges(), np.array([[40.0, 10.0]]), np.array([[1.0, 0.0]]), 16)
    edgels = find_edgels(profile, candidates=3)
    assert np.allclose(edgels.offset[0, :2], [11.5, -10.5], atol=0.2)
    assert np.isnan(edgels.offset[0, 2]) and edgels.contrast[0, 2] == 0
    assert edgels.contrast[0, 0] > edgels.contrast[0, 1] > 0


def test_a_remembered_polarity_is_preferred():
    image = two_edges()
    image[:, 52:] = 20
    profile = sample_normals(image, np.array([[40.0, 10.0]]), np.array([[1.0, 0.0]]), 16)
    assert abs(find_edgels(profile).offset[0, 0] - 11.5) < 0.2
    wanted = find_edgels(profile, wanted=np.array([30.0]))
    assert abs(wanted.offset[0, 0] + 10.5) < 0.2


def test_nothing_is_found_where_nothing_is():
    flat = np.full((40, 40), 128, np.uint8)
    pixels = np.array([[20.0, 20.0], [1.0, 39.0], [-50.0, 900.0]])
    normal = np.array([[1.0, 0.0], [0.6, 0.8], [0.0, 1.0]])
    for candidates in (1, 4):
        edgels = find_edgels(sample_normals(flat, pixels, normal, 10), candidates)
        assert np.isnan(edgels.offset).all() and not edgels.contrast.any()
    tiny = find_edgels(sample_normals(np.zeros((1, 1), np.uint8), pixels, normal, 10))
    assert np.isnan(tiny.offset).all()
