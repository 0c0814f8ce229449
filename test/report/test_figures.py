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
"""What the figures show is true: fixed points, residuals, cells and projection uncertainty."""

from dataclasses import replace
import xml.etree.ElementTree as ElementTree

import cv2
import numpy as np
import pytest
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.report.figures import draw_figures
from selfcal_ros.report.observations import observations
from selfcal_ros.report.pair_geometry import pair_geometry, single_pairs
from selfcal_ros.report.projection_uncertainty import projection_uncertainty
from selfcal_ros.report.residual_figures import cells, coverage_figure
from selfcal_ros.report.style import counted_along_x, new_panel
from selfcal_ros.values.tracks import Tracks

#: Of a covariance of all parameters.
COVARIANCE_SHAPE = (len(PARAMETER_NAMES),) * 2


def test_epipoles_lie_on_the_horizon_and_screw_axes_pass_through_v(calibration, sequence):
    pairs = pair_geometry(calibration.reconstruction, calibration.camera.K)
    assert pairs.pairs.shape == (15, 2) and np.isfinite(pairs.screw_axes).all()
    line = sequence.horizon / np.linalg.norm(sequence.horizon[:2])
    epipoles = pairs.epipoles[..., :2] / pairs.epipoles[..., 2:]
    distance = (epipoles @ line[:2] + line[2]) / np.maximum(np.abs(epipoles).max(-1), 1e3)
    assert np.abs(distance).max() < 1e-9
    lines = pairs.screw_axes / np.linalg.norm(pairs.screw_axes[:, :2], axis=1, keepdims=True)
    v = sequence.vanishing_point[:2] / sequence.vanishing_point[2]
    assert np.abs(lines[:, :2] @ v + lines[:, 2]).max() < 1e-6


def test_the_screw_axis_is_at_one_place_in_both_images(calibration):
    # F + F' splits into the horizon and the image of the screw axis (thesis 5.12)
    K, poses = calibration.camera.K, calibration.reconstruction.cam_from_world
    pairs = pair_geometry(calibration.reconstruction, K)
    horizon = calibration.fixed_points.horizon
    inverse = np.linalg.inv(K)
    for (a, b), m in zip(pairs.pairs, pairs.screw_axes):
        R = poses[b, :, :3] @ poses[a, :, :3].T
        t = poses[b, :, 3] - R @ poses[a, :, 3]
        cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
        F = inverse.T @ cross @ R @ inverse
        symmetric, product = F + F.T, np.outer(horizon, m) + np.outer(m, horizon)
        scale = np.sum(symmetric * product) / np.sum(product**2)
        assert np.linalg.norm(symmetric - scale * product) < 1e-6 * np.linalg.norm(symmetric)


def test_a_pair_without_rotation_has_no_screw_axis(calibration):
    shape = calibration.reconstruction
    poses = shape.cam_from_world.copy()
    poses[1, :, :3] = poses[0, :, :3]
    pairs = pair_geometry(replace(shape, cam_from_world=poses), calibration.camera.K)
    assert np.isnan(pairs.screw_axes[0]).all() and np.isfinite(pairs.epipoles[0]).all()


def test_single_pairs_find_the_fixed_points_by_themselves(calibration, sequence):
    exact = replace(sequence.tracks, xy=sequence.true_pixels[sequence.tracks.frame,
                                                             sequence.tracks.track])
    pairs = single_pairs(calibration, observations(calibration, exact))
    assert len(pairs.pairs) == 13      # steps 1, 2, 3 and 5 of six views
    truth = pair_geometry(calibration.reconstruction, calibration.camera.K)
    order = [np.flatnonzero((truth.pairs == pair).all(axis=1))[0] for pair in pairs.pairs]
    for found, true in ((pairs.epipoles, truth.epipoles), (pairs.screw_axes, truth.screw_axes)):
        assert np.abs(np.cross(found, true[order])).max() < 1e-5
    noisy = single_pairs(calibration, observations(calibration, sequence.tracks))
    line = sequence.horizon / np.linalg.norm(sequence.horizon[:2])
    near = noisy.epipoles[..., :2] / noisy.epipoles[..., 2:]
    near = near[np.abs(near).max(axis=-1) < 2000]
    # a tenth of a pixel of noise moves epipoles by pixels
    assert 0.01 < np.median(np.abs(near @ line[:2] + line[2])) < 20


def test_many_pairs_are_thinned(calibration):
    assert len(pair_geometry(calibration.reconstruction, calibration.camera.K, 5).pairs) == 5


def test_residuals_are_the_noise(calibration, sequence):
    seen = observations(calibration, sequence.tracks)
    truth = sequence.true_pixels[sequence.tracks.frame, sequence.tracks.track]
    assert np.allclose(seen.residual, truth - sequence.tracks.xy, atol=1e-9)
    assert seen.used.mean() > 0.998
    assert np.std(seen.residual) == pytest.approx(calibration.noise_sigma_px, rel=0.05)


