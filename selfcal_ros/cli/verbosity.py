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
"""-v and -q: how much the library says on standard error while it works."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
import logging
import sys

#: All loggers of the package are below this one.
LIBRARY = 'selfcal_ros'


def add_verbose_argument(parser: argparse.ArgumentParser) -> None:
    """Add -v, which every verb has."""
    parser.add_argument('-v', '--verbose', action='count', default=0,
                        help='tell on standard error what is done; -vv tells of every image')


def add_quiet_argument(parser: argparse._ActionsContainer,
                       what: str = 'print nothing but errors and the reason of a failure') -> None:
    """Add -q to a verb, or to a group of its arguments."""
    parser.add_argument('-q', '--quiet', action='store_true', help=what)


@contextmanager
def library_messages(args: argparse.Namespace) -> Iterator[None]:
    """Show the messages of the library as the arguments say, until the work is done."""
    verbose = getattr(args, 'verbose', 0)
    level = (logging.ERROR if getattr(args, 'quiet', False) else
             {0: logging.WARNING, 1: logging.INFO}.get(verbose, logging.DEBUG))
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter('%(levelname)s %(name)s: %(message)s'))
    handler.setLevel(level)
    logger, before = logging.getLogger(LIBRARY), logging.getLogger(LIBRARY).level
    logger.addHandler(handler)
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
