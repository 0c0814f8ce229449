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
"""A ROS domain for the tests of one process."""

from contextlib import contextmanager
import socket

import pytest


@contextmanager
def reserved_domain():
    """Reserve a domain among all tests of this machine; ids up to 101 are safe everywhere."""
    for number in range(1, 102):
        # a name in the same network name space as DDS, of all users, gone with the process
        with socket.socket(socket.AF_UNIX) as lock:
            try:
                lock.bind(f'\0selfcal_ros_domain_{number}')
            except OSError:
                continue
            yield number
            return
    pytest.fail('all ROS domains are taken by other tests')
