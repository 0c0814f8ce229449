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
"""`selfcal calibrate`: a recording in, a calibrated camera with its uncertainties out."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import sys
from typing import cast, TYPE_CHECKING

from selfcal_ros.cli.colours import coloured
from selfcal_ros.cli.excerpt_options import add_excerpt_arguments, excerpt_from
from selfcal_ros.cli.facts import add_fact_arguments, facts_from, FREE
from selfcal_ros.cli.force import (add_force_argument, check_outputs, check_suffix,
                                   written_line)
from selfcal_ros.cli.machine_output import add_json_argument, is_standard_output
from selfcal_ros.cli.many import add_many_arguments, run_many
from selfcal_ros.cli.parsing import add_seed_argument, output_path
from selfcal_ros.cli.rig import add_rig_arguments, run_rig
from selfcal_ros.cli.robot_options import add_mount_outputs, add_robot_arguments, robot_from
from selfcal_ros.cli.scene_outputs import add_scene_arguments, SceneOutputs
from selfcal_ros.cli.status import LeftOut, status_of
from selfcal_ros.cli.verbosity import add_quiet_argument

if TYPE_CHECKING:
    from selfcal_ros.calibration.result import Calibration, NotCalibrated
    from selfcal_ros.pipeline.calibrate_input import CalibrationSettings
    from selfcal_ros.pipeline.feature_session import ExtractedTracks
    from selfcal_ros.pipeline.frame_source import FrameSource
    from selfcal_ros.pipeline.progress import Progress
    from selfcal_ros.rorapid.options import ReadLines

#: Motions from tracks of an unknown scene.
MOTIONS = ('auto', 'planar', 'translation', 'rotation', 'general', 'repeated')
#: --view without a file.
VIEWER = Path('-')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `selfcal calibrate`."""
    parser.add_argument('input', metavar='INPUT', nargs='+',
                        help='a rosbag2 folder, an .mcap, .db3 or .bag file, a folder of images, '
                             'a video, or tracks.csv (columns frame,track,x,y); several of these '
                             'are calibrated each and together')
    parser.add_argument('--topic', help='image topic of a bag, when it holds several')
    parser.add_argument('--motion', default='auto', type=_motion,
                        choices=(*MOTIONS, 'known-object'),
                        help='how the camera moved (default: found out); repeated: equal objects '
                             'in one image, each a frame of tracks.csv')
    parser.add_argument('--views', type=int, metavar='N',
                        help='with --motion general: use so few views, four or more')
    parser.add_argument('--translation-frames', type=int, nargs='+', metavar='FRAME',
                        help='with --motion translation: the images that are related by pure '
                             'translation, counted from 0 (default: found out)')
    parser.add_argument('--parallel-objects', type=int, nargs='+', metavar='OBJECT',
                        help='with --motion repeated: the objects that stand parallel, by their '
                             'numbers in the table (default: found out)')
    parser.add_argument('--mode', choices=('auto', 'video', 'wide'), default='auto',
                        help='follow points from image to image, or match far-apart photographs '
                             '(default: found out)')
    parser.add_argument('--max-keyframes', type=int, metavar='N',
                        help='use at most so many images (default 40; 60 of a table)')
    parser.add_argument('--mask', metavar='MASK.PNG',
                        help='an image of the same size: white (not zero) where the images may be '
                             'used, black where not, such as on the body of the robot; the circle '
                             'of a fisheye image is found without')
    parser.add_argument('--object', metavar='WHAT',
                        help='known object: chessboard:COLSxROWS:SQUARE_M or '
                             'charuco:COLSxROWS:SQUARE_M:MARKER_M (inner corners), '
                             'aprilgrid:COLSxROWS:TAG_M:SPACING (tags; space over side, as in '
                             'Kalibr), circles:COLSxROWS:SPACING_M, '
                             'acircles:COLSxROWS:SPACING_M (staggered; between rows), '
                             'tsai:COLSxROWS:SQUARE_M:GAP_M:MARGIN_M (squares), or points.csv '
                             '(columns point,X,Y,Z) for an INPUT of tracks')
    parser.add_argument('--flatness', type=float, metavar='SIGMA_M',
                        help='with --object: how far the board may bend, as a standard deviation '
                             'in metres, 0 for an exactly flat one with an exact print (default: '
                             'bend and print are estimated)')
    parser.add_argument('--track', action='store_true',
                        help='follow an object of known shape (--model, --init) through the '
                             'images, and calibrate from its edges')
    from selfcal_ros.cli.track import add_object_arguments
    add_object_arguments(parser, required=False)
    parser.add_argument('--camera', type=Path, metavar='CAMERA.YAML',
                        help='with --track: a rough calibration to begin with (default: focal '
                             'lengths are tried)')
    parser.add_argument('--image-size', type=int, nargs=2, metavar=('W', 'H'),
                        help='image size in pixels, for tracks.csv')
    add_excerpt_arguments(parser)
    add_seed_argument(parser)
    add_fact_arguments(parser)
    add_robot_arguments(parser)
    add_many_arguments(parser)
    add_rig_arguments(parser)
    output = parser.add_argument_group('output')
    output.add_argument('--output', type=output_path, metavar='CAMERA.YAML',
                        help='calibration file for camera drivers (default camera.yaml)')
    output.add_argument('--camera-name', default='camera', help='name inside CAMERA.YAML')
    add_json_argument(output)
    output.add_argument('--report', type=output_path, metavar='REPORT.HTML',
                        help='everything, for a person')
    add_scene_arguments(output)
    add_mount_outputs(output)
    output.add_argument('--view', type=output_path, nargs='?', const=VIEWER, metavar='SCENE.RRD',
                        help='open the Rerun viewer with images, path and structure, or write '
                             'SCENE.RRD for it (extra: view)')
    add_force_argument(output)
    add_quiet_argument(output)


