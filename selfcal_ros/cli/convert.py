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
"""`selfcal convert`: an image folder or a video becomes a bag."""

from __future__ import annotations

import argparse
from pathlib import Path

from selfcal_ros.cli.progress import ProgressBar
from selfcal_ros.cli.status import EXIT_DONE
from selfcal_ros.errors import InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `selfcal convert`."""
    parser.add_argument('input', metavar='INPUT', help='image folder, video or bag')
    parser.add_argument('output', type=Path, metavar='OUTPUT', help='rosbag2 folder to make')
    parser.add_argument('--topic', default='/camera/image_raw',
                        help='topic to write (default /camera/image_raw)')
    parser.add_argument('--input-topic', help='topic to read from a bag with several')
    parser.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap')
    parser.add_argument('--compressed', choices=('jpeg', 'png'),
                        help='write CompressedImage to TOPIC/compressed')
    parser.add_argument('--frame-id', default='camera_optical_frame')
    parser.add_argument('--quiet', action='store_true')


def run(args: argparse.Namespace) -> int:
    """Convert; returns the exit status."""
    from selfcal_ros.pipeline.bag_writer import write_image_bag
    from selfcal_ros.pipeline.sources import open_source
    if args.output.suffix and args.output.suffix not in ('.mcap', '.db3'):
        raise InputError(f'{args.output} is no name for a bag folder; leave {args.output.suffix} '
                         'away.')
    with open_source(args.input, args.input_topic, colour=True) as source, \
            ProgressBar(not args.quiet) as progress:
        if source.kind == 'tracks':
            raise InputError(f'{args.input} holds tracks, not images; a bag needs images.')

        def counted():
            for frame in source:
                yield frame
                progress('writing', frame.index + 1, source.count)

        count = write_image_bag(args.output, counted(), args.topic, args.storage, args.compressed,
                                args.frame_id)
    if not args.quiet:
        print(f'{count} images written to {args.output}.')
    return EXIT_DONE
