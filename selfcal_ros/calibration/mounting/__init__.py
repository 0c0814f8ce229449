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
"""
Where the camera sits on the robot: its pose on the body, metric scale, offset of the clocks.

Poses of the camera come from its images, up to scale, in a world of their own (`camera_poses`).
Poses of the body come from odometry, an arm or motion capture (`body_track`). Closed forms start
the mount from both (`starts`), one maximum-likelihood estimate finishes it (`adjustment`), and
`open_freedoms` tells what these motions leave open. Read `mounting` first; docs/mounting.md has
the mathematics.
"""
