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
"""Residuals by radius, worst images and points, ranges, and the course: known truth."""

from dataclasses import replace
import re

import numpy as np
import pytest
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.report.figures import draw_figures, draw_tables
from selfcal_ros.report.object_views import distance_and_tilt
from selfcal_ros.report.observations import observations
from selfcal_ros.report.pose_course import pose_course, roll_pitch_yaw
from selfcal_ros.report.projection_uncertainty import projection_uncertainty
from selfcal_ros.report.radial_residuals import radial_figure, radial_residuals
from selfcal_ros.report.ranges import angular_sigmas, ranges_table
from selfcal_ros.report.residual_figures import residual_figure
from selfcal_ros.report.worst import (_levels, arrow_scale, fit_of_images, fit_of_points,
                                      worst_tables)


def test_a_course_over_the_radius_is_found(calibration, sequence):
    rng = np.random.default_rng(3)
    xy = rng.uniform(0, 600, (2000, 2))
    centre = np.array([300.0, 200.0])
    away = xy - centre
    residual = -1e-3 * away + rng.normal(scale=0.05, size=away.shape)
    found = radial_residuals(centre, xy, residual)
    assert np.abs(found.outwards_px + 1e-3 * found.radius_px).max() < 5 * found.sigma_px.max()
    assert np.abs(found.around_px).max() < 5 * found.sigma_px.max()
    assert found.spread_px == pytest.approx(
        np.sqrt(0.05**2 + (1e-3 * found.radius_px)**2 / 2), rel=0.15)
    # 125 observations a ring, and the course within it
    assert np.all((found.sigma_px > 0.9 * 0.05 / 125**0.5)
                  & (found.sigma_px < 1.3 * 0.05 / 125**0.5))
    assert (np.diff(found.radius_px) > 0).all()
    assert radial_residuals(centre, xy[:50], residual[:50]) is None
    seen = observations(calibration, sequence.tracks)
    assert 'as far as chance' in radial_figure(calibration, seen).caption
    off = replace(seen, residual=seen.residual - 1e-3 * (seen.xy - calibration.camera.K[:2, 2]))
    assert 'farther out than the camera says' in radial_figure(calibration, off).caption


def test_the_worst_image_and_the_worst_point_are_named_first(calibration, sequence):
    xy, (frame, track) = sequence.tracks.xy.copy(), (sequence.tracks.frame, sequence.tracks.track)
    rng = np.random.default_rng(4)
    # less than what is rejected
    xy[frame == 4] += rng.normal(scale=0.08, size=(int((frame == 4).sum()), 2))
    xy[track == 11] += rng.choice([-0.2, 0.2], size=(int((track == 11).sum()), 2))
    tracks = replace(sequence.tracks, xy=xy)
    result = replace(calibration, observation_count=len(tracks))
    seen = observations(result, tracks)
    assert seen.used.all()
    images, points = fit_of_images(result, seen), fit_of_points(seen)
    assert images.key[images.worst()[0]] == 4 and points.key[points.worst()[0]] == 11
    assert images.rms_px[0] == pytest.approx(0.1 * np.sqrt(2), rel=0.15)
    of_images, of_points = worst_tables(result, seen)
    assert of_images.rows[0][0] == '4' and of_points.rows[0][0] == '11'
    assert len(of_points.rows) == 6 and all(len(row) == 5 for row in of_points.rows)
    place = re.fullmatch(r'(\d): \((\d+), (\d+)\)', of_points.rows[0][4])
    assert int(place[1]) in range(6)


@pytest.mark.parametrize('length, expected', [(0.64, 50), (0.1, 500), (0.05, 1000), (1e4, 1)])
def test_arrows_are_as_long_as_can_be_seen(length, expected):
    residual = np.full((50, 2), length / np.sqrt(2))
    assert arrow_scale(residual, 640) == expected
    assert length * expected < 0.08 * 640 * 1.01 or expected == 1


def test_no_two_labels_and_no_two_numbers_overlap(calibration, sequence):
    seen = observations(calibration, sequence.tracks)
    drawings = draw_figures(calibration, sequence.tracks)
    fit, sigmas = (next(one for one in drawings if one.name == name)
                   for name in ('images-fit', 'sigmas'))
    for figure in (fit.panels[0], sigmas.panels[1]):
        figure.draw_without_rendering()
        boxes = [text.get_window_extent() for text in figure.axes[0].texts]
        assert len(boxes) >= 3
        assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])
    assert _levels(np.array([977, 981, 979]), np.array([0.5, 0.5, 0.9]), 1000.0, 1.0) == [0, 1, 0]
    # what is far out does not stand in the last bars
    wide = seen.residual.copy()
    wide[::50] *= 1000
    axes = residual_figure(calibration, replace(seen, residual=wide)).panels[-1].axes[0]
    heights = [bar.get_height() for bar in axes.patches]
    assert max(heights[0], heights[-1]) < 0.02 * max(heights)
    assert 'lie beyond the ends' in axes.get_legend().texts[1].get_text()


