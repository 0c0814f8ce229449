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
What is object and what is not: the part of an image around it, and both sides of its outline.

Ours, not the thesis's. `region_of_interest` cuts the part out, without lens distortion, at a scale
that is fast; texture is compared in it. `outline_greys` knows the grey levels of both sides,
and `background_change` the scene without the object.
"""
