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
A model of an object from two images between which the camera moved (thesis 7.3.4).

Read `two_view_model` first: vertices in two images in, a wireframe with covariances out.
`line_matching` finds these vertices by itself, `picked_vertices` reads those picked by hand;
`plane_loops` makes faces of lines, `point_covariance` says how well all is known.
"""
