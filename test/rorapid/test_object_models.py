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
"""Models of objects from two translated images: found by themselves, picked, and real."""

from dataclasses import replace
import json
from pathlib import Path
from types import SimpleNamespace

from bench.tracking.object_models import MOVED, onto, PICKED_CUBE, translated, wholly_visible
import cv2
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.pipeline.object_modelling import (
    model_recording, ModelledObject, ModelRequest)
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.rorapid.acquisition.picked_vertices import read_picked
from selfcal_ros.rorapid.acquisition.plane_loops import plane_loops
from selfcal_ros.rorapid.acquisition.two_view_model import points_from_translation
from selfcal_ros.rorapid.estimation.initial_pose import read_pose_file
from selfcal_ros.rorapid.model import read_model, write_model
from selfcal_ros.rorapid.tracker import RorapidTracker
from selfcal_ros.synthetic.object_shapes import SHAPES
from selfcal_ros.synthetic.paths import look_at
from selfcal_ros.synthetic.recordings import default_camera, write_image_folder
from selfcal_ros.values.wireframe import Polygon, WireframeModel

CUBE = Path(__file__).resolve().parents[2].parent / 'shared' / 'data' / 'visp_mbt_cube'


@pytest.mark.parametrize('shape, faces', [('box', 3), ('step_block', 5), ('l_block', 5),
                                          ('cube', 3)])
def test_lines_and_faces_of_rendered_objects_come_out_right(shape, faces, tmp_path):
    recording = translated(shape, background=False, distortion=(-0.1, 0.02, 0, 0))
    write_image_folder(recording, tmp_path / 'images')
    with open_source(tmp_path / 'images') as source:
        made = model_recording(source, ModelRequest(
            recording.camera, baseline_m=float(np.linalg.norm(MOVED))))
    model, pose, truth = made.acquired.model, recording.cam_from_world[0], recording.model
    X = model.vertices @ made.acquired.rotation.T + made.acquired.translation
    apart = np.linalg.norm(X[:, None] - truth.vertices @ pose[:, :3].T - pose[:, 3], axis=2)
    nearest = apart.argmin(axis=1)
    # one vertex for one, within a hundredth of the size of the object
    assert len(set(nearest)) == len(nearest)
    assert apart.min(axis=1).max() < 0.01 * np.linalg.norm(np.ptp(truth.vertices, axis=0))
    assert {frozenset(map(int, nearest[list(line)])) for line in model.lines} \
        == wholly_visible(truth, pose)
    known = {frozenset(face.indices) for face in truth.faces}
    found = [frozenset(map(int, nearest[list(face.indices)])) for face in model.faces]
    assert len(set(found)) == len(found) == faces and set(found) <= known
    assert f'{len(model.lines)} lines and {faces} faces' in made.text()


def test_one_face_and_one_line_without_a_face_are_in_the_singular():
    square = WireframeModel.build([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]],
                                  [(1, 4)], [Polygon((0, 1, 2, 3))])
    made = ModelledObject(SimpleNamespace(
        model=square, rotation=np.eye(3), translation=np.array([1e-7, -0.20004, 1.0]),
        structure=SimpleNamespace(shape_covariances=np.zeros((5, 3, 3)), noise_px=0.1,
                                  sigma_px=0.1, moved=np.ones(3))), (0, 1))
    assert '5 lines and 1 face, ' in made.text() and '1 line belongs to no face' in made.text()
    assert made.start == '0 -0.2 1 0 0 0'


