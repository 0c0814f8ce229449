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
"""How a camera moved, as a result names it."""

from __future__ import annotations

from typing import Literal, TypeAlias

#: The motions of results, `motion` of result.json; `unknown` where a refusal cannot tell.
Motion: TypeAlias = Literal['none', 'rotation', 'pivot', 'translation', 'planar', 'circular',
                            'general', 'known-object', 'unknown']