def test_signs_of_homogeneous_points_and_strange_observations_do_not_matter(calibration,
                                                                            sequence):
    shape = calibration.reconstruction
    sign = np.where(np.arange(len(shape.points)) % 2, -1.0, 1.0)[:, None]
    order = np.random.default_rng(0).permutation(len(shape.points))
    flipped = replace(calibration, reconstruction=replace(
        shape, points=(shape.points * sign)[order], tracks=shape.tracks[order]))
    tracks = sequence.tracks
    more = Tracks(np.append(tracks.frame, [0, 77]), np.append(tracks.track, [999, 0]),
                  np.vstack([tracks.xy, [[1, 1], [2, 2]]]), tracks.image_size)
    seen = observations(flipped, more)
    assert len(seen.xy) == len(tracks)
    assert np.allclose(seen.residual, observations(calibration, tracks).residual, atol=1e-9)


def test_what_a_lens_field_displaces_is_no_outlier(calibration, sequence):
    # a bend of half a pixel, five times the noise, which the calibration has allowed for
    xy = sequence.tracks.xy + 0.5 * np.sin(sequence.tracks.xy[:, ::-1] / 150)
    tracks = replace(sequence.tracks, xy=xy)
    seen = observations(calibration, tracks)
    assert calibration.observation_count == len(tracks) and seen.used.all()
    drawings = {drawing.name: drawing for drawing in draw_figures(calibration, tracks)}
    assert 'deviates' in drawings['residuals'].caption
    plain = {drawing.name: drawing for drawing in draw_figures(calibration, sequence.tracks)}
    assert 'deviates' not in plain['residuals'].caption


def test_cells_cover_the_image():
    xy = np.array([[-0.5, -0.5], [639.4, 479.4], [19.49, 0], [19.51, 0], [5000, -9]])
    index, shape, side = cells((640, 480), xy, 32)
    assert shape == (24, 32) and side == 20
    assert index.tolist() == [0, 24 * 32 - 1, 0, 1, 31]


def test_projection_uncertainty_of_the_centre_alone():
    # without distortion and without a rotation, a shift of the centre is a shift everywhere
    camera = Camera([[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]], width=640, height=480)
    covariance = np.zeros(COVARIANCE_SHAPE)
    covariance[2, 2] = 4.0
    plain = projection_uncertainty(camera, covariance, rotate=False)
    assert np.allclose(plain.covariance, [[4, 0], [0, 0]], atol=1e-6)
    assert np.allclose(plain.sigma_px, 2)
    # a rotation undoes most of it
    turned = projection_uncertainty(camera, covariance).sigma_px
    assert turned.max() < 1.2 and np.sqrt(np.mean(turned**2)) < 0.5


def test_projection_uncertainty_against_draws():
    camera = Camera([[500, 0, 330], [0, 505, 235], [0, 0, 1]], [-0.2, 0.05, 1e-3, -5e-4],
                    640, 480)
    rng = np.random.default_rng(3)
    root = np.diag([1, 1, 0.5, 0.5, 0.1, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4]) \
        @ (np.eye(len(PARAMETER_NAMES)) + 0.3 * rng.standard_normal(COVARIANCE_SHAPE))
    found = projection_uncertainty(camera, root @ root.T, 12)
    grid = np.stack(np.meshgrid(found.u, found.v), axis=-1).reshape(-1, 2)
    rays = np.column_stack([camera.normalised(grid), np.ones(len(grid))])
    draws = []
    for _ in range(600):
        drawn = 0.02 * root @ rng.standard_normal(len(PARAMETER_NAMES))
        other = Camera.from_parameters(camera.parameters + drawn)
        # the best rotation by Gauss-Newton on true projections, differences for derivatives
        turn = np.zeros(3)
        for _ in range(3):
            def project(w):
                c = np.cross(np.broadcast_to(w, rays.shape), rays)
                return other.project(rays + c).ravel()
            J = np.stack([(project(turn + d) - project(turn - d)) / 2e-5
                          for d in 1e-5 * np.eye(3)], axis=1)
            turn = turn - np.linalg.lstsq(J, project(turn) - grid.ravel(), rcond=None)[0]
        draws.append((project(turn) - grid.ravel()).reshape(-1, 2) / 0.02)
    measured = np.einsum('dni,dnj->nij', draws, draws) / len(draws)
    wanted = found.covariance.reshape(-1, 2, 2)
    ratio = np.trace(measured, axis1=1, axis2=2) / np.trace(wanted, axis1=1, axis2=2)
    # the spread of a sample variance of 600 draws is at most sqrt(2 / 600) = 6 %
    assert np.abs(ratio - 1).max() < 0.25 and abs(ratio.mean() - 1) < 0.05


@pytest.mark.long
def test_all_figures_are_drawn_and_are_reproducible(calibration, sequence):
    drawings = draw_figures(calibration, sequence.tracks)
    assert [d.name for d in drawings] == ['fixed-points', 'projection', 'lens', 'sigmas',
                                          'residuals', 'radial', 'images-fit', 'path', 'course',
                                          'coverage']
    images = []
    for drawing in drawings:
        assert drawing.caption and drawing.title
        images.append(drawing.svgs())
        for svg in images[-1]:
            ElementTree.fromstring(svg)
        assert all(png.startswith(b'\x89PNG') for png in drawing.pngs())
    again = draw_figures(calibration, sequence.tracks)
    assert [drawing.svgs() for drawing in again] == images


