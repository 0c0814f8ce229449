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
"""A lens that is not what the model says: found, allowed for, and not invented."""

import numpy as np
import pytest

from selfcal_ros import calibrate, CameraFacts, Tracks
from selfcal_ros.calibration.uncertainty.distortion_misfit import displacement_modes
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.synthetic import special_scenes
from selfcal_ros.synthetic.scenes import pitched_mount, planar_sequence

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2')


def drive(seed, bend_px=0.0):
    """Return tracks of a drive through a lens with a displacement of degree three, and camera."""
    sequence = special_scenes.drive(np.random.default_rng(seed), 0.1, views=12, tracks=500)
    tracks = sequence.tracks
    x, y = ((tracks.xy - [320, 240]) / 320).T
    bend = bend_px * np.stack([y**3 - x * y, 1.5 * x**2 * y], axis=1)
    return (Tracks(tracks.frame, tracks.track, tracks.xy + bend, tracks.image_size),
            sequence.camera)


def test_modes_start_at_degree_two():
    """No mode is a shift, a scaling or a shear: those are the calibration matrix itself."""
    u, v = np.meshgrid(np.linspace(0, 639, 41), np.linspace(0, 479, 31))
    xy = np.column_stack([u.ravel(), v.ravel()])
    modes = displacement_modes(xy, (640, 480))
    second = np.diff(modes[:, 0].reshape(31, 41, -1), n=2, axis=1)
    across = np.diff(modes[:, 0].reshape(31, 41, -1), n=2, axis=0)
    mixed = np.diff(np.diff(modes[:, 0].reshape(31, 41, -1), axis=0), axis=1)

    half = modes.shape[2] // 2
    bent = np.abs(second).max((0, 1)) + np.abs(across).max((0, 1)) + np.abs(mixed).max((0, 1))
    assert (bent[:half] > 1e-4).all()
    assert not modes[:, 0, half:].any() and not modes[:, 1, :half].any()


def test_a_perfect_lens_has_no_field():
    for seed in range(2):
        tracks, camera = drive(seed)
        result = calibrate(tracks, facts=FACTS)

        assert result
        assert not any('lens deviates' in note for note in result.notes)


def test_no_field_where_one_is_all_but_absorbed():
    """
    An S-curve of a pitched camera leaves bends of the lens that poses and points absorb.

    Regressors that carry the image noise would explain the residuals by such a bend.
    """
    rng = np.random.default_rng(0)
    camera = Camera([[520, 0, 328], [0, 520, 235], [0, 0, 1]], [-0.12, 0.05, 0, 0], 640, 480)
    heading = np.radians(np.interp(np.linspace(0, 1, 24), [0, 0.5, 1], [0, 30, 0]))
    path = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1) * 0.15, axis=0)
    points = rng.uniform((-12, -12, -1.2), (15, 12, 2.5), (2500, 3))
    tracks = planar_sequence(rng, camera, pitched_mount(np.radians(20)), heading, path, points,
                             0.1, only_inside=True).tracks.with_at_least(3)

    result = calibrate(tracks, facts=FACTS)

    assert result
    assert not any('lens deviates' in note for note in result.notes)
    assert result.sigma['fx'] < 0.5
    assert abs(result.camera.K[0, 0] - 520) < 3 * result.sigma['fx']


def test_a_bent_lens_is_found_and_the_truth_covered():
    covered = []
    for seed in range(2):
        tracks, camera = drive(seed, 0.6)
        result = calibrate(tracks, facts=FACTS)

        assert result
        assert any('lens deviates' in note for note in result.notes)
        sigma = np.sqrt(np.diag(result.covariance))[[0, 2, 3]]
        covered.append((result.camera.parameters - camera.parameters)[[0, 2, 3]] / sigma)

    assert np.abs(covered).max() < 4
    assert np.isfinite(covered).all()


@pytest.mark.long
@pytest.mark.parametrize('bend_px', [2.0, 4.0])
def test_what_bends_more_than_a_lens_is_no_calibration(bend_px):
    tracks, _ = drive(0, bend_px)

    result = calibrate(tracks, facts=FACTS)

    assert not result
    assert 'smoothly over the image' in result.reason and '--lens' in result.advice
    assert not any(word in result.reason for word in ('nan', 'inf'))
