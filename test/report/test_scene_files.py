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
"""Path and structure for other programs: what their readers find is what was written."""

from dataclasses import replace
import json

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from selfcal_ros.calibration.result import FocalCourse
from selfcal_ros.calibration.structure.camera_path import camera_path
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.pipeline.excerpt import Excerpt
from selfcal_ros.pipeline.feature_session import ExtractedTracks
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.report.ply import camera_frusta
from selfcal_ros.report.scene_files.colmap_model import check_colmap_folder, write_colmap
from selfcal_ros.report.scene_files.exported_scene import exported_scene
from selfcal_ros.report.scene_files.keyframe_files import KeyframeFiles, read_keyframes
from selfcal_ros.report.scene_files.pose_files import (COLUMNS, format_of, SUFFIXES, write_poses)
from selfcal_ros.report.scene_files.transforms_json import write_transforms
from selfcal_ros.values.tracks import Tracks

STAMPS = {k: 1_700_000_000_000_000_001 + 33_333_333 * k for k in range(6)}
LENSES = {'pinhole': ('plumb_bob', []), 'opencv': ('plumb_bob', [-0.1, 0.02, 1e-3, -2e-3]),
          'k3': ('plumb_bob', [-0.1, 0.02, 1e-3, -2e-3, 0.01]),
          'rational': ('rational_polynomial', [0.3, 0.05, 1e-3, -2e-3, 0.01, 0.4, 0.08, 0.002]),
          'fisheye': ('equidistant', [-0.02, 0.01, -0.004, 0.0007])}
NAMES = [f'frame_{k}.png' for k in range(6)]


def seen_by(calibration, sequence, lens, zoom=None):
    """Return a result with a lens, and noisy tracks of what it sees; one of them is wrong."""
    model, d = LENSES[lens]
    camera = Camera(calibration.camera.K, d, calibration.camera.width, calibration.camera.height,
                    model)
    focal = None if zoom is None else FocalCourse(np.arange(6), camera.K[0, 0] * zoom,
                                                  np.ones(6))
    result = replace(calibration, camera=camera, focal=focal, observation_count=0)
    X = (np.einsum('vij,pj->vpi', sequence.cam_from_world[:, :, :3], sequence.points)
         + sequence.cam_from_world[:, None, :, 3])
    uv = np.stack([result.camera_of(k).project(X[k]) for k in range(6)])
    uv += np.random.default_rng(0).normal(0, 0.1, uv.shape)
    uv[2, 7] += 40.0
    view, point = np.mgrid[:6, :len(sequence.points)]
    return result, Tracks(view.ravel(), point.ravel(), uv.reshape(-1, 2),
                          (camera.width, camera.height), STAMPS)


@pytest.fixture(scope='module')
def scene(calibration, sequence):
    return exported_scene(*seen_by(calibration, sequence, 'opencv'))


def read_colmap(folder):
    """Read a text model by the words of COLMAP's documentation."""
    lines = {name: [line for line in (folder / f'{name}.txt').read_text().split('\n')
                    if not line.startswith('#')] for name in ('cameras', 'images', 'points3D')}
    cameras = {int(words[0]): (words[1], [int(one) for one in words[2:4]],
                               [float(one) for one in words[4:]])
               for words in map(str.split, filter(None, lines['cameras']))}
    images = {}
    for head, seen in zip(lines['images'][::2], lines['images'][1::2]):
        number, *pose, camera, name = head.split(' ', 9)
        seen = np.array(seen.split(), float).reshape(-1, 3)
        images[int(number)] = np.array(pose, float), int(camera), name, seen
    points = {}
    for words in map(str.split, filter(None, lines['points3D'])):
        points[int(words[0])] = (np.array(words[1:4], float), words[4:7], float(words[7]),
                                 np.array(words[8:], int).reshape(-1, 2))
    return cameras, images, points


