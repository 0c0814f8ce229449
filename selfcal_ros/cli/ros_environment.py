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
"""The environment of ROS processes that a command starts."""

from __future__ import annotations

from collections.abc import Mapping
import os
from pathlib import Path
import sys

from selfcal_ros.cli.colours import wants_colour

#: Where Fast DDS looks for its settings: up to version 2 (Jazzy), and from version 3 on (Kilted).
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')


def ros_environment(profile: Path) -> dict[str, str]:
    """Return the environment with our settings of Fast DDS, where the user has none."""
    environment = dict(os.environ)
    for name in PROFILES:
        environment.setdefault(name, str(profile))
    environment.setdefault('RCUTILS_CONSOLE_OUTPUT_FORMAT', '[{name}] {message}')
    return environment


def own_graph(profile: Path, log: Path) -> Mapping[str, str]:
    """Return that of a graph of our own, which neither hears nor disturbs robots around."""
    environment = {**ros_environment(profile), **dict.fromkeys(PROFILES, str(profile)),
                   'ROS_DOMAIN_ID': str(1 + os.getpid() % 100)}
    environment.setdefault('ROS_LOG_DIR', str(log.absolute()))
    if wants_colour(sys.stderr):
        # what nodes say comes to the terminal through a pipe
        environment.setdefault('RCUTILS_COLORIZED_OUTPUT', '1')
    return environment
