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
"""Comparison of calibrations: pixels after the best rotation, and sigmas that are true."""

from matplotlib.quiver import QuiverKey
import numpy as np
import pytest
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.report.comparison import compare_cameras
from selfcal_ros.report.comparison_figure import comparison_figure

#: Of a covariance of all parameters.
COVARIANCE_SHAPE = (len(PARAMETER_NAMES),) * 2

TRUTH = np.array([520, 520, 320, 240, 0, -0.12, 0.05, 0, 0, 0])


def spread():
    """Return a root of a covariance: one focal length, the aspect ratio held."""
    root = np.zeros((len(PARAMETER_NAMES), 5))
    root[[0, 1], 0] = 1.0
    root[2, [0, 1]] = 0.3, 0.8
    root[3, 2] = 0.8
    root[5, 3], root[6, 3], root[6, 4] = 0.002, -0.003, 0.003
    return root


def camera(values):
    return Camera.from_parameters(values, 640, 480)


def test_a_camera_with_itself_and_with_a_turned_one_is_zero():
    a = camera(TRUTH)
    for same in (compare_cameras(a, a), compare_cameras(a, a, *[spread() @ spread().T] * 2)):
        assert np.nanmax(same.distance_px) < 1e-9
        assert same.verdict == 'The calibrations are the same, but for rounding.'
    # what the principal point does is nearly what a rotation does; 1 % of focal length is not
    shifted = compare_cameras(a, camera(TRUTH + [0, 0, 2, 1, 0, 0, 0, 0, 0, 0]))
    assert np.nanmax(shifted.distance_px) < 1.0
    assert shifted.rotation_rad == pytest.approx(np.hypot(2, 1) / 520, rel=0.2)
    zoomed = compare_cameras(a, camera(TRUTH * [1.01, 1.01, 1, 1, 1, 1, 1, 1, 1, 1]))
    assert 1.0 < np.nanmax(zoomed.distance_px) < 5.0
    assert zoomed.agree is None and 'Without covariances' in zoomed.verdict


def test_p_values_are_uniform_when_nothing_has_changed():
    rng, root = np.random.default_rng(5), spread()
    C = root @ root.T
    found = [compare_cameras(camera(TRUTH + root @ rng.standard_normal(5)),
                             camera(TRUTH + root @ rng.standard_normal(5)), C, C)
             for _ in range(200)]
    p = np.array([one.p_value for one in found])
    assert all(one.freedom == 5 for one in found)
    for nominal in (0.2, 0.5, 0.8):
        # three standard deviations of a share of 200
        assert abs(np.mean(p < nominal) - nominal) < 3 * np.sqrt(nominal * (1 - nominal) / 200)
    # at one place the difference is that of one direction
    at = np.array([one.sigmas[0] for one in found])
    assert 0.5 < np.median(at) < 1.5
    assert np.mean([one.agree for one in found]) > 0.98


def test_rounding_of_a_covariance_is_no_knowledge():
    """Both focal lengths differed in the eleventh digit, and cameras that agree by 445 sigma."""
    rng, root = np.random.default_rng(6), spread()
    C = root @ root.T
    C[1, 1] *= 1 + 3e-11
    found = compare_cameras(camera(TRUTH), camera(TRUTH + root @ rng.standard_normal(5)), None, C)

    assert found.freedom == 5 and found.joint_sigmas < 3


def test_a_change_of_five_sigmas_is_seen_and_said():
    root = spread()
    moved = compare_cameras(camera(TRUTH), camera(TRUTH + 7 * root[:, 0]), root @ root.T,
                            root @ root.T)
    assert moved.agree is False and moved.p_value < 1e-3
    assert 'the camera has changed' in moved.verdict
    # a camera without covariance counts as exact, so it is seen better
    alone = compare_cameras(camera(TRUTH), camera(TRUTH + 7 * root[:, 0]), root @ root.T)
    assert alone.chi2 == pytest.approx(2 * moved.chi2)


def test_joint_sigmas_are_those_of_one_normal_number():
    root = np.zeros((len(PARAMETER_NAMES), 1))
    root[:2, 0] = 1.0
    # one free direction: the joint test is that of this one alone
    for moved in (2.0, 7.0, 35.0, 60.0):
        found = compare_cameras(camera(TRUTH), camera(TRUTH + moved * root[:, 0]), root @ root.T)
        assert found.joint_sigmas == pytest.approx(moved, rel=0.07)
        assert found.joint_sigmas == pytest.approx(np.sqrt(found.chi2), rel=1e-3)
        assert found.beyond(0.9 * moved) and not found.beyond(1.1 * moved)
    # what no parameter explains is beyond any number of sigmas, and without sigmas nothing is
    apart = camera(TRUTH), camera(TRUTH * [1.02, 1.02, 1, 1, 1, 1, 1, 1, 1, 1])
    held = compare_cameras(*apart, np.zeros(COVARIANCE_SHAPE))
    assert held.freedom == 0 and held.beyond(1e9)
    assert compare_cameras(*apart).beyond(3) is None
    assert not compare_cameras(apart[0], apart[0], np.zeros(COVARIANCE_SHAPE)).beyond(1)


