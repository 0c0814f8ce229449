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
"""The renderer against projection by `Camera`: where things are, how bright, what hides what."""

import cv2
import numpy as np
import pytest

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.synthetic import recordings, worlds
from selfcal_ros.synthetic.render import quantise, Renderer, Scene, Surface
from selfcal_ros.synthetic.wide_recordings import hand_walk, wide_camera

IDENTITY = np.eye(3, 4)
DISTORTION = [-0.12, 0.05, 0.001, -0.002]


def _camera(distortion=()):
    return Camera([[520, 0, 158.0], [0, 515, 117.0], [0, 0, 1]], distortion, 320, 240)


def _slanted(texture, body=0):
    """Return a rectangle that fills the view, turned about two axes, facing the camera."""
    edge_u, edge_v = np.array([2.4, 0.2, 0.9]), np.array([0.15, 1.9, -0.5])
    origin = np.array([0.05, 0.02, 2.5]) - (edge_u + edge_v) / 2
    # the visible side is the one to which U x V points: let u run from right to left
    return Surface(origin + edge_u, -edge_u, edge_v, texture, body)


def _fisheye(circle_deg=185.0):
    return wide_camera(circle_deg, (160, 120), filled='height', off_centre_px=(2, -1))


def _room(grey):
    """Return the six walls of a room around the camera, brighter one after the other."""
    wall = np.ones((64, 64))
    return [Surface(s.origin, s.edge_u, s.edge_v, (k + 1) * grey * wall) for k, s in
            enumerate(worlds.room(np.random.default_rng(0), [-2, -2, -2], [2, 2, 2],
                                  worlds.Style(texel_m=0.1), worlds.Style(texel_m=0.1)))]


def _pixel_rays(camera):
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    rays = np.ones(pixels.shape[:2] + (3,))
    rays[..., :2] = camera.normalised(pixels.astype(float))
    return rays


@pytest.mark.parametrize('distortion', [(), DISTORTION], ids=['pinhole', 'distorted'])
@pytest.mark.parametrize('axis', [0, 1])
def test_grey_ramp_shows_texture_coordinate_of_every_pixel(distortion, axis):
    # a texture whose grey level is its own coordinate makes each pixel tell where its ray went
    camera = _camera(distortion)
    ramp = np.broadcast_to(np.arange(256.0), (256, 256))
    surface = _slanted(ramp if axis == 0 else ramp.T)
    image = Renderer(Scene([surface]), camera).intensity(IDENTITY)
    frame = np.column_stack([surface.edge_u, surface.edge_v, surface.origin])
    u = np.linalg.solve(frame, _pixel_rays(camera).reshape(-1, 3).T)
    expected = (u[axis] / u[2]).reshape(image.shape) * 256 - 0.5
    inside = (expected > 1) & (expected < 254)
    assert inside.mean() > 0.9
    slope = np.hypot(*np.gradient(expected))[inside]
    error_px = (image - expected)[inside] / slope
    assert np.abs(error_px).max() < 0.01
    assert abs(error_px.mean()) < 0.001


@pytest.mark.parametrize('distortion', [(), DISTORTION], ids=['pinhole', 'distorted'])
def test_chessboard_corners_lie_where_camera_projects_them(distortion):
    camera = _camera(distortion)
    square = 32
    board = np.indices((256, 384)) // square
    surface = _slanted(40.0 + 170.0 * (board.sum(axis=0) % 2))
    image = Renderer(Scene([surface]), camera, supersampling=5).render(IDENTITY)
    u, v = np.meshgrid(np.arange(1, 12) / 12, np.arange(1, 8) / 8)
    points = (surface.origin + u[..., None] * surface.edge_u
              + v[..., None] * surface.edge_v).reshape(-1, 3)
    expected = camera.project(points)
    margin = (expected > 12).all(axis=1) & (expected < [307, 227]).all(axis=1)
    expected = expected[margin]
    assert len(expected) >= 30
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    corners = np.ascontiguousarray(expected[:, None], dtype=np.float32)
    found = cv2.cornerSubPix(image, corners, (4, 4), (-1, -1), criteria).reshape(-1, 2)
    error = found - expected
    assert np.abs(error.mean(axis=0)).max() < 0.02
    assert np.sqrt((error ** 2).mean()) < 0.04


