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
"""What a user may state of poses and mount in words, for the command line and the nodes."""

from __future__ import annotations

from math import radians
import re

from selfcal_ros.calibration.mount import MountFacts
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera_facts import LARGEST_SIGMA, LEAST_SIGMA

#: Parts of a mount that can be stated, with their units.
PARTS = {'x': 'm', 'y': 'm', 'z': 'm', 'roll': 'degrees', 'pitch': 'degrees', 'yaw': 'degrees',
         'scale': '', 'time_offset': 's'}
_ANGLES = ('roll', 'pitch', 'yaw')
_FACT = re.compile(r'^(\w+)=([^:]+)(?::(.+))?$')


def stated_sigmas(text: str | None) -> tuple[float | None, float | None]:
    """
    Read metres and degrees of --robot-sigma, such as 0.001:0.05; nothing of nothing.

    Returns
    -------
    position_m, rotation_rad : float or None

    Raises
    ------
    ArgumentError
        If it is no such pair.

    """
    if not text:
        return None, None
    words = text.split(':')
    numbers = [_number(word) for word in words]
    if len(numbers) != 2 or not all(
            number is not None and LEAST_SIGMA <= number <= LARGEST_SIGMA for number in numbers):
        raise ArgumentError(f'--robot-sigma takes metres and degrees, such as 0.001:0.05, not '
                            f'{text!r:.40}.')
    return numbers[0], radians(numbers[1] or 0.0)


def mount_facts(texts: list[str]) -> MountFacts:
    """
    Return what is stated of the mount.

    Parameters
    ----------
    texts : list of str
        NAME=VALUE:SIGMA or NAME=VALUE each; angles in degrees.

    Returns
    -------
    MountFacts

    Raises
    ------
    ArgumentError
        If one is no such fact.

    """
    stated: dict[str, tuple[float, float]] = {}
    for text in texts:
        match = _FACT.match(text)
        value = match and _number(match[2])
        sigma = match and (0.0 if match[3] is None else _number(match[3]))
        if not match or match[1] not in PARTS or value is None or sigma is None:
            raise ArgumentError(f'--mount-fact takes NAME=VALUE or NAME=VALUE:SIGMA with one of '
                                f'{", ".join(PARTS)}, such as z=0.52:0.01; got {text!r:.40}.')
        if match[1] in stated:
            raise ArgumentError(f'--mount-fact states {match[1]} twice; leave one out.')
        turn = match[1] in _ANGLES
        stated[match[1]] = (radians(value), radians(sigma)) if turn else (value, sigma)
    return MountFacts(**stated)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
