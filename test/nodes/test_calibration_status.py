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
"""What diagnostics say of a session."""

from msg_adapters.diagnostics import OK, WARN
from selfcal_ros.calibration.result import HINT, NotCalibrated
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.nodes.calibration_status import calibration_status
from selfcal_ros.pipeline.calibration_session import SessionSnapshot


def snapshot(**changes):
    return SessionSnapshot(**{
        'frames': 10, 'keyframes': 5, 'new_keyframes': 0, 'points': 100,
        'image_size': (640, 480), 'estimates': 1, 'resets': 0, 'estimating': False,
        'abandoned': False, 'calibration': None, 'failure': None, **changes})


def test_a_hint_is_a_warning_with_its_sentence_and_without_a_camera():
    hint = NotCalibrated.of(NoEstimate(HINT, turned_deg=5.6, focal_px=620.0, sigma_px=30.0))
    level, text, values = calibration_status(snapshot(failure=hint))
    assert level == WARN != OK and 'fx' not in values
    assert text.startswith('A hint, no calibration: The camera turned by 5.6 degrees in all')
    assert '620 ± 30 px' in text and '20 degrees or more' in text
