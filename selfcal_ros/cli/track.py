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
"""`selfcal track`: follow a known object through a recording."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
import sys
from typing import TYPE_CHECKING

from selfcal_ros.cli.excerpt_options import add_excerpt_arguments, excerpt_from
from selfcal_ros.cli.force import check_outputs, check_suffix, written_line
from selfcal_ros.cli.parsing import add_seed_argument, output_path, start_pose
from selfcal_ros.cli.status import EXIT_DONE, EXIT_NOT_CALIBRATED
from selfcal_ros.cli.verbosity import add_quiet_argument
from selfcal_ros.cli.track_rig import (add_rig_arguments, check_single, overlays_of, rig_of,
                                       track_rig_recordings)
from selfcal_ros.errors import ArgumentError, InputError

if TYPE_CHECKING:
    from selfcal_ros.geometry.camera import Camera
    from selfcal_ros.pipeline.excerpt import Excerpt
    from selfcal_ros.pipeline.frame_source import Frame
    from selfcal_ros.pipeline.progress import Progress
    from selfcal_ros.pipeline.tracking_loop import Target
    from selfcal_ros.pipeline.tracking_outcome import TrackingRun
    from selfcal_ros.report.poses_csv import PosesTable
    from selfcal_ros.rorapid.options import TrackerOptions
    from selfcal_ros.rorapid.tracked_frame import TrackedFrame
    from selfcal_ros.values.camera_rig import PlacedCamera


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `selfcal track`."""
    parser.add_argument('input', metavar='INPUT', nargs='+',
                        help='a rosbag2 folder, an .mcap, .db3 or .bag file, a folder of images, '
                             'or a video; with --cameras one for each, or a single bag')
    parser.add_argument('--topic', help='image topic of a bag, when it holds several')
    parser.add_argument('--depth-topic', metavar='TOPIC',
                        help='depth images of the bag (16UC1 in millimetres, 32FC1 in metres), '
                             'registered to the images and with their stamps')
    add_excerpt_arguments(parser)
    add_object_arguments(parser)
    parser.add_argument('--camera', type=Path, metavar='CAMERA.YAML',
                        help='calibration of the camera, as `selfcal calibrate` writes it, or '
                             'another program')
    add_rig_arguments(parser)
    parser.add_argument('--model-scale', type=float, default=1.0, metavar='METRES',
                        help='metres per unit of a mesh: 0.001 where it is in millimetres '
                             '(default 1)')
    parser.add_argument('--init-sigma', type=float, metavar='METRES',
                        help='standard deviation of the distance in --init, where it was '
                             'measured: then a model of the wrong size is noticed, which images '
                             'alone cannot tell')
    group = parser.add_argument_group('how to track')
    group.add_argument('--method', choices=('modern', 'rorapid', 'rapid'), default='modern',
                       help="RAPiD and RoRAPiD are the thesis's; modern adds what has been "
                            'learned since (default)')
    group.add_argument('--camera-model', choices=('perspective', 'zoom', 'weak', 'affine'),
                       default='perspective',
                       help='zoom: the focal length changes and is tracked; weak, affine: for '
                            'long lenses (default perspective)')
    group.add_argument('--motion', choices=('general', 'translation', 'planar'),
                       default='general', help='how the object can move before the camera '
                       '(default general)')
    group.add_argument('--plane-axis', type=float, nargs=3, metavar=('X', 'Y', 'Z'),
                       help='with --motion planar: axis of rotation in the camera frame '
                            '(default: learned)')
    group.add_argument('--line-delay', type=float, metavar='S',
                       help='rolling shutter: time from one row to the next, in seconds; negative '
                            'from the lowest row up (default: as the camera file says; where it '
                            'says nothing, all rows are read at once)')
    group.add_argument('--lines', choices=('rows', 'columns'), default=None,
                       help='what is read one after the other, with --line-delay (default rows)')
    add_seed_argument(group)
    output = parser.add_argument_group('output')
    output.add_argument('--output', type=output_path, default=Path('poses.csv'),
                        metavar='POSES.CSV',
                        help='pose of the object in every image (default poses.csv); of several '
                             'objects a table each, poses_NAME.csv')
    output.add_argument('--overlay', type=output_path, metavar='VIDEO.MP4',
                        help='the images with the object drawn over them')
    add_quiet_argument(output)


