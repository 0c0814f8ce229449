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
"""The report on a fisheye that sees more than a half of all directions."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.angular_measurement import central_angle, fields_of_view
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.report.figures import draw_figures
from selfcal_ros.report.lens_curve import lens_curve
from selfcal_ros.report.observations import observations
from selfcal_ros.report.page import page_html
from selfcal_ros.report.phrases import meaning, parameter_rows
from selfcal_ros.report.projection_uncertainty import projection_uncertainty
from selfcal_ros.values.tracks import Tracks

CAMERA = Camera([[240, 0, 402], [0, 240, 297], [0, 0, 1]], [-0.01, 0.004, -0.003, 0.0004], 800,
                600, 'equidistant')
NOISE_PX = 0.2
#: No observation lies farther from the axis.
REACH = np.radians(100)


@pytest.fixture(scope='module')
def room():
    """Return a calibration by eight views in a room, and its tracks."""
    rng = np.random.default_rng(4)
    points = rng.uniform([-4, -3, -4], [4, 3, 4], (500, 3))
    poses, rows = [], []
    for view in range(8):
        R = rotation_matrix(rng.normal(0, 0.4, 3))
        centre = rng.uniform(-1, 1, 3)
        poses.append(np.column_stack([R, -R @ centre]))
        X = (points - centre) @ R.T
        xy = CAMERA.project(X)
        angle = np.arctan2(np.hypot(X[:, 0], X[:, 1]), X[:, 2])
        seen = (angle < REACH) & (xy > 0).all(axis=1) & (xy < [799, 599]).all(axis=1)
        rows.append(np.column_stack([np.full(seen.sum(), view), np.flatnonzero(seen),
                                     xy[seen] + NOISE_PX * rng.standard_normal((seen.sum(), 2))]))
    table = np.concatenate(rows)
    tracks = Tracks(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2:], (800, 600))
    covariance = covariance_of(table[::20, 2:])
    names = CAMERA.parameter_names
    free = np.diag(covariance) > 0
    return Calibration(
        camera=CAMERA, covariance=covariance,
        status={name: 'estimated' if one else 'held' for name, one in zip(names, free)},
        held_by={'skew': 'skew = 0'}, motion='general',
        facts=CameraFacts(skew=0.0, distortion='equidistant'), frames=tuple(range(8)),
        reprojection_rms_px=0.28, noise_sigma_px=NOISE_PX, observation_count=len(table),
        outlier_count=0, reconstruction=Reconstruction(
            np.arange(8), np.array(poses), np.arange(500),
            np.column_stack([points, np.ones(500)])), software='selfcal_ros 0.0'), tracks


def covariance_of(pixels):
    """Return the covariance that measured rays give the camera, its skew held."""
    rays, step, n = CAMERA.rays(pixels), 1e-5, len(CAMERA.parameter_names)
    free = np.delete(np.arange(n), 4)
    J = np.stack([(Camera.from_parameters(CAMERA.parameters + step * np.eye(n)[k], 800, 600,
                                          CAMERA.model).project(rays) - pixels).ravel() / step
                  for k in free], axis=1)
    covariance = np.zeros((n, n))
    covariance[np.ix_(free, free)] = np.linalg.inv(J.T @ J) * NOISE_PX**2
    return covariance


def test_the_field_of_view_goes_beyond_180_degrees_and_its_sigma_is_true(room):
    result, _ = room
    fields = fields_of_view(CAMERA, result.covariance)
    ends = CAMERA.rays([[-0.5, 299.5], [799.5, 299.5]])
    half = np.degrees(np.arctan2(np.hypot(ends[:, 0], ends[:, 1]), ends[:, 2]))
    assert half.sum() > 185
    # the row through the middle misses the principal point by 2.5 of 400 px
    assert fields['horizontal'].value == pytest.approx(half.sum(), abs=0.02)
    assert fields['vertical'].value < 180 < fields['diagonal'].value
    rng = np.random.default_rng(0)
    values, vectors = np.linalg.eigh(result.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    drawn = [fields_of_view(Camera.from_parameters(
        CAMERA.parameters + root @ rng.standard_normal(len(values)), 800, 600, CAMERA.model),
        result.covariance)['horizontal'].value for _ in range(300)]
    assert np.std(drawn) == pytest.approx(fields['horizontal'].sigma, rel=0.15)
    # the common angle of 30 degrees is found on the way out
    assert central_angle(CAMERA, result.covariance).value == 30


def test_residuals_are_noise_also_behind_the_camera(room):
    result, tracks = room
    seen = observations(result, tracks)
    behind = CAMERA.rays(seen.xy)[:, 2] < 0
    assert behind.sum() > 50 and np.isfinite(seen.residual).all() and seen.used.mean() > 0.99
    for some in (behind, ~behind):
        assert np.std(seen.residual[some]) == pytest.approx(NOISE_PX, rel=0.2)


def test_the_curve_of_the_lens_and_its_band(room):
    result, tracks = room
    curve = lens_curve(CAMERA, result.covariance, tracks.xy)
    theta = np.radians(curve.angle_deg)
    k = CAMERA.distortion
    assert np.allclose(curve.radius_px, 240 * theta * (
        1 + k[0] * theta**2 + k[1] * theta**4 + k[2] * theta**6 + k[3] * theta**8), atol=1e-6)
    assert np.allclose(curve.reference_px, 240 * theta, atol=1e-4)
    assert curve.reached_deg == pytest.approx(100, abs=1)
    # nothing is uncertain on the axis, and all the more beyond what was seen
    assert curve.sigma_px[0] == 0 and curve.sigma_px[-1] > 5 * np.median(curve.sigma_px)
    # the band is that of draws from the covariance
    rng = np.random.default_rng(1)
    values, vectors = np.linalg.eigh(result.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    at = np.searchsorted(curve.angle_deg, [40, 80])
    rays = np.column_stack([np.sin(theta[at]), 0 * at, np.cos(theta[at])])
    drawn = []
    for _ in range(300):
        one = Camera.from_parameters(CAMERA.parameters + root @ rng.standard_normal(9), 800, 600,
                                     CAMERA.model)
        drawn.append(one.project(rays)[:, 0] - one.K[0, 2])
    assert np.allclose(np.std(drawn, axis=0), curve.sigma_px[at], rtol=0.25)


def test_a_pinhole_that_is_held_has_no_curve_and_an_uncertain_one_has(calibration):
    pinhole = Camera(CAMERA.K, (), 800, 600)
    curve = lens_curve(pinhole, np.zeros((10, 10)))
    assert np.allclose(curve.radius_px, curve.reference_px) and curve.reached_deg is None
    folded = Camera(CAMERA.K, [-0.9], 800, 600)
    assert lens_curve(folded, np.zeros((10, 10))).angle_deg[-1] < 32


@pytest.mark.long
def test_every_figure_of_a_fisheye_is_drawn_and_told(room):
    result, tracks = room
    drawings = {one.name: one for one in draw_figures(result, tracks)}
    assert {'projection', 'lens', 'sigmas', 'residuals', 'coverage'} <= set(drawings)
    assert 'Observations reach 100 degrees' in drawings['lens'].caption
    page = page_html(result, 'text', tracks=tracks)
    assert 'id="lens"' in page and 'distortion, θ³' in page and 'equidistant' in page
    assert "Distortion is ROS&#39;s equidistant, on angles" in page and 'plumb_bob' not in page
    rows = {row.name: row for row in parameter_rows(result)}
    assert float([row for row in parameter_rows(result) if row.name == 'FoV'][0].value) > 185
    assert rows['k2'].meaning == 'distortion, θ⁵'
    assert meaning('rational_polynomial', 'k4') != meaning('plumb_bob', 'k1')


def test_where_a_fisheye_has_no_ray_there_is_no_sigma():
    rim = Camera(np.diag([150.0, 150, 1]) + np.array([[0, 0, 400], [0, 0, 300], [0, 0, 0]]),
                 [-1 / (3 * np.radians(95)**2)], 800, 600, 'equidistant')
    sigma = projection_uncertainty(rim, np.eye(9) * 1e-6).sigma_px
    assert np.isnan(sigma[0, 0]) and np.isfinite(sigma[15, 20])
    curve = lens_curve(rim, np.zeros((9, 9)))
    assert 90 < curve.angle_deg[-1] <= 95


def test_where_a_lens_is_not_valid_is_said(calibration):
    # turns back at a normalised radius of 1 / sqrt(3 * 0.8), within the image
    folded = replace(calibration, camera=Camera([[400, 0, 400], [0, 400, 300], [0, 0, 1]],
                                                [-0.8, 0, 0, 0, 0], 800, 600))
    curve = lens_curve(folded.camera, folded.covariance)
    u, v = np.meshgrid(np.arange(800) - 400, np.arange(600) - 300)
    reach = 400 * (2 / 3) / np.sqrt(3 * 0.8)      # where the fold is in the image
    assert curve.blind == pytest.approx(float((np.hypot(u, v) > reach).mean()), abs=0.03)
    drawing, = (one for one in draw_figures(folded) if one.name == 'lens')
    assert 'has no rays' in drawing.caption
    assert lens_curve(CAMERA, np.zeros((9, 9))).blind == 0
