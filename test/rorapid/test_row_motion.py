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
"""Objects that move while the lines of an image are read one after the other."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.rorapid.estimation.kalman_filter import ConstantVelocityFilter
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.projection.row_motion import RowMotion
from selfcal_ros.rorapid.region.region_of_interest import Region
from selfcal_ros.rorapid.texture.appearance import appearance_of
from selfcal_ros.rorapid.tracker import RorapidTracker
from selfcal_ros.rorapid.visibility.visible_mesh import visible_of
from selfcal_ros.synthetic.object_shapes import cube
from selfcal_ros.synthetic.objects import perturbed, tracked_object
from selfcal_ros.values.mesh import MeshModel

K = np.array([[520.0, 0, 322], [0, 530, 236], [0, 0, 1]])
DELAY_S = 40e-6
#: Turn (rad/s) and motion (m/s) of the object.
VELOCITY = np.array([0.7, -0.5, 1.1, 0.3, -0.25, 0.2])
POSE = ObjectPose(rotation_matrix(np.array([0.3, -0.4, 0.2])), np.array([0.08, 0.12, 0.4]))


def _moving(camera, model='perspective', lines='rows', delay_s=DELAY_S, velocity=VELOCITY):
    motion = RowMotion(camera, delay_s, lines)
    motion.now(velocity, np.eye(len(velocity)))
    return Projection(camera, model, motion)


@pytest.fixture
def rng():
    """Random numbers, the same in each run."""
    return np.random.default_rng(7)


def _points(rng):
    return rng.uniform(-0.05, 0.05, (40, 3))


@pytest.mark.parametrize('lines', ['rows', 'columns'])
@pytest.mark.parametrize('delay_s', [DELAY_S, -DELAY_S])
@pytest.mark.parametrize('camera', [
    Camera(K, (), 640, 480), Camera(K, (-0.25, 0.07, 0.001, -0.002, 0.0), 640, 480),
    Camera(K, (0.05, -0.01, 0.0, 0.0), 640, 480, 'equidistant')], ids=['pinhole', 'bent', 'fish'])
def test_a_point_is_where_it_is_when_its_line_is_read(rng, camera, lines, delay_s):
    projection, plain = _moving(camera, lines=lines, delay_s=delay_s), Projection(camera)
    points = _points(rng)
    seen = projection.project(POSE, points).pixels
    axis, count = (1, 480) if lines == 'rows' else (0, 640)
    exact = np.empty_like(seen)
    for k, (point, pixel) in enumerate(zip(points, seen)):
        line = pixel[axis]
        for _ in range(20):
            late = delay_s * (line - (count - 1) / 2)
            then = plain.moved(POSE, late * VELOCITY)
            exact[k] = plain.project(then, point[None]).pixels[0]
            line = exact[k, axis]
    moved = np.linalg.norm(exact - plain.project(POSE, points).pixels, axis=1).max()
    assert moved > 2
    # what is left is of second order in the time until the line is read
    assert np.linalg.norm(seen - exact, axis=1).max() < 0.02 * moved
    assert np.allclose(projection.displacement(POSE, points),
                       seen - plain.project(POSE, points).pixels)


@pytest.mark.parametrize('model', ['weak', 'zoom', 'affine'])
def test_other_camera_models_move_alike(rng, model):
    camera, points = Camera(K, (), 640, 480), _points(rng)
    state = Projection(camera, model).from_pose(POSE.rotation, POSE.translation, 1.2)
    velocity = VELOCITY if model == 'weak' else np.append(VELOCITY, 0.0)
    if model == 'affine':
        velocity = np.array([0.7, -0.5, 1.1, 0.3, -0.25, 0.2, 0.8, -0.6])
    plain, rows = Projection(camera, model), _moving(camera, model, velocity=velocity)
    seen = rows.project(state, points).pixels
    exact = np.array([plain.project(plain.moved(state, DELAY_S * (pixel[1] - 239.5) * velocity),
                                    point[None]).pixels[0] for pixel, point in zip(seen, points)])
    moved = np.linalg.norm(exact - plain.project(state, points).pixels, axis=1).max()
    assert moved > 2
    assert np.linalg.norm(seen - exact, axis=1).max() < 0.03 * moved


def test_what_rests_is_projected_as_if_all_lines_were_read_at_once(rng):
    camera, points = Camera(K, (), 640, 480), _points(rng)
    rests = _moving(camera, velocity=np.zeros(6))
    assert not rests.reads_rows
    assert np.array_equal(rests.project(POSE, points).pixels,
                          Projection(camera).project(POSE, points).pixels)


def test_without_an_image_size_there_is_no_middle_line():
    with pytest.raises(ArgumentError, match='image size'):
        RowMotion(Camera(K), DELAY_S, 'rows')


def test_pictures_of_faces_bend_as_the_rows_say():
    camera = Camera(K, (), 640, 480)
    projection = _moving(camera)
    texture = appearance_of(visible_of(cube().model, 6, 10), np.zeros(3), projection, 48)
    region = Region(np.zeros((480, 640), np.uint8), np.zeros(2), 1.0)
    for face in texture._faces:
        H = texture._homography(face, POSE, region)
        inner = face.frame_corners.mean(axis=0) + 0.3 * (
            face.frame_corners - face.frame_corners.mean(axis=0))
        drawn = inner @ H[:, :2].T + H[:, 2]
        points = inner @ face.axes.T + face.origin
        seen = projection.project(POSE, points).pixels
        moved = np.abs(projection.displacement(POSE, points)).max()
        assert moved > 1.5
        assert np.abs(drawn[:, :2] / drawn[:, 2:] - seen).max() < 0.05 * moved


def test_corners_of_a_curved_surface_are_placed_where_rows_say(rng):
    camera = Camera(K, (), 640, 480)
    projection = _moving(camera)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.05, 0.05, 9)] * 2), axis=-1).reshape(-1, 2)
    vertices = np.column_stack([grid, 2 * (grid**2).sum(axis=1)])
    at = np.arange(81).reshape(9, 9)
    quads = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], axis=-1).reshape(-1, 4)
    model = MeshModel.build(vertices, np.concatenate([quads[:, [0, 2, 1]], quads[:, [0, 3, 2]]]))
    views = appearance_of(visible_of(model, 6, 10), np.zeros(3), projection, 48)
    region = Region(np.zeros((480, 640), np.uint8), np.zeros(2), 1.0)
    pixels = projection.project(POSE, np.column_stack([
        within := rng.uniform(-0.03, 0.03, (40, 2)), 2 * (within**2).sum(axis=1)])).pixels
    views._place(region, POSE, np.eye(6), pixels)
    view = views._views[0]
    # as exact as a step of first order from where they were thought to be
    assert np.abs(projection.project(POSE, view.points).pixels - view.texels).max() < 0.05


def _knowing(projection, prior):
    """Return a filter of the pose and the velocity with a covariance (12, 12)."""
    kalman = ConstantVelocityFilter(projection, np.eye(6), POSE, prior[:6, :6], np.ones(6),
                                    np.ones(6))
    kalman.velocity, kalman.covariance = VELOCITY.copy(), prior.copy()
    return kalman


def test_an_image_that_tells_a_later_pose_is_taken_in_as_such(rng):
    projection = Projection(Camera(K, (), 640, 480))
    root = rng.normal(size=(12, 12))
    prior = 1e-4 * (root @ root.T + np.eye(12))
    late = 5e-3 * np.eye(6) + 1e-3 * rng.normal(size=(6, 6))
    seen = rng.normal(size=(6, 6))
    seen = 1e4 * (seen @ seen.T + np.eye(6))
    kalman = _knowing(projection, prior)
    z = 1e-4 * rng.normal(size=6)
    posterior = np.linalg.inv(np.linalg.inv(prior[:6, :6]) + seen)
    state = projection.moved(POSE, posterior @ seen @ z)
    kalman.absorb(state, posterior, late)
    # the same as one linear measurement z = p + late v of both
    H = np.hstack([np.eye(6), late])
    gain = prior @ H.T @ np.linalg.inv(H @ prior @ H.T + np.linalg.inv(seen))
    step = gain @ z
    assert np.allclose(kalman.covariance, prior - gain @ H @ prior, rtol=1e-6, atol=1e-12)
    assert np.allclose(projection.difference(kalman.state, POSE), step[:6], rtol=1e-3, atol=1e-9)
    assert np.allclose(kalman.velocity - VELOCITY, step[6:], rtol=1e-6, atol=1e-9)
    again, other = _knowing(projection, prior), _knowing(projection, prior)
    again.absorb(state, posterior, np.zeros((6, 6)))
    other.absorb(state, posterior)
    assert np.allclose(again.covariance, other.covariance, rtol=1e-7, atol=1e-13)
    assert np.allclose(again.velocity, other.velocity)


def test_a_pose_that_is_only_proposed_leaves_a_covariance(rng):
    """It is wider than the prediction, so that no image can have led to it."""
    projection = Projection(Camera(K, (), 640, 480))
    root = rng.normal(size=(12, 12))
    prior = 1e-4 * (root @ root.T + np.eye(12))
    kalman = _knowing(projection, prior)
    wide, late = 1e-2 * np.eye(6), 5e-3 * np.eye(6)
    kalman.absorb(POSE, wide, late)
    assert np.linalg.eigvalsh(kalman.covariance)[0] > 0
    assert np.allclose(kalman.pose_covariance, wide + late @ prior[6:, 6:] @ late.T)


def _followed(recording, frames, options):
    """Squared errors over covariances, errors in degrees, and states, from the third image on."""
    tracker = RorapidTracker(recording.model, recording.camera, options)
    tracker.start(*perturbed(recording.rotations[0], recording.translations[0],
                             np.random.default_rng(1), np.deg2rad(0.5), 0.001))
    squares, degrees, states = [], [], []
    for frame, stamp, pose in zip(frames, recording.stamps_ns, recording.cam_from_world):
        found = tracker.track(frame, int(stamp))
        turn = rotation_vector(found.rotation @ pose[:, :3].T)
        error = np.concatenate([found.translation - pose[:, 3], turn])
        squares.append(error @ np.linalg.solve(found.covariance, error))
        degrees.append(np.rad2deg(np.linalg.norm(turn)))
        states.append(found.state.value)
    return np.array(squares[3:]), np.array(degrees[3:]), states[3:]


def test_a_fast_object_before_a_rolling_shutter():
    recording = tracked_object(9, 'box', speed=3.0, readout_s=0.02, seed=6)
    renderer = recording.renderer()
    frames = [recording.frame(k, renderer) for k in range(9)]
    knows = TrackerOptions(line_delay_s=0.02 / 480)
    squares, degrees, states = _followed(recording, frames, knows)
    assert set(states) == {'tracking'}
    # 6 numbers: 99.9 % lie below 22.5
    assert squares.max() < 22.5
    _, wrong, _ = _followed(recording, frames, replace(knows, line_delay_s=0.0))
    assert np.median(wrong) > 3 * np.median(degrees)