@pytest.mark.parametrize('lens', ['pinhole', 'opencv', 'k3', 'rational', 'fisheye'])
def test_colmap_sees_the_points_where_we_do(tmp_path, calibration, sequence, lens):
    result, tracks = seen_by(calibration, sequence, lens)
    scene = exported_scene(result, tracks)
    write_colmap(tmp_path / 'model', scene, NAMES)
    cameras, images, points = read_colmap(tmp_path / 'model')
    model, size, p = cameras[1]
    assert model == {'pinhole': 'PINHOLE', 'opencv': 'OPENCV', 'k3': 'FULL_OPENCV',
                     'rational': 'FULL_OPENCV', 'fisheye': 'OPENCV_FISHEYE'}[lens]
    assert size == [tracks.image_size[0], tracks.image_size[1]] and len(points) > 250
    # OpenCV has the same lenses, and its (0, 0) half a pixel inside
    K, d = np.array([[p[0], 0, p[2] - 0.5], [0, p[1], p[3] - 0.5], [0, 0, 1]]), np.array(p[4:])
    errors, told = [], []
    for number, (pose, camera, name, seen) in images.items():
        assert name == NAMES[number - 1] and camera == 1
        R = Rotation.from_quat(pose[[1, 2, 3, 0]]).as_matrix()
        tied = seen[seen[:, 2] > 0]
        X = np.array([points[int(one)][0] for one in tied[:, 2]]) @ R.T + pose[4:]
        assert (X[:, 2] > 0).all()
        uv = (cv2.fisheye.distortPoints((X[:, None, :2] / X[:, None, 2:]), K, d)
              if lens == 'fisheye' else cv2.projectPoints(X, np.zeros(3), np.zeros(3), K, d)[0])
        errors.append(uv[:, 0] + 0.5 - tied[:, :2])
        assert (seen[:, 2] != 0).all()
    rms = np.sqrt(np.mean(np.concatenate(errors)**2))
    assert rms == pytest.approx(0.1, rel=0.05)
    assert len(np.concatenate(errors)) == np.sum(scene.point >= 0) == sum(
        len(track) for *_, track in points.values())
    for number, (_, _, error, track) in points.items():
        # every track names the observations that name it
        assert all(images[image][3][row, 2] == number for image, row in track)
        told += [error] * len(track)
    assert np.mean(told) == pytest.approx(
        np.mean(np.linalg.norm(np.concatenate(errors), axis=1)), rel=1e-6)
    # the wrong one is there, and is nobody's
    assert images[3][3][7, 2] == -1 and images[3][3][7, 0] == tracks.xy[
        (tracks.frame == 2) & (tracks.track == 7)][0, 0] + 0.5


@pytest.mark.parametrize('lens', ['opencv', 'rational', 'fisheye'])
def test_colmap_itself_finds_the_residuals_that_we_report(tmp_path, calibration, sequence, lens):
    pycolmap = pytest.importorskip('pycolmap')
    result, tracks = seen_by(calibration, sequence, lens)
    scene = exported_scene(result, tracks)
    write_colmap(tmp_path, scene, NAMES)
    model = pycolmap.Reconstruction()
    model.read_text(str(tmp_path))
    assert model.num_points3D() == len(scene.points) and model.num_reg_images() == 6
    for view, name in enumerate(NAMES):
        image = model.images[view + 1]
        assert image.name == name
        cam_from_world = image.cam_from_world
        if callable(cam_from_world):
            cam_from_world = cam_from_world()
        rows = scene.rows_of(view)
        for seen, point, error in zip(image.points2D, scene.point[rows], scene.error[rows]):
            assert seen.has_point3D() == (point >= 0)
            if point >= 0:
                at = cam_from_world * model.points3D[seen.point3D_id].xyz
                uv = model.cameras[1].img_from_cam(at)
                assert np.linalg.norm(uv - seen.xy) == pytest.approx(error, abs=1e-6)


def test_a_camera_that_zooms_is_a_camera_an_image(tmp_path, calibration, sequence):
    zoom = np.linspace(0.9, 1.1, 6)
    result, tracks = seen_by(calibration, sequence, 'opencv', zoom)
    scene = exported_scene(result, tracks)
    write_colmap(tmp_path, scene, NAMES)
    cameras, images, _ = read_colmap(tmp_path)
    f = result.camera.K[0, 0]
    assert [cameras[images[k + 1][1]][2][0] for k in range(6)] == pytest.approx(f * zoom)
    write_transforms(tmp_path / 'transforms.json', scene, NAMES)
    frames = json.loads((tmp_path / 'transforms.json').read_text())['frames']
    assert [frame['fl_x'] for frame in frames] == pytest.approx(f * zoom)
    assert np.mean(scene.error[scene.point >= 0]) < 0.2


