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
"""What the report says of single observations agrees with what the calibration says of all."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.structure.metric_structure import metric_structure
from selfcal_ros.report.observations import observations
from selfcal_ros.report.worst import fit_of_images
from selfcal_ros.synthetic.rolling_scenes import drive, hand, record

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2')


def recorded(readout_s, kind, step_s=0.2, views=24, seed=0, **options):
    rng = np.random.default_rng([seed, 5])
    return record(rng, kind(rng), readout_s, 0.1 + step_s * np.arange(views), points=110,
                  **options).tracks


def upright(tracks):
    """Turn the images by 90 degrees: the former rows run from left to right."""
    xy = np.column_stack([tracks.xy[:, 1], 639 - tracks.xy[:, 0]])
    return replace(tracks, xy=xy, image_size=(480, 640))


def stabilised(tracks):
    """Shift every image by itself."""
    shift = np.random.default_rng(3).normal(0, 3, (tracks.frame.max() + 1, 2))
    return replace(tracks, xy=tracks.xy + shift[tracks.frame])


CASES = {
    'hand': lambda: (recorded(-0.03, hand), {'rolling_shutter'}),
    'video': lambda: (recorded(0.02, hand, interval_s=1 / 30), {'rolling_shutter'}),
    'columns': lambda: (upright(recorded(0.02, hand)), {'rolling_shutter'}),
    'turns': lambda: (recorded(0.02, partial(hand, shift_m=0.0)), {'rolling_shutter'}),
    'far apart': lambda: (recorded(0.025, hand, 1.1, 12), {'rows_by_view'}),
    'stabilised': lambda: (stabilised(recorded(0.0, hand, 0.5, 20)), {'images_shifted'}),
    'all rows at once': lambda: (recorded(0.0, drive), set()),
}


@pytest.mark.long
@pytest.mark.parametrize('case', CASES)
def test_observations_fit_as_the_calibration_says(case):
    # with all rows at once a hand read in 30 ms left 3.2 px in place of 0.26
    tracks, told = CASES[case]()
    result = calibrate(tracks, facts=SQUARE)
    table = observations(result, tracks)
    rms_px = np.sqrt(np.mean(np.sum(table.residual[table.used]**2, axis=1)))

    assert told <= {finding.kind for finding in result.findings}
    assert rms_px == pytest.approx(result.reprojection_rms_px, rel=0.1)
    # how the camera moved at both ends has no witness on one side
    assert len(metric_structure(result, tracks).points) > (
        0.9 * len(result.reconstruction.points) if result.motion != 'rotation' else -1)
    assert fit_of_images(result, table).rejected[1:-1].sum() <= 0.01 * len(tracks.frame)
