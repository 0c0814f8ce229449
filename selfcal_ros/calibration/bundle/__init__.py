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
The one estimator: a maximum-likelihood adjustment of a product of blocks.

    u(observation) = lens( path[view] · point )

Blocks are `lens`, `path` (with the kinds of `motion`), `zoom`, `shutter`, `rig` and
`object_poses`. Unknowns have names (`unknowns`), facts are priors on them (`priors`).
`scene_model`, `rig_model` and `object_model` are the products, `bundle` adjusts any of them,
`robust_fit` finds outliers and the noise level. Every method ends here (thesis 6.3 asks for it).
Read `model` first, then `bundle`.
"""