@pytest.mark.parametrize('lens', ['k3', 'fisheye'])
def test_transforms_have_the_axes_and_pixels_of_nerfstudio(tmp_path, calibration, sequence, lens):
    result, tracks = seen_by(calibration, sequence, lens)
    scene = exported_scene(result, tracks)
    path = write_transforms(tmp_path / 'transforms.json', scene, NAMES, STAMPS, 'sparse_pc.ply')
    content = json.loads(path.read_text())
    assert content['camera_model'] == {'k3': 'OPENCV', 'fisheye': 'OPENCV_FISHEYE'}[lens]
    assert [frame['file_path'] for frame in content['frames']] == NAMES
    assert content['frames'][1]['stamp_ns'] == STAMPS[1]
    d = LENSES[lens][1]
    names = {'k3': ['k1', 'k2', 'p1', 'p2', 'k3'], 'fisheye': ['k1', 'k2', 'k3', 'k4']}[lens]
    assert [content[name] for name in names] == d
    assert (content['w'], content['h']) == tracks.image_size
    for view, frame in enumerate(content['frames']):
        pose = np.array(frame['transform_matrix'])
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
        rows = scene.rows_of(view)
        tied = scene.point[rows] >= 0
        # OpenGL's camera looks along -z, y up
        X = (scene.points[scene.point[rows][tied]] - pose[:3, 3]) @ pose[:3, :3] * [1, -1, -1]
        plain = X[:, :2] / X[:, 2:] * [content['fl_x'], content['fl_y']] + [
            content['cx'] - 0.5, content['cy'] - 0.5]
        measured = Camera(result.camera.K).project(result.camera.rays(scene.xy[rows][tied]))
        assert np.sqrt(np.mean((plain - measured)**2)) < 0.15


def test_what_a_format_cannot_hold_is_refused_before_a_file_is_written(tmp_path, calibration,
                                                                       sequence, scene):
    rational = exported_scene(*seen_by(calibration, sequence, 'rational'))
    with pytest.raises(ArgumentError, match='rational_polynomial'):
        write_transforms(tmp_path / 'transforms.json', rational, NAMES)
    skewed = replace(scene, camera=Camera([[500, 3, 320], [0, 500, 240], [0, 0, 1]],
                                          width=640, height=480))
    with pytest.raises(ArgumentError, match='skew'):
        write_colmap(tmp_path / 'model', skewed, NAMES)
    with pytest.raises(ArgumentError, match='rename'):
        write_colmap(tmp_path / 'model', scene, ['a b', *NAMES[1:]])
    assert not list(tmp_path.iterdir())
    (tmp_path / 'old').mkdir()
    (tmp_path / 'old' / 'images.bin').touch()
    with pytest.raises(ArgumentError, match='another model'):
        check_colmap_folder(tmp_path / 'old')
    (tmp_path / 'file').touch()
    with pytest.raises(ArgumentError, match='is a file'):
        check_colmap_folder(tmp_path / 'file')
    with pytest.raises(InputError, match='does not exist'):
        check_colmap_folder(tmp_path / 'none' / 'model')


def test_every_format_of_poses_says_the_same(tmp_path, calibration):
    covariance = np.einsum('vij,vkj->vik', *2 * (np.random.default_rng(0).normal(size=(6, 6, 6)),))
    path = replace(camera_path(calibration), covariance=covariance)
    tum, euroc, table = (write_poses(tmp_path / form, form, path, STAMPS, 'a\nsource')
                         for form in ('tum', 'euroc', 'csv'))
    # as evo reads them
    rows = np.loadtxt(tum, comments='#')
    assert rows.shape == (6, 8) and np.allclose(np.diff(rows[:, 0]), 0.033333333, atol=1e-6)
    assert '\n1700000000.033333334 ' in tum.read_text()
    assert np.allclose(rows[:, 1:4], path.centre, atol=0, rtol=1e-15)
    assert np.allclose(Rotation.from_quat(rows[:, 4:]).as_matrix(), path.rotation)
    other = np.genfromtxt(euroc, delimiter=',', comments='#')
    assert other.shape == (6, 8) and np.array_equal(other[:, 1:4], rows[:, 1:4])
    assert np.array_equal(other[:, 4:], rows[:, [7, 4, 5, 6]])
    head, first = euroc.read_text().splitlines()[:2]
    assert head.startswith('#timestamp [ns],p_RS_R_x [step]') and first.startswith(
        f'{STAMPS[0]},')
    lines = [line for line in table.read_text().splitlines() if not line.startswith('#')]
    assert lines[0].split(',') == list(COLUMNS) and len(COLUMNS) == 45
    cells = np.array([line.split(',') for line in lines[1:]])
    assert [int(one) for one in cells[:, 1]] == list(STAMPS.values())
    assert np.array_equal(cells[:, 2:9].astype(float), rows[:, 1:])
    assert np.array_equal(cells[:, 9:].astype(float).reshape(6, 6, 6), covariance)
    for text in (tum.read_text(), table.read_text()):
        assert 'world_T_camera' in text and 'median step' in text and '# a source\n' in text


