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
"""The words of why it is not known where the camera sits on the robot."""

from __future__ import annotations

from selfcal_ros.findings.phrase import Phrase

MOUNTING: dict[str, Phrase] = {
    'gyro_without_poses': Phrase(
        'The turns of the camera come without their instants or their covariance.',
        'A gyro is compared with turns between images. It needs a stamp of every image, and how '
        'well each turn is known.',
        'Give a bag, or images with time stamps, of a camera that moves before an unknown scene.'),
    'gyro_covers_too_little': Phrase(
        'The gyro covers {intervals} of the intervals between images; at least {least} are '
        'needed.',
        'It was recorded at another time than the images, or with long gaps.',
        'Record images and gyro together, by clocks that differ by less than half a second.'),
    'gyro_contradicts': Phrase(
        'The gyro contradicts the turns of the camera: {dropped} of {intervals} intervals were '
        'set aside, and the rest differ by {density_deg:.2g}° in a second.',
        'It is on another body, its axes are left-handed, or its clock is not that of the images.',
        'Check the topic of the gyro, its axes, and that it reports radians a second.'),
    'gyro_leaves_an_axis_open': Phrase(
        'The camera turned about one axis only, so that it may be turned against the gyro about '
        'that axis by any angle (± {sigma_deg:.2g}°).',
        'Turns about one axis look alike to a camera that is turned about that axis.',
        'Turn about a second axis, too.'),
    'gyro_tells_no_place': Phrase(
        'A gyro measures no place and no length.',
        'It measures turns only.',
        'Give poses of the body: odometry, an arm, or motion capture.'),
    'gyro_turns_evenly': Phrase(
        'The turns are too even to tell the offset of the clocks.',
        'While a body turns at a steady rate, a later instant looks like an earlier one.',
        'Turn to and fro, so that the rate of turning changes.'),
}
