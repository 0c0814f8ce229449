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
"""Views of a patterned round part: corners lie on the surface, and a view that fails goes."""

import numpy as np
import pytest

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.region.region_of_interest import region_of_interest, Undistorter
from selfcal_ros.rorapid.texture.surface_views import SurfaceViews
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState
from selfcal_ros.rorapid.visibility.visible_mesh import VisibleMesh
from selfcal_ros.synthetic.mesh_scenes import bean, handle, MeshRenderer
from selfcal_ros.synthetic.objects import object_poses, perturbed
from selfcal_ros.values.mesh import MeshModel

CAMERA = Camera(np.array([[520, 0, 320], [0, 520, 240], [0, 0, 1.0]]), (), 640, 480)


@pytest.fixture(scope='module')
def scene():
    """Make views of a bean, and learn them; what is chosen in one image is placed in the next."""
    vertices, faces = bean()
    model = MeshModel.build(vertices, faces)
    centre = np.asarray(model.centre, float)
    drawn = MeshRenderer(vertices, faces, CAMERA, textured=True)
    views = SurfaceViews(VisibleMesh(model), centre, Projection(CAMERA))
    states, regions = [], []
    for pose in object_poses('general', 90, model.diameter_m)[::30]:
        state = ObjectPose(pose[:, :3], pose[:, 3] + pose[:, :3] @ centre)
        image = drawn.render(pose)
        place = Projection(CAMERA).project(state, np.asarray(model.extent) - centre).pixels
        region = region_of_interest(image, place, 40.0, Undistorter(CAMERA))
        states.append(state)
        regions.append(region)
        for _ in range(2):
            views.learn(region, state, True, np.eye(6) * 1e-8)
    return model, centre, views, states, regions


def test_corners_lie_on_the_side_of_the_surface_that_is_seen(scene):
    model, centre, views, states, _ = scene
    assert len(views._views) == len(states)
    for view, state in zip(views._views, states):
        turned = view.points @ state.rotation.T + state.translation
        assert np.allclose(CAMERA.project(turned), view.region.outside(view.texels), atol=1e-6)
        # on a face: its plane, and within it
        corners = (model.vertices - centre)[model.triangles]
        height = np.abs(np.einsum('fi,nfi->nf', model.normals,
                                  view.points[:, None] - corners[:, 0]))
        assert height.min(axis=1).max() < 1e-9
        assert (np.einsum('ni,ni->n', view.normals, -state.rotation.T @ state.translation
                          - view.points) > 0).all()


def test_where_there_is_no_surface_nothing_is_found(scene):
    *_, views, states, _ = scene
    points, normals, cosine = views._on_surface(np.array([[5.0, 5.0], [630, 470]]), states[0])
    assert (cosine == -1).all() and points.shape == normals.shape == (2, 3)
    assert not len(views._on_surface(np.zeros((0, 2)), states[0])[2])


def test_a_view_that_is_not_the_first_is_dropped_when_its_corners_fail(scene):
    *_, views, states, regions = scene
    last = views._views[-1]
    matches = views.follow(regions[-1], states[-1])
    assert matches is not None and views._views[int(matches.face[0])] is last
    for _ in range(40):
        last.score[:] = np.where(np.isin(np.arange(len(last.score)), matches.corner),
                                 last.score, 0.0)
        if any(one is last for one in views._views):
            views.judge(matches, np.zeros(len(matches.corner), bool))
    assert all(one is not last for one in views._views) and len(views._views) == 2


def test_a_view_of_an_unconfirmed_pose_is_as_unsure_as_the_pose_and_may_be_disowned(scene):
    model, centre, _, states, regions = scene
    views = SurfaceViews(VisibleMesh(model), centre, Projection(CAMERA))
    unsure = np.diag([0.05**2] * 3 + [0.01**2] * 3)
    views.glance(regions[0], states[0], unsure)
    matches = views.follow(regions[0], states[0])
    assert matches is not None and np.allclose(matches.common, unsure)
    views.disown()
    assert not views.known
    views.glance(regions[0], states[0], unsure)
    views.learn(regions[0], states[0], True, unsure)
    views.disown()
    assert views.known


@pytest.mark.long
@pytest.mark.parametrize('shape, seed', [(bean, 3), (handle, 22)])
def test_a_pattern_does_not_draw_a_start_away_before_it_is_confirmed(shape, seed):
    """The edges of the pattern drew these 10 and 12 degrees off, and called that tracked."""
    vertices, faces = shape()
    model = MeshModel.build(vertices, faces)
    drawn = MeshRenderer(vertices, faces, CAMERA, textured=True)
    poses = object_poses('general', 60, model.diameter_m, speed=0.7)
    away = float(np.linalg.norm(poses[:, :, 3], axis=1).mean())
    tracker = RorapidTracker(model, CAMERA, rng=np.random.default_rng(0))
    tracker.start(*perturbed(poses[0][:, :3], poses[0][:, 3], np.random.default_rng(seed), 0.05,
                             0.01 * away))
    turned_deg = []
    for k, pose in enumerate(poses[:24]):
        found = tracker.track(drawn.render(pose, np.random.default_rng(k), 1.0))
        if found.state is TrackerState.TRACKING:
            cosine = (np.trace(found.rotation @ pose[:, :3].T) - 1) / 2
            turned_deg.append(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    assert len(turned_deg) > 8 and max(turned_deg) < 6
