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
"""Why ROS did not start, in a sentence for who typed the command."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
import re

#: What rcl says of a file of parameters, and where in its source.
_PARAMETERS = re.compile(r"Couldn't parse params file: '--params-file (.*?)'\. Error: (.*)", re.S)
_RULE = re.compile(r"Couldn't parse (remap|parameter override) rule: '-[rp] (.*?)'\.", re.S)
_PLACE = re.compile(r', at \S+\.c(?:pp)?:\d+')
#: Domains are numbered up to here; their ports would not fit otherwise.
LAST_DOMAIN = 232
#: How each kind of rule is written.
_FORMS = {'remap': '-r FROM:=TO', 'parameter override': '-p NAME:=VALUE'}


@contextmanager
def unheard() -> Iterator[None]:
    """Let rcl print nothing of its own while ROS starts; its error is told by `start_failure`."""
    from rclpy.logging import LoggingSeverity, set_logger_level
    set_logger_level('rcl', LoggingSeverity.FATAL)
    try:
        yield
    finally:
        set_logger_level('rcl', LoggingSeverity.UNSET)


def domain_problem(given: str) -> str:
    """
    Say why there is no such domain; '' if there is one, or ROS says itself what is wrong.

    Fast DDS ends the process where the ports of a domain would be beyond 65535.

    Parameters
    ----------
    given : str
        The variable ROS_DOMAIN_ID.

    """
    if not given.strip().isdecimal() or int(given) <= LAST_DOMAIN:
        return ''
    return f'ROS_DOMAIN_ID must be from 0 to {LAST_DOMAIN}, not {given.strip():.20}.'


def start_failure(error: Exception) -> str:
    """
    Return the sentence for an error of `rclpy.init`.

    Parameters
    ----------
    error : Exception
        Of a private class of rclpy: a broken file of parameters, or an unwritable log.

    """
    if type(error).__name__ == 'UnknownROSArgsError':
        return f'ROS knows no argument {str(error):.80}; leave it out, or put -- before it.'
    text = ' '.join(_PLACE.sub('', str(error)).split()).removeprefix('failed to initialize rcl: ')
    found = _PARAMETERS.match(text)
    rule = _RULE.match(text)
    if rule and rule[2].startswith('__ns:=') and rule[2][6:7] != '/':
        return f'A namespace begins with a slash; write --ros-args -r __ns:=/{rule[2][6:]:.60}.'
    if rule and ':=' in rule[2] and not rule[2].endswith(':='):
        return f'{rule[2]:.80} holds a name that ROS cannot take; use letters, digits, _ and /.'
    if rule:
        return f'{rule[2]:.80} is no rule of ROS; write --ros-args {_FORMS[rule[1]]}.'
    if not found:
        return f'ROS did not start: {text.rstrip(" .")}.'
    path, why = found[1], found[2].rstrip(' .')
    if not os.path.exists(path):
        return f'The parameter file {path} does not exist; name another.'
    if os.path.isdir(path):
        return f'The parameter file {path} is a folder; name a file in it.'
    return (f'The parameter file {path} cannot be read ({why}); it holds NODE:, in it '
            'ros__parameters:, and in that NAME: VALUE.')
