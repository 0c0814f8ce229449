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
"""What was lost and comes back elsewhere is found; what is another thing, or ambiguous, is not."""

from functools import lru_cache

import numpy as np
import pytest

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.rorapid.edges.control_points import ControlModel
from selfcal_ros.rorapid.estimation.sampled_views import SampledViews
from selfcal_ros.rorapid.projection.camera_models import Projection
from selfcal_ros.rorapid.region.background_change import BackgroundChange
from selfcal_ros.rorapid.region.foreground_blob import foreground_blobs
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerOptions, TrackerState
from selfcal_ros.rorapid.visibility.visible_mesh import visible_of
from selfcal_ros.synthetic.mesh_scenes import bean, handle, MeshRenderer, ring
from selfcal_ros.synthetic.objects import object_poses, tracked_object
from selfcal_ros.values.mesh import MeshModel

CAMERA = Camera(np.array([[520, 0, 320], [0, 520, 240], [0, 0, 1.0]]), (), 640, 480)


def noisy(scene, seed):
    rng = np.random.default_rng(seed)
    return np.clip(scene + rng.normal(size=scene.shape), 0, 255).round().astype(np.uint8)


def turned_by_deg(rotation, other):
    return np.degrees(np.linalg.norm(rotation_vector(rotation @ other.T)))


SCENE = np.tile(np.linspace(40, 200, 320), (240, 1))


def with_box(x, y, side=40):
    scene = SCENE.copy()
    scene[y:y + side, x:x + side] += 45
    return scene


def test_what_is_new_in_a_scene_is_in_one_piece_where_it_is():
    change = BackgroundChange()
    assert not any(change.look(noisy(SCENE, k)) for k in range(6))
    piece, = change.look(noisy(with_box(100, 80), 6))
    inside = np.zeros(SCENE.shape, bool)
    inside[80:120, 100:140] = True
    assert np.mean((piece > 0) != inside) < 0.002
    # it does not become part of the scene while it stays
    assert all(len(change.look(noisy(with_box(100, 80), k))) == 1 for k in range(7, 60))


@pytest.mark.parametrize('scenes', (
    # half out of the image, a speck, nearly all of the image, light that goes on
    [SCENE] * 6 + [with_box(290, 80)], [SCENE] * 6 + [with_box(100, 80, 8)],
    [SCENE] * 6 + [with_box(5, 5, 230)], [SCENE] * 6 + [SCENE + 20],
    # a camera that moves
    [np.roll(with_box(100, 80), 8 * k, axis=1) for k in range(8)]),
    ids=('at the border', 'speck', 'large', 'light', 'moving camera'))
def test_nothing_is_new_where_it_cannot_be_told(scenes):
    change = BackgroundChange()
    assert not any(change.look(noisy(scene, k)) for k, scene in enumerate(scenes))


def test_images_of_another_size_begin_another_scene():
    change = BackgroundChange()
    for k in range(6):
        change.look(noisy(SCENE, k))
    assert not change.look(noisy(np.zeros((120, 160)), 7))


@pytest.mark.long
@pytest.mark.parametrize('shape', ('step_block', 'spool'))
def test_the_silhouette_of_a_pose_proposes_it(shape):
    made = tracked_object(4, shape=shape, seed=5)
    visible = visible_of(made.model, 4, 8, 40)
    control = ControlModel(visible, Projection(made.camera, 'perspective'), (640, 480))
    views = SampledViews(visible, control.centre)
    renderer = made.renderer()
    background = renderer._background(made.camera, made.poses(0))
    for k in range(4):
        mask = np.uint8(255) * (np.abs(made.frame(k, renderer) - background) > 8)
        centred = made.translations[k] + made.rotations[k] @ control.centre
        poses = views.poses(mask, made.camera.K, 64)
        near = [pose for pose in poses if turned_by_deg(pose.rotation, made.rotations[k]) < 20]
        offset = min(np.linalg.norm(pose.translation - centred) for pose in near)
        assert offset < 0.08 * np.linalg.norm(centred)


