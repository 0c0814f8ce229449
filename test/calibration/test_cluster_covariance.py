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
"""ClusterCovariance of errors: seen where it is, not seen where it is not."""

import numpy as np

import pytest
from selfcal_ros import calibrate, CameraFacts, Tracks
from selfcal_ros.calibration.uncertainty.cluster_covariance import jackknife_excess
from selfcal_ros.synthetic.scenes import sequence_si

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')


def test_independent_noise_is_not_widened():
    notes = []
    for seed in range(10):
        sequence = sequence_si(np.random.default_rng(seed), 0.2, views=8)
        notes += calibrate(sequence.tracks, facts=FACTS).notes

    assert sum('shared' in note for note in notes) <= 1


@pytest.mark.long
def test_drift_within_tracks_is_seen_and_covered():
    """Errors that grow along a track: the sigma widens, and holds the truth."""
    deviations, found = [], 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        sequence = sequence_si(rng, 0.1, views=8)
        tracks = sequence.tracks
        drift = rng.standard_normal((len(sequence.points), 2))
        xy = tracks.xy + 0.1 * drift[tracks.track] * (tracks.frame - 3.5)[:, None]
        result = calibrate(Tracks(tracks.frame, tracks.track, xy, tracks.image_size), facts=FACTS)
        found += any('within a track' in note for note in result.notes)
        deviations.append((result.camera.K[0, 0] - 900) / result.sigma['fx'])

    assert found >= 5
    assert np.sqrt(np.mean(np.square(deviations))) < 1.6


def test_stretches_that_agree_add_nothing():
    rng = np.random.default_rng(0)
    covariance = np.diag([1.0, 4.0, 0.0])
    # leaving out one of seven groups of independent data
    without = np.tile(covariance * 7 / 6, (7, 1, 1))
    shifts = rng.standard_normal((7, 3)) * np.sqrt(np.diag(covariance) / 6)

    assert jackknife_excess(shifts, without, covariance)[0] == 1
    ratio, more = jackknife_excess(5 * shifts, without, covariance)
    assert 3 < ratio < 7
    assert not more[2].any()
    assert np.linalg.eigvalsh(more).min() > -1e-9
