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
from pathlib import Path

import cv2
import numpy as np
import pytest
from selfcal_ros.calibration.known_object.point_calibration import calibrate_known_object
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.features.targets import Chessboard, parse_target, PointList, read_points
from selfcal_ros.features.tsai_grid import TsaiGrid
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.pipeline.object_session import read_object_views
from selfcal_ros.synthetic.calibration_grid import grid_scene, view_of_grid
from selfcal_ros.synthetic.render import Renderer
from selfcal_ros.values.tracks import Tracks

GRID = TsaiGrid(4, 4, 0.04, 0.03, 0.03)
K = [[649, 0, 256], [0, 973, 256], [0, 0, 1]]
HAS_CHARUCO = any(hasattr(getattr(cv2, 'aruco', None), name)
                  for name in ('CharucoDetector', 'interpolateCornersCharuco'))


def warped(picture, size=(640, 480), seed=0):
    """Show a flat picture in perspective; returns the image and the homography."""
    h, w = picture.shape
    source = np.float32([[0, 0], [w, 0], [w, h], [0, h]])
    target = np.float32([[110, 60], [540, 110], [500, 420], [90, 390]])
    H = cv2.getPerspectiveTransform(source, target)
    # four samples a pixel each way: the edges are then where they should be
    fine = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]) @ H
    image = cv2.warpPerspective(picture, fine, (4 * size[0], 4 * size[1]), borderValue=255)
    image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(seed).normal(0, 2, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8), H


def mapped(H, points):
    x = np.column_stack([points, np.ones(len(points))]) @ H.T
    return x[:, :2] / x[:, 2:]


def chess_picture(columns, rows, side=60):
    y, x = np.mgrid[:(rows + 3) * side, :(columns + 3) * side] // side
    inside = (x > 0) & (x < columns + 2) & (y > 0) & (y < rows + 2)
    return np.where(inside & ((x + y) % 2 == 0), 20, 230).astype(np.uint8)


def test_chessboard_corners_are_where_they_were_drawn():
    board = parse_target('chessboard:7x5:0.03')
    image, H = warped(chess_picture(7, 5))
    identity, xy = board.find(image)
    assert (identity == np.arange(35)).all()
    # between pixels 119 and 120 of the picture
    drawn = mapped(H, board.known.points[:, :2] / 0.03 * 60 + 2 * 60 - 0.5)
    if np.abs(xy - drawn).max() > 10:
        drawn = drawn[::-1]
    assert np.sqrt(np.mean((xy - drawn)**2)) < 0.1
    assert len(board.find(np.full((480, 640), 128, np.uint8))[0]) == 0


@pytest.mark.long
@pytest.mark.skipif(not HAS_CHARUCO, reason='this OpenCV has no ChArUco boards')
@pytest.mark.parametrize('dictionary', ['', 'DICT_5X5_100'])
def test_charuco_corners_are_where_they_were_drawn(dictionary):
    aruco = cv2.aruco
    markers = aruco.getPredefinedDictionary(aruco.DICT_5X5_100)
    if hasattr(aruco, 'CharucoDetector'):
        picture = aruco.CharucoBoard((8, 6), 0.04, 0.03, markers).generateImage((800, 600))
    else:
        picture = aruco.CharucoBoard_create(8, 6, 0.04, 0.03, markers).draw((800, 600))
    image, H = warped(picture)
    image[350:, :250] = 255                        # a part of the board suffices
    text = 'charuco:7x5:0.04:0.03' + (dictionary and f':{dictionary}')
    board = parse_target(text)
    identity, xy = board.find(image)
    assert 15 < len(identity) < 35
    drawn = mapped(H, (board.known.points[identity, :2] / 0.04 + 1) * 100 - 0.5)
    assert np.median(np.linalg.norm(xy - drawn, axis=1)) < 0.1
    again, _ = board.find(image)
    assert (again == identity).all()


@pytest.mark.long
@pytest.mark.skipif(not hasattr(getattr(cv2, 'aruco', None), 'CharucoDetector'),
                    reason='this OpenCV draws boards in one way')
def test_parts_of_an_old_charuco_board_have_the_numbers_of_the_whole(tmp_path):
    # a part without the last column suits both layouts, and was numbered by which image came first
    aruco = cv2.aruco
    drawn = aruco.CharucoBoard((7, 4), 0.04, 0.03, aruco.getPredefinedDictionary(
        aruco.DICT_5X5_100))
    drawn.setLegacyPattern(True)
    whole = cv2.copyMakeBorder(drawn.generateImage((700, 400)), 60, 60, 60, 60,
                               cv2.BORDER_CONSTANT, value=255)
    for k, (first, last) in enumerate([(0, 360), (200, 560), (0, 820), (0, 600)]):
        image = np.full_like(whole, 255)
        image[:, first:last] = whole[:, first:last]
        cv2.imwrite(str(tmp_path / f'{k}.png'), image)
    tracks = read_object_views(tmp_path, parse_target('charuco:6x3:0.04:0.03')).tracks

    assert np.bincount(tracks.frame).min() > 4 and np.bincount(tracks.frame)[2] == 18
    row, column = np.divmod(tracks.track, 6)
    at = 60 + 100 * np.column_stack([column + 1, row + 1]) - 0.5
    assert np.linalg.norm(tracks.xy - at, axis=1).max() < 1