def test_poses_that_a_mask_proposes_go_with_the_image():
    """Turning the image turns the poses, and twice the size is half the distance."""
    vertices, faces = handle()
    visible = visible_of(MeshModel.build(vertices, faces, 'knob'), 4, 8, 60)
    views = SampledViews(visible, np.zeros(3))
    yy, xx = np.mgrid[:480, :640]
    mask = np.uint8(255) * ((np.abs(xx - 320) < 60) & (np.abs(yy - 240) < 30)
                            | (np.abs(xx - 350) < 20) & (np.abs(yy - 200) < 30))
    first = views.poses(mask, CAMERA.K, 5)[0]
    small = views.poses(np.ascontiguousarray(mask[::2, ::2]), np.diag([0.5, 0.5, 1]) @ CAMERA.K,
                        5)[0]
    assert turned_by_deg(first.rotation, small.rotation) < 11
    assert np.allclose(first.translation, small.translation, rtol=0.03, atol=0.01)
    upside = views.poses(np.ascontiguousarray(mask[::-1, ::-1]), CAMERA.K, 5)[0]
    half = rotation_matrix(np.array([0, 0, np.pi]))
    assert turned_by_deg(half @ first.rotation, upside.rotation) < 11


def seen_then_away(tracker, images, scene, away=8):
    """Follow an object, take it away, and return how often a pose was published meanwhile."""
    for image in images:
        found = tracker.track(image)
    assert found
    poses = sum(bool(tracker.track(noisy(scene, 50 + k))) for k in range(away))
    assert tracker.state is TrackerState.LOST
    return poses


@lru_cache(maxsize=None)
def sequence(shape, first, seed=91):
    """Ten images of an object, its scene, and four images of it from `first` on."""
    made = tracked_object(first + 4, shape=shape, supersampling=2, seed=seed)
    renderer = made.renderer()
    scene = renderer._background(made.camera, made.poses(0))
    return made, scene, [made.frame(k, renderer) for k in (*range(10), *range(first, first + 4))]


def back_after_absence(shape, first):
    """Poses of an object that comes back: turned by (degrees), and off by (share of distance)."""
    made, scene, images = sequence(shape, first)
    tracker = RorapidTracker(made.model, made.camera, rng=np.random.default_rng(0))
    tracker.start(made.rotations[0], made.translations[0])
    assert turned_by_deg(made.rotations[9], made.rotations[first]) > 30
    assert seen_then_away(tracker, images[:10], scene) <= 3
    errors = []
    for k, image in enumerate(images[10:], first):
        frame = tracker.track(image)
        if frame:
            truth = made.translations[k]
            errors.append((turned_by_deg(frame.rotation, made.rotations[k]),
                           np.linalg.norm(frame.translation - truth) / np.linalg.norm(truth)))
    return np.array(errors).reshape(-1, 2)


@pytest.mark.long
@pytest.mark.parametrize('first', (60, 110))
def test_an_object_that_comes_back_otherwise_turned_is_found(first):
    errors = back_after_absence('l_block', first)
    assert len(errors) >= 2 and (errors[:, 0] < 1.0).all() and (errors[:, 1] < 0.01).all()


@pytest.mark.long
def test_an_object_that_looks_the_same_turned_by_half_is_found_in_either_pose():
    errors = back_after_absence('step_block', 80)
    half = np.minimum(errors[:, 0], 180 - errors[:, 0])
    assert len(errors) >= 2 and (half < 1.0).all() and np.ptp(errors[:, 0]) < 1.0


@pytest.mark.long
def test_a_cube_with_pictures_is_not_found_turned_by_a_quarter():
    assert (back_after_absence('cube', 130)[:, 0] < 1.0).all()


@pytest.mark.long
def test_another_object_that_comes_in_is_not_taken_for_it():
    made, scene, images = sequence('l_block', 110)
    tracker = RorapidTracker(made.model, made.camera, rng=np.random.default_rng(0))
    tracker.start(made.rotations[0], made.translations[0])
    seen_then_away(tracker, images[:10], scene)
    _, thing, others = sequence('step_block', 110)
    for k, image in enumerate(others[10:]):
        # the other object stands before the scene of the first
        mask = np.abs(image - thing) > 8
        assert not tracker.track(noisy(np.where(mask, image, scene), k))


