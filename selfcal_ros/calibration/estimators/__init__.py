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
From tracks to a result, one file a kind of motion, and the tests that a result must pass.

Read `motion_choice` for the choice of the motion, and `motion_calibration` for what is tried of a
path: each is a list of attempts in order. `one_motion` is the whole chain of one motion, and
`acceptance` has the reasons of a refusal.
"""
