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
from selfcal_ros.synthetic.lap_scenes import laps


# an exception, and two refusals: starts by a wrong focal length cannot close the loop
@pytest.mark.parametrize('seed', [7, 8, 29])
def test_a_drive_that_comes_back_to_its_points_is_calibrated(seed):
    scene = laps(np.random.default_rng(seed))
    found = calibrate(scene.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))

    error = found.camera.parameters[[0, 2, 3]] - scene.camera.parameters[[0, 2, 3]]
    sigma = np.array([found.sigma[name] for name in ('fx', 'cx', 'cy')])
    assert (np.abs(error) < 3 * sigma).all()
    assert sigma[0] < 5e-3 * scene.camera.parameters[0]
