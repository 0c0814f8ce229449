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
What the faces of the object look like, learned while it is tracked. Ours, not the thesis's.

Read `texture_memory` first: pictures of the faces, followed into the next image. `surface_views`
does the same for curved surfaces, which have no plane faces. `corner_fit`
makes a pose of the corners followed, `view_memory` finds a lost object again.
"""
