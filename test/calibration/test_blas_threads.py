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
"""Turns about a point beside the camera: right within true sigmas, whatever the start."""

import numpy as np
import pytest

from selfcal_ros.calibration.blas_threads import on_one_thread

threadpoolctl = pytest.importorskip('threadpoolctl')


def threads():
    """Count the threads of each BLAS that is loaded."""
    return [pool['num_threads'] for pool in threadpoolctl.threadpool_info()
            if pool['user_api'] == 'blas']


@on_one_thread
def inside(fails=False):
    """Say what it is told."""
    assert np.isfinite(np.ones((2, 2)) @ np.ones(2)).all()
    if fails:
        raise ValueError('on purpose')
    return threads()


def test_blas_has_one_thread_inside_and_its_own_number_afterwards():
    with threadpoolctl.threadpool_limits(2, 'blas'):
        before = threads()
        assert set(inside()) == {1}
        assert threads() == before
        with pytest.raises(ValueError, match='on purpose'):
            inside(fails=True)
        assert threads() == before
    assert inside.__doc__ == 'Say what it is told.'
