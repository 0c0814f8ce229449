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
import cv2
import numpy as np
import pytest

from selfcal_ros.errors import ArgumentError
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel
from selfcal_ros.synthetic.objects import (MOTIONS, object_poses, perturbed, pose_errors, SHAPES,
                                           tracked_object)
from selfcal_ros.synthetic.render import Renderer, Scene


def _edge_offsets(recording, index, renderer):
    """Where along the normal of each control point the image steps, pixels; only clear steps."""
    image = renderer.intensity_of(index)
    camera, pose = recording.camera_at(index), recording.cam_from_world[index]
    seen = VisibleModel(recording.model, 12, 24).control_points(pose[:, :3], pose[:, 3])
    X, direction = (v @ pose[:, :3].T for v in (seen.object_points, seen.tangents))
    X = X + pose[:, 3]
    xy = camera.project(X)
    along = camera.project(X + 1e-5 * direction) - xy
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    steps = np.arange(-3, 3.01, 0.125)
    at = (xy[:, None] + steps[:, None] * normal[:, None]).astype(np.float32)
    profile = cv2.remap(image.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    low, high = profile[:, :1], profile[:, -1:]
    share = (profile - low) / np.where(high == low, 1, high - low)
    # flat, one step, flat
    flat = (np.abs(share[:, :12]) < 0.06).all(axis=1) & (np.abs(share[:, -12:] - 1) < 0.06).all(
        axis=1)
    clear = seen.visible & (np.abs(high - low)[:, 0] > 20) & flat
    share = share[clear]
    # the ideal step with the same sum: share of the samples that lie behind it
    behind = share.sum(axis=1) / len(steps)
    return (0.5 - behind) * len(steps) * 0.125


@pytest.mark.long
@pytest.mark.parametrize('shape', SHAPES)
def test_edges_of_the_model_are_edges_of_the_image(shape):
    recording = tracked_object(90, shape, noise_sigma=0.0, distortion=(-0.1, 0.02, 0, 0),
                               background=False)
    renderer = recording.renderer(5)
    offsets = np.concatenate([_edge_offsets(recording, k, renderer) for k in (0, 30, 60, 89)])
    assert len(offsets) > 150
    assert abs(np.median(offsets)) < 0.02
    assert np.median(np.abs(offsets)) < 0.05
    # a control point beside a corner sees two edges
    assert np.percentile(np.abs(offsets), 90) < 0.15


def test_the_window_is_what_the_whole_image_would_be():
    recording = tracked_object(40, 'step_block', size=(160, 120), distortion=(-0.1, 0.02, 0, 0))
    whole = Renderer(Scene(recording.surfaces), recording.camera, 3)
    renderer = recording.renderer()
    for k in (0, 39):
        np.testing.assert_allclose(renderer.intensity_of(k), whole.intensity(recording.poses(k)),
                                   atol=1e-9)


def test_motions_are_what_they_are_called():
    general, translation, planar = (object_poses(m, 200, 0.1) for m in MOTIONS)
    assert np.abs(translation[:, :, :3] - translation[0, :, :3]).max() < 1e-12
    assert np.ptp(translation[:, :, 3], axis=0).min() > 0.03
    axis = planar[0, :, 2]
    np.testing.assert_allclose(planar[:, :, :3] @ planar[0, :, :3].T @ axis,
                               np.tile(axis, (200, 1)), atol=1e-12)
    np.testing.assert_allclose((planar[:, :, 3] - planar[0, :, 3]) @ axis, 0, atol=1e-12)
    turns = general[:, :, :3] @ general[0, :, :3].T
    angle, _ = pose_errors(turns, np.ones(3), np.eye(3), np.ones(3))
    assert angle.max() > np.deg2rad(90)
    for poses in (general, translation, planar):
        np.testing.assert_allclose(poses[:, :, :3] @ np.swapaxes(poses[:, :, :3], 1, 2),
                                   np.tile(np.eye(3), (200, 1, 1)), atol=1e-12)


@pytest.mark.parametrize('zoom', [None, (1500.0, 6000.0)])
def test_the_object_stays_in_view_and_moves_a_few_pixels_between_images(zoom):
    recording = tracked_object(600, zoom_px=zoom)
    corners = np.array([recording.camera_at(k).project(recording.model.extent @ R.T + t)
                        for k, (R, t) in enumerate(zip(recording.rotations,
                                                       recording.translations))])
    assert corners.min() > 5 and (corners.max(axis=(0, 1)) < [634, 474]).all()
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=2).max(axis=1)
    assert 2 < np.percentile(steps, 90) < 9
    size = np.ptp(corners, axis=1).max(axis=1)
    assert 90 < size.min() and size.max() < 320


def test_the_lens_zooms_about_the_principal_point():
    recording = tracked_object(5, zoom_px=(1500, 6000))
    focal = [recording.camera_at(k).K[0, 0] for k in range(5)]
    np.testing.assert_allclose(focal, recording.focal_px)
    np.testing.assert_allclose(focal, 1500 * 4 ** (np.arange(5) / 4))
    for k in range(5):
        K = recording.camera_at(k).K
        np.testing.assert_allclose(K[:2, 2], recording.camera.K[:2, 2])
        np.testing.assert_allclose(K[1, 1], K[0, 0])
    assert recording.truth()['focal_px'][4] == 6000


def test_images_can_be_made_again_and_follow_the_seed():
    first, again, other = (tracked_object(3, size=(160, 120), seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.frame(2), again.frame(2))
    assert (first.frame(2) != other.frame(2)).mean() > 0.5
    frames = list(first.frames())
    np.testing.assert_array_equal(frames[2][0], first.frame(2))
    assert [stamp for _, stamp in frames] == first.stamps_ns.tolist()
    truth = first.truth()
    assert truth['object'] == 'cube' and np.shape(truth['cam_from_object']) == (3, 3, 4)


def test_clutter_and_background_can_be_chosen():
    plain, cluttered = (tracked_object(1, clutter=c, noise_sigma=0, background=False).frame(0)
                        for c in (0.0, 1.0))
    assert (plain[:40] == 0).all()
    spread = [np.abs(np.diff(image.astype(float), axis=1)).mean() for image in (plain, cluttered)]
    assert spread[1] > 1.3 * spread[0]


def test_poses_are_disturbed_by_as_much_as_was_asked():
    rng = np.random.default_rng(0)
    R, t = perturbed(np.eye(3), np.array([0, 0, 2.0]), rng, 0.1, 0.02)
    angle, share = pose_errors(R, t, np.eye(3), np.array([0, 0, 2.0]))
    np.testing.assert_allclose([angle, share], [0.1, 0.01])


@pytest.mark.parametrize('wrong', [{'shape': 'house'}, {'motion': 'rolling'}, {'views': 0}])
def test_what_does_not_exist_is_refused(wrong):
    with pytest.raises(ArgumentError):
        tracked_object(**{'views': 2, **wrong})
