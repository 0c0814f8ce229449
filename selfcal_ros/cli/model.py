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
"""`selfcal model`: make a wireframe model of an object from two images of it."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from selfcal_ros.cli.force import add_force_argument, check_outputs
from selfcal_ros.cli.parsing import add_seed_argument, output_path
from selfcal_ros.cli.status import EXIT_DONE, EXIT_NOT_CALIBRATED
from selfcal_ros.cli.verbosity import add_quiet_argument


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `selfcal model`."""
    parser.add_argument('input', metavar='INPUT',
                        help='a folder of images, a video or a bag in which camera or object '
                             'moved without turning')
    parser.add_argument('--topic', help='image topic of a bag, when it holds several')
    parser.add_argument('--camera', type=Path, required=True, metavar='CAMERA.YAML',
                        help='calibration of the camera, as `selfcal calibrate` writes it, or '
                             'another program')
    parser.add_argument('--images', type=int, nargs=2, metavar=('I', 'J'),
                        help='which two images, counted from 0 (default: the first, and of the '
                             'last and some between them the one that shows most lines)')
    scale = parser.add_argument_group('how large the object is (one of them)')
    scale.add_argument('--length', type=float, metavar='METRES',
                       help='length of the longest line of the model')
    scale.add_argument('--between', nargs=2, metavar=('A', 'B'),
                       help='with --length: the vertices that it lies between')
    scale.add_argument('--baseline', type=float, metavar='METRES',
                       help='how far the camera moved between the two images')
    group = parser.add_argument_group('the object')
    group.add_argument('--region', type=float, nargs=4,
                       metavar=('LEFT', 'TOP', 'RIGHT', 'BOTTOM'),
                       help='where the object is in the first image, in pixels')
    group.add_argument('--vertices', type=Path, metavar='PICKED.YAML',
                       help='vertices picked by hand in both images, with lines and faces; for '
                            'objects whose lines are not found')
    group.add_argument('--exact', action='store_true',
                       help='leave picked vertices where they are, and do not move them to '
                            'where the edges in the images meet')
    group.add_argument('--no-faces', action='store_true',
                       help='make no opaque faces of the lines that are found')
    output = parser.add_argument_group('output')
    output.add_argument('--output', type=output_path, default=Path('object.cao'),
                        metavar='OBJECT.CAO',
                        help='the model, as .cao or .yaml (default object.cao)')
    output.add_argument('--obj', type=output_path, metavar='OBJECT.OBJ',
                        help='the model for programs that draw it')
    add_force_argument(output, 'replace the model if it exists')
    add_quiet_argument(output)
    add_seed_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Make the model; returns the exit status."""
    from selfcal_ros.geometry.no_estimate import NoEstimate
    from selfcal_ros.pipeline.object_modelling import model_recording, ModelRequest
    from selfcal_ros.pipeline.sources import open_source
    from selfcal_ros.report.camera_files.known_camera import read_known_camera
    from selfcal_ros.rorapid.acquisition.picked_vertices import read_picked
    from selfcal_ros.rorapid.model import write_model
    _check_outputs(args)
    camera = read_known_camera(args.camera)
    request = ModelRequest(
        camera, length_m=args.length, baseline_m=args.baseline,
        between=tuple(args.between) if args.between else None,
        region=tuple(args.region) if args.region else None,
        picked=read_picked(args.vertices) if args.vertices else None, exact=args.exact,
        faces=not args.no_faces, name=args.output.stem)
    with open_source(args.input, args.topic) as source:
        made = model_recording(source, request, tuple(args.images) if args.images else None,
                               args.seed)
    if isinstance(made, NoEstimate):
        print(f'No model: {made.reason}', file=sys.stderr)
        return EXIT_NOT_CALIBRATED
    model = made.acquired.model
    written = [write_model(model, args.output, replace=args.force)]
    if args.obj:
        written.append(write_model(model, args.obj))
    if not args.quiet:
        print(made.text())
        print(f'Written: {", ".join(map(str, written))}.')
    return EXIT_DONE


def _check_outputs(args: argparse.Namespace) -> None:
    """Refuse outputs that cannot be, before the work."""
    from selfcal_ros.errors import ArgumentError
    if args.output.suffix.lower() not in ('.cao', '.yaml', '.yml'):
        raise ArgumentError(f'The model {args.output} must be named .cao or .yaml.')
    if args.obj and args.obj.suffix.lower() != '.obj':
        raise ArgumentError(f'The drawing {args.obj} must be named .obj.')
    check_outputs((args.output,), (args.input, args.camera, args.vertices), args.force,
                  (args.obj,))