def test_pyplot_is_left_alone(calibration, sequence):
    from matplotlib import _pylab_helpers, rcParams
    before = dict(rcParams)
    draw_figures(calibration, sequence.tracks)
    assert not _pylab_helpers.Gcf.figs and dict(rcParams) == before


def test_little_is_enough(calibration):
    bare = replace(calibration, fixed_points=None, residuals=None,
                   covariance=np.zeros(COVARIANCE_SHAPE))
    assert [d.name for d in draw_figures(bare)] == ['lens', 'path', 'course']
    unknown = replace(calibration, covariance=np.full(COVARIANCE_SHAPE, np.inf))
    for drawing in draw_figures(unknown):
        drawing.svgs()
    assert draw_figures(NotCalibrated('No.')) == []
    assert coverage_figure(np.empty((0, 2)), (640, 480)) is None


@pytest.mark.parametrize('v', [(1, 0, 0), (1e9, 3, 1), (0, -2, 1e-9)])
def test_far_vanishing_points_are_pointed_to(calibration, v):
    far = replace(calibration, fixed_points=replace(calibration.fixed_points,
                                                    vanishing_point=np.array(v, float)))
    drawing = draw_figures(far)[0]
    assert drawing.name == 'fixed-points'
    drawing.svgs()


def drawn(drawings):
    """Lay out and draw all panels; writing them down would take as long again."""
    for drawing in drawings:
        for panel in drawing.panels:
            panel.draw_without_rendering()


@pytest.mark.long
@pytest.mark.parametrize('broken', [
    {'camera': Camera(np.diag([900.0, 900, 1]))},
    {'camera': Camera([[900, 0, 400], [0, 900, 0], [0, 0, 1]], width=4000, height=2)},
    {'camera': Camera([[900, 0, 400], [0, 900, 300], [0, 0, 1]], [-5, 3, 1, 1], 800, 600)},
    # what concerns other figures goes together
    {'covariance': np.full(COVARIANCE_SHAPE, np.nan), 'residuals': np.full((100, 2), np.nan)},
    {'covariance': -np.eye(*COVARIANCE_SHAPE), 'noise_sigma_px': np.nan}])
@pytest.mark.filterwarnings('error')
def test_strange_results_are_drawn_as_far_as_they_go(calibration, sequence, broken):
    drawn(draw_figures(replace(calibration, **broken), sequence.tracks))


@pytest.mark.long
@pytest.mark.filterwarnings('error')
def test_strange_geometry_is_drawn_as_far_as_it_goes(calibration, sequence):
    shape = calibration.reconstruction
    points = shape.points.copy()
    points[:5], points[5:9, 3] = np.nan, 0
    nothing = replace(shape, points=points[:0], tracks=shape.tracks[:0])
    for changed in (replace(shape, points=points), nothing,
                    replace(shape, cam_from_world=shape.cam_from_world * np.nan),
                    replace(shape, cam_from_world=shape.cam_from_world[[0] * 6])):
        drawn(draw_figures(replace(calibration, reconstruction=changed), sequence.tracks))
    # a camera that looks straight down: the horizon is at infinity, v the principal point
    down = replace(calibration.fixed_points, horizon=np.array([0, 0, 1.0]),
                   vanishing_point=np.array([400, 300, 1.0]))
    drawings = draw_figures(replace(calibration, fixed_points=down), sequence.tracks)
    assert drawings[0].name == 'fixed-points' and drawings[0].svgs()


def test_coverage_says_how_much_is_empty():
    corners = np.array([[1, 1], [639, 1], [1, 479], [639, 479]])
    assert coverage_figure(corners, (640, 480)).caption.startswith('99 %')
    everywhere = np.stack(np.meshgrid(np.arange(0, 640, 8), np.arange(0, 480, 8)), axis=-1)
    assert 'all over' in coverage_figure(everywhere.reshape(-1, 2), (640, 480)).caption


@pytest.mark.parametrize('size', [(640, 480), (512, 512), (480, 640), (600, 620), (540, 960)])
def test_no_label_beside_an_image_is_cut_off_whatever_its_shape(size):
    xy = np.random.default_rng(0).uniform(0, 1, (400, 2)) * size
    png, = coverage_figure(xy, size).pngs()
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_GRAYSCALE)
    rows, columns = np.nonzero(picture < 250)
    assert min(rows.min(), columns.min(), picture.shape[0] - 1 - rows.max(),
               picture.shape[1] - 1 - columns.max()) > 3


def test_images_are_counted_in_whole_numbers():
    axes = new_panel()
    for last in (3, 19, 90, 1500):
        counted_along_x(axes, 'image')
        axes.set_xlim(0, last)
        ticks = axes.get_xticks()
        assert len(ticks) > 2 and (ticks % 1 == 0).all()
