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
"""A polyhedron is found by its corners, whatever stands behind it; other things are not."""

from pathlib import Path

from bench.tracking.tracking_objects import NEW_OBJECTS
from bench.tracking.tracking_runs import cube_sequence
from bench.tracking.tracking_sought import recorded
import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree, ConvexHull
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.rorapid.estimation.corner_alignment import CornerAlignment, has_corners
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel
from selfcal_ros.synthetic.objects import tracked_object
from selfcal_ros.values.wireframe import Polygon, WireframeModel

DATA = Path(__file__).resolve().parents[2].parent / 'shared' / 'data'

SHAPES = ('step_block', 'l_block', 'slanted', 'channel')


def shape_of(name, seed):
    return NEW_OBJECTS[name](seed) if name in NEW_OBJECTS else name


def turned_by_deg(rotation, other):
    return np.degrees(np.linalg.norm(rotation_vector(rotation @ other.T)))


@pytest.mark.parametrize('axis', ((0.5, 0.4, 0.2), (-0.6, 0.3, 1.1), (0.3, -0.7, -0.4)))
def test_a_drawing_of_the_edges_gives_the_pose_among_lines_without_meaning(axis):
    model = tracked_object(1, shape='step_block', background=False).model
    K = np.array([[2000.0, 0, 320], [0, 2000.0, 240], [0, 0, 1]])
    rotation, away = rotation_matrix(np.array(axis)), 2000 * model.diameter_m / 180
    translation = np.array([0.02, -0.01, away])
    visible = VisibleModel(model, 40)
    seen = visible.control_points(rotation, translation - rotation @ model.centre)
    points = (seen.object_points[seen.visible] - model.centre) @ rotation.T + translation
    pixels = (points @ K.T)[:, :2] / points[:, 2:]
    image = np.full((480, 640), 60, np.uint8)
    rng = np.random.default_rng(3)
    for start, step in zip(rng.uniform(0, 480, (60, 2)), rng.uniform(-90, 90, (60, 2))):
        cv2.line(image, *np.rint([start, start + step]).astype(int).tolist(), 120, 2)
    cv2.rectangle(image, *np.rint([pixels.min(axis=0) - 12, pixels.max(axis=0) + 12]).astype(
        int).tolist(), 60, -1)
    for line in np.unique(seen.primitive[seen.visible]):
        along = pixels[seen.primitive[seen.visible] == line]
        cv2.polylines(image, [np.rint(along).astype(np.int32)], False, 220, 2)
    poses = CornerAlignment(visible, model.centre).poses(image, K, 24)
    assert len(poses) > 5
    turned = [turned_by_deg(pose.rotation, rotation) for pose in poses]
    best = poses[int(np.argmin(turned))]
    assert min(turned) < 6
    assert np.linalg.norm(best.translation - translation) < 0.06 * away


def test_an_image_without_corners_gives_no_pose():
    model = tracked_object(1, shape='cube', background=False).model
    alignment = CornerAlignment(VisibleModel(model), model.centre)
    K = np.array([[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]])
    assert alignment.poses(np.full((480, 640), 90, np.uint8), K, 24) == []


@pytest.mark.long
@pytest.mark.parametrize('name', SHAPES)
def test_it_is_found_in_one_place_before_a_wall_full_of_things(name):
    """The images are the same but for noise: nothing tells by its motion."""
    made = tracked_object(1, shape_of(name, 31), seed=31, supersampling=2, background=True)
    scene = made.frame(0, made.renderer()).astype(float)
    tracker = RorapidTracker(made.model, made.camera, rng=np.random.default_rng(0))
    tracker.seek()
    frames = [tracker.track(np.clip(scene + np.random.default_rng(k).normal(size=scene.shape),
                                    0, 255).astype(np.uint8)) for k in range(9)]
    assert [frame.state for frame in frames[-3:]] == [TrackerState.TRACKING] * 3
    true = made.model.vertices @ made.rotations[0].T + made.translations[0]
    for frame in filter(None, frames):
        # half a turn takes the step block onto itself
        placed = made.model.vertices @ frame.rotation.T + frame.translation
        assert cKDTree(placed).query(true)[0].max() < 0.02 * made.model.diameter_m


