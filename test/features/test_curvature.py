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
from selfcal_ros.features.curvature import (along_tracks, composed, EpipolarGeometry,
                                            feigned_shift, plane_curvature)
from selfcal_ros.features.klt import Appearances
from selfcal_ros.features.registration import DoubledImage, PatchRegistration
from selfcal_ros.features.selection import Verified
from selfcal_ros.features.video_curvature import KeptFrame, without_feigned_shifts
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.division import DivisionModel
from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.values.tracks import Tracks
from test_support.feature_scenes import pixel_grid, waves

SIZE = (640, 480)
STRAIGHT, BARREL = DivisionModel((0.0,), SIZE), DivisionModel((-0.3, -0.05), SIZE)
#: Beyond 90 degrees from the axis lifted points have a negative last coordinate.
FISHEYE = DivisionModel((-1.03, -0.91), SIZE)


def pixels_ahead(lens, H, xy):
    """Map pixels (..., 2) by a homography of lifted points."""
    return lens.pixels(lens.lifted(xy) @ H.T)


def derivatives(function, xy, step=0.5):
    """Return first (2, 2) and second derivatives (2, 3) of pixels at a pixel, by differences."""
    u, v = step * np.eye(2)
    at = function(np.array([xy, xy + u, xy - u, xy + v, xy - v, xy + u + v, xy - u - v,
                            xy + u - v, xy - u + v]))
    first = np.stack([at[1] - at[2], at[3] - at[4]], axis=1) / (2 * step)
    second = np.stack([at[1] + at[2] - 2 * at[0], (at[5] + at[6] - at[7] - at[8]) / 4,
                       at[3] + at[4] - 2 * at[0]], axis=1) / step**2
    return at[0], first, second


def views(lens, seed, count=12, turn=0.25):
    """Planes before two views: F of lifted points, homographies, and a pixel of each."""
    rng = np.random.default_rng(seed)
    K = np.diag([1.3, 1.3, 1.0])
    R, t = rotation_matrix(turn * rng.normal(size=3)), 0.6 * rng.normal(size=3)
    F = np.linalg.inv(K).T @ cross_matrix(t) @ R @ np.linalg.inv(K)
    normals = np.column_stack([0.4 * rng.normal(size=(count, 2)), rng.uniform(0.15, 0.4, count)])
    H = [K @ (R + np.outer(t, normal)) @ np.linalg.inv(K) for normal in normals]
    return F, H, rng.uniform([150, 100], [490, 380], (count, 2))


@pytest.mark.parametrize('lens', [STRAIGHT, BARREL, FISHEYE], ids=['straight', 'barrel', 'fish'])
@pytest.mark.parametrize('seed', [1, 2, 3])
def test_the_plane_and_its_bend_follow_from_the_affine_warp(lens, seed):
    F, H, xy = views(lens, seed)
    xy_b, affine, second = (np.array(part) for part in zip(*(
        derivatives(lambda near, one=one: pixels_ahead(lens, one, near), at)
        for one, at in zip(H, xy))))
    ahead = np.isfinite(xy_b).all(axis=1)

    found = plane_curvature(np.repeat(F[None], len(xy), axis=0), lens, xy, xy_b, affine)

    # what is near the epipole counts less; else it is the bend itself
    epipole = lens.pixels(np.linalg.svd(F)[0][:, 2] * np.array([[1.0], [-1.0]]))
    away = np.nanmin(np.linalg.norm(xy_b[:, None] - epipole, axis=2), axis=1)
    assert ahead.sum() >= 6
    for k in np.flatnonzero(ahead):
        share = (found[k] * second[k]).sum() / (second[k]**2).sum()
        assert np.abs(found[k] - share * second[k]).max() < 0.02 * np.abs(second[k]).max() + 1e-7
        assert 0 <= share < 1.02
        assert share > 0.9 or away[k] < 150
    assert np.abs(second[ahead]).max() > 1e-4


def test_the_epipole_and_nonsense_ask_for_nothing():
    F, H, xy = views(STRAIGHT, 4)
    xy_b, affine, _ = derivatives(lambda near: pixels_ahead(STRAIGHT, H[0], near), xy[0])
    epipole = np.linalg.svd(F)[0][:, 2]
    epipole = STRAIGHT.pixels(epipole * np.sign(epipole[2]))
    start = np.linalg.solve(H[0], STRAIGHT.lifted(epipole))
    start = STRAIGHT.pixels(start * np.sign(start[2]))
    assert np.isfinite([epipole, start]).all()
    at_epipole = plane_curvature(F[None], STRAIGHT, start[None], epipole[None], affine[None])
    assert np.abs(at_epipole).max() < 1e-3
    assert (plane_curvature(np.zeros((1, 3, 3)), STRAIGHT, xy[:1], xy_b[None], affine[None])
            == 0).all()


def test_bends_of_one_warp_after_another_are_put_together():
    rng = np.random.default_rng(5)
    A, B = np.eye(2) + 0.2 * rng.normal(size=(2, 2, 2))
    P, Q = 0.01 * rng.normal(size=(2, 2, 3))

    def bent(first, second):
        return lambda xy: xy @ first.T + np.stack(
            [xy[:, 0]**2 / 2, xy[:, 0] * xy[:, 1], xy[:, 1]**2 / 2], axis=1) @ second.T

    inner, outer = bent(A, P), bent(B, Q)
    _, _, true = derivatives(lambda xy: outer(inner(xy)), np.zeros(2), 1e-3)
    found = composed(B[None], Q[None], A[None], P[None])[0]
    assert np.abs(found - true).max() < 1e-6


