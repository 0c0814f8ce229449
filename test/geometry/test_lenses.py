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
"""Lens models: derivatives against differences, projections against OpenCV's, and the fold."""

import cv2
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES, lens_model, LENS_MODELS
from selfcal_ros.geometry.lenses.model import fitted_coefficients
from selfcal_ros.values.ros_lenses import ros_distortion

#: Coefficients of a real lens of each model, and the angle from the axis that it is used to.
LENSES = {
    'plumb_bob': ([-0.28, 0.08, 1e-3, -2e-3, -0.01], 40),
    'rational_polynomial': ([0.78, 0.07, 1e-3, -2e-3, 0.001, 1.11, 0.24, 0.002], 60),
    'equidistant': ([-0.02, 0.006, -0.004, 5e-4], 100),
    'fov': ([0.95], 100),
    'ucm': ([1.3, -0.05, 0.01, 1e-3, -2e-3], 100),
    'eucm': ([0.58, 1.1], 100),
    'double_sphere': ([-0.21, 0.59], 100)}
K = np.array([[520, 0.3, 322], [0, 515, 241], [0, 0, 1]])


@pytest.fixture(params=LENSES)
def lens(request):
    """Return a model and its coefficients."""
    return lens_model(request.param), np.array(LENSES[request.param][0])


def directions(model, count=200, narrower=1.0):
    """Return unit rays (count, 3) up to the angle that a lens is used to."""
    rng = np.random.default_rng(7)
    angle = np.radians(LENSES[model.name][1] * narrower) * np.sqrt(rng.uniform(0, 1, count))
    around = rng.uniform(0, 2 * np.pi, count)
    return np.column_stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around),
                            np.cos(angle)])


def test_no_model_is_left_out():
    assert set(LENSES) == set(LENS_MODELS)
    for model, free in LENS_CHOICES.values():
        assert LENS_MODELS[model.name] is model and set(free) <= set(model.coefficients)
    with pytest.raises(ArgumentError, match="'magic' is unknown; known are plumb_bob"):
        lens_model('magic')


def test_derivatives_by_the_ray_are_differences(lens):
    # of any length: the image does not depend on it
    model, values = lens
    rays, step = 3 * directions(model), 1e-6
    numeric = np.stack([(model.image(rays + d, values).xy - model.image(rays - d, values).xy)
                        / (2 * step) for d in step * np.eye(3)], axis=-1)
    own = model.image(rays, values).by_ray()
    assert np.abs(own - numeric).max() < 1e-7 * np.abs(own).max()
    assert np.abs(np.einsum('nij,nj->ni', own, rays)).max() < 1e-12
    # on the axis it is that of a pinhole
    ahead = np.array([[0, 0, 2.0]])
    scale = model.image(np.array([[1e-7, 0, 1.0]]), values).xy[0, 0] * 1e7
    assert np.allclose(model.image(ahead, values).by_ray(),
                       np.array([[1, 0, 0], [0, 1, 0]]) * scale / 2, atol=1e-6)


def test_derivatives_by_the_coefficients_are_differences(lens):
    model, values = lens
    rays, step = directions(model), 1e-6
    for k, name in enumerate(model.coefficients):
        d = step * np.eye(len(values))[k]
        change = model.image(rays, values + d).xy - model.image(rays, values - d).xy
        numeric = change / (2 * step)
        own = np.stack(model.image(rays, values).by_coefficient(name), axis=-1)
        assert np.abs(own - numeric).max() < 1e-8 * max(np.abs(own).max(), 1), name


def test_rays_undo_the_image(lens):
    # of the angular models beyond 90 degrees
    model, values = lens
    rays = np.concatenate([directions(model), [[0, 0, 1]]])
    back = model.rays(model.image(rays, values).xy, values)
    assert np.abs(back - rays).max() < 1e-10
    assert np.degrees(model.widest_angle(values)) > LENSES[model.name][1]


def test_the_camera_projects_beyond_90_degrees():
    camera = Camera(K, LENSES['equidistant'][0], 640, 480, 'equidistant')
    rays = directions(camera.lens)
    assert (rays[:, 2] < 0).any()
    pixels = camera.project(rays.reshape(20, 10, 3))
    assert pixels.shape == (20, 10, 2)
    assert np.abs(camera.rays(pixels).reshape(-1, 3) - rays).max() < 1e-10
    # and where a pinhole has no image, there is none
    flat = camera.normalised(pixels).reshape(-1, 2)
    assert np.array_equal(np.isfinite(flat).all(axis=1), rays[:, 2] > 0)


