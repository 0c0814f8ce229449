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
"""Trifocal tensors against the cameras that made them."""

import numpy as np
import pytest
from selfcal_ros.geometry import projective, tensor_cameras, trifocal
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.synthetic import scenes, special_scenes
from test_support.image_maps import (circular_image, tensor_from_cameras, transfer_point,
                                     transform_points)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def views_of(sequence):
    return np.moveaxis(sequence.tracks.xy.reshape(len(sequence.points), -1, 2), 1, 0)


@pytest.fixture
def planar(rng):
    """Noise-free planar motion: the sequence, its views in the canonical frame, and the frame."""
    sequence = scenes.sequence_si(rng, 0.0, aspect_ratio=1.1, skew=5.0)
    H = projective.canonical_transform(sequence.horizon, sequence.vanishing_point)
    return sequence, transform_points(H, views_of(sequence)), H


def same_up_to_scale(a, b, tolerance=1e-8):
    a, b = a.ravel() / np.linalg.norm(a), b.ravel() / np.linalg.norm(b)
    return min(np.abs(a - b).max(), np.abs(a + b).max()) < tolerance


def true_tensor(sequence):
    K, poses = sequence.camera.K, sequence.cam_from_world
    P = [K @ pose for pose in poses]
    back = np.linalg.inv(np.vstack([P[0], [0, 0, 0, 1]]))
    return tensor_from_cameras(P[1] @ back, P[2] @ back)


def test_linear_tensor_is_exact_for_any_motion(rng):
    for sequence in (scenes.sequence_si(rng, 0.0), special_scenes.general_motion(rng, 0.0)):
        T, *_ = trifocal.linear_tensor_estimate(*views_of(sequence))
        assert same_up_to_scale(T, true_tensor(sequence))


def test_tensor_relates_lines(rng):
    sequence = special_scenes.general_motion(rng, 0.0)
    T = true_tensor(sequence)
    a, b, c = (projective.homogeneous(xy) for xy in views_of(sequence))
    lines = [np.cross(x[3], x[31]) for x in (a, b, c)]
    predicted = np.einsum('j,k,ijk->i', lines[1], lines[2], T)
    assert np.abs(np.cross(projective.unit(predicted), projective.unit(lines[0]))).max() < 1e-9


def test_transfer_predicts_the_third_image(rng):
    sequence = special_scenes.general_motion(rng, 0.0)
    a, b, c = views_of(sequence)
    assert transfer_point(true_tensor(sequence), a, b) == pytest.approx(c, abs=1e-6)


def test_transform_moves_the_tensor_with_the_images(rng):
    sequence = special_scenes.general_motion(rng, 0.0)
    H = np.eye(3) + 1e-4 * rng.normal(size=(3, 3))
    moved = transform_points(H, views_of(sequence))
    T = trifocal.transform_tensor(true_tensor(sequence), H)
    assert transfer_point(T, moved[0], moved[1]) == pytest.approx(moved[2], abs=1e-6)


def test_planar_motion_leaves_twelve_elements_in_the_canonical_frame(planar):
    sequence, _, H = planar
    T = trifocal.transform_tensor(true_tensor(sequence), H)
    T = trifocal.transform_tensor(T, np.diag([1e-3, 1e-3, 1.0]))
    rest = np.ones((3, 3, 3), bool)
    rest[tuple(trifocal.PLANAR_ELEMENTS.T)] = False
    assert np.abs(T[rest]).max() < 1e-9 * np.abs(T).max()


def test_circular_points_are_exact_from_fifty_and_from_four_points(planar):
    sequence, views, H = planar
    for chosen in (np.arange(50), np.array([0, 11, 28, 49])):
        found = trifocal.circular_points(*views[:, chosen])
        i = circular_image(found.kappa, H)
        truth = projective.unit(sequence.circular_point)
        miss = min(np.abs(np.cross(x, truth)).max() for x in (i, i.conj()))
        assert miss < 1e-8
        assert np.polyval(trifocal.circular_cubic(found.tensor), found.fourth) == pytest.approx(
            0, abs=1e-6 * np.abs(found.tensor).max() * abs(found.fourth) ** 2)


def test_cameras_agree_with_the_tensor_and_with_the_images(planar):
    sequence, views, H = planar
    T = trifocal.circular_points(*views).tensor
    cameras = tensor_cameras.planar_cameras(T)
    assert same_up_to_scale(tensor_from_cameras(*cameras), T)
    in_pixels = tensor_cameras.cameras_in_pixels(cameras, H)
    assert same_up_to_scale(tensor_from_cameras(*in_pixels), true_tensor(sequence))


def test_degenerate_triplets_are_refused(rng):
    few = trifocal.linear_tensor_estimate(*rng.normal(size=(3, 6, 2)))
    assert isinstance(few, NoEstimate) and few.kind == 'too_few'
    assert trifocal.circular_points(*rng.normal(size=(3, 3, 2))).kind == 'too_few'
    same = np.tile(views_of(scenes.sequence_si(rng, 0.0))[:1], (3, 1, 1))
    assert not trifocal.linear_tensor_estimate(*same)
    assert not trifocal.circular_points(*same)
