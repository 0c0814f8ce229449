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
"""What one step tells of an optimum of Huber's loss is what going there would."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import Prior, Priors
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, fit_robustly, Observations,
                                                       rescaled)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.uncertainty.distortion_misfit import find_distortion_misfit
from selfcal_ros.calibration.uncertainty.profile_likelihood import profile_likelihood_excess
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.synthetic.special_scenes import drive

TRUTH = Camera([[520, 0, 320], [0, 520, 240], [0, 0, 1]], (), 640, 480)
VIEWS = 15


def seen(rng, displaced=lambda xy, view: 0.0, uneven=0.0, noise_px=0.2):
    """Return an optimum of a drive whose errors are Gaussian, each with a sigma of its own."""
    sequence = drive(rng, 0.0, VIEWS, 200, camera=TRUTH)
    observed = Observations.of(sequence.tracks, np.arange(VIEWS))
    size = np.exp(rng.normal(0, uneven, len(observed.xy)))
    noise = noise_px * size[:, None] * rng.standard_normal((len(size), 2))
    observed = replace(observed, xy=observed.xy + displaced(observed.xy, observed.view) + noise)
    points = np.column_stack([sequence.points[observed.track], np.ones(len(observed.track))])
    lens = Lens.of(TRUTH)
    state = rescaled(SceneState(lens, AxisPath.of_poses(np.eye(3), sequence.cam_from_world),
                                points / np.linalg.norm(points, axis=1, keepdims=True)))
    held = Priors({name: Prior(lens[name], 0.0) for name in lens.names
                   if name not in ('f', 'cx', 'cy')}, lens.model)
    fit = fit_robustly(observed, state, GENERAL, held, noise_px)
    return replace(fit, state=fit.bundle.optimise(fit.state, 60, 1e-7))


@pytest.mark.parametrize('uneven', [0.0, 0.8])
def test_a_valley_that_is_a_parabola_adds_nothing(uneven):
    # it added 7 % to the variance of Gaussian errors, and 19 % to that of uneven ones
    fit = seen(np.random.default_rng(1), uneven=uneven)
    _, excess = profile_likelihood_excess(fit, (640, 480), least=0.0)
    assert np.diag(excess)[0] < 0.03 * fit.lens_covariance[0, 0]


def test_a_field_moves_the_camera_as_far_as_going_there():
    def smooth(xy, _):
        d = (xy - [320, 240]) / 320
        return 0.3 * np.stack([np.sin(3 * d[:, 0]) * np.cos(2 * d[:, 1]),
                               np.sin(2.5 * d[:, 1]) * d[:, 0]], axis=1)

    fit = seen(np.random.default_rng(1), smooth)
    found = find_distortion_misfit(fit, (640, 480), 1.0)
    field = found.residual - fit.bundle.residuals(found.state)
    freed = replace(fit.observations, xy=fit.observations.xy - field)
    bundle = bundle_of(freed, fit.motion, fit.bundle.priors, fit.bundle.sigma_px)
    best = bundle.optimise(found.state, 60, 1e-7)

    moved, further = (state.lens['f'] - fit.state.lens['f'] for state in (found.state, best))
    assert abs(moved) > 0.5 and moved == pytest.approx(further, rel=0.02)
    # what is left of the images after the field is as well known as before
    assert found.covariance[0, 0] > 0.999 * fit.lens_covariance[0, 0]


def test_what_a_fact_alone_tells_is_not_from_the_images():
    rng = np.random.default_rng(3)
    tracks = drive(rng, 0.0, 12, 200, camera=TRUTH).tracks
    uneven = np.exp(rng.normal(0, 0.8, len(tracks.xy)))[:, None]
    tracks = replace(tracks, xy=tracks.xy + 0.3 * uneven * rng.standard_normal(tracks.xy.shape))
    found = calibrate(tracks, facts=CameraFacts(
        aspect_ratio=1.0, skew=0.0, skew_sigma_px=1e-3, distortion='none'), motion='planar')
    # it was 9 % from the images with tails, and less than nothing with Gaussian errors
    assert found.identifiability.from_images['skew'] == pytest.approx(0, abs=1e-3)
    assert found.identifiability.from_images['fx'] > 0.99