@pytest.mark.parametrize('model, values, fold', [
    # r (1 + k1 r²) rises up to r² = -1 / (3 k1), and θ (1 + k1 θ²) as well
    ('plumb_bob', [-0.4], np.arctan(np.sqrt(1 / 1.2))),
    # the image rises again, from 80 degrees on
    ('plumb_bob', [-1.02, 0.05], np.arctan(0.581)),
    ('rational_polynomial', [-0.4, 0, 0, 0, 0, 0], np.arctan(np.sqrt(1 / 1.2))),
    ('equidistant', [-0.2], np.sqrt(1 / 0.6))])
def test_beyond_the_fold_there_is_nothing(model, values, fold):
    camera = Camera(np.eye(3), values, model=model)
    assert camera.lens.widest_angle(camera.distortion) == pytest.approx(fold, abs=0.006)
    angle = fold * np.array([0.2, 0.9, 0.99])
    rays = np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])
    assert np.abs(camera.rays(camera.project(rays)) - rays).max() < 1e-9
    radius = camera.project(rays)[-1, 0]
    for beyond in (1.1, 2, 10, 1000, 1e5):
        assert np.isnan(camera.rays([[beyond * radius, 0], [0, -beyond * radius]])).all(), beyond
    if not camera.lens.is_perspective:
        assert np.isnan(camera.project([np.sin(1.01 * fold), 0, np.cos(1.01 * fold)])).all()


def test_behind_a_perspective_there_is_nothing():
    camera = Camera(K, LENSES['plumb_bob'][0])
    assert np.isnan(camera.project([[0.1, 0.1, -1], [0.1, 0.1, 0]])).all()


@pytest.mark.parametrize('name', ['plumb_bob', 'rational_polynomial'])
def test_perspectives_are_those_of_opencv(name):
    values = np.array(LENSES[name][0])
    camera = Camera(K - [[0, 0.3, 0], [0] * 3, [0] * 3], values, model=name)
    X = 4 * directions(camera.lens)
    theirs, by = cv2.projectPoints(X, np.zeros(3), np.zeros(3), camera.K, values)
    assert np.abs(camera.project(X) - theirs[:, 0]).max() < 1e-9
    image = camera.lens.image(X, values)
    for k, coefficient in enumerate(camera.lens.coefficients):
        ours = np.stack(image.by_coefficient(coefficient), axis=-1) * camera.K[[0, 1], [0, 1]]
        assert np.abs(ours.ravel() - by[:, 10 + k]).max() < 1e-9


def test_equidistant_is_the_fisheye_of_opencv():
    # which wants its points ahead
    values = np.array(LENSES['equidistant'][0])
    camera = Camera(K, values, model='equidistant')
    X = 4 * directions(camera.lens, narrower=0.88)
    theirs, _ = cv2.fisheye.projectPoints(X[:, None], np.zeros(3), np.zeros(3), K, values,
                                          alpha=K[0, 1] / K[0, 0])
    assert np.abs(camera.project(X) - theirs[:, 0]).max() < 1e-9


def test_coefficients_are_fitted_to_rays(lens):
    model, values = lens
    rays = directions(model, narrower=0.8)
    xy = model.image(rays, values).xy
    if model.name not in ('fov', 'eucm'):  # no lenses at zero, and not estimated
        free = model.coefficients
        fitted = fitted_coefficients(model, free, rays, xy, steps=20)
        assert np.abs(model.image(rays, fitted).xy - xy).max() < 1e-6
    # a pixel without a ray says nothing, what is not free stays zero
    xy[0] = np.nan
    held = fitted_coefficients(model, (), rays, xy)
    assert not held.any() and len(held) == len(model.coefficients)


def test_a_fit_of_one_coefficient_is_linear():
    model, values = lens_model('equidistant'), np.array([-0.03, 0, 0, 0])
    rays = directions(model)
    xy = model.image(rays, values).xy
    xy[:3] = np.nan
    assert np.abs(fitted_coefficients(model, ('k1',), rays, xy, steps=1) - values).max() < 1e-12


