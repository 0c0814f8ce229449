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
"""Short clips turn as far as they say, drift as patches do, and are never beyond four sigmas."""

from bench.calibration import short_clips
from bench.calibration.short_clips import clip, EVERY, MAX_SIGMAS, one_run
import numpy as np
import pytest


def test_patches_drift_beside_the_noise_of_each_image():
    still, moved = (clip(np.random.default_rng(1), 'room', 'hand', 3.0, walk_px=walk_px,
                         noise_px=1e-9) for walk_px in (1e-9, 0.03))
    one = dict(zip(zip(still.frame.tolist(), still.track.tolist()), still.xy))
    apart = {(f, t): xy - one[f, t] for f, t, xy in zip(
        moved.frame.tolist(), moved.track.tolist(), moved.xy) if (f, t) in one}
    steps = np.array([apart[f + EVERY, t] - apart[f, t]
                      for f, t in apart if (f + EVERY, t) in apart])
    usual = 1.4826 * np.median(np.abs(steps))
    assert 0.9 < usual / (0.03 * np.sqrt(EVERY)) < 1.1


@pytest.mark.long
def test_a_clip_is_true_and_green_only_where_it_is_sure(monkeypatch):
    monkeypatch.setattr(short_clips, 'POINTS', 80)
    status, _, turn_deg, worst, share = one_run(('room', 'hand', 'auto', 3))
    assert status in ('calibrated', 'hint') and 2 < turn_deg < 15
    assert worst < MAX_SIGMAS and (status == 'hint') == (share > 0.01)
