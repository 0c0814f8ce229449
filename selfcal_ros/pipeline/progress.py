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
"""Who hears how far long work has come."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

#: Called as progress(text, done, total): the stage, the number or share that is done, and of how
#: many; the total is None where it is not known.
Progress: TypeAlias = Callable[[str, float, float | None], object]
