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
"""Gross errors that an estimate agrees with, since it rests on them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from selfcal_ros import CameraFacts
from selfcal_ros.calibration.bundle.deleted_tracks import deleted_tracks, without_hidden_errors
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.bundle.robust_fit import (fit_robustly, Observations, refit,
                                                       with_all_points)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.scenes import observe

CAMERA = Camera(np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), width=640, height=480)
VIEWS, MIDDLE, NOISE_PX = 9, 4, 0.2
#: Points of either half, then those of the three views in the middle: far ones, and a near one.
HALF, FAR = 120, 12
NEAR = 2 * HALF + FAR


def two_halves(rng):
    """Observe a path of which a near point, and far ones weakly, tell the scale between halves."""
    at = np.linspace(0, 1.5 * np.pi, VIEWS)[:, None]
    R = rotation_matrix(0.15 * np.sin(at * [1, 2, 1] + [0, 1, 2]))
    centres = 0.8 * np.sin(at * [1, 1, 2] + [1, 0, 3])
    path = np.concatenate([R, -R @ centres[..., None]], axis=2)
    points = rng.uniform([-3, -2.2, 4], [3, 2.2, 9], (NEAR + 1, 3))
    points[2 * HALF:NEAR] *= 4
    points[NEAR] = centres[MIDDLE] + R[MIDDLE].T @ [*rng.uniform(-0.2, 0.2, 2), 2.0]
    seen = np.zeros((VIEWS, len(points)), bool)
    seen[:MIDDLE + 1, :HALF] = seen[MIDDLE:, HALF:2 * HALF] = True
    seen[MIDDLE - 1:MIDDLE + 2, 2 * HALF:] = True
    return observe(rng, CAMERA, path, points, NOISE_PX, only_inside=True, seen=seen), points[NEAR]


def with_error(sequence, near, scale):
    """Return tracks whose near point is seen as if the later half were of another scale."""
    path, tracks = sequence.cam_from_world, sequence.tracks
    R, t = path[MIDDLE + 1, :, :3], path[MIDDLE + 1, :, 3]
    centres = -np.einsum('vji,vj->vi', path[:, :, :3], path[:, :, 3])
    step = scale * (centres[MIDDLE + 1] - centres[MIDDLE])
    moved = CAMERA.project((R @ (near - centres[MIDDLE] - step))[None])
    true = CAMERA.project((R @ near + t)[None])
    xy = np.array(tracks.xy)
    xy[(tracks.track == NEAR) & (tracks.frame == MIDDLE + 1)] += (moved - true)[0]
    return replace(tracks, xy=xy)


def fitted(sequence, tracks):
    observations = Observations.of(tracks, np.arange(VIEWS))
    start = SceneState(Lens.of(CAMERA), AxisPath.of_poses(np.eye(3), sequence.cam_from_world))
    return fit_robustly(observations, with_all_points(start, observations), GENERAL,
                        priors_from_facts(CameraFacts(aspect_ratio=1.0, skew=0.0)), NOISE_PX)


def scale_of(fit, sequence):
    """Scale of the later half of a path over that of the first, by the truth."""
    path = sequence.cam_from_world
    centres = -np.einsum('vji,vj->vi', path[:, :, :3], path[:, :, 3])
    ratio = (np.linalg.norm(np.diff(fit.state.path.centres(), axis=0), axis=1)
             / np.linalg.norm(np.diff(centres, axis=0), axis=1))
    return np.mean(ratio[MIDDLE:]) / np.mean(ratio[:MIDDLE])


@pytest.mark.parametrize('seed', (1, 2, 3))
def test_an_error_that_the_path_follows_is_seen_without_its_track(seed):
    sequence, near = two_halves(np.random.default_rng(seed))
    fit = fitted(sequence, with_error(sequence, near, 1.25))
    # no residual shows it, and the scale is wrong
    assert NEAR in fit.observations.track
    assert abs(scale_of(fit, sequence) - 1) > 0.15

    found = deleted_tracks(fit)

    place = int(np.flatnonzero(fit.observations.track[found.point] == NEAR)[0])
    assert found.freedom[place] == 3
    assert found.with_it[place] < chi2.isf(1e-3, 3)
    assert chi2.sf(found.without_it[place], 3) < 1e-6
    rest, points = fit.observations.select(
        fit.observations.track[fit.observations.point] != NEAR)
    state = replace(fit.state, points=fit.state.points[points])
    without = refit(replace(fit, observations=rest, state=state), fit.motion)
    # an adjustment without it leaves so much less; what is straight in one step is not quite so
    assert abs(2 * (fit.cost - without.cost) / found.without_it[place] - 1) < 0.3

    clean = without_hidden_errors(fit)
    assert clean.outliers == fit.outliers + 3
    assert np.array_equal(clean.observations.track, fit.observations.track[
        fit.observations.track != NEAR])
    assert abs(scale_of(clean, sequence) - 1) < 0.06


def test_a_tie_that_is_right_stays():
    """The only near tie is what the scale rests on, and the others agree within chance."""
    for seed in range(4):
        sequence, _ = two_halves(np.random.default_rng(seed))
        fit = fitted(sequence, sequence.tracks)

        found = deleted_tracks(fit)

        assert without_hidden_errors(fit) is fit
        # as chi-squares are: their mean is the freedom, and they exceed what rests on them
        assert abs(np.mean(found.without_it / found.freedom) - 1) < 0.15
        assert np.all(found.without_it >= found.with_it)


def test_tracks_that_others_say_nothing_of_are_not_held_against_them():
    sequence, near = two_halves(np.random.default_rng(1))
    tracks = with_error(sequence, near, 1.25)
    # without the far ones the near point alone tells the scale
    fit = fitted(sequence, tracks.select((tracks.track < 2 * HALF) | (tracks.track == NEAR)))

    assert NEAR in fit.observations.track
    assert without_hidden_errors(fit) is fit
