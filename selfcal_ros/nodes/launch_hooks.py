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
What our launch files do before and after their nodes.

`launch` is imported where it is called: nodes run without it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from selfcal_ros.nodes.given_paths import given_path
from selfcal_ros.nodes.launch_arguments import launch_problem

if TYPE_CHECKING:
    from launch.action import Action
    from launch.events.process import ProcessExited
    from launch.launch_context import LaunchContext

#: Where Fast DDS looks for its settings: up to version 2 (Jazzy), and from version 3 on (Kilted).
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')


def look_at_arguments(names: Iterable[str]) -> Action:
    """Return the action after which nothing starts where one of these arguments is wrong."""
    from launch.actions import OpaqueFunction
    from launch.substitutions import LaunchConfiguration

    def check(context: LaunchContext) -> None:
        given = context.launch_configurations
        if 'params_file' in given:
            # launch itself passes over a file whose path begins with ~
            given['params_file'] = given_path(given['params_file'])
        values = {name: LaunchConfiguration(name).perform(context) for name in names}
        problem = launch_problem(values)
        if problem:
            raise RuntimeError(problem)
    return OpaqueFunction(function=check)


def end_on_refusal(event: ProcessExited, _: LaunchContext) -> list[Action]:
    """End everything where a node has refused its input or its parameters (status 2)."""
    from launch.actions import Shutdown
    return [Shutdown(reason='a node refused what it was given')] if event.returncode == 2 else []


def dds_settings() -> list[Action]:
    """Return the actions that make nodes find peers at once, with room for large images."""
    from launch.actions import SetEnvironmentVariable
    from launch.substitutions import PathJoinSubstitution
    from launch_ros.substitutions import FindPackageShare
    profile = PathJoinSubstitution([FindPackageShare('selfcal_ros'), 'config', 'fastdds.xml'])
    return [SetEnvironmentVariable(name, profile) for name in PROFILES]