def test_edge_covers_its_share_of_a_pixel():
    # a white half plane whose edge crosses column 10 at a quarter of the pixel
    camera = Camera([[100, 0, 10.0], [0, 100, 10.0], [0, 0, 1]], (), 32, 32)
    white = np.full((64, 64), 200.0)
    edge_x = (10.25 - 10.0) / 100
    surface = Surface([edge_x + 1, -1, 1], [-1, 0, 0], [0, 2, 0], white)
    image = Renderer(Scene([surface]), camera, supersampling=8).intensity(IDENTITY)
    np.testing.assert_allclose(image[5, [9, 10, 11]], [0, 50, 200])


def test_depth_is_exact_and_nearest_surface_wins():
    camera = _camera(DISTORTION)
    grey = np.full((64, 64), 100.0)
    wall = Surface([5, -5, 4], [-10, 0, 0], [0, 10, 0], grey)
    card = Surface([0.2, -0.2, 1.5], [-0.4, 0, 0], [0, 0.4, 0], grey + 100)
    renderer = Renderer(Scene([wall, card]), camera)
    depth, image = renderer.depth(IDENTITY), renderer.intensity(IDENTITY)
    rays = _pixel_rays(camera)[..., :2] * 1.5
    on_card = np.abs(rays).max(axis=-1) < 0.2
    np.testing.assert_allclose(depth, np.where(on_card, 1.5, 4.0), rtol=1e-12)
    within = cv2.erode(on_card.astype(np.uint8), np.ones((3, 3))) > 0
    np.testing.assert_allclose(image[within], 200)
    outside = cv2.dilate(on_card.astype(np.uint8), np.ones((3, 3))) == 0
    np.testing.assert_allclose(image[outside], 100)


def test_back_side_is_not_seen_and_empty_space_is_background():
    away = Surface([-1, -1, 2], [2, 0, 0], [0, 2, 0], np.full((64, 64), 100.0))
    renderer = Renderer(Scene([away]), _camera(), background=17)
    assert (renderer.intensity(IDENTITY) == 17).all()
    assert np.isnan(renderer.depth(IDENTITY)).all()


def test_tiles_hide_nothing_that_can_be_seen():
    # the depth map culls surfaces tile by tile; here every ray meets every surface
    recording = recordings.agv_drive(3, size=(160, 120))
    camera, pose = recording.camera, recording.cam_from_world[1]
    depth = recording.renderer().depth(pose)
    frames = np.array([np.column_stack([s.edge_u, s.edge_v, s.origin])
                       for s in recording.surfaces])
    frames = pose[:, :3] @ frames
    frames[:, :, 2] += pose[:, 3]
    frames = frames[np.linalg.det(frames) < 0]
    a, b, w = np.moveaxis(np.linalg.inv(frames) @ _pixel_rays(camera).reshape(-1, 3).T, 1, 0)
    w = np.where((a >= 0) & (b >= 0) & (a <= w) & (b <= w), w, 0).max(axis=0)
    np.testing.assert_allclose(depth.ravel(), 1 / w, rtol=1e-9)


def test_far_texture_fades_to_its_mean_instead_of_aliasing():
    checker = 255.0 * (np.indices((512, 512)).sum(axis=0) % 2)
    far = Surface([10, -10, 40], [-20, 0, 0], [0, 20, 0], checker)
    camera = Camera([[100, 0, 31.5], [0, 100, 31.5], [0, 0, 1]], (), 40, 40)
    image = Renderer(Scene([far]), camera).intensity(IDENTITY)
    np.testing.assert_allclose(image[12:38, 12:38], 127.5, atol=2.0)


def test_bodies_move_apart():
    grey = np.full((64, 64), 100.0)
    card = Surface([0.2, -0.2, 1.5], [-0.4, 0, 0], [0, 0.4, 0], grey + 100, 0)
    wall = Surface([5, -5, 4], [-10, 0, 0], [0, 10, 0], grey, 1)
    renderer = Renderer(Scene([card, wall]), _camera())
    moved = IDENTITY.copy()
    moved[0, 3] = 0.1
    depth = renderer.depth(np.stack([moved, IDENTITY]))
    centre = _camera().project(np.array([0.1, 0, 1.5]))
    rows, columns = np.nonzero(depth == depth.min())
    np.testing.assert_allclose([columns.mean(), rows.mean()], centre, atol=0.6)
    assert depth.max() == pytest.approx(4.0)


