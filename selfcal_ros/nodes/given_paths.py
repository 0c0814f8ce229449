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
Paths as users give them to nodes and launch files.

A shell leaves ~ alone after `bag:=`, so that it is for us to put the home folder in its place.
"""

from __future__ import annotations

from os.path import expanduser

from selfcal_ros.pipeline.several_objects import several


def given_path(text: str) -> str:
    """Return a path with the home folder in place of ~."""
    return expanduser(text)


def model_paths(text: str) -> list[str]:
    """
    Return the paths of the parameter model, which are parted by commas.

    Raises
    ------
    ArgumentError
        If there is nothing between two commas.

    """
    return [given_path(path) for path in several(given_path(text))]
