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
Where the descents of an adjustment stop, by what their states are for.

The unit is sigma² of the cost. A descent that stops at a tolerance t leaves all unknowns together
within about √(2 t) sigma of the optimum (`Bundle.optimise`). The limits of iterations beside them
only bound the time: where a descent is slow, a start or a comparison is not worth more.
"""

#: Of a start, or of a round that a finer one follows: 1.4 sigma.
TO_GO_ON = 1.0
#: To choose among starts, tracks or moving things, which differ by far more: one sigma.
TO_CHOOSE = 0.5
#: To compare costs of starts and lenses that differ by tens: 0.45 sigma.
TO_COMPARE_ROUGHLY = 0.1
#: To compare models by their likelihood, where one unit decides: 0.3 sigma.
TO_COMPARE = 0.05
#: Of an estimate, whose noise and covariance are reported: 0.2 sigma.
TO_ESTIMATE = 0.02
#: Where a small change of the estimate itself is what is looked for: 0.14 sigma.
TO_MEASURE = 0.01
#: Before the noise is known the cost has no scale, and a share of it counts.
SHARE_OF_COST = 2e-3