def test_without_a_clock_images_are_counted_and_what_is_not_known_is_empty(tmp_path, calibration):
    path = camera_path(calibration)
    assert path.covariance is None
    tum, euroc, table = (write_poses(tmp_path / form, form, path, None, '')
                         for form in ('tum', 'euroc', 'csv'))
    assert np.loadtxt(tum)[:, 0].tolist() == list(range(6))
    assert euroc.read_text().startswith('#frame,')
    line = table.read_text().splitlines()[-1].split(',')
    assert line[:2] == ['5', ''] and line[9:] == [''] * 36
    for suffix, form in SUFFIXES.items():
        assert format_of(tmp_path / f'a{suffix.upper()}') == form
    assert format_of(tmp_path / 'a.csv', 'euroc') == 'euroc'
    with pytest.raises(ArgumentError, match='--poses-format'):
        format_of(tmp_path / 'poses')


@pytest.mark.parametrize('clock, told', [('header', True), ('log', True), ('video', True),
                                         ('nominal', False), ('none', False)])
def test_only_a_clock_gives_stamps(clock, told):
    reading = ExtractedTracks(Tracks([3], [0], [[1.0, 2.0]], stamps_ns={3: 7}), '', clock=clock)
    assert reading.stamps_ns == ({3: 7} if told else None)


def test_frusta_frame_what_the_camera_sees():
    camera = Camera([[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]], width=640, height=480)
    turn = Rotation.from_euler('xyz', [0.3, -0.2, 1.0]).as_matrix()
    tip, *corners = camera_frusta(camera, turn[None], np.array([[1.0, 2, 3]]))[0]
    assert np.allclose(tip, (1, 2, 3))
    seen = camera.project((np.array(corners) - tip) @ turn)
    assert np.allclose(seen, [(-0.5, -0.5), (639.5, -0.5), (639.5, 479.5), (-0.5, 479.5)])


def test_images_are_named_from_where_the_file_lies(tmp_path):
    own = KeyframeFiles(('frame_000007.png',), None, None)
    assert own.relative_to(tmp_path) == ['images/frame_000007.png']
    there = KeyframeFiles(('a b.jpg',), tmp_path / 'shots', None)
    assert there.relative_to(tmp_path / 'out') == ['../shots/a b.jpg']


def test_halves_of_images_are_files_of_their_own(tmp_path):
    # the whole images were named, for cameras of half their size
    rng = np.random.default_rng(0)
    whole = [rng.integers(0, 256, (48, 128), np.uint8) for _ in range(2)]
    (tmp_path / 'pairs').mkdir()
    for k, image in enumerate(whole):
        cv2.imwrite(str(tmp_path / 'pairs' / f'{k}.png'), image)
    tracks = Tracks([0, 1], [0, 0], [[5, 5], [6, 5]], (64, 48))
    with open_source(tmp_path / 'pairs', excerpt=Excerpt(half='right')) as source:
        found = read_keyframes(source, np.arange(2), tracks, np.arange(1), [tmp_path / 'images'])
    for k, name in enumerate(found.names):
        written = cv2.imread(str(tmp_path / 'images' / name), cv2.IMREAD_GRAYSCALE)
        np.testing.assert_array_equal(written, whole[k][:, 64:])
