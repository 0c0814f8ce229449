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
"""One chain of corrections: every motion has the shared ones in their order, or says why not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from selfcal_ros import CameraFacts
from selfcal_ros.calibration.bundle.motion import GENERAL, PIVOT
from selfcal_ros.calibration.estimators.model_selection import ModelDecision
from selfcal_ros.calibration.estimators.rotation_corrections import rotation_corrections
from selfcal_ros.calibration.estimators.supported_optimum import corrections
from selfcal_ros.calibration.uncertainty import assessed_estimate
from selfcal_ros.calibration.uncertainty.assessed_estimate import (
    allow_for_prism, allow_for_segments, AssessedEstimate, Chain, SHARED)
from selfcal_ros.calibration.uncertainty.cluster_covariance import ClusterCovariance

CLUSTERS = ClusterCovariance({'track': 1.5, 'region': 1.2}, np.eye(2))


def estimate(**values):
    """Return an estimate without an adjustment behind it."""
    return AssessedEstimate(None, (640, 480), CLUSTERS, None, CLUSTERS.covariance, None,
                            CLUSTERS.findings(), **values)


def test_a_chain_lacks_no_shared_correction_in_silence():
    for steps in (SHARED[1:], SHARED[::-1], (*SHARED, allow_for_prism)):
        with pytest.raises(ValueError, match='every shared correction'):
            Chain(steps)
    own = (lambda found: found)
    assert Chain((own, *SHARED)).steps == (own, *SHARED)


def test_steps_run_one_after_another(monkeypatch):
    # the shared ones need an adjustment
    monkeypatch.setattr(assessed_estimate, 'SHARED', ())

    def doubled(found):
        return replace(found, covariance=2 * found.covariance)

    def wider(found):
        return found.widened(np.eye(2))

    for steps, expected in (((doubled, wider), 3.0), ((wider, doubled), 4.0)):
        assert Chain(steps).applied_to(estimate()).covariance[0, 0] == expected


def test_motions_add_steps_of_their_own():
    model = ModelDecision(None, np.ones(2, bool), (), None, np.eye(2), True, 1.0, 2 * np.eye(2))
    problems = [SimpleNamespace(motion=motion, is_weak=motion is PIVOT, instants=(0.0, 1.0),
                                facts=CameraFacts()) for motion in (GENERAL, PIVOT)]
    general, pivot = (corrections(model, problem).steps for problem in problems)
    assert len(general) == len(SHARED) + 2 and len(pivot) == len(SHARED) + 3
    # what was chosen on the way counts as often as errors count
    # but for a line delay, which holds them
    assert general[2](estimate()).covariance[0, 0] == 1 + CLUSTERS.variance_inflation + 2
    turned, missed = (rotation_corrections(may_miss, np.eye(2)).steps
                      for may_miss in (False, True))
    assert len(missed) == len(turned) + 1 and missed[-2] is turned[-1]


def test_what_segments_were_found_to_add_is_not_sought_again():
    found = allow_for_segments(estimate(jackknife=(1.3, 3 * np.eye(2))))
    assert found.covariance[0, 0] == 4.0
    assert [one.kind for one in found.findings][-1] == 'errors_within_segment'


def test_variances_are_inflated_by_tracks_and_regions_together():
    assert CLUSTERS.variance_inflation == pytest.approx(1 + 1.25 + 0.44)
    assert CLUSTERS.sigma_inflation**2 == pytest.approx(CLUSTERS.variance_inflation)