def test_the_picture_shows_where_and_which_way():
    a = camera(TRUTH)
    b = camera(TRUTH * [1.02, 1.02, 1, 1, 1, 1, 1, 1, 1, 1])
    found = compare_cameras(a, b)
    drawing = comparison_figure(found, a, ('a$_.yaml', 'b.yaml'))
    axes, bar = drawing.panels[0].axes
    heat = axes.collections[0].get_array()
    assert float(heat.max()) == pytest.approx(np.nanmax(found.distance_px))
    arrows, = (each for each in axes.collections if hasattr(each, 'U'))
    at = arrows.get_offsets() - [320, 240]
    # a longer focal length pushes the border outwards, or, after the rotation, all points
    outer = np.hypot(*at.T) > 200
    assert (np.einsum('ni,ni->n', at, np.column_stack([arrows.U, arrows.V]))[outer] > 0).all()
    # how long an arrow is, is told; which line is which, beside the scale
    told, = axes.findobj(QuiverKey)
    key = float(told.text.get_text().removesuffix(' px'))
    longest = np.hypot(arrows.U, arrows.V).max()
    assert longest / 2.5 <= key <= longest
    assert len(bar.collections) > 1
    assert drawing.pngs()[0].startswith(b'\x89PNG')
    assert len(comparison_figure(compare_cameras(a, b, np.diag([1.0] * 10)), a).panels[0].axes
               ) == 4
    # nothing to see is no failure
    assert comparison_figure(compare_cameras(a, a), a).svgs()


def test_facts_that_contradict_each_other_are_no_agreement():
    root = spread()
    skewed = compare_cameras(camera(TRUTH), camera(TRUTH + [0, 20, 0, 0, 0, 0, 0, 0, 0, 0]),
                             100 * root @ root.T, 100 * root @ root.T)
    assert skewed.agree is False and skewed.untested_px > 1
    assert 'facts contradict' in skewed.verdict


def test_lenses_of_other_models():
    fisheye = Camera(camera(TRUTH).K, [0.0, 0.0], 640, 480, 'equidistant')
    found = compare_cameras(fisheye, camera(TRUTH * [1, 1, 1, 1, 1, 0, 0, 0, 0, 0]))
    # in the corner, 44 degrees from the axis, they differ by that angle and its tangent
    angle = np.hypot(320, 240) / 520
    assert np.nanmax(found.distance_px) == pytest.approx(520 * (np.tan(angle) - angle), rel=0.01)
    assert np.nanmax(compare_cameras(fisheye, fisheye).distance_px) < 1e-9
    with pytest.raises(InputError, match='9 parameters is none of the 10 .* lens model plumb_bob'):
        compare_cameras(fisheye, camera(TRUTH), None, np.eye(9))


#: A fisheye of 90 degrees, and the rational lens next to it: 0.02 px apart at most.
FISHEYE = np.array([400, 400, 320, 240, 0, -0.03, 0.008, -0.004, 0.0006])
RATIONAL = np.array([399.917956, 399.917956, 320, 240, 0, 0.346812689, -0.0297561748, 0, 0,
                     0.00236203260, 0.707451794, 0, 0])


def estimated(values, model, free, seed):
    """Return a root (n, k) of the covariance that 300 measured rays give a camera."""
    one = Camera.from_parameters(values, 640, 480, model)
    pixels = np.random.default_rng(seed).uniform([20, 20], [620, 460], (300, 2))
    rays, step = one.rays(pixels), 1e-4
    moves = np.array([[name in group.split() for name in one.parameter_names]
                      for group in free], float)
    J = np.stack([(Camera.from_parameters(values + step * move, 640, 480, model).project(rays)
                   - pixels).ravel() / step for move in moves], axis=1)
    return moves.T @ np.linalg.cholesky(np.linalg.inv(J.T @ J) * 0.5**2)


def test_calibrations_of_two_families_are_tested_each_by_its_own_covariance():
    roots = (estimated(FISHEYE, 'equidistant', ('fx fy', 'cx', 'cy', 'k1', 'k2', 'k3'), 1),
             estimated(RATIONAL, 'rational_polynomial', ('fx fy', 'cx', 'cy', 'k1', 'k2', 'k4'),
                       2))
    C = [root @ root.T for root in roots]
    rng, found = np.random.default_rng(3), []

    def pair(shift=0.0):
        drawn = [truth + root @ rng.standard_normal(6) for truth, root in zip(
            (FISHEYE, RATIONAL), roots)]
        drawn[1][:2] += shift
        return (Camera.from_parameters(drawn[0], 640, 480, 'equidistant'),
                Camera.from_parameters(drawn[1], 640, 480, 'rational_polynomial'))

    found = [compare_cameras(*pair(), *C) for _ in range(60)]
    p = np.array([one.p_value for one in found])
    for nominal in (0.2, 0.5, 0.8):
        assert abs(np.mean(p < nominal) - nominal) < 3 * np.sqrt(nominal * (1 - nominal) / 60)
    assert np.mean([one.agree for one in found]) > 0.95
    # the sum of both, not one of them: a camera known exactly is told apart better
    moved = pair(3.0)
    both, alone = compare_cameras(*moved, *C), compare_cameras(*moved, C[0])
    assert both.agree is False and 'the camera has changed' in both.verdict
    assert alone.chi2 > both.chi2 and not alone.agree


def test_what_cannot_be_compared():
    with pytest.raises(InputError, match='one size'):
        compare_cameras(camera(TRUTH), Camera.from_parameters(TRUTH, 320, 240))
    with pytest.raises(InputError, match='not finite'):
        compare_cameras(camera(TRUTH), camera(TRUTH), np.full(COVARIANCE_SHAPE, np.nan))
    with pytest.raises(InputError, match='undone anywhere'):
        compare_cameras(camera(TRUTH + [0, 0, 9e5, 0, 0, -0.9, 0, 0, 0, 0]), camera(TRUTH))
