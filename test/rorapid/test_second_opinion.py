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
"""Poses of plain parts before walls that share their greys: not called tracked where they slid."""

from __future__ import annotations

from bench.tracking.tracking_walls import follow
import pytest
from selfcal_ros.rorapid.tracker import TrackerState


@pytest.mark.long
def test_a_pose_that_the_edges_would_leave_is_asked_again():
    """
    Of 100 images 21 were called tracked and wrong (d² above 50).

    Of the ring, which is the harder one, 3 to 4 are: kernels of BLAS and OpenCV differ.
    """
    followed = [one for part, wall, seed in (('lever', 'slope', 21), ('ring', 'stripes', 6))
                for one in follow(part, wall, seed)]
    assert sum(one.is_wrong for one in followed) <= 6
    assert sum(one.state is TrackerState.TRACKING for one in followed) >= 40


def test_a_handle_before_its_mug_tells_how_far_the_mug_is_turned():
    """Its outline alone left it 11 degrees off: 45 images were called tracked and wrong."""
    followed = follow('mug', 'grey', 62)
    assert sum(one.is_wrong for one in followed) <= 3
    assert sum(one.state is TrackerState.TRACKING for one in followed) >= 45