def between(first, second):
    """Pixels from one view to another, through homographies from the first of all."""
    H = second @ np.linalg.inv(first)

    def moved(xy):
        ahead = np.column_stack([xy, np.ones(len(xy))]) @ H.T
        return ahead[:, :2] / ahead[:, 2:]
    return moved


@pytest.mark.long
@pytest.mark.parametrize('seed', [1, 2])
def test_positions_in_images_of_a_plane_are_off_as_predicted(seed):
    """A plane seen aslant: the affine fit is off by hundredths of a pixel, which are taken off."""
    grey, pixels = waves(np.random.default_rng(seed)), pixel_grid(340)
    H = np.array([[1.05, 0.1, -6.0], [-0.08, 0.95, 14.0], [7e-4, -5e-4, 1.0]])
    xy = np.stack(np.meshgrid(*2 * [np.arange(60, 240, 12.0)]), axis=2).reshape(-1, 2)
    moved, back = between(np.eye(3), H), between(H, np.eye(3))
    image, there = (DoubledImage.of(grey(one.reshape(pixels.shape)))
                    for one in (pixels, back(pixels.reshape(-1, 2))))

    true, affine, second = (np.array(part) for part in zip(*(
        derivatives(moved, one, 2.0) for one in xy)))
    registration = PatchRegistration()
    templates = registration.templates(image, xy)
    found, warp, correlation, step = registration.register(templates, there, true, affine,
                                                           iterations=20, tolerance_px=1e-4)
    # OpenCV 4 interpolates at multiples of 1/32 px, so that steps of a thousandth go to and fro
    good = (correlation > 0.95) & (step < (3e-3 if cv2.__version__ < '5' else 1e-3))
    off = (found - true)[good]
    predicted = feigned_shift(templates.response, warp, second)[good]

    assert good.mean() > 0.8
    gain = (predicted * off).sum() / (predicted**2).sum()
    assert gain == pytest.approx(1.0, abs=0.15)
    before, after = (np.sqrt(np.mean(one**2)) for one in (off, off - predicted))
    assert before > 0.005
    assert after < 0.5 * before


def test_where_no_geometry_is_known_nothing_is_taken_off():
    geometry = EpipolarGeometry.of([(0, 1, np.full((3, 3), np.nan), STRAIGHT)], 3)
    second = along_tracks(geometry, np.array([0, 1, 2]), np.zeros(3, int),
                          np.array([False, True, False]), np.ones((3, 2)),
                          np.tile(1.1 * np.eye(2), (3, 1, 1)))
    assert (second == 0).all()


def video():
    """A wall that a camera passes: four keyframes of 60 points, and the shifts in each."""
    rng = np.random.default_rng(6)
    camera = Camera([[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]], (), *SIZE)
    X = np.column_stack([rng.uniform(-1, 1, (60, 2)), np.full(60, 4.0)])
    X[:, 2] += 0.8 * X[:, 0] + 0.3 * X[:, 1]
    response = rng.normal(0, 4.0, (60, 2, 6))
    poses = [(rotation_matrix(np.array([0.04, 0.2, 0.06]) * k), np.array([0.4, 0.15, -0.3]) * k)
             for k in range(4)]
    normal = np.linalg.lstsq(X, np.ones(60), rcond=None)[0]
    K, inverse = camera.K, np.linalg.inv(camera.K)
    H = [K @ (R + np.outer(t, normal)) @ inverse for R, t in poses]
    true = np.array([camera.project(X @ R.T + t) for R, t in poses])
    return camera, H, true, response, poses


def test_a_template_taken_anew_shows_a_point_beside_the_first():
    camera, H, true, response, poses = video()
    ids, seen = np.arange(60), []
    kept, begin, beside = [], 0, np.zeros((60, 2))
    for k in range(4):
        moved = between(H[begin], H[k])
        at = true[begin]
        _, A, second = (np.array(part) for part in zip(*(
            derivatives(moved, one, 1.0) for one in at)))
        shift = feigned_shift(response, A, second) + np.einsum('nij,nj->ni', A, beside)
        seen.append(true[k] + shift)
        kept.append(KeptFrame(k, ids, seen[k], Appearances(seen[begin], A, response)))
        if k == 2:
            # the next template is taken where the point seems to be
            begin, beside = 2, shift
    K = np.linalg.inv(camera.K)
    fitted = []
    for a in range(4):
        for b in range(a + 1, 4):
            R = poses[b][0] @ poses[a][0].T
            t = poses[b][1] - R @ poses[a][1]
            fitted.append((a, b, K.T @ cross_matrix(t) @ R @ K))
    tracks = Tracks(np.repeat(np.arange(4), 60), np.tile(ids, 4), np.concatenate(seen), SIZE)
    found = without_feigned_shifts(Verified(tracks, 0, STRAIGHT, np.arange(4), fitted), kept)

    truth = true.transpose(1, 0, 2).reshape(-1, 2)
    before, after = (np.sqrt(np.mean((one - truth)**2)) for one in (tracks.xy, found.xy))
    assert before > 0.01
    assert after < 0.1 * before
