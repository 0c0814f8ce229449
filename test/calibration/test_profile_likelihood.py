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

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.uncertainty import profile_likelihood
from selfcal_ros.synthetic.scenes import sequence_si


@pytest.mark.long
@pytest.mark.parametrize('seed', range(4))
def test_no_valley_leads_beyond_what_facts_with_sigmas_state(seed):
    rng = np.random.default_rng(seed)
    tracks = sequence_si(rng, 1.0, 3).tracks
    stated = {'aspect_ratio': 0.005, 'skew': 5.0, 'cx': 10.0, 'cy': 10.0}
    facts = CameraFacts(
        aspect_ratio=1 + 0.005 * rng.standard_normal(), aspect_ratio_sigma=0.005,
        skew=5 * rng.standard_normal(), skew_sigma_px=5.0,
        principal_point=(400 + 10 * rng.standard_normal(), 300 + 10 * rng.standard_normal()),
        principal_point_sigma_px=10.0, distortion='none')

    result = calibrate(tracks, motion='planar', facts=facts)

    assert result, result.reason
    fx, fy = result.camera.parameters[:2]
    ratio = np.array([-fy, fx]) / fx**2
    sigmas = dict(zip(('cx', 'cy', 'skew'), np.sqrt(np.diag(result.covariance)[2:5])),
                  aspect_ratio=np.sqrt(ratio @ result.covariance[:2, :2] @ ratio))
    for name, sigma in stated.items():
        assert 0 < sigmas[name] < 1.1 * sigma, name


def test_pixels_twice_as_wide_as_high_are_no_accident_that_is_believed():
    """Three views and zero skew: fy of 560 ± 72 was found, where 900 is right and costs little."""
    tracks = sequence_si(np.random.default_rng([767, 1000, 3]), 1.0, 3).tracks

    result = calibrate(tracks, motion='planar', facts=CameraFacts(skew=0.0, distortion='none'))

    assert not result
    assert result.kind == 'parameters_undetermined' and result.status['fy'] == 'unobservable'


def test_a_valley_without_an_optimum_is_left_open_and_not_followed_for_ever(monkeypatch):
    tracks = sequence_si(np.random.default_rng(1), 1.0, 3).tracks
    asked = []

    def better(fit, *_):
        asked.append(fit)
        return fit

    monkeypatch.setattr(profile_likelihood, '_beyond', better)
    result = calibrate(tracks, motion='planar',
                       facts=CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none'))
    assert not result and result.kind == 'parameters_undetermined'
    assert len(asked) == profile_likelihood.MAX_OPTIMA + 1
