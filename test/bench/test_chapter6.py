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
"""The tables of chapter 6, with few seeds: what is stated holds the truth as often as it says."""

from bench.calibration import coverage
from bench.thesis import chapter6
import numpy as np
import pytest
from scipy.stats import chi2
from selfcal_ros.synthetic.scenes import sequence_si


def allowed(runs):
    """Four binomial standard deviations of a share, and the table's own 0.03."""
    return 4 * np.sqrt(coverage.SHARES * (1 - coverage.SHARES) / runs) + 0.03


@pytest.mark.long
def test_lines_points_and_the_closed_form_lie_in_their_ellipsoids():
    runs = 40
    sequence = sequence_si(np.random.default_rng(0), 0.0)
    truths = chapter6.true_lines(sequence)
    results = [chapter6.one_run(seed, 0.1) for seed in range(runs)]
    for method in ('pairs', 'batch'):
        truths |= {f'v {method}': sequence.vanishing_point, f'l {method}': sequence.horizon}
    for name, truth in truths.items():
        distance = [chapter6.along_sphere(*r[name], truth) for r in results]
        held = np.mean(np.array(distance)[:, None] < chi2.ppf(coverage.SHARES, 2), axis=0)
        assert (np.abs(held - coverage.SHARES) < allowed(runs)).all(), (name, held)
    distance = [x @ np.linalg.solve(covariance, x) for x, covariance in (r['K'] for r in results)]
    held = np.mean(np.array(distance)[:, None] < chi2.ppf(coverage.SHARES, 4), axis=0)
    assert (np.abs(held - coverage.SHARES) < allowed(runs)).all()


def test_true_lines_are_the_screw_axes_of_the_pairs():
    sequence = sequence_si(np.random.default_rng(0), 0.0)
    found = chapter6.one_run(0, 1e-6)
    for name, truth in chapter6.true_lines(sequence).items():
        x = found[name][0]
        assert np.abs(np.cross(x, truth / np.linalg.norm(truth))).max() < 1e-5, name


# the plain case at 0.3 px is that of `si_triplet`, in test_bench_smoke
@pytest.mark.long
@pytest.mark.parametrize('case', [
    coverage.Case(3, 1.0), coverage.Case(3, 0.3, outliers=0.1),
    coverage.Case(3, 0.3, distortion='radial2'),
    coverage.Case(3, 0.3, ('aspect_ratio', 'skew', 'principal_point'), soft=True)],
    ids=coverage.Case.name)
def test_the_true_camera_lies_in_the_ellipsoids_of_the_stated_covariance(case):
    # all distances together know the scale of a covariance better than shares of twice the runs
    runs = 10
    done = [r for r in (coverage.one_run(seed, case) for seed in range(runs)) if r[0] is not None]
    assert len(done) >= runs - 1
    distance, size = coverage.distances(done)
    least, most = chi2.ppf([1e-3, 1 - 1e-3], size * len(done))
    assert least < distance.sum() < most
    assert (np.abs(coverage.shares(done) - coverage.SHARES) < allowed(len(done))).all()


def test_every_combination_of_facts_is_in_the_table():
    assert len(coverage.all_facts()) == 7
    names = {case.name() for case in coverage.cases()}
    assert len(names) == 10 and len(coverage.cases()) == 90
    assert coverage.free_parameters(coverage.Case(3, 0.1, ('skew', 'principal_point'))) == [0, 1]