def add_object_arguments(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """Add the options that say what the object is and where it is at first."""
    group = parser.add_argument_group('the object')
    group.add_argument('--model', type=Path, required=required, metavar='MODEL.CAO',
                       help="shape of the object: ViSP's .cao, our .yaml, or a mesh: .obj, .ply "
                            'or .stl; `selfcal track` takes several, parted by commas')
    group.add_argument('--init', type=start_pose, metavar='POSE',
                       help='where the object is in the first image: six numbers '
                            '"tx ty tz rx ry rz" (metres, angle-axis radians, object in the '
                            "camera's optical frame), or a .pos file; or a .init file of object "
                            'points, with --clicks; of several objects parted by semicolons; '
                            '`selfcal track` takes auto, too: the object is sought in each '
                            'image until it is found')
    group.add_argument('--clicks', type=float, nargs='+', metavar='U V',
                       help='where the points of the .init file are in the first image, in '
                            'pixels and in its order')


def run(args: argparse.Namespace) -> int:
    """Track; returns the exit status."""
    from selfcal_ros.cli.progress import Progress
    from selfcal_ros.pipeline.several_objects import object_names, parted_starts, several
    from selfcal_ros.pipeline.tracking_loop import Target
    from selfcal_ros.pipeline.tracking_run import read_start
    from selfcal_ros.pipeline.tracking_session import AUTO
    from selfcal_ros.report.camera_files.known_camera import read_known
    from selfcal_ros.report.overlay_video import check_video_path
    from selfcal_ros.rorapid.model import read_model
    from selfcal_ros.rorapid.options import TrackerOptions
    if args.lines is not None and args.line_delay is None:
        raise ArgumentError('--lines needs --line-delay, the time from one line to the next.')
    options = TrackerOptions(method=args.method, camera_model=args.camera_model,
                             motion=args.motion,
                             plane_axis=tuple(args.plane_axis) if args.plane_axis else None,
                             line_delay_s=args.line_delay or 0.0, lines=args.lines or 'rows')
    if args.init_sigma is not None and not 0 < args.init_sigma < 1e6:
        raise ArgumentError(f'--init-sigma takes some metres, not {args.init_sigma:g}.')
    check_suffix('poses', args.output, 'are a table', '.csv')
    excerpt = excerpt_from(args)
    paths = several(str(args.model))
    if len(paths) > 1 and args.clicks:
        raise ArgumentError('--clicks are of one object; give the poses of several by --init '
                            '"tx ty tz rx ry rz; ...".')
    names = object_names(paths)
    outputs = [args.output] if len(paths) == 1 else [
        args.output.with_name(f'{args.output.stem}_{name}{args.output.suffix}') for name in names]
    cameras: tuple[PlacedCamera, ...] = ()
    if args.rig is None:
        check_single(args)
        stored = read_known(args.camera)
        camera = stored.camera
        if args.line_delay is None and stored.line_delay_s is not None:
            options = replace(options, line_delay_s=stored.line_delay_s,
                              lines='columns' if stored.lines == 'columns' else 'rows')
        overlays = [args.overlay] if args.overlay else []
    else:
        inputs, cameras = rig_of(args)
        camera, overlays = cameras[0].camera, overlays_of(args.overlay, inputs)
    check_outputs((), (*args.input, *map(Path, paths), args.camera, args.rig, args.init), False,
                  (*outputs, *overlays),
                  {'--output': args.output, '--overlay': args.overlay})
    for overlay in overlays:
        check_video_path(overlay)
    earlier = [path for path in (*outputs, *overlays) if path.is_file()]
    models = [read_model(path, args.model_scale) for path in paths]
    starts = [None if word == AUTO else read_start(word, args.clicks, camera)
              for word in parted_starts(args.init or '', len(paths))]
    targets = [Target(model, start, args.init_sigma) for model, start in zip(models, starts)]
    with Progress.of(args) as progress:
        alike = {'seed': args.seed, 'progress': progress, 'excerpt': excerpt,
                 'names': names if len(paths) > 1 else ['']}
        if cameras:
            runs, tables = track_rig_recordings(inputs, cameras, targets, options,
                                                overlays=overlays, **alike)
        else:
            runs, tables = track_recording(args.input[0], targets, camera, options,
                                           topic=args.topic, overlay=args.overlay,
                                           depth_topic=args.depth_topic, **alike)
    # not earlier: an input error stands alone
    for path, model in zip(paths, models):
        for remark in getattr(model, 'remarks', ()):
            print(f'{path}: {remark}', file=sys.stderr)
    written = [table.write(output) for table, output in zip(tables, outputs)]
    if options.line_delay_s and not args.quiet:
        source = '' if args.line_delay is not None else f', as {args.camera} says'
        print(f'{options.lines.capitalize()} are read {1e6 * abs(options.line_delay_s):.3g} µs '
              f'apart{source}; poses are those at the stamps, when the middle one is read.')
    tell(names, runs, written_line([*written, *overlays], earlier), args.quiet)
    return EXIT_DONE if all(run.followed for run in runs) else EXIT_NOT_CALIBRATED


def tell(names: Sequence[str], runs: Sequence[TrackingRun], written: str, quiet: bool) -> None:
    """
    Print how it went; if quiet, only what was lost.

    Parameters
    ----------
    names : sequence of str
        Of the objects.
    runs : sequence of TrackingRun
    written : str
        Which files it left, in words.
    quiet : bool

    """
    for name, run in zip(names, runs):
        text = run.text() if len(runs) == 1 else f'{name}: {run.text()}'
        if not quiet:
            print(text)
        elif not run.followed:
            print(text, file=sys.stderr)
    if not quiet:
        print(written)


def track_recording(path: str | Path, targets: Sequence[Target], camera: Camera,
                    options: TrackerOptions | None = None, *, topic: str | None = None,
                    overlay: Path | None = None, seed: int = 0, progress: Progress | None = None,
                    listeners: Iterable[Callable[[Frame, tuple[TrackedFrame, ...]], object]] = (),
                    excerpt: Excerpt | None = None, depth_topic: str | None = None,
                    names: Sequence[str] = ('',)) -> tuple[list[TrackingRun], list[PosesTable]]:
    """
    Track through a recording, and write the overlay where one is wished for.

    Returns
    -------
    list of TrackingRun
        Of each target.
    list of PosesTable
        Not written yet.

    """
    from selfcal_ros.pipeline.depth_topic import open_depths
    from selfcal_ros.pipeline.sources import Excerpt, open_source
    from selfcal_ros.pipeline.tracking_run import playing_rate_hz, track_objects
    from selfcal_ros.report.overlay_video import drawing_into, OverlayVideo
    from selfcal_ros.report.poses_csv import PosesTable
    tables = [PosesTable() for _ in targets]

    def add(frame: Frame, tracked: Sequence[TrackedFrame]) -> None:
        for table, one in zip(tables, tracked):
            table.add(frame, one)

    with ExitStack() as stack:
        source = stack.enter_context(open_source(
            path, topic, colour=overlay is not None or any(
                target.model.is_outlined for target in targets),
            excerpt=excerpt or Excerpt()))
        listeners = [add, *listeners]
        if overlay:
            video = stack.enter_context(OverlayVideo(overlay, playing_rate_hz(source)))
            listeners.append(drawing_into(video, [target.model for target in targets], camera,
                                          names))
        depths = stack.enter_context(open_depths(path, depth_topic)) if depth_topic else None
        runs = track_objects(source, targets, camera, options, seed=seed, progress=progress,
                             listeners=listeners, depths=depths)
    if depths is not None and not depths.found:
        raise InputError(f'No image has a depth image of its time on {depth_topic}; stamps must '
                         'agree within 10 ms.')
    return runs, tables
