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
"""The syntax trees of sources: tests that look for different things share them."""

import ast
from functools import cache
import gc


@cache
def tree_of(path):
    """Parse a file; whoever asks again gets the same tree, which nobody changes."""
    return ast.parse(path.read_text(encoding='utf-8'), str(path))


@cache
def trees_in(*folders):
    """
    Return the tree of every source under some folders, by its path.

    The collector of garbage would look at all of them again and again while they grow, which
    takes longer than to parse them; afterwards it leaves them alone.
    """
    running = gc.isenabled()
    gc.disable()
    try:
        return {path: tree_of(path) for folder in folders
                for path in sorted(folder.rglob('*.py'))}
    finally:
        gc.freeze()
        if running:
            gc.enable()
