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
`selfcal convert`: images become a bag; camera files become those of another program.

What INPUT is decides which of the two.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
import re
from typing import TYPE_CHECKING

from selfcal_ros.cli.excerpt_options import add_excerpt_arguments, excerpt_from
from selfcal_ros.cli.force import add_force_argument, check_outputs
from selfcal_ros.cli.parsing import output_path, text, topic_name
from selfcal_ros.cli.progress import Progress
from selfcal_ros.cli.status import EXIT_DONE
from selfcal_ros.cli.verbosity import add_quiet_argument
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.pipeline.excerpt import Excerpt

if TYPE_CHECKING:
    from selfcal_ros.pipeline.frame_source import Frame

#: Kinds of camera file that can be written.
KINDS = ('ros', 'opencv', 'kalibr', 'colmap', 'mrcal')
#: Kinds of file that hold where a camera is on a robot.
TRANSFORMS = ('urdf', 'tf', 'moveit', 'easy_handeye2', 'easy_handeye')
DEFAULT_TOPIC = '/camera/image_raw'
#: End of the topic of compressed images, beside that of the raw ones.
_COMPRESSED = '/compressed'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `selfcal convert`."""
    parser.add_argument('input', metavar='INPUT',
                        help='image folder, video or bag; or a camera file: ROS camera_info YAML, '
                             'OpenCV YAML, XML or JSON, Kalibr camchain, COLMAP cameras.txt or '
                             'cameras.bin (or their folder), .cameramodel of mrcal, result.json '
                             'of selfcal; or where a camera is on a robot: result.json, a URDF, '
                             'YAML of static_transform_publisher, files of easy_handeye and '
                             'MoveIt')
    parser.add_argument('output', type=output_path, metavar='OUTPUT',
                        help='rosbag2 folder, or camera file, to make')
    parser.add_argument('--topic', type=topic_name,
                        help='image topic of a bag, to be read, and written under its name; any '
                             'other name is the topic to write (default: read the only one, '
                             f'write {DEFAULT_TOPIC})')
    add_quiet_argument(parser, 'print nothing but errors')
    bag = parser.add_argument_group('images to a bag')
    bag.add_argument('--input-topic', help='topic to read; --topic is the one to write then')
    bag.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap',
                     help='file format of the bag (default mcap)')
    bag.add_argument('--compressed', choices=('jpeg', 'png'),
                     help='write CompressedImage to TOPIC/compressed')
    bag.add_argument('--frame-id', type=text, default='camera_optical_frame',
                     help='for images that do not name their frame (default '
                          'camera_optical_frame)')
    add_excerpt_arguments(parser)
    file = parser.add_argument_group('camera files')
    file.add_argument('--to', choices=(*KINDS, *TRANSFORMS),
                      help='kind to write (default: by the name of OUTPUT; .xml is OpenCV, .txt '
                           'and .bin are COLMAP, *camchain*.yaml is Kalibr, other .yaml is ROS, '
                           '.cameramodel is mrcal; .urdf, .launch.py (MoveIt) and .calib '
                           '(easy_handeye2) are transforms of a camera on a robot, and so is '
                           '.yaml from one of these: tf, of static_transform_publisher)')
    file.add_argument('--camera-frame', type=text, metavar='FRAME',
                      help='frame of the camera, where INPUT is a result.json (default: that of '
                           'the images, or camera_optical_frame)')
    file.add_argument('--camera', metavar='NAME',
                      help='which of several cameras: cam1, left, or 3')
    file.add_argument('--camera-name', help='name to write (default: that of INPUT)')
    file.add_argument('--image-size', type=int, nargs=2, metavar=('W', 'H'),
                      help='image size in pixels, for OpenCV files without it')
    file.add_argument('--fisheye', action='store_true',
                      help='the OpenCV file is one of cv2.fisheye, without saying so')
    add_force_argument(file, 'replace OUTPUT, a camera file')


def run(args: argparse.Namespace) -> int:
    """Convert; returns the exit status."""
    from selfcal_ros.report.camera_files.formats import is_camera_file
    excerpt = excerpt_from(args)
    if _is_transform(args):
        return _convert_transform(args)
    if args.to or args.camera or args.fisheye or is_camera_file(args.input):
        if excerpt != Excerpt():
            raise ArgumentError('--start, --duration, --every and --half are for images; leave '
                                'them out.')
        return _convert_camera(args)
    return _convert_images(args, excerpt)


def _is_transform(args: argparse.Namespace) -> bool:
    """Tell whether a transform is to be written."""
    from selfcal_ros.report.mounts.transform_reading import is_transform_file
    if args.to:
        return args.to in TRANSFORMS
    # our own result has a camera, too, and that is what a .yaml is of
    return args.output.name.lower().endswith(('.urdf', '.launch.py', '.calib')) or (
        is_transform_file(args.input) and Path(args.input).is_file())


def _convert_transform(args: argparse.Namespace) -> int:
    """Write where a camera is on a robot in another way."""
    from selfcal_ros.report.mounts.transform_files import (FORMATS, kind_of_name,
                                                           write_transform)
    from selfcal_ros.report.mounts.transform_reading import read_transform
    check_outputs((args.output,), (args.input,), args.force)
    kind = args.to or kind_of_name(args.output)
    source_kind, stored = read_transform(args.input, args.camera_frame, args.camera)
    if kind == source_kind and not args.to:
        raise ArgumentError(f'{args.input} and {args.output} are both files of '
                            f'{FORMATS[kind].title}; say with --to what to make.')
    write_transform(args.output, stored, kind, replace=args.force)
    if not args.quiet:
        print(f'{stored.child} on {stored.parent} of {args.input} written to {args.output} for '
              f'{FORMATS[kind].title}.')
    return EXIT_DONE


def _convert_camera(args: argparse.Namespace) -> int:
    """Turn one camera file into another."""
    from selfcal_ros.report.camera_files.formats import (chosen, FORMATS, read_cameras,
                                                         write_camera)
    size = tuple(args.image_size) if args.image_size else None
    if size and min(size) <= 0:
        raise ArgumentError('The image size must be a positive width and height.')
    source_kind, cameras = read_cameras(args.input, fisheye=args.fisheye, image_size=size)
    found = chosen(args.input, cameras, args.camera)
    check_outputs((args.output,), (args.input,), args.force)
    kind = args.to or kind_of_name(args.output)
    if kind == source_kind and not args.to:
        raise ArgumentError(f'{args.input} and {args.output} are both files of '
                            f'{FORMATS[kind].title}; say with --to what to make.')
    name = args.camera_name or re.sub(r'[^A-Za-z0-9_]', '_', found.name)
    if kind == source_kind == 'ros':
        # with R and P, as of a stereo pair, and what the file says of itself
        from selfcal_ros.report.copied_camera_yaml import (comments_of, read_copied_camera,
                                                           write_copied_camera)
        write_copied_camera(args.output, read_copied_camera(args.input)[0], name,
                            comments_of(args.input), replace=args.force)
    else:
        write_camera(args.output, kind, found.camera, name, args.topic or found.topic,
                     replace=args.force)
    if not args.quiet:
        print(f'{found.name} of {args.input} written to {args.output} for {FORMATS[kind].title}.')
        if kind == 'colmap' or source_kind == 'colmap':
            print('COLMAP counts pixels from the corner of the image: its principal point is half '
                  'a pixel larger.')
    return EXIT_DONE


def kind_of_name(path: Path) -> str:
    """
    Guess the kind of camera file to write from its name.

    Raises
    ------
    ArgumentError
        If the name tells nothing.

    """
    suffix = path.suffix.lower()
    if suffix in ('.txt', '.bin'):
        return 'colmap'
    if suffix in ('.xml', '.cameramodel'):
        return 'opencv' if suffix == '.xml' else 'mrcal'
    if suffix in ('.yaml', '.yml'):
        return 'kalibr' if 'camchain' in path.name else 'ros'
    raise ArgumentError(f'The name {path.name} does not tell what to make; say it with --to '
                        f'({", ".join(KINDS)}).')


def _topics(args: argparse.Namespace) -> tuple[str | None, str]:
    """
    Return the topic to read, None for the only one, and that to write.

    Raises
    ------
    ArgumentError
        If raw images would go under the name of compressed ones.

    """
    from selfcal_ros.pipeline.bag_source import has_image_topic
    topic = args.topic
    if topic and args.input_topic is None and has_image_topic(args.input, topic):
        return topic, f'/{topic.lstrip("/").removesuffix(_COMPRESSED)}'
    if topic and topic.endswith(_COMPRESSED):
        raise ArgumentError(f'{topic} is a name of compressed images, which --compressed gives to '
                            f'them; leave {_COMPRESSED} away.')
    return args.input_topic, topic or DEFAULT_TOPIC


def _convert_images(args: argparse.Namespace, excerpt: Excerpt) -> int:
    """Turn images into a bag."""
    from selfcal_ros.pipeline.bag_writer import write_image_bag
    from selfcal_ros.pipeline.sources import open_source
    from selfcal_ros.report.camera_files.formats import CAMERA_SUFFIXES
    from selfcal_ros.report.not_a_camera import refuse_other_kinds
    if args.output.suffix and args.output.suffix not in ('.mcap', '.db3'):
        if args.output.suffix.lower() in CAMERA_SUFFIXES:
            # who names a camera file wants a camera
            refuse_other_kinds(args.input)
        raise InputError(f'{args.output} is no name for a bag folder; leave {args.output.suffix} '
                         'away.')
    read, written = _topics(args)
    with open_source(args.input, read, colour=True, excerpt=excerpt) as source, \
            Progress.of(args) as progress:
        if source.kind == 'tracks':
            raise InputError(f'{args.input} holds tracks, not images; a bag needs images.')

        def counted() -> Iterator[Frame]:
            for done, frame in enumerate(source, start=1):
                yield frame
                progress('writing', done, source.count)

        count = write_image_bag(args.output, counted(), written, args.storage, args.compressed,
                                args.frame_id)
    if not args.quiet:
        print(f'{count} image{"s" * (count != 1)} written to {args.output}, on the topic {written}'
              f'{_COMPRESSED if args.compressed else ""}.')
    return EXIT_DONE