def test_a_known_length_fixes_the_scale_and_the_pose_starts_the_tracker(tmp_path):
    recording = translated('l_block', background=False)
    write_image_folder(recording, tmp_path / 'images')
    with open_source(tmp_path / 'images') as source:
        request = ModelRequest(recording.camera, length_m=0.1, name='L')
        made = model_recording(source, request, images=(1, 0))
    edges = made.acquired.model.edges()
    assert abs(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).max() - 0.1) < 1e-9
    assert abs(np.linalg.norm(made.acquired.structure.moved)
               - np.linalg.norm(MOVED)) < 0.01 * np.linalg.norm(MOVED)
    (tmp_path / 'start.pos').write_text(made.start)
    path = write_model(made.acquired.model, tmp_path / 'L.cao')
    tracker = RorapidTracker(read_model(path), recording.camera)
    tracker.start(*read_pose_file(tmp_path / 'start.pos'))
    image = [image for image, _ in recording.frames()][1]
    tracked = tracker.track(image)
    assert tracked and tracked.share_found > 0.9 and tracked.rms_px < 0.5


def test_the_spread_within_the_object_is_what_the_covariance_says():
    camera, rng, sigma = default_camera(), np.random.default_rng(2), 0.2
    pose = look_at([0.25, -0.3, 0.26], [0, 0, 0])
    X = SHAPES['box']().model.vertices @ pose[:, :3].T + pose[:, 3]
    views = camera.project(X), camera.project(X + MOVED)
    for fact in ({'baseline_m': float(np.linalg.norm(MOVED))},
                 {'known_length': (0, 7, float(np.linalg.norm(X[7] - X[0])))}):
        squares = []
        for _ in range(200):
            found = points_from_translation(*(view + rng.normal(0, sigma, view.shape)
                                              for view in views), camera, sigma_px=sigma, **fact)
            squares.append(((onto(found.points, X) - X)**2).sum(axis=1))
        stated = np.trace(found.shape_covariances, axis1=1, axis2=2)
        # of 200 runs a mean square is known to some 10 %
        assert np.abs(np.mean(squares, axis=0) / stated - 1).max() < 0.35


def test_a_marking_on_a_face_is_no_face():
    square = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]], float)
    vertices = np.concatenate([square, 0.25 * square + [1, 1, 0], 0.25 * square + [9, 9, 0]])
    pairs = [(4 * loop + k, 4 * loop + (k + 1) % 4) for loop in range(3) for k in range(4)]
    assert {frozenset(loop) for loop in plane_loops(vertices, pairs)} == {
        frozenset(range(4)), frozenset(range(8, 12))}


def test_what_is_written_as_cao_is_read_again(tmp_path):
    for shape, make in SHAPES.items():
        model = make().model
        again = read_model(write_model(model, tmp_path / f'{shape}.cao'))
        assert {frozenset(map(int, line)) for line in again.lines} == {
            frozenset(map(int, line)) for line in model.lines}
        assert [face.indices for face in again.faces] == [face.indices for face in model.faces]
        np.testing.assert_allclose(again.vertices[:len(model.vertices)], model.vertices,
                                   atol=1e-9)
        for one, other in zip(again.conics, model.conics, strict=True):
            np.testing.assert_allclose(one.centre, other.centre, atol=1e-9)
            np.testing.assert_allclose(np.linalg.norm(one.axis_u), np.linalg.norm(other.axis_u),
                                       rtol=1e-6)
        assert [c.radius_m for c in again.cylinders] == [c.radius_m for c in model.cylinders]
    ellipse = replace(SHAPES['cube']().model.conics[0], axis_u=np.array([0.01, 0, 0]),
                      axis_v=np.array([0, 0.02, 0]))
    flat = replace(SHAPES['cube']().model, conics=(ellipse,))
    with pytest.raises(InputError, match='circles'):
        write_model(flat, tmp_path / 'flat.cao')


def test_a_drawing_has_all_parts(tmp_path):
    model = SHAPES['spool']().model
    rows = write_model(model, tmp_path / 'spool.obj').read_text().splitlines()
    points = sum(row.startswith('v ') for row in rows)
    assert points == len(model.vertices) + 64 * len(model.conics) + 2 * len(model.cylinders)
    assert sum(row.startswith('f ') for row in rows) == len(model.faces)
    indices = [int(word) for row in rows if row[0] in 'fl' for word in row.split()[1:]]
    assert min(indices) == 1 and max(indices) == points


