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
"""A path is begun under a lens that keeps points near wherever they may yet be."""

import numpy as np
import pytest

from selfcal_ros import calibrate
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, Observations, RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.lens_selection import with_lens, gentle_lens
from selfcal_ros.calibration.initialisation.initial_structure import (chained_centres,
                                                                      PairGeometry,
                                                                      relative_rotations)
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.synthetic.hard_scenes import CAMERA, s_curve, vehicle

SIZE = (752, 480)
FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='plumb_bob')


def fit_with(distortion):
    """Views of points all over the image through a lens; returns them as a fit."""
    lens = Lens.of(Camera([[458, 0, 367], [0, 458, 248], [0, 0, 1]], distortion, *SIZE))
    view, point = np.divmod(np.arange(60), 30)
    xy = np.random.default_rng(0).uniform([2, 2], [749, 477], (60, 2))
    state = SceneState(lens, AxisPath.at_origin(np.eye(3), np.zeros(2)),
                       np.tile([0, 0, 1.0, 0], (30, 1)))
    observations = Observations(view, point, xy, np.arange(30))
    bundle = bundle_of(observations, GENERAL, priors_from_facts(FACTS), 0.2)
    return RobustFit(bundle, state, observations, 0)


def test_a_strong_barrel_begins_as_an_equidistant_lens_and_comes_back():
    fit = fit_with((-0.2834, 0.0739, 0.0002, 0.0, 0.0))
    lens, priors = gentle_lens(fit, FACTS, SIZE)
    assert not lens.model.is_perspective and priors.lens is lens.model
    xy = fit.observations.xy
    angle = np.arccos(np.sum(lens.camera().rays(xy) * fit.state.lens.camera().rays(xy), axis=1))
    assert np.sqrt(np.mean(angle**2)) < 2 / 458
    # outside the image the polynomial throws points away, and the other lens does not
    beyond = np.array([[np.tan(np.radians(80.0)), 0, 1]])
    thrown, near = (float(one.camera().project(beyond)[0, 0]) for one in (fit.state.lens, lens))
    assert SIZE[0] < near < thrown / 40
    again = with_lens(with_lens(fit.state, xy, 'equidistant'), xy, 'plumb_bob').lens
    assert again['k1'] == pytest.approx(-0.2834, abs=0.02)


def test_other_lenses_begin_as_they_are():
    fit = fit_with((-0.05, 0.01, 0.0, 0.0, 0.0))
    lens, priors = gentle_lens(fit, FACTS, SIZE)
    assert lens is fit.state.lens and priors is fit.bundle.priors


@pytest.mark.filterwarnings('error')
def test_pairs_where_a_supposed_lens_has_no_rays_are_no_cause_for_a_warning():
    # it bends back before the corner
    lens = Camera([[300, 0, 320], [0, 300, 240], [0, 0, 1]], [-0.8, 0.0], 640, 480)
    corner = np.random.default_rng(0).uniform(0, 30, (2, 12, 2))
    assert not np.isfinite(lens.rays(corner[0])).any()
    pair = PairGeometry(0, 1, np.eye(3), np.arange(12), *corner)

    assert np.isfinite(relative_rotations([pair], lens)).all()
    for planar in (False, True):
        assert np.isfinite(chained_centres([pair], lens, np.tile(np.eye(3), (2, 1, 1)),
                                           planar)).all()


@pytest.mark.long
@pytest.mark.parametrize('stated, begun', [
    ('equidistant', 'plumb_bob'), ('rational', 'plumb_bob'), ('plumb_bob', 'equidistant'),
    ('plumb_bob', 'rational_polynomial'), ('equidistant', 'rational_polynomial')])
def test_a_start_may_have_another_lens_than_the_stated_one(stated, begun):
    """The closed form of planar motion knows no lens: its camera has that of a pinhole."""
    drive = vehicle(np.random.default_rng(3), s_curve(12))
    start = Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], (), 640, 480, begun)
    result = calibrate(drive.tracks, start=start, facts=CameraFacts(
        aspect_ratio=1.0, skew=0.0, distortion=stated))

    assert result.facts.distortion == stated
    away = np.abs(result.camera.parameters[[0, 2, 3]] - CAMERA.parameters[[0, 2, 3]])
    assert (away < 4 * np.array([result.sigma[name] for name in ('fx', 'cx', 'cy')])).all()


def test_a_start_whose_lens_is_never_estimated_is_refused_in_a_sentence():
    drive = vehicle(np.random.default_rng(3), s_curve(12))
    start = Camera(CAMERA.K, [0.9], 640, 480, 'fov')

    with pytest.raises(ArgumentError, match='fov'):
        calibrate(drive.tracks, start=start)
