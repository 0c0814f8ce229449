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
"""The bench of shares counts what it is given, and its worlds give what it counts."""

from bench.calibration import rough_shares
from bench.calibration.suppositions import WORLDS
from bench.lenses.lens_population import profile_path
from bench.tables import Report
import numpy as np
import pytest

pytestmark = pytest.mark.skipif(
    not WORLDS.exists() or profile_path() is None,
    reason='needs ../shared/data/lens_profiles.csv and ../shared/world_cases.py')


def _run(error, readout_ms=None):
    fields = {'refused': '', 'error': error, 'covariance': np.diag([4.0, 1.0, 1.0]).tolist()}
    return fields if readout_ms is None else {**fields, 'readout_ms': readout_ms,
                                              'readout_sigma_ms': 0.5}


def test_a_line_counts_shares_refusals_and_what_is_far_off():
    rng = np.random.default_rng(3)
    runs = [_run((rng.standard_normal(3) * [2, 1, 1]).tolist(), 5 + 0.5 * rng.standard_normal())
            for _ in range(400)]
    line = rough_shares.row(Report(), 'hand, read in 5 ms',
                            [*runs, _run([9.0, 0.0, 0.0], 5.0), {'refused': 'points_behind'}])

    name, count, refused, *held = line[:7]
    assert (count, refused) == (401, 1)
    np.testing.assert_allclose([float(share) for share in held], rough_shares.SHARES, atol=0.07)
    assert line[11] == 1 and float(line[10]) == 4.5
    assert line[12].startswith('5.0') and float(line[14]) == pytest.approx(1, abs=0.15)


def test_sigmas_that_are_too_small_miss():
    rng = np.random.default_rng(4)
    report = Report()
    rough_shares.row(report, 'hand, read in 5 ms', [
        _run((1.5 * rng.standard_normal(3) * [2, 1, 1]).tolist()) for _ in range(300)])
    assert report.failures


def test_a_run_has_the_camera_with_the_aspect_ratio_that_is_stated_with_a_sigma():
    run = rough_shares.one_run(('hand, aspect ratio ± 0.005', 11))

    error, covariance = np.array(run['error']), np.array(run['covariance'])
    assert not run['refused'] and covariance.shape == (3, 3)
    assert (np.abs(error) < 4 * np.sqrt(np.diag(covariance))).all()
    assert len(rough_shares.troubles()) == 13


@pytest.mark.long
def test_a_head_is_no_path_that_leaves_out_what_contradicts_it():
    """A free path left 5 % less noise without a tenth of the observations: 6.3 sigmas off."""
    run = rough_shares.one_run(('head, lever of 8 cm', 549))

    error, covariance = np.array(run['error']), np.array(run['covariance'])
    assert 'tracks_moving' not in run['findings']
    assert (np.abs(error) < 4 * np.sqrt(np.diag(covariance))).all()
