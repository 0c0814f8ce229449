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
"""Calibration from edges: true within its sigmas, and refused for the right reason."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros.calibration.known_object.edge_calibration import calibrate_from_edges
from selfcal_ros.calibration.known_object.edge_views import EdgeViews
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.rotation import rotation_matrix

CAMERA = Camera([[520, 0, 328], [0, 520, 235], [0, 0, 1]], (), 640, 480)
FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
PER_LINE = 10


def cube_edges(rng, noise_px, views=16, camera=CAMERA, zoom=1.0, slide_px=0.0, bend_px=0.0):
    """Measure the twelve edges of a cube from many sides; `zoom` grows over the sequence."""
    corners = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    pairs = [(a, b) for a in range(8) for b in range(a + 1, 8)
             if np.count_nonzero(corners[a] != corners[b]) == 1]
    share = (np.arange(PER_LINE) + 0.5) / PER_LINE
    points = np.concatenate([corners[a] + share[:, None] * (corners[b] - corners[a])
                             for a, b in pairs])
    tangents = np.repeat([(corners[b] - corners[a]) / 0.2 for a, b in pairs], PER_LINE, axis=0)
    primitive = np.repeat(np.arange(12), PER_LINE)
    columns, poses = [], []
    # an edge that is not quite where the model has it, the same in all images
    bent = bend_px * rng.normal(size=12)[primitive]
    for view in range(views):
        R = rotation_matrix(rng.normal(0, 0.9, 3))
        t = np.array([*rng.uniform(-0.12, 0.12, 2), rng.uniform(0.45, 0.7)])
        K = camera.K.copy()
        K[:2, :2] *= zoom**(view / max(views - 1, 1))
        own = Camera(K, camera.distortion, 640, 480)
        X, along = points @ R.T + t, tangents @ R.T
        pixels = own.project(X)
        run = own.project(X + 1e-5 * along) - pixels
        run /= np.linalg.norm(run, axis=1, keepdims=True)
        normal = np.column_stack([-run[:, 1], run[:, 0]])
        # along its edge an edgel may be anywhere
        xy = pixels + normal * (rng.normal(0, noise_px, len(X)) + bent)[:, None] \
            + run * rng.uniform(-slide_px, slide_px, len(X))[:, None]
        columns.append((np.full(len(X), view), np.arange(len(X)), primitive, points, tangents, xy))
        poses.append(np.column_stack([rotation_matrix(rng.normal(0, 0.01, 3)) @ R,
                                      t * rng.normal(1, 0.01)]))
    joined = [np.concatenate(column) for column in zip(*columns)]
    return EdgeViews(*joined, np.array(poses), (640, 480))


def start(share=1.05):
    K = CAMERA.K.copy()
    K[:2, :2] *= share
    K[:2, 2] = 319.5, 239.5
    return Camera(K, (), 640, 480)


def sigmas(result, camera=CAMERA):
    error = result.camera.parameters - camera.parameters
    return np.array([error[k] / result.sigma[name] for k, name in ((0, 'fx'), (2, 'cx'),
                                                                   (3, 'cy'))])


def test_exact_edges_give_the_camera_exactly():
    result = calibrate_from_edges(cube_edges(np.random.default_rng(0), 1e-6, slide_px=2.0),
                                  start(1.15), facts=FACTS)
    assert np.abs(result.camera.K - CAMERA.K).max() < 1e-2
    assert result.motion == 'known-object' and len(result.frames) == 16


def test_the_truth_lies_within_the_sigmas():
    found = np.array([sigmas(calibrate_from_edges(
        cube_edges(np.random.default_rng(seed), 0.2, views=10), start(), facts=FACTS))
        for seed in range(16)])
    # 48 numbers know their spread to a tenth
    assert 0.7 < np.sqrt(np.mean(found**2)) < 1.35


@pytest.mark.long
def test_edges_that_are_not_where_the_model_has_them_widen_the_sigmas():
    found, widths = [], []
    for seed in range(8):
        result = calibrate_from_edges(cube_edges(np.random.default_rng(seed), 0.1, views=14,
                                                 bend_px=0.3), start(), facts=FACTS)
        found.append(sigmas(result))
        widths.append(any('edge' in note for note in result.notes))
    assert np.sqrt(np.mean(np.square(found))) < 2.0
    assert np.mean(widths) > 0.7


def test_distortion_is_found():
    camera = Camera(CAMERA.K, (-0.12, 0.05, 0, 0), 640, 480)
    views = cube_edges(np.random.default_rng(2), 0.05, views=30, camera=camera)
    result = calibrate_from_edges(views, start(), facts=replace(FACTS, distortion='radial2'))
    assert np.abs(sigmas(result, camera)).max() < 3.5
    assert abs(result.camera.distortion[0] + 0.12) < 4 * result.sigma['k1']


def test_a_lens_that_zooms_is_refused():
    result = calibrate_from_edges(cube_edges(np.random.default_rng(3), 0.1, zoom=1.15), start(),
                                  facts=FACTS)
    assert not result and result.kind in ('focal_length_changes', 'edges_misfit')


def test_edges_of_something_else_are_refused():
    rng = np.random.default_rng(4)
    views = cube_edges(rng, 0.1)
    result = calibrate_from_edges(replace(views, xy=views.xy + rng.normal(0, 6, views.xy.shape)),
                                  start(), facts=FACTS)
    assert not result and result.kind == 'edges_misfit'


def test_one_image_is_not_enough_and_says_so():
    result = calibrate_from_edges(cube_edges(np.random.default_rng(5), 0.1, views=1), start())
    assert not result and result.kind == 'too_few_edge_images'


@pytest.mark.parametrize('change', [
    {'xy': np.full((16 * 120, 2), np.nan)}, {'frame': np.arange(16 * 120)[::-1]},
    {'points': np.zeros((3, 3))}])
def test_impossible_arrays_are_refused(change):
    views = cube_edges(np.random.default_rng(7), 0.1)
    with pytest.raises(InputError):
        replace(views, **change)


@pytest.mark.long
def test_edges_that_err_by_themselves_are_in_the_sigmas():
    """Twelve edges: sums over so few gave sigmas that were a quarter too small."""
    found = [sigmas(calibrate_from_edges(cube_edges(
        np.random.default_rng(seed), 0.05, views=14, bend_px=0.3), start(), facts=FACTS))
        for seed in range(100, 116)]
    # 48 numbers know their spread to a tenth; of edges that err by chance sigmas are a third wide
    assert 0.6 < np.sqrt(np.mean(np.square(found))) < 1.1
