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
"""--start, --duration and --every: options of every command that reads images."""

from __future__ import annotations

import argparse

from selfcal_ros.pipeline.excerpt import Excerpt, HALVES


def add_excerpt_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose a part of the recording."""
    group = parser.add_argument_group('part of the recording')
    group.add_argument('--start', type=float, default=0.0, metavar='S',
                       help='pass over the first S seconds (image files count as 30 a second)')
    group.add_argument('--duration', type=float, metavar='S', help='use S seconds')
    group.add_argument('--every', type=int, metavar='N', help='use one of N images')
    group.add_argument('--half', choices=HALVES,
                       help='use one half of each image, as of a stereo camera that puts both '
                            'views into one')


def excerpt_from(args: argparse.Namespace) -> Excerpt:
    """
    Return the part of the recording that the options choose.

    Raises
    ------
    ArgumentError
        If a number is impossible.

    """
    return Excerpt(args.start, args.duration, 1 if args.every is None else args.every,
                   args.half)
