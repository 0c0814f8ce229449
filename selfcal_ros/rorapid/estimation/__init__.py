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
Poses from edges and texture, one measurement an image (thesis 7.2.1 and 7.3.1).

Read `robust_tracker` first, the method by default; `rapid_tracker` holds the thesis's own RAPiD
(algorithm 7.1) and RoRAPiD (7.2). `pose_search` searches from many starts, and `arrival` finds
what comes back by its silhouette (`sampled_views`) or its corners (`corner_alignment`).
`outline_watch` and `second_opinion` find poses of meshes that slide. `depth_fit` is what a depth
image adds. `kalman_filter` predicts, `track_quality` judges, and `initial_pose` makes a first pose
of clicked points.
"""
