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
"""Depth images: poses are better by them, and a model of another size is said."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.rorapid.estimation.depth_fit import surface_places
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState
from selfcal_ros.synthetic.depth_scenes import depth_of
from selfcal_ros.synthetic.mesh_scenes import bean, MeshRenderer
from selfcal_ros.synthetic.objects import object_poses, tracked_object
from selfcal_ros.values.mesh import MeshModel
from selfcal_ros.values.wireframe import Polygon

CAMERA = Camera(np.array([[520, 0, 320], [0, 520, 240], [0, 0, 1.0]]), (), 640, 480)
VIEWS = 16


@lru_cache(maxsize=None)
def lump(seed=1):
    """A lump before clutter: grey images, depths, poses, model."""
    vertices, faces = bean()
    drawn = MeshRenderer(vertices, faces, CAMERA, np.random.default_rng(seed))
    first = 5 * (seed - 1)
    poses = object_poses('general', first + VIEWS, 0.1, speed=0.9)[first:]
    images = [drawn.render(pose, np.random.default_rng(k), 1.0) for k, pose in enumerate(poses)]
    depths = [depth_of(vertices[faces], pose, CAMERA, np.random.default_rng(100 + k), 1.2)
              for k, pose in enumerate(poses)]
    return images, depths, poses, MeshModel.build(vertices, faces, 'bean')


def followed(model, poses, images, depths, camera=CAMERA, scale=1.0):
    tracker = RorapidTracker(model, camera, rng=np.random.default_rng(0))
    tracker.start(poses[0][:, :3], scale * poses[0][:, 3])
    return [tracker.track(image, None, depth) for image, depth in zip(images, depths)]


def errors(frames, poses):
    return np.array([np.r_[frame.translation - pose[:, 3],
                           rotation_vector(frame.rotation @ pose[:, :3].T)]
                     for frame, pose in zip(frames, poses) if frame])


@pytest.mark.long
def test_poses_of_a_round_part_are_better_by_depths_and_their_sigmas_true():
    off: tuple[list, list] = ([], [])
    square: list = []
    for seed in range(1, 3):
        images, depths, poses, model = lump(seed)
        for k, given in enumerate(([None] * VIEWS, depths)):
            frames = followed(model, poses, images, given)
            assert all(frames)
            off[k].extend(errors(frames, poses))
        square += [e @ np.linalg.solve(frame.covariance, e) / 6
                   for e, frame in zip(off[1][-VIEWS:], frames)]
    without, with_depths = (np.sqrt(np.mean(np.square(each), axis=0)) for each in off)
    assert np.linalg.norm(with_depths[3:]) < 0.92 * np.linalg.norm(without[3:])
    assert np.linalg.norm(with_depths[:3]) < np.linalg.norm(without[:3])
    assert 0.2 < np.mean(square) < 2.0


@pytest.mark.long
@pytest.mark.parametrize('spoilt', ('nothing', 'no number', 'something before it', 'the wall'))
def test_depths_that_say_nothing_change_nothing(spoilt):
    images, depths, poses, model = lump()
    depth = {'nothing': np.zeros_like(depths[0]), 'no number': np.full_like(depths[0], np.nan),
             'something before it': np.full_like(depths[0], 0.15),
             'the wall': np.full_like(depths[0], 1.2)}[spoilt]
    alone = followed(model, poses[:6], images[:6], [None] * 6)
    given = followed(model, poses[:6], images[:6], [depth] * 6)
    for one, other in zip(alone, given):
        assert np.allclose(one.rotation, other.rotation, atol=0.02)
        assert np.allclose(one.translation, other.translation, atol=0.002)


@lru_cache(maxsize=None)
def block():
    made = tracked_object(14, shape='l_block', supersampling=2, seed=6)
    renderer = made.renderer()
    return made, [made.frame(k, renderer) for k in range(14)]


@pytest.mark.long
@pytest.mark.parametrize('size, scale, said', (
    (1.0, 1.0, ''), (1.0, 1.004, ''), (1.05, 1.0, 'too large'), (0.97, 1.0, 'too small'),
    (1.0, 1.05, 'too small')))
def test_a_model_of_another_size_than_the_depths_is_said(size, scale, said):
    made, images = block()
    corners = made.model.vertices[made.model.triangles]
    depths = [depth_of(corners, pose, made.camera, np.random.default_rng(k), 1.5, scale=scale)
              for k, pose in enumerate(made.cam_from_world)]
    # a model that is wrong by a factor, which grey images cannot tell
    model = replace(made.model, vertices=size * made.model.vertices)
    frames = followed(model, made.cam_from_world, images, depths, made.camera, size)
    if said:
        assert frames[-1].state is TrackerState.DEGRADED and said in frames[-1].reason
        amount = 100 * abs(size / scale - 1)
        assert f'{amount:.0f}.' in frames[-1].reason or f'{amount - 1:.0f}.' in frames[-1].reason
    else:
        assert frames[-1].state is TrackerState.TRACKING and not frames[-1].reason


@pytest.mark.parametrize('shape', ('cube', 'spool', 'step_block'))
def test_places_lie_on_the_surface_evenly_with_normals_outward(shape):
    model = tracked_object(1, shape=shape, background=False).model
    points, normals = surface_places(model, 400)
    assert len(points) == 400 and np.allclose(np.linalg.norm(normals, axis=1), 1)
    # a step outward leads away from all other places of the solid's middle
    centre = model.extent.mean(axis=0)
    outward = np.einsum('ni,ni->n', points - centre, normals)
    # the inner sides of steps and of a spool's rims face the middle
    assert np.mean(outward > 0) > {'cube': 0.99, 'step_block': 0.8, 'spool': 0.6}[shape]
    low, high = model.extent.min(axis=0), model.extent.max(axis=0)
    assert (points > low - 1e-9).all() and (points < high + 1e-9).all()
    assert np.allclose(points.mean(axis=0), centre, atol=0.12 * np.ptp(model.extent))


@pytest.mark.long
@pytest.mark.parametrize('which', ('all', 'every other'))
def test_faces_may_be_wound_in_any_way(which):
    made, images = block()
    corners = made.model.vertices[made.model.triangles]
    depths = [depth_of(corners, pose, made.camera, np.random.default_rng(k), 1.5)
              for k, pose in enumerate(made.cam_from_world)]
    model = replace(made.model, faces=tuple(
        Polygon(face.indices[::-1], face.name) if which == 'all' or k % 2 else face
        for k, face in enumerate(made.model.faces)))
    frames = followed(model, made.cam_from_world, images, depths, made.camera)
    assert all(frame.state is TrackerState.TRACKING for frame in frames)
    # places on the far side would be compared with what is before them
    usual = followed(made.model, made.cam_from_world, images, depths, made.camera)
    off, as_usual = (np.sqrt(np.mean(errors(some, made.cam_from_world)**2, axis=0))
                     for some in (frames, usual))
    assert np.linalg.norm(off[:3]) < 1.3 * np.linalg.norm(as_usual[:3])
