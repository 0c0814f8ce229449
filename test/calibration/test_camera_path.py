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
"""Where the camera was: against the truth, and as well known as the covariance says."""

import numpy as np
import pytest

from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath, path_unknowns
from selfcal_ros.calibration.calibrate import calibrate
from selfcal_ros.calibration.known_object.point_calibration import calibrate_known_object
from selfcal_ros.calibration.structure.camera_path import camera_path
from selfcal_ros.calibration.structure.metric_structure import metric_structure, world_and_scale
from selfcal_ros.calibration.structure.path_precision import in_the_world, path_slopes
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.report.scene_files.world_words import world_in_words
from selfcal_ros.synthetic.scenes import sequence_si
from selfcal_ros.synthetic.special_scenes import general_motion, pure_rotation
from selfcal_ros.values.known_object import KnownObject
from selfcal_ros.values.tracks import Tracks

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')


def placed(poses):
    """Return rotations and centres of [R | t] relative to the first, in steps between views."""
    _, scale = world_and_scale(poses, False)
    R = poses[:, :, :3]
    centres = -np.einsum('vji,vj->vi', R, poses[:, :, 3])
    return (R[0] @ np.swapaxes(R, 1, 2), scale * (centres - centres[0]) @ R[0].T)


def errors_of(path, poses):
    """Return the errors (V, 6) of a path against true poses, both relative to the first view."""
    R, centres = placed(poses)
    W = path.rotation[0]
    if path.motion == 'rotation':
        centres = 0 * centres
    turned = path.rotation @ np.swapaxes(W @ R, 1, 2)
    return np.concatenate([path.centre - centres @ W.T, rotation_vector(turned)], axis=1)


def whitened_square(errors, covariance):
    """Return the mean square of errors in sigmas over the directions that are not fixed."""
    squares = []
    for error, C in zip(errors, covariance):
        free = np.diag(C) > 1e-16
        assert np.abs(error[~free]).max(initial=0) < 1e-6
        if free.any():
            sigma = np.sqrt(np.diag(C)[free])
            whole = C[np.ix_(free, free)] / np.outer(sigma, sigma)
            z = error[free] / sigma
            rank = np.linalg.matrix_rank(whole, 1e-9, hermitian=True)
            squares.append(z @ np.linalg.pinv(whole, 1e-9, hermitian=True) @ z / rank)
    return np.mean(squares)


@pytest.mark.parametrize('make, motion, seeds', [
    (lambda rng: sequence_si(rng, noise_px=0.1, views=6), 'planar', 3),
    (lambda rng: pure_rotation(rng, views=5), 'rotation', 3)])
def test_poses_are_off_by_what_the_covariance_says(make, motion, seeds):
    squares = []
    for seed in range(seeds):
        sequence = make(np.random.default_rng(seed))
        result = calibrate(sequence.tracks, motion=motion, facts=FACTS)
        path = camera_path(result)
        assert path.motion == motion and path.unit == {'planar': 'step', 'rotation': ''}[motion]
        assert not path.centre[0].any() and np.abs(path.covariance[0]).max() < 1e-12
        squares.append(whitened_square(errors_of(path, sequence.cam_from_world[path.frames]),
                                       path.covariance))
    # chi-square over its freedom: a sigma that is off by 1.7 either way does not pass
    assert 0.35 < np.mean(squares) < 2.9, squares


def test_the_path_is_that_of_the_structure_beside_it():
    scene = general_motion(np.random.default_rng(3))
    result = calibrate(scene.tracks, motion='general', facts=FACTS)
    path, structure = camera_path(result), metric_structure(result, scene.tracks)
    assert np.allclose(path.rotation, np.swapaxes(structure.cam_from_world[:, :, :3], 1, 2))
    assert np.allclose(path.centre, structure.centres)
    # the optical frame of the first view in its own body frame: right is -y, down is -z
    assert np.allclose(path.rotation[0], [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-9)
    assert np.median(np.linalg.norm(np.diff(path.centre, axis=0), axis=1)) == pytest.approx(1)
    squares = whitened_square(errors_of(path, scene.cam_from_world[path.frames]), path.covariance)
    assert 0.2 < squares < 4


def test_before_a_known_object_poses_are_in_its_frame_and_its_metres():
    camera = Camera([[520, 0, 330], [0, 520, 236], [0, 0, 1]], width=640, height=480)
    corners = np.array([(0.04 * x, 0.04 * y, 0.0) for y in range(5) for x in range(7)])
    R = rotation_matrix(np.array([(0.5, 0, 0), (-0.5, 0, 0), (0, 0.5, 0), (0.2, -0.5, 0)]))
    seen = corners @ np.swapaxes(R, 1, 2) + [-0.12, -0.08, 0.6]
    squares = []
    for seed in range(6):
        noise = np.random.default_rng(seed).normal(0, 0.2, (4, 35, 2))
        tracks = Tracks(np.repeat(np.arange(4), 35), np.tile(np.arange(35), 4),
                        (camera.project(seen) + noise).reshape(-1, 2), image_size=(640, 480))
        path = camera_path(calibrate_known_object(tracks, KnownObject(range(35), corners),
                                                  facts=FACTS))
        assert path.unit == 'm' and 'object' in world_in_words(path)
        off = path.centre + np.swapaxes(R, 1, 2) @ [-0.12, -0.08, 0.6]
        turned = rotation_vector(path.rotation @ R)
        squares.append(whitened_square(np.concatenate([off, turned], axis=1), path.covariance))
    assert 0.5 < np.mean(squares) < 2, squares


def test_slopes_of_the_poses_are_their_differences():
    rng = np.random.default_rng(0)
    path = AxisPath(rotation_matrix(rng.normal(size=3)), rng.normal(size=4),
                    0.3 * rng.normal(size=(4, 2)), rng.normal(size=(4, 3)))
    unknowns = path_unknowns(GENERAL, 4, ('f',))
    slopes = in_the_world(path.cam_from_world(), *path_slopes(path, unknowns),
                          False).toarray().reshape(4, 6, -1)
    axes = world_and_scale(path.cam_from_world(), False)[0][:, :3]
    first = axes @ path.cam_from_world()[0, :, :3].T
    R, centres = placed(path.cam_from_world())
    for k in range(1, len(unknowns)):
        moved = []
        for step in (1e-6, -1e-6):
            steps = np.zeros(len(unknowns))
            steps[k] = step
            other = path.moved(steps[1:3], steps[unknowns.by_view])
            turned, away = placed(other.cam_from_world())
            moved.append(np.concatenate([
                (away - centres) @ first.T,
                rotation_vector(first @ turned @ np.swapaxes(first @ R, 1, 2))], axis=1))
        assert np.allclose((moved[0] - moved[1]) / 2e-6, slopes[:, :, k], atol=1e-7), k