def _motion(value: str) -> str:
    """Take a motion; one is found and not stated."""
    if value == 'pivot':
        raise argparse.ArgumentTypeError('pivot is found and not stated; leave --motion out, or '
                                         'say auto')
    return value


def run(args: argparse.Namespace) -> int:
    """Calibrate; returns the exit status."""
    from selfcal_ros.errors import ArgumentError
    from selfcal_ros.pipeline.calibrate_input import CalibrationSettings
    from selfcal_ros.pipeline.many_inputs import find_recordings
    _check_options(args)
    _check_track(args)
    robot, known = robot_from(args)
    settings = CalibrationSettings(
        # a known object determines the aspect ratio, and cameras are square to 0.1 % only; the
        # edges of a small object do not
        facts=facts_from(args, FREE if args.object else 1.0), motion=args.motion,
        translation_frames=args.translation_frames and tuple(args.translation_frames),
        parallel_objects=args.parallel_objects and tuple(args.parallel_objects),
        views=args.views,
        known_object=args.object, flatness=args.flatness, mode=args.mode, topic=args.topic,
        max_keyframes=args.max_keyframes,
        image_size=tuple(args.image_size) if args.image_size else None,
        mask=args.mask, seed=args.seed,
        excerpt=excerpt_from(args), robot=robot, mount_facts=known,
        # whoever says how many wants no choice made
        **({} if args.every is None else {'long': None}))
    if args.mask is not None:
        from selfcal_ros.features.mask import read_mask
        # before the long work, and once for many recordings
        read_mask(args.mask)
    if args.cameras:
        return run_rig(args, settings)
    if args.baseline:
        raise ArgumentError('--baseline is the distance of two cameras; name them with '
                            '--cameras.')
    paths, many = find_recordings(args.input)
    if many:
        if args.track:
            raise ArgumentError('--track takes a single recording.')
        if args.robot:
            raise ArgumentError('--robot takes a single recording.')
        return run_many(args, paths, settings)
    for name in ('output_dir', 'jobs', 'scheduler'):
        if getattr(args, name) is not None:
            raise ArgumentError(f'--{name.replace("_", "-")} is for many recordings; give several '
                                'INPUTs, or a folder of them.')
    return _run_one(args, args.input[0], settings)


def _check_options(args: argparse.Namespace) -> None:
    """Refuse options that contradict each other."""
    from selfcal_ros.errors import ArgumentError
    check_suffix('report', args.report, 'is one page', '.html', '.htm')
    check_suffix('camera file', args.output, 'is YAML', '.yaml', '.yml')
    known = bool(args.object) or args.track
    if known and args.motion not in ('auto', 'known-object'):
        option = '--track' if args.track else '--object'
        raise ArgumentError(f'{option} and --motion {args.motion} exclude each other; leave one '
                            'of them out.')
    if args.views is not None and (args.motion != 'general' or args.views < 4):
        raise ArgumentError('--views needs --motion general, and at least 4 of them; or limit '
                            'the images with --max-keyframes.')
    if args.parallel_objects and (args.motion != 'repeated' or args.translation_frames):
        raise ArgumentError('--parallel-objects needs --motion repeated, and no '
                            '--translation-frames.')
    if args.focal == 'varying' and (known or args.motion == 'repeated'):
        raise ArgumentError('--focal varying is for an unknown scene in several images; leave it '
                            'out.')
    if args.flatness is not None and not (args.object and 0 <= args.flatness < 1):
        raise ArgumentError('--flatness is the standard deviation of the bend of an --object in '
                            'metres, such as 0.0005, or 0 for a flat one.')
    if args.motion == 'known-object' and not known:
        raise ArgumentError('--motion known-object needs --object, for example '
                            'chessboard:9x6:0.025 (inner corners, metres), or --track with the '
                            '--model of an object.')
    if args.view:
        if known:
            raise ArgumentError('--view shows the structure of an unknown scene; leave it out, '
                                'the object is known.')
        from selfcal_ros.report.viewer import load_rerun
        load_rerun()
    least = 1 if known else 3
    if args.max_keyframes is not None and args.max_keyframes < least:
        raise ArgumentError(f'--max-keyframes must be at least {least}: fewer views cannot '
                            'calibrate.')


