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
"""The slope that the soak bench reports is one that it can see."""

import mmap
import os

from bench.live.soak import allocated_mb, growth
import numpy as np


def test_growth_is_told_from_the_steps_of_an_allocator():
    hours = np.linspace(0.1, 10, 300)
    leak = 150 + 54 * hours + np.random.default_rng(1).normal(0, 0.1, hours.size)
    slope, error = growth(hours, leak)
    assert abs(slope - 54) < 0.1 and slope > 2 * error
    # grown at first, and once by a step
    still = 150 + 60 * np.minimum(hours, 2) + 8 * (hours > 8)
    slope, error = growth(hours, still)
    assert abs(slope) < 2 * error + 1


def test_memory_that_is_used_is_counted_and_what_is_only_promised_is_not():
    before = allocated_mb(os.getpid())
    # of the system: the allocator may have as much that other tests used and gave back
    promised = np.frombuffer(mmap.mmap(-1, 50_000_000, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS),
                             np.uint8)
    assert allocated_mb(os.getpid()) - before < 10
    promised[:] = 1
    assert 45 < allocated_mb(os.getpid()) - before < 60
