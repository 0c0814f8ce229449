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
"""The limb of a shaded ball is a circle of known radius; its edges lie inside of it."""

from itertools import product

import numpy as np

from selfcal_ros.rorapid.edges.edgels import find_edgels, sample_normals
from selfcal_ros.rorapid.edges.limb import limb_shift

CENTRE = np.array([100.3, 99.6])


def ball(radius_px, light, background=60.0, samples=8, size=200):
    """A Lambertian ball far away, each pixel the mean of samples."""
    fine = (np.arange(size * samples) + 0.5) / samples - 0.5
    x, y = np.meshgrid((fine - CENTRE[0]) / radius_px, (fine - CENTRE[1]) / radius_px)
    towards = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    light = np.asarray(light, float) / np.linalg.norm(light)
    shade = np.clip(x * light[0] + y * light[1] + towards * light[2], 0, 1)
    image = np.where(x**2 + y**2 < 1, 95 + 110 * shade, background)
    return image.reshape(size, samples, size, samples).mean(axis=(1, 3)).round().astype(np.uint8)


def edges(image, radius_px, places=90):
    angle = np.arange(places) * 2 * np.pi / places
    out = np.column_stack([np.cos(angle), np.sin(angle)])
    profiles = sample_normals(image, CENTRE + radius_px * out, out, 8)
    found = find_edgels(profiles)
    shift, worse = limb_shift(profiles, found.offset, found.contrast, -np.ones(places))
    return found.offset[:, 0], shift[:, 0], worse[:, 0]


def test_shading_draws_the_edge_inwards_and_the_shift_takes_it_back():
    raw, mended = [], []
    for radius_px, light in product((20, 35, 60), ((0, 0, 1), (-0.4, -0.6, 0.7), (0.8, 0.1, 0.6))):
        offset, shift, _ = edges(ball(radius_px, light), radius_px)
        raw.append(-offset.mean())
        mended.append(np.abs(offset - shift).mean())
    assert min(raw) > 0.05                 # pixels, inwards
    assert (np.array(mended) < 0.75 * np.array(raw)).all()
    assert np.mean(mended) < 0.5 * np.mean(raw)


def test_a_flat_disc_is_left_alone():
    x, y = np.meshgrid(np.arange(200) - CENTRE[0], np.arange(200) - CENTRE[1])
    image = np.where(np.hypot(x, y) < 40, 160, 60).astype(np.uint8)
    _, shift, worse = edges(image, 40)
    assert np.abs(shift).max() < 0.02
    assert worse.max() < 1.2


def test_an_edge_of_a_pattern_beside_the_limb_is_no_shading():
    image = ball(40, (0, 0, 1))
    x, y = np.meshgrid(np.arange(200) - CENTRE[0], np.arange(200) - CENTRE[1])
    image[(np.hypot(x, y) < 36.8)] = 250
    offset, shift, _ = edges(image, 40)
    outer = np.abs(offset) < 2
    assert np.abs(shift[outer]).max(initial=0.0) < 0.2


def test_an_edge_with_another_beside_it_is_located_worse():
    x, y = np.meshgrid(np.arange(200) - CENTRE[0], np.arange(200) - CENTRE[1])
    away = np.hypot(x, y)
    image = np.where(away < 37, 200, np.where(away < 40, 110, 60)).astype(np.uint8)
    _, _, worse = edges(image, 40)
    assert worse.min() > 1.5
