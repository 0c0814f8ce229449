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
"""What the curvature of a fisheye does to positions of patches is predicted."""

import numpy as np
import pytest
from selfcal_ros.features.curvature import curvature_bias, ideal_fisheye, WINDOW_VARIANCE
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.division import DivisionModel
from selfcal_ros.geometry.rotation import rotation_matrix

FISHEYE = Camera([[220.0, 0, 320], [0, 220, 240], [0, 0, 1]], [-0.04, 0.008, -0.008, 0.0015],
                 640, 480, 'equidistant')


@pytest.mark.parametrize('turn', [(0, 0.6, 0), (0.5, 0, 0.3), (0.1, -0.9, 0.2)])
def test_an_affine_fit_of_a_bent_warp_is_off_as_predicted(turn):
    """A camera that turns maps a patch exactly; the affine map nearest to that has this bias."""
    R = rotation_matrix(np.array(turn, float))
    ray = np.array([[0.0, 0, 1], [0.5, 0.1, 1], [0.2, -0.6, 1]])
    xy_a = FISHEYE.project(ray)
    u, v = np.meshgrid(*[np.linspace(-10, 10, 21)] * 2)
    offsets = np.column_stack([u.ravel(), v.ravel()])
    weight = np.exp(-0.5 * (offsets**2).sum(axis=1) / WINDOW_VARIANCE)
    design = np.column_stack([np.ones(len(offsets)), offsets]) * np.sqrt(weight)[:, None]
    bias, affine, xy_b = [], [], []
    for xy in xy_a:
        seen = FISHEYE.project(FISHEYE.rays(xy + offsets) @ R.T)
        fit = np.linalg.lstsq(design, seen * np.sqrt(weight)[:, None], rcond=None)[0]
        true = FISHEYE.project(FISHEYE.rays(xy) @ R.T)
        bias.append(fit[0] - true)
        affine.append(fit[1:].T)
        xy_b.append(true)
    found = curvature_bias(FISHEYE, xy_a, np.array(xy_b), np.array(affine))
    assert np.linalg.norm(bias, axis=1).max() > 0.005
    assert np.abs(found - bias).max() < 0.1 * np.linalg.norm(bias, axis=1).max()


def test_without_a_ray_nothing_is_taken_off():
    camera = Camera(FISHEYE.K, (), 640, 480, 'equidistant')
    far = np.array([[-5000.0, 240.0]])
    assert (curvature_bias(camera, far, far, np.eye(2)[None]) == 0).all()


def test_only_a_wide_lens_counts():
    assert ideal_fisheye(DivisionModel((0.0,), (640, 480))) is None
    assert ideal_fisheye(DivisionModel((-0.1,), (640, 480))) is None
    camera = ideal_fisheye(DivisionModel((-1.03, -0.91), (640, 480)))
    assert camera.K[0, 0] == pytest.approx(220, rel=0.1)