def test_fields_of_view():
    pinhole = Camera([[320, 0, 319.5], [0, 320, 239.5], [0, 0, 1]], (), 640, 480)
    assert np.degrees(pinhole.field_of_view()) == pytest.approx([90, 2 * 36.869898])
    # an equidistant lens sees as far as its image is wide
    fisheye = Camera([[200, 0, 319.5], [0, 200, 239.5], [0, 0, 1]], (), 640, 480, 'equidistant')
    assert fisheye.field_of_view() == pytest.approx([3.2, 2.4])
    assert np.isnan(Camera(pinhole.K).field_of_view()).all()
    # where the lens folds inside the image nobody can tell
    folded = Camera(pinhole.K, [-0.4], 640, 480)
    assert np.isnan(folded.field_of_view()[0])


@pytest.mark.parametrize('model, values, words', [
    ('equidistant', [0.1, 0, 0], 'equidistant has 4 coefficients, not 3'),
    ('equidistant', [0.1, 0, 0, 0, 0.1], 'equidistant has 4 coefficients, not 5'),
    ('plumb_bob', [0.1] * 8, 'plumb_bob has 5 coefficients, not 8'),
    ('rational_polynomial', [0.1] * 7, 'rational_polynomial has 8 coefficients, not 7'),
    ('fov', [0.9], "'fov' is not supported; plumb_bob, rational_polynomial, equidistant are")])
def test_what_ros_cannot_hold(model, values, words):
    with pytest.raises(ArgumentError, match=words):
        ros_distortion(model, np.array(values, float))


@pytest.mark.parametrize('model, values, kept', [
    ('plumb_bob', [], 0), ('plumb_bob', [0.1, 0.1], 2), ('plumb_bob', [0.1] * 4, 4),
    ('plumb_bob', [0.1] * 5 + [0] * 3, 5),
    ('rational_polynomial', [0.1] * 5, 5), ('rational_polynomial', [0.1] * 8 + [0] * 4, 8),
    ('equidistant', [0.1] * 4, 4), ('equidistant', [], 0), ('equidistant', [0.1] * 4 + [0], 4)])
def test_what_ros_holds(model, values, kept):
    assert ros_distortion(model, np.array(values, float)).tolist() == values[:kept]


def test_lenses_that_see_nothing_are_refused():
    with pytest.raises(ArgumentError, match='sees nothing but its axis'):
        Camera(K, [-1e3], model='equidistant')
    with pytest.raises(ArgumentError, match='between 0 and pi'):
        Camera(K, [3.2], model='fov')


def test_a_lens_under_another_name():
    plumb = Camera(K, LENSES['plumb_bob'][0], 640, 480)
    rational = plumb.as_model('rational_polynomial')
    X = directions(plumb.lens)
    assert np.abs(rational.project(X) - plumb.project(X)).max() < 1e-10
    assert np.array_equal(rational.as_model('plumb_bob').distortion, plumb.distortion)
    with pytest.raises(ArgumentError, match='equidistant'):
        plumb.as_model('equidistant')
    assert rational.distortion_as('equidistant') is None


def test_a_rational_lens_whose_pole_and_zero_all_but_cancel_tears_the_image():
    """Such an estimate was 6 px off beyond 60 degrees, and right within."""
    model = lens_model('rational_polynomial')
    torn = np.array([0.676371241, -0.135588345, 0.0, 0.0, -0.0490764595, 0.995938268,
                     0.0584455776, -0.137363014])
    # what it was to be, none at all, and a true pole at 54 degrees
    whole = np.array([[0.8, 0.25, 4e-4, -6e-4, 0.02, 1.12, 0.48, 0.06], np.zeros(8),
                      [0.5, 0.1, 0, 0, 0, -0.5, 0, 0]])
    angles = np.radians([60.0, 61.1, 61.1524, 61.2, 63.0])
    x, _ = model.distorted(torn, np.tan(angles), 0 * angles)
    expected, _ = model.distorted(whole[0], np.tan(angles), 0 * angles)
    assert abs(x - expected)[[0, -1]].max() < 0.01 < 0.05 < abs(x - expected)[2]
    assert not model.is_smooth(torn)
    assert all(model.is_smooth(values) for values in whole)