def test_noise_has_its_sigma_and_needs_an_rng():
    flat = np.full((200, 200), 100.0)
    noisy = quantise(flat, np.random.default_rng(1), 2.0).astype(float)
    # rounding adds a variance of 1/12
    assert noisy.std() == pytest.approx(np.sqrt(4 + 1 / 12), rel=0.02)
    with pytest.raises(ArgumentError):
        quantise(flat, None, 2.0)


def test_impossible_scenes_are_refused():
    with pytest.raises(ArgumentError):
        Scene([])
    with pytest.raises(ArgumentError):
        Scene([_slanted(np.zeros((100, 64)))])
    scene = Scene([_slanted(np.zeros((64, 64)))])
    with pytest.raises(ArgumentError):
        Renderer(scene, Camera(np.eye(3)))
    with pytest.raises(ArgumentError):
        Renderer(scene, _camera(), supersampling=2).depth(IDENTITY)


def test_a_fisheye_sees_beside_and_behind_itself_and_is_black_beyond_its_circle():
    camera = _fisheye()
    pixels = np.stack(np.meshgrid(np.arange(160.0), np.arange(120.0)), axis=-1)
    rays = camera.rays(pixels)
    angle = np.arccos(rays[..., 2])
    walls = Scene(_room(30.0))
    renderer = Renderer(walls, camera, circle_rad=np.deg2rad(185))
    image, depth = renderer.intensity(IDENTITY), renderer.depth(IDENTITY)
    outside = ~(angle <= np.deg2rad(92.5))
    black = cv2.erode(outside.astype(np.uint8), np.ones((3, 3))) > 0
    assert 0.3 < black.mean() < 0.5 and (image[black] == 0).all()
    assert np.isnan(depth[black]).all()
    # the wall that a ray hits first is the one along its largest component
    inside = angle < np.deg2rad(92)
    expected = 2 * rays[..., 2] / np.abs(rays).max(axis=-1)
    np.testing.assert_allclose(depth[inside], expected[inside], rtol=1e-9)
    assert (depth[inside] < 0).any()


@pytest.mark.parametrize('axis', [0, 1])
def test_grey_ramp_far_from_the_axis_of_a_fisheye(axis):
    # centred 80 degrees from the axis: most of it is seen, a part of it behind the camera
    camera = _fisheye()
    turn = cv2.Rodrigues(np.array([0.0, np.deg2rad(80), 0.0]))[0]
    ramp = np.broadcast_to(np.arange(256.0), (256, 256))
    flat = _slanted(ramp if axis == 0 else ramp.T)
    surface = Surface(*(turn @ v for v in (flat.origin, flat.edge_u, flat.edge_v)), flat.texture)
    image = Renderer(Scene([surface]), camera, background=-100).intensity(IDENTITY)
    frame = np.column_stack([surface.edge_u, surface.edge_v, surface.origin])
    pixels = np.stack(np.meshgrid(np.arange(160.0), np.arange(120.0)), axis=-1)
    rays = camera.rays(pixels)
    a, b, w = np.moveaxis(rays @ np.linalg.inv(frame).T, -1, 0)
    seen = (a > 0.02) & (b > 0.02) & (a < w - 0.02) & (b < w - 0.02) & (rays[..., 2] < 0.2)
    assert seen.sum() > 300 and (rays[..., 2][seen] < -0.02).sum() > 20
    expected = (a, b)[axis][seen] / w[seen] * 256 - 0.5
    # two hundredths of a pixel, of which each is several grey levels wide
    assert np.abs(image[seen] - expected).max() < 0.35


@pytest.mark.long
def test_wide_recordings_fill_their_circle_and_tell_their_lens():
    camera = _fisheye(170.0)
    walk = hand_walk(3, 170.0, camera, noise_sigma=0)
    reach = np.arccos(camera.rays(np.stack(np.meshgrid(np.arange(160.0), np.arange(120.0)),
                                           axis=-1))[..., 2])
    image = walk.frame(1)
    assert (image[reach < np.deg2rad(84)] > 0).all()
    assert (image[~(reach < np.deg2rad(87))] == 0).all()
    assert walk.truth()['distortion_model'] == 'equidistant'
    # by hand it turns about every axis
    turns = [cv2.Rodrigues(R @ walk.cam_from_world[0, :, :3].T)[0].ravel()
             for R in walk.cam_from_world[1:, :, :3]]
    assert np.abs(turns).max(axis=0).min() > 0.1


def test_a_circle_that_the_lens_does_not_reach_is_refused():
    with pytest.raises(ArgumentError, match='at most'):
        wide_camera(170, coefficients=[-0.3], model='plumb_bob')