def come_back(shape, what, images=4):
    """Errors in degrees of a smooth part that comes back, and the states."""
    vertices, faces = shape()
    model = MeshModel.build(vertices, faces, 'part')
    drawn = MeshRenderer(vertices, faces, CAMERA, textured=what == 'patterned')
    poses = object_poses('general', 130, model.diameter_m, speed=0.9)
    tracker = RorapidTracker(model, CAMERA, rng=np.random.default_rng(0))
    tracker.start(poses[0][:, :3], poses[0][:, 3])
    seen_then_away(tracker, [drawn.render(poses[k], np.random.default_rng(k), 1.0)
                             for k in range(8)], drawn._background)
    frames = [tracker.track(drawn.render(pose, np.random.default_rng(k), 1.0))
              for k, pose in enumerate(poses[120:120 + images])]
    return [turned_by_deg(frame.rotation, pose[:, :3])
            for frame, pose in zip(frames, poses[120:]) if frame]


@pytest.mark.long
def test_a_round_part_that_looks_different_from_all_sides_is_found_by_its_outline():
    errors = come_back(ring, 'plain')
    assert errors and max(errors) < 3


@pytest.mark.long
def test_a_round_part_that_looks_alike_from_two_sides_stays_lost():
    assert not come_back(bean, 'plain', 5)


@pytest.mark.long
def test_a_pattern_does_not_pass_for_the_outline():
    # it stays lost: no outline is sure enough
    assert not come_back(ring, 'patterned', 6)


def test_what_stands_out_from_a_shaded_background_is_one_piece_without_holes():
    scene = SCENE.copy()
    scene[80:140, 100:170] = 30
    # a side as grey as the background behind it
    scene[95:125, 120:150] = SCENE[95:125, 120:150]
    piece, = foreground_blobs(noisy(scene, 1))
    inside = np.zeros(SCENE.shape, bool)
    inside[80:140, 100:170] = True
    assert np.mean((piece > 0) != inside) < 0.003


def test_nothing_stands_out_from_a_background_full_of_things():
    made, scene, images = sequence('l_block', 60)
    assert not foreground_blobs(images[0]) and not foreground_blobs(noisy(SCENE, 2))


def sought(model, camera, images):
    tracker = RorapidTracker(model, camera, rng=np.random.default_rng(0))
    tracker.seek()
    return [tracker.track(image) for image in images]


def test_an_object_before_a_plain_background_is_found_without_a_start():
    vertices, faces = handle()
    model = MeshModel.build(vertices, faces, 'knob')
    drawn = MeshRenderer(vertices, faces, CAMERA)
    poses = object_poses('general', 6, model.diameter_m, speed=1.1)
    frames = sought(model, CAMERA, [drawn.render(pose, np.random.default_rng(k), 1.0)
                                    for k, pose in enumerate(poses)])
    assert frames[-1].state is TrackerState.TRACKING
    for frame, pose in zip(frames, poses):
        assert not frame or turned_by_deg(frame.rotation, pose[:, :3]) < 3


@pytest.mark.long
def test_an_object_that_moves_before_a_wall_is_found_without_a_start():
    made, _, images = sequence('l_block', 60, seed=502)
    frames = sought(made.model, made.camera, images[:10])
    found = [k for k, frame in enumerate(frames) if frame]
    assert found and found[0] > 0
    assert all(turned_by_deg(frames[k].rotation, made.rotations[k]) < 1.5 for k in found)


@pytest.mark.long
def test_another_object_is_not_found_and_it_is_said_what_is_missing():
    made, _, images = sequence('l_block', 60)
    other = tracked_object(2, shape='cube')
    frames = sought(other.model, made.camera, images)
    assert not any(frames) and 'not seen yet' in frames[-1].reason


def test_the_methods_of_the_thesis_do_not_search():
    made, _, _ = sequence('l_block', 60)
    tracker = RorapidTracker(made.model, made.camera, TrackerOptions(method='rorapid'))
    with pytest.raises(ArgumentError, match='modern'):
        tracker.seek()