@pytest.mark.parametrize('text, says', [
    ('3', '"vertices:"'), ('vertices: {a: [1, 2, 3]}\nlines: []', 'vertex a must be 4 numbers'),
    ('vertices: {a: [1, 2, 3, .nan]}\nlines: []', 'vertex a'),
    ('vertices: {a: [1, 2, 3, 4]}', 'name lines or faces'),
    ('vertices: {a: [1, 2, 3, 4]}\nlines: [[a, b]]', "names the vertex 'b'"),
    ('vertices: {a: [1, 2, 3, 4]}\nlines: [[a, a]]', 'twice'),
    ('vertices: {a: [1, 2, 3, 4]}\nfaces: [[a, a]]', 'face 0 must be'),
    ('vertices: {a: [1, 2, 3, 4]}\ncolour: red', 'colour'),
    ('vertices: {a: [1, 2, 3, 4]', 'is not valid YAML'),
    ('a: !!python/object:os.system x', 'is not valid YAML')])
def test_what_is_wrong_with_picked_vertices_is_one_sentence(tmp_path, text, says):
    path = tmp_path / 'picked.yaml'
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_picked(path)
    assert says in str(error.value) and '\n' not in str(error.value)
    assert str(path) in str(error.value)


def test_the_scale_is_stated_once():
    camera = default_camera()
    for wrong in ({}, {'length_m': 1.0, 'baseline_m': 1.0}, {'length_m': -1.0},
                  {'baseline_m': 1.0, 'between': ('a', 'b')},
                  {'length_m': 1.0, 'region': (5, 5, 1, 1)}):
        with pytest.raises(ArgumentError):
            ModelRequest(camera, **wrong)


@pytest.mark.long
@pytest.mark.skipif(not CUBE.is_dir(), reason=f'needs the image sequence {CUBE}')
def test_two_images_of_a_real_cube_make_a_model_that_tracks_it(tmp_path):
    camera = Camera(json.loads((CUBE / 'gt.json').read_text())['K'], width=640, height=480)
    true = read_model(CUBE / 'cube.cao')
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
              for path in sorted((CUBE / 'images').glob('*.jpg'))]
    reference = _tracked(true, camera, images, *read_pose_file(CUBE / 'cube.0.pos'))
    picked = tmp_path / 'picked.yaml'
    picked.write_text(PICKED_CUBE)
    with open_source(CUBE / 'images') as source:
        made = model_recording(source, ModelRequest(
            camera, length_m=0.084, between=('left', 'front'), picked=read_picked(picked)),
            images=(48, 102))
        automatic = model_recording(source, ModelRequest(
            camera, length_m=0.084, region=(310, 170, 455, 330)), images=(48, 102))
    # its pictures hide its edges among others: that must be said, not a poor model be made
    assert isinstance(automatic, NoEstimate)
    # OpenCV 4 finds other segments
    assert automatic.kind == ('no_connected_lines' if cv2.__version__ < '5' else 'no_closed_faces')
    model = made.acquired.model
    edges = model.edges()
    assert np.abs(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1) - 0.084).max() < 0.008
    followed = _tracked(model, camera, images[48:], made.acquired.rotation,
                        made.acquired.translation)
    corners = camera.project(_seen(true, reference[48]))
    own = [np.linalg.norm(corners - xy, axis=1).argmin() for xy in camera.project(
        _seen(model, (made.acquired.rotation, made.acquired.translation)))]
    apart = np.array([np.linalg.norm(camera.project(_seen(model, here))
                                     - camera.project(_seen(true, there))[own], axis=1).mean()
                      for here, there in zip(followed, reference[48:], strict=True)])
    assert np.median(apart) < 1.2 and apart.max() < 2


def _tracked(model, camera, images, rotation, translation):
    tracker = RorapidTracker(model, camera)
    tracker.start(rotation, translation)
    poses = []
    for image in images:
        tracked = tracker.track(image)
        assert tracked
        poses.append((tracked.rotation, tracked.translation))
    return poses


def _seen(model, pose):
    return model.vertices @ pose[0].T + pose[1]
