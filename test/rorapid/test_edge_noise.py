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
"""What is learned of the noise of edges is true of the edges that it was learned from."""

import numpy as np
import pytest

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.rorapid.edges.control_points import ControlModel
from selfcal_ros.rorapid.edges.edge_noise import (
    _AROUND_PX, _SECTOR_PX, _SECTORS, CommonScatter, EdgeNoise, shared_by_outline,
    sums_together)
from selfcal_ros.rorapid.edges.edgels import BOW_OF_LANES, find_edgels, sample_normals
from selfcal_ros.rorapid.projection.camera_models import Projection
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel
from selfcal_ros.values.wireframe import Conic, WireframeModel

FAR = np.full(60, np.inf)


@pytest.mark.parametrize('place, grey', [(0.1, 8.0), (0.3, 1.0), (0.1, 20.0)])
def test_the_noise_of_place_and_of_grey_levels_is_found(place, grey):
    rng = np.random.default_rng(1)
    noise = EdgeNoise()
    for _ in range(200):
        contrast = rng.uniform(10, 150, 60) * rng.choice([-1, 1], 60)
        true = np.hypot(place, grey / contrast)
        noise.learn(contrast, FAR, true * rng.standard_normal(60))
    contrast = np.array([12.0, 40.0, 140.0])
    assert np.allclose(noise.sigma(contrast, FAR[:3]), np.hypot(place, grey / contrast), rtol=0.2)


def test_near_the_end_of_a_line_an_edge_is_worth_less():
    noise = EdgeNoise()
    sigma = noise.sigma(np.full(3, 50.0), np.array([3.0, 30.0, np.inf]))
    assert sigma[0] > 2 * sigma[1] > 2 * sigma[2] * 0.99


def scatter_of(common, rng, images=300, lines=10, each=6):
    """Factor learned from straight lines about a state of two shifts, edgels of sigma 1."""
    angle = np.linspace(0, np.pi, lines, endpoint=False)
    rows = np.repeat(np.column_stack([np.cos(angle), np.sin(angle)]), each, axis=0)
    primitive = np.repeat(np.arange(lines), each)
    weight = np.ones(len(rows))
    H = rows.T @ rows
    scatter, errors, factors = CommonScatter(), [], []
    for _ in range(images):
        residual = rng.standard_normal(len(rows)) + np.repeat(
            common * rng.standard_normal(lines), each)
        q = np.linalg.solve(H, rows.T @ residual)
        errors.append(q)
        # a limit that nothing reaches: the cost is as curved as the weights say
        sums, = sums_together(primitive, rows, weight, np.zeros(len(rows)), residual - rows @ q,
                              [len(rows)], H[None])
        scatter.learn(sums)
        factors.append(scatter.factor(sums))
    return np.mean(factors[30:]), np.mean(np.einsum('ni,ij,nj->n', errors, H, errors)) / 2


@pytest.mark.parametrize('common', [0.0, 0.5, 1.0])
def test_what_lines_share_widens_the_covariance_as_much_as_the_errors(common):
    learned, true = scatter_of(common, np.random.default_rng(2))
    # above the truth by what no residual can show
    assert 0.9 < learned / true < 1.5


def test_edges_that_are_left_out_make_the_cost_less_curved():
    rows = np.random.default_rng(3).standard_normal((40, 2))
    off = np.random.default_rng(4).uniform(0, 0.9, 40)
    plain, cut = CommonScatter(), CommonScatter()
    H = rows.T @ rows
    for scatter, how_far in ((plain, np.zeros(40)), (cut, off)):
        for _ in range(50):
            scatter.learn(sums_together(np.arange(40) // 4, rows, np.ones(40), how_far,
                                        0.5 * np.ones(40), [40], H[None])[0])
    assert cut.factor(np.zeros(4)) > 1.5 * plain.factor(np.zeros(4))


def ring(radius_px=30.0):
    """Camera, control points and image of a bright disc that faces the camera."""
    camera = Camera([[500, 0, 160], [0, 500, 120], [0, 0, 1]], width=320, height=240)
    radius_m = radius_px / 500
    model = WireframeModel.build(
        np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0.0]]) * 2 * radius_m, [(0, 1)], (), conics=[
            Conic([0, 0, 0], [radius_m, 0, 0], [0, radius_m, 0])])
    projection = Projection(camera)
    control = ControlModel(VisibleModel(model), projection, (320, 240))
    state = projection.from_pose(np.eye(3), np.array([0, 0, 1.0]) + control.centre)
    fine = (np.arange(320 * 8) + 0.5) / 8 - 0.5
    inside = np.hypot(fine[None, :] - 160, fine[:240 * 8, None] - 120) < radius_px
    image = inside.reshape(240, 8, 320, 8).mean(axis=(1, 3)) * 120 + 60
    return control.view(state), np.round(image).astype(np.uint8)


def test_a_curve_is_found_where_it_is_although_the_lanes_are_straight():
    radius = 12.0
    view, image = ring(radius)
    at = np.flatnonzero(view.searched & (view.curvature != 0))
    assert np.allclose(np.abs(view.curvature[at]), 1 / radius, rtol=1e-3)
    found = find_edgels(sample_normals(image, view.projected.pixels[at], view.normal[at], 5))
    bow = BOW_OF_LANES * view.curvature[at]
    outward = -np.sign(view.curvature[at])
    raw = (found.offset[:, 0] * outward).mean()
    assert abs(raw) > 0.015
    assert abs(((found.offset[:, 0] - bow) * outward).mean()) < 0.5 * abs(raw)


def test_what_shading_moves_in_common_is_counted_exactly():
    rng = np.random.default_rng(5)
    angle = np.linspace(-np.pi, np.pi, 72, endpoint=False) + 1e-3
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    side = rng.choice([-1.0, 1.0], 72)
    # two shifts and the size of a circle, along normals of either sign
    rows = side[:, None] * np.column_stack([normal, np.ones(72)])
    sigma = 0.1
    H = rows.T @ rows / sigma**2
    known = H - shared_by_outline(rows, np.full(72, sigma**-2), side, 80 * normal, H)
    sector = ((angle / (2 * np.pi) + 0.5) * _SECTORS).astype(int) % _SECTORS
    found = []
    for _ in range(4000):
        offset = _AROUND_PX * rng.normal() + _SECTOR_PX * rng.normal(size=_SECTORS)[sector]
        measured = side * offset + sigma * rng.normal(size=72)
        found.append(np.linalg.solve(H, rows.T @ measured / sigma**2))
    expected = np.linalg.inv(known)
    scale = np.sqrt(np.diag(expected))
    assert np.abs((np.cov(np.array(found).T) - expected) / np.outer(scale, scale)).max() < 0.08
    assert expected[2, 2] > 10 * np.linalg.inv(H)[2, 2] > 0
    # however much is shared, no information becomes negative
    few = rows[:2]
    little = few.T @ few * 1e6
    left = little - shared_by_outline(few, np.full(2, 1e6), side[:2], 80 * normal[:2], little)
    assert np.linalg.eigvalsh(left).min() > -1e-6 * np.trace(little)