@pytest.mark.skipif(HAS_CHARUCO, reason='this OpenCV has ChArUco boards')
def test_without_aruco_it_says_what_to_install():
    with pytest.raises(InputError, match='4.7 or later'):
        parse_target('charuco:7x5:0.04:0.03')


@pytest.fixture(scope='module')
def scene():
    return grid_scene(4, 4, 0.04, 0.03, 0.03)


@pytest.mark.long
@pytest.mark.parametrize('inside', [True, False])
@pytest.mark.parametrize('distortion', [[0, 0, 0, 0], [-0.2, 0.05, 0, 0]])
def test_one_image_of_a_tsai_grid_gives_the_camera(scene, inside, distortion):
    camera = Camera(K, distortion, 512, 512)
    pose = view_of_grid(GRID.known.points, 1.0, [0.35, 0.1, 0.05], inside=inside)
    image = Renderer(scene, camera, 3, 120).render(pose, np.random.default_rng(0), 2.0)
    identity, xy = GRID.find(image)
    assert len(identity) == 128
    true = camera.project(GRID.known.points @ pose[:, :3].T + pose[:, 3])
    # half a turn about its middle carries the grid into itself
    turned = true.reshape(2, 8, 8, 2)[::-1, ::-1].reshape(-1, 2)
    error = min(np.sqrt(np.mean((xy - one)**2)) for one in (true, turned))
    assert error < 0.03
    result = calibrate_known_object(Tracks(np.zeros(128), identity, xy, (512, 512)), GRID.known,
                                    facts=CameraFacts(skew=0.0, distortion='radial1'))
    assert result.camera.K[0, 0] == pytest.approx(649, rel=0.002)
    assert result.camera.K[1, 1] == pytest.approx(973, rel=0.002)
    assert np.hypot(*(result.camera.K[:2, 2] - 256)) < 1.5


def test_a_grid_that_is_cut_off_is_not_found(scene):
    camera = Camera(K, np.zeros(4), 512, 512)
    pose = view_of_grid(GRID.known.points, 1.0, shift_m=(0.25, 0))
    image = Renderer(scene, camera, 2, 120).render(pose)
    assert len(GRID.find(image)[0]) == 0
    assert len(GRID.find(np.zeros((64, 64), np.uint8))[0]) == 0
    assert len(GRID.find(np.random.default_rng(0).integers(0, 255, (480, 640), np.uint8))[0]) == 0


def test_grid_of_other_numbers_and_a_regular_pitch_across_the_fold():
    grid = TsaiGrid(2, 3, 0.04, 0.04, 0.02)
    scene = grid_scene(2, 3, 0.04, 0.04, 0.02)
    camera = Camera([[900, 0, 320], [0, 900, 240], [0, 0, 1]], np.zeros(4), 640, 480)
    for inside in (True, False):
        pose = view_of_grid(grid.known.points, 0.8, [0.3, 0, 0.1], inside=inside)
        identity, xy = grid.find(Renderer(scene, camera, 3, 120).render(pose))
        assert len(identity) == 48
        true = camera.project(grid.known.points @ pose[:, :3].T + pose[:, 3])
        turned = true.reshape(2, 6, 4, 2)[::-1, ::-1].reshape(-1, 2)
        assert min(np.abs(xy - one).max() for one in (true, turned)) < 0.15


@pytest.mark.parametrize('text, words', [
    ('sphere:3', 'unknown'), ('chessboard', 'unknown'), ('chessboard:9:0.1', 'form chessboard'),
    ('chessboard:9x6', 'form chessboard'), ('chessboard:9x6:a', 'form chessboard'),
    ('chessboard:2x6:0.1', 'at least 3 x 3'), ('chessboard:9x6:-1', 'positive'),
    ('chessboard:9x6:nan', 'positive'), ('chessboard:99999x6:0.1', 'no size'),
    ('tsai:4x4:0.04', 'form tsai'), ('tsai:4x4:0.04:0:0.03', 'positive'),
    ('charuco:7x5:0.03', 'form charuco'),
])
def test_a_wrong_object_is_refused_in_one_sentence(text, words):
    with pytest.raises(ArgumentError, match=words):
        parse_target(text)


