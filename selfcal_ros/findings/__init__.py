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
What is found out, as data; and the words for it, all in this one place.

A `Finding` is a kind and its values. Refusals and warnings are findings everywhere in the package,
from the closed forms of the geometry to the command line. Programs switch on the kind.

The words stand below all other storeys, next to the errors. Every storey makes findings, the
geometry too, and whatever is made must be able to print itself without the reports above it. The
tables hold a phrase for each kind: `refusals` (why there is no calibration), `closed_forms` (why
one step gives no estimate) and `remarks` (what a user should know of a result). The page
docs/troubleshooting.md is made from them. Read `finding` first.
"""