def _run_one(args: argparse.Namespace, path: str, settings: CalibrationSettings) -> int:
    """Calibrate one recording; returns the exit status."""
    from selfcal_ros.cli.progress import Progress
    from selfcal_ros.cli.time_left import CALIBRATION
    with Progress.of(args, CALIBRATION) as progress:
        # libraries load and the first image is searched before there is more to say
        progress('starting')
        from selfcal_ros.cli.motion_text import motion_text
        from selfcal_ros.cli.outputs import Outputs
        from selfcal_ros.cli.result_text import result_text
        from selfcal_ros.pipeline.calibrate_input import calibrate_input
        from selfcal_ros.pipeline.sources import check_kind, open_source
        # a camera file in place of a recording would be refused as an output that is an input
        check_kind(path)
        outputs = Outputs(camera_yaml=args.output or Path('camera.yaml'), result_json=args.json,
                          report=args.report, scene=SceneOutputs.of(args),
                          camera_name=args.camera_name, seed=args.seed,
                          mount=args.mount_output, camera_frame=args.camera_frame,
                          command=getattr(args, 'command_line', ()), inputs=(path,),
                          replaces_own=args.output is None)
        replaced = outputs.replaced
        # before the long work, so that a mistyped folder costs a second and not the result
        outputs.check(path, args.mask, args.model, args.camera, args.object,
                      None if settings.robot is None else settings.robot.table,
                      force=args.force)
        check_outputs((), (path,), args.force, (args.view,))
        if args.track:
            result, reading = _from_edges(args, path, settings, progress)
        else:
            result, reading = calibrate_input(path, settings, progress)
        known = args.track or settings.known_object

        def open_frames() -> FrameSource:
            return open_source(path, args.topic, colour=True, excerpt=settings.excerpt)

        why = (motion_text(result, args.motion),) if result and not known else ()
        notes = (*why, *reading.notes)
        text = result_text(result, notes=notes,
                           mount_facts=frozenset(settings.mount_facts.stated))
        progress('writing')
        written, left_out = outputs.write(result, text, reading.description, reading.tracks,
                                          open_frames, (*why, *reading.findings),
                                          reading.stamps_ns,
                                          _figures(reading) if args.report else (), args.force,
                                          replaced is not None)
    if not (args.quiet or is_standard_output(args.json)):
        print(coloured(text))
        print(written_line(written, (replaced,) if replaced else ()))
    elif not result:
        print(result, file=sys.stderr)
    if args.view and result and result.motion == 'rotation':
        what = 'Nothing is shown' if args.view == VIEWER else f'{args.view} was not written'
        left_out.append(LeftOut(f'{what}: a camera that only turned has neither path nor '
                                'structure.'))
    for one in left_out:
        print(one.sentence, file=sys.stderr)
    if args.view and result and result.motion != 'rotation':
        from selfcal_ros.report.viewer import view
        view(result, reading.tracks, open_frames,
             None if args.view == VIEWER else args.view)
    return status_of(bool(result), left_out)


def _figures(reading: ExtractedTracks) -> tuple[str, ...]:
    """Return the time line of a recording that was followed in parts."""
    survey = getattr(reading, 'survey', None)
    if survey is None or len(survey.glances) < 2:
        return ()
    from selfcal_ros.report.timeline_figure import timeline_html
    return (timeline_html(survey),)


def _from_edges(args: argparse.Namespace, path: str | Path, settings: CalibrationSettings,
                progress: Progress) -> tuple[Calibration | NotCalibrated, ExtractedTracks]:
    """Calibrate from the edges of a tracked object; returns the result and the reading."""
    from selfcal_ros.pipeline.tracked_calibration import calibrate_tracked_object
    from selfcal_ros.report.camera_files.known_camera import read_known
    from selfcal_ros.rorapid.model import read_model
    stored, facts = read_known(args.camera) if args.camera else None, settings.facts
    if stored is not None and stored.line_delay_s and args.line_delay is None and (
            args.shutter != 'global'):
        facts = replace(facts, line_delay_s=stored.line_delay_s)
    return calibrate_tracked_object(path, read_model(args.model), facts, init=args.init,
                                    clicks=args.clicks,
                                    start=None if stored is None else stored.camera,
                                    topic=args.topic, max_keyframes=args.max_keyframes,
                                    seed=args.seed, progress=progress, excerpt=settings.excerpt,
                                    lines=cast('ReadLines', 'rows' if stored is None else
                                               stored.lines))


def _check_track(args: argparse.Namespace) -> None:
    """Refuse options that belong to --track without it, and --track without them."""
    from selfcal_ros.errors import ArgumentError
    if not args.track:
        given = [name for name in ('model', 'init', 'clicks', 'camera') if getattr(args, name)]
        if given:
            raise ArgumentError(f'--{given[0]} is for a tracked object; add --track, or leave it '
                                'out.')
        return
    if args.object:
        raise ArgumentError('--track and --object exclude each other: edges of a --model are '
                            'followed, points of an --object are found.')
    if not args.model:
        raise ArgumentError('--track needs the shape of the object: --model object.cao.')
    if args.image_size:
        raise ArgumentError('--image-size is for tables of tracks; leave it out.')
    if args.mask is not None:
        raise ArgumentError('--track follows edges of the whole object; leave --mask out.')