@pytest.mark.long
def test_a_painted_cube_on_a_desk_is_found_and_its_distance_is_not_doubted():
    sequence = cube_sequence()
    if sequence is None:
        pytest.skip('the recorded sets are not there')
    assert recorded(sequence, 144) == (4, 0)
    tracker = RorapidTracker(sequence.model, sequence.camera, rng=np.random.default_rng(0))
    tracker.seek()
    frames = [tracker.track(image) for image in sequence.images[144:152]]
    assert frames[-1].state is TrackerState.TRACKING and not frames[-1].reason


@pytest.mark.long
def test_one_that_moves_on_while_it_is_sought_is_met_where_it_goes():
    """A search takes as long as four images, which a camera does not wait for."""
    made = tracked_object(22, 'step_block', seed=33, supersampling=2, speed=2.0, background=True)
    renderer = made.renderer()
    tracker = RorapidTracker(made.model, made.camera, rng=np.random.default_rng(0))
    tracker.seek()
    number, states = 0, [tracker.state]
    while number < 22 and states[-1] is not TrackerState.TRACKING:
        states.append(tracker.track(made.frame(number, renderer), number * 33_333_333).state)
        found = states[-2:] == [TrackerState.LOST, TrackerState.INITIALISING]
        number += 5 if found else 1
    assert states[-1] is TrackerState.TRACKING
    assert states.count(TrackerState.INITIALISING) >= 2


@pytest.mark.long
@pytest.mark.parametrize('sought', ('cube', 'slab'))
def test_another_object_before_a_wall_full_of_things_is_not_taken_for_it(sought):
    made = tracked_object(9, 'step_block', seed=32, supersampling=2, background=True)
    renderer = made.renderer()
    model = tracked_object(1, shape_of(sought, 32), background=False).model
    tracker = RorapidTracker(model, made.camera, rng=np.random.default_rng(0))
    tracker.seek()
    frames = [tracker.track(made.frame(k, renderer)) for k in range(9)]
    assert not any(frames) and 'no corners' in frames[-1].reason
    # nothing is drawn where it was never seen
    assert all(frame.image_px.shape == (0, 2) and not len(frame.found) for frame in frames)


@pytest.mark.long
@pytest.mark.skipif(not (DATA / 'vgg_corridor').is_dir(), reason='needs the recorded sets')
@pytest.mark.parametrize('name', ('channel', 'slab'))
def test_nothing_is_found_in_a_corridor_of_straight_lines(name):
    """Letters on its floor have corners and sides as the parts have them."""
    model = tracked_object(1, shape_of(name, 611), background=False).model
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
              for path in sorted((DATA / 'vgg_corridor' / 'images').iterdir())]
    height, width = images[0].shape
    camera = Camera(np.array([[0.9 * width, 0, width / 2], [0, 0.9 * width, height / 2],
                              [0, 0, 1]]), (), width, height)
    tracker = RorapidTracker(model, camera, rng=np.random.default_rng(0))
    tracker.seek()
    assert not any(tracker.track(image) for image in images)


@pytest.mark.parametrize('name, sought', (('cube', True), ('ball of many faces', False)))
def test_a_model_of_many_lines_is_not_sought_by_corners(name, sought):
    """It would take seconds, in which a node does nothing else."""
    if sought:
        model = tracked_object(1, shape=name, background=False).model
    else:
        points = np.random.default_rng(0).normal(size=(150, 3))
        points *= 0.05 / np.linalg.norm(points, axis=1, keepdims=True)
        model = WireframeModel.build(points, [], [
            Polygon(tuple(corners.tolist())) for corners in ConvexHull(points).simplices])
    assert has_corners(VisibleModel(model)) is sought
