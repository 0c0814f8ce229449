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
"""The bend of a model against simulation, and where it is looked at."""

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.estimators import model_selection as model_choice
from selfcal_ros.calibration.uncertainty.second_order import mean_square_offset
from selfcal_ros.geometry.camera import PARAMETER_NAMES
from selfcal_ros.synthetic.scenes import sequence_si

#: Of a covariance of all parameters.
COVARIANCE_SHAPE = (len(PARAMETER_NAMES),) * 2

FACTS = CameraFacts(aspect_ratio=1.0, distortion='radial2')


def test_the_mean_square_of_the_bend_is_that_of_a_simulation():
    rng = np.random.default_rng(0)
    size = 4
    second = 0.3 * rng.standard_normal((size,) * 3)
    second += second.transpose(0, 2, 1)
    # of a model u + second(u, u) / 2 the information is JᵀJ with J = I + second(u)
    slopes = np.einsum('ljk->jkl', second) + np.einsum('kjl->jkl', second)
    u = rng.standard_normal((200_000, size))
    bends = 0.5 * np.einsum('kij,ni,nj->nk', second, u, u)
    drawn = bends[:, :, None] * bends[:, None]
    spread = drawn.std(axis=0) / np.sqrt(len(u))
    assert (np.abs(mean_square_offset(slopes) - drawn.mean(axis=0)) < 4 * spread).all()


@pytest.mark.long
@pytest.mark.parametrize('noise_px, bent', [(0.1, False), (1.0, True)])
def test_only_what_is_determined_badly_bends(monkeypatch, noise_px, bent):
    tracks = sequence_si(np.random.default_rng(3), noise_px).tracks
    curved = calibrate(tracks, motion='planar', facts=FACTS)
    monkeypatch.setattr(model_choice, 'second_order_covariance',
                        lambda *_: np.zeros(COVARIANCE_SHAPE))
    flat = calibrate(tracks, motion='planar', facts=FACTS)

    assert np.array_equal(curved.camera.parameters, flat.camera.parameters)
    free = [0, 2, 3, 4, 5, 6]
    units = np.sqrt(np.diag(flat.covariance)[free])
    more = (curved.covariance - flat.covariance)[np.ix_(free, free)] / np.outer(units, units)
    values = np.linalg.eigvalsh(more)
    if not bent:
        assert not more.any()
        return
    assert values[0] > -1e-9 and 0.01 < values[-1] < 0.5
    # across the surface, where the ellipsoid is thin, it counts most
    thin = np.linalg.eigh(flat.covariance[np.ix_(free, free)] / np.outer(units, units))
    inside = thin[1].T @ more @ thin[1] / np.sqrt(np.outer(thin[0], thin[0]))
    assert np.argmax(np.diag(inside)) == 0 and inside[0, 0] > 0.2
