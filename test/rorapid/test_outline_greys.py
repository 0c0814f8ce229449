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
"""A patterned disc: the region tells its border from the edges of its pattern."""

import numpy as np

from selfcal_ros.rorapid.edges.edgels import find_edgels, sample_normals
from selfcal_ros.rorapid.region.outline_greys import OutlineGreys

CENTRE, RADIUS = np.array([100.0, 100.0]), 60.0
ANGLE = np.arange(72) * 2 * np.pi / 72
OUT = np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])
PIXELS = CENTRE + RADIUS * OUT


def image(rng):
    """Rings of two greys, the outer one weak before its background."""
    x, y = np.meshgrid(np.arange(200) - CENTRE[0], np.arange(200) - CENTRE[1])
    r = np.hypot(x, y)
    pattern = np.where((r // 5).astype(int) % 2, 100.0, 200.0)
    return np.where(r < RADIUS, pattern, 80 + rng.normal(size=r.shape)).round().astype(np.uint8)


def learned(picture, shift=0.0):
    greys = OutlineGreys()
    greys.learn(sample_normals(picture, PIXELS + shift * OUT, OUT, 10), PIXELS, -np.ones(72))
    return greys


def test_the_border_is_preferred_to_stronger_edges_inside():
    picture = image(np.random.default_rng(0))
    profiles = sample_normals(picture, PIXELS, OUT, 12)
    edgels = find_edgels(profiles, 3)
    border = np.abs(edgels.offset) < 1.5
    inside = edgels.offset < -3.5
    assert np.abs(edgels.contrast[inside]).mean() > 2 * np.abs(edgels.contrast[border]).mean()
    for shift in (0.0, 2.0, -2.0):             # learned from a pose that is a little off
        penalty = learned(picture, shift).penalty(profiles, PIXELS, -np.ones(72), edgels.offset)
        assert np.mean(penalty[border] == 0) > 0.95 and np.median(penalty[inside]) > 2


def test_it_does_not_matter_which_way_the_normals_point():
    picture = image(np.random.default_rng(1))
    greys = learned(picture)
    offset = np.tile([-7.3, 0.2, 4.1], (72, 1))
    one = greys.penalty(sample_normals(picture, PIXELS, OUT, 12), PIXELS, -np.ones(72), offset)
    other = greys.penalty(sample_normals(picture, PIXELS, -OUT, 12), PIXELS, np.ones(72), -offset)
    assert np.allclose(one, other, atol=1e-4)


def test_where_no_background_is_beside_nothing_is_said():
    picture = image(np.random.default_rng(2))
    profiles = sample_normals(picture, PIXELS, OUT, 12)
    offset = np.full((72, 1), -7.0)
    assert not learned(picture).penalty(profiles, PIXELS, np.zeros(72), offset).any()
    assert not OutlineGreys().penalty(profiles, PIXELS, np.ones(72), offset).any()