def test_what_is_uncertain_at_a_range(calibration):
    variance = np.zeros(len(PARAMETER_NAMES))
    variance[2] = 4.0   # cx alone: a rotation takes up nearly all of it
    camera = Camera(calibration.camera.K, width=800, height=600)
    one = replace(calibration, camera=camera, covariance=np.diag(variance))
    hidden = angular_sigmas(one)
    assert max(hidden.values()) < 0.5 * 2 / 900
    variance[:2] = 9.0
    scaled = replace(one, covariance=np.diag(variance))
    sigmas = angular_sigmas(scaled)
    assert sigmas['in the middle'] < sigmas['halfway out'] < sigmas['near the corners']
    table = ranges_table(scaled, (1.0, 10.0))
    near, far = ([float(value.split()[0]) for value in row[1:]] for row in table.rows)
    assert far == pytest.approx(10 * np.array(near), rel=0.06)
    assert near[2] == pytest.approx(1e3 * sigmas['near the corners'], rel=0.06)
    assert '0.33 %' in table.caption
    assert ranges_table(replace(one, covariance=np.full_like(one.covariance, np.inf))) is None


@pytest.mark.parametrize('model', ['plumb_bob', 'equidistant'])
def test_the_direction_of_a_ray_is_as_uncertain_as_its_pixel_says(model):
    # the error of the worst pixel times the most that any pixel turns a ray is twice as much
    camera = Camera.from_parameters([300, 300, 319.5, 99.5, 0] + [0] * (
        5 if model == 'plumb_bob' else 4), 640, 200, model)
    C = np.diag([9.0, 9.0, 1.0, 1.0] + [0] * (len(camera.parameter_names) - 4))
    found = projection_uncertainty(camera, C, 9)
    sigma = found.direction_sigma_rad(camera)

    for i, j in ((0, 0), (1, 4), (2, 8)):
        pixel = np.array([found.u[j], found.v[i]])
        x, y = (pixel - [319.5, 99.5]) / 300
        if model == 'plumb_bob':
            ray = np.array([x, y, 1]) / np.sqrt(1 + x * x + y * y)
            slope = np.array([[1, 0], [0, 1], [0, 0]]) / 300 / np.sqrt(1 + x * x + y * y)
            A = slope - np.outer(ray, ray @ slope)
        else:
            A = (camera.rays(pixel + 1e-4 * np.eye(2))
                 - camera.rays(pixel - 1e-4 * np.eye(2))).T / 2e-4
        exact = np.sqrt(np.linalg.eigvalsh(A @ found.covariance[i, j] @ A.T)[-1])
        assert sigma[i, j] == pytest.approx(exact, rel=1e-4)


def test_the_course_has_the_turns_and_steps_of_the_path(calibration, sequence):
    stamps = {k: 10**18 + k * 500_000_000 for k in range(6)}
    course = pose_course(calibration, replace(sequence.tracks, stamps_ns=stamps))
    assert course.in_seconds and course.time[-1] == 2.5
    R, t = sequence.cam_from_world[:, :, :3], sequence.cam_from_world[:, :, 3]
    turns = np.linalg.norm(rotation_vector(R[1:] @ np.swapaxes(R[:-1], 1, 2)), axis=1)
    assert np.abs(np.diff(course.angles_deg[:, 2])) == pytest.approx(np.degrees(turns))
    assert np.ptp(course.angles_deg[:, :2], axis=0).max() < 1e-6
    centres = -np.einsum('vji,vj->vi', R, t)
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    assert np.linalg.norm(np.diff(course.position, axis=0), axis=1) == pytest.approx(
        steps / np.median(steps))
    assert not pose_course(calibration).in_seconds
    assert pose_course(replace(calibration, motion='known-object')) is None
    # REP 103, fixed axes: roll, then pitch, then yaw
    angles = np.array([0.1, -0.3, 2.0])
    R = [rotation_matrix(angle * axis) for angle, axis in zip(angles, np.eye(3))]
    assert roll_pitch_yaw((R[2] @ R[1] @ R[0])[None])[0] == pytest.approx(angles)


def test_how_a_board_was_held(calibration):
    board = np.column_stack([np.random.default_rng(5).uniform(-0.1, 0.1, (20, 2)), np.zeros(20),
                             np.ones(20)])
    board[:, :2] -= board[:, :2].mean(axis=0)
    tilts = np.radians([0, 30, 70])
    poses = np.array([np.column_stack([rotation_matrix([tilt, 0, 0]), [0, 0, z]])
                      for tilt, z in zip(tilts, (1.0, 2.0, 0.5))])
    shape = replace(calibration.reconstruction, frames=np.arange(3), cam_from_world=poses,
                    tracks=np.arange(20), points=board)
    held = replace(calibration, motion='known-object', reconstruction=shape)
    distance, tilt = distance_and_tilt(held)
    assert distance == pytest.approx([1, 2, 0.5]) and tilt == pytest.approx([0, 30, 70], abs=1e-5)
    drawing, = (one for one in draw_figures(held) if one.name == 'views')
    assert '33 % of the views' in drawing.caption
    table, = draw_tables(held)
    assert table.rows[-1][0].startswith('1 m, of the object')
    assert distance_and_tilt(calibration) is None


@pytest.mark.long
def test_the_page_has_them_in_their_sections(html):
    places = [html.index(f'id="{name}"') for name in (
        'scene', 'course', 'certainty', 'ranges', 'lens', 'fit', 'radial', 'images-fit',
        'worst-images', 'worst-points', 'geometry')]
    assert places == sorted(places)
