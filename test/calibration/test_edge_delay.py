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
"""The line delay of a rolling shutter from edges of an object that moves meanwhile."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros.calibration.bundle.edge_rows import EdgeRows
from selfcal_ros.calibration.known_object.edge_calibration import calibrate_from_edges

from .test_edge_calibration import CAMERA, cube_edges, FACTS, sigmas, start

ROWS, INTERVAL_S = 480, 1 / 30
#: How fast the image of the object moves, pixels a second.
SPEED = 300.0


def moving_edges(seed, line_delay_s, supposed_s=0.0, noise_px=0.2, views=12, lines='rows'):
    """Measure edges of a cube that moves otherwise in every view."""
    rng = np.random.default_rng([seed, 31])
    edges = cube_edges(rng, noise_px, views)
    axis, middle = (1, 239.5) if lines == 'rows' else (0, 319.5)
    slope = rng.normal(0, SPEED, (views, 2))[edges.frame] * (edges.xy[:, axis] - middle)[:, None]
    # the edgels come as they would be for a line delay that is supposed
    return replace(edges, xy=edges.xy + (line_delay_s - supposed_s) * slope,
                   rows=EdgeRows(supposed_s, slope, lines, INTERVAL_S))


@pytest.mark.parametrize('readout_s, supposed_s, lines', [
    (0.02, 0.0, 'rows'), (0.02, 0.015, 'rows'), (-0.008, 0.0, 'rows'), (0.03, 0.03, 'columns')])
def test_a_rolling_shutter_is_found_and_undone(readout_s, supposed_s, lines):
    count = ROWS if lines == 'rows' else 640
    result = calibrate_from_edges(
        moving_edges(1, readout_s / count, supposed_s / count, lines=lines), start(), facts=FACTS)
    found = result.shutter
    assert (found.status, found.lines, found.rows) == ('estimated', lines, count)
    assert abs(found.readout_s - readout_s) < 3 * count * found.sigma_s < 0.002
    assert found.intervals == pytest.approx(found.readout_s / INTERVAL_S)
    assert np.abs(sigmas(result)).max() < 3


def test_a_global_shutter_is_called_one_and_costs_no_sigma():
    for seed in range(8):
        views = moving_edges(seed, 0.0)
        result = calibrate_from_edges(views, start(), facts=FACTS)
        still = calibrate_from_edges(replace(views, rows=None), start(), facts=FACTS)
        assert result.shutter is None
        assert np.allclose(result.covariance, still.covariance)


def test_line_delay_and_camera_lie_within_their_sigmas():
    found = []
    for seed in range(14):
        result = calibrate_from_edges(moving_edges(seed, 4e-5), start(), facts=FACTS)
        found.append([(result.shutter.line_delay_s - 4e-5) / result.shutter.sigma_s,
                      *sigmas(result)])
    # 56 numbers know their spread to a tenth
    assert 0.7 < np.sqrt(np.mean(np.square(found))) < 1.35


def test_facts_are_heeded():
    views = moving_edges(3, 4e-5)
    stated = calibrate_from_edges(views, start(), facts=replace(FACTS, line_delay_s=4e-5))
    assert stated.shutter is None and np.abs(sigmas(stated)).max() < 3
    held = calibrate_from_edges(views, start(), facts=replace(FACTS, shutter='global'))
    assert not held or held.noise_sigma_px > 2 * stated.noise_sigma_px
    asked = calibrate_from_edges(moving_edges(3, 0.0), start(),
                                 facts=replace(FACTS, shutter='rolling'))
    assert abs(asked.shutter.line_delay_s) < 3 * asked.shutter.sigma_s
    assert np.abs(asked.camera.K - CAMERA.K).max() < 5