@pytest.mark.skipif(not HAS_CHARUCO, reason='this OpenCV has no ChArUco boards')
@pytest.mark.parametrize('text, words', [
    ('charuco:7x5:0.03:0.04', 'smaller'), ('charuco:7x5:0.04:0.03:DICT_9X9', 'unknown'),
    ('charuco:1x5:0.04:0.03', 'at least 2 x 2'),
    ('charuco:30x30:0.04:0.03:DICT_4X4_50', 'more markers'),
])
def test_a_wrong_charuco_board_is_refused(text, words):
    with pytest.raises(ArgumentError, match=words):
        parse_target(text)


def test_points_are_read(tmp_path):
    path = tmp_path / 'points.csv'
    path.write_text('point,X,Y,Z\n7,0,0,1.5\n3,1,2,3\n', encoding='utf-8')
    target = parse_target(str(path))
    assert isinstance(target, PointList)
    assert target.known.identity.tolist() == [3, 7]
    assert target.known.points.tolist() == [[1, 2, 3], [0, 0, 1.5]]


@pytest.mark.parametrize('content, words', [
    ('', 'must start'), ('point,X,Y,Z\n', 'no points'), ('a,b\n1,2\n', 'must start'),
    ('point,X,Y,Z\n1,2,3\n', 'line 2'), ('point,X,Y,Z\n1,2,3,inf\n', 'line 2'),
    ('point,X,Y,Z\n1,0,0,0\n1,0,0,1\n', 'twice'),
    ('point,X,Y,Z\n99999999999999999999999,0,0,0\n', 'line 2'),
])
def test_wrong_points_are_refused(tmp_path, content, words):
    path = tmp_path / 'points.csv'
    path.write_text(content, encoding='utf-8')
    with pytest.raises(InputError, match=words):
        read_points(path)


def test_missing_points_are_an_input_error(tmp_path):
    with pytest.raises(InputError, match='cannot be read'):
        parse_target(str(tmp_path / 'nowhere.csv'))


def test_recorded_chessboards_give_the_camera():
    folder = next((p / 'shared/data/opencv_left' for p in Path(__file__).resolve().parents
                   if (p / 'shared/data/opencv_left').is_dir()), None)
    if folder is None:
        pytest.skip('../shared/data/opencv_left is not there')
    board, seen = Chessboard(9, 6, 0.025), []
    for path in sorted((folder / 'images').glob('*.jpg')):
        seen.append(board.find(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))[1])
    assert all(len(xy) == 54 for xy in seen)
    tracks = Tracks(np.repeat(np.arange(len(seen)), 54), np.tile(np.arange(54), len(seen)),
                    np.concatenate(seen), (640, 480))
    # what was published supposes a flat board
    found = {lens: calibrate_known_object(tracks, board.known, flatness=0, facts=CameraFacts(
        skew=0.0, distortion=lens)).camera for lens in ('radtan', 'auto')}
    for camera in found.values():
        assert camera.K[0, 0] == pytest.approx(532.46, rel=0.002)
        assert camera.K[1, 1] == pytest.approx(532.41, rel=0.002)
        assert np.hypot(*(camera.K[:2, 2] - [341.97, 232.66])) < 3
    # the truth has a third radial coefficient: k1 depends on it
    assert found['radtan'].distortion[0] == pytest.approx(-0.3, abs=0.015)
    # together the three bend what the boards reach as the true ones do
    true = 1 - 0.3088 * 0.4 + 0.1624 * 0.4**2 - 0.0362 * 0.4**3
    k1, k2, _, _, k3 = found['auto'].distortion
    assert 1 + k1 * 0.4 + k2 * 0.4**2 + k3 * 0.4**3 == pytest.approx(true, abs=0.004)


@pytest.mark.skipif(not hasattr(getattr(cv2, 'aruco', None), 'CharucoDetector'),
                    reason='this OpenCV draws its boards otherwise')
def test_charuco_corners_of_noisy_images_are_smoothed():
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
    picture = cv2.aruco.CharucoBoard((8, 6), 0.03, 0.022, markers).generateImage((640, 480))
    H = np.array([[0.6, 0.05, 60.0], [-0.04, 0.55, 90.0], [1e-4, -1e-4, 1.0]])
    drawn = 20 + cv2.warpPerspective(picture, H, (640, 480), borderValue=255) * 0.8
    noisy = np.clip(drawn + np.random.default_rng(0).normal(0, 10, drawn.shape), 0, 255)
    identity, xy = parse_target('charuco:7x5:0.03:0.022').find(noisy.astype(np.uint8))
    assert len(identity) > 25
    x, y = 80.0 * (1 + np.array([identity % 7, identity // 7])) - 0.5
    true = np.column_stack([x, y, np.ones(len(x))]) @ H.T
    error = xy - true[:, :2] / true[:, 2:]
    # 0.11 to 0.12 without
    assert np.sqrt(np.mean(error**2)) < 0.1
