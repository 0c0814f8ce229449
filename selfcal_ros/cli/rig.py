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
"""`selfcal calibrate --cameras`: cameras that move together, calibrated in one."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
import sys
from typing import TYPE_CHECKING

from selfcal_ros.cli.colours import coloured
from selfcal_ros.cli.force import check_outputs, is_made_here, make_folder, written_line
from selfcal_ros.cli.machine_output import is_standard_output, write_json
from selfcal_ros.cli.progress import Progress
from selfcal_ros.cli.status import EXIT_DONE, LeftOut, status_of
from selfcal_ros.cli.time_left import rig_courses

if TYPE_CHECKING:
    from selfcal_ros.calibration.result import NotCalibrated
    from selfcal_ros.calibration.rigs.result import RigCalibration
    from selfcal_ros.pipeline.calibrate_input import CalibrationSettings
    from selfcal_ros.pipeline.rig_input import RigReading

#: Options of one camera that a rig does not take.
OF_ONE_CAMERA = ('object', 'track', 'view', 'topic', 'views', 'translation_frames',
                 'parallel_objects', 'poses', 'poses_format', 'ply', 'transforms', 'output_dir',
                 'jobs', 'scheduler')
#: Motions of a rig.
MOTIONS = ('auto', 'planar', 'general')


def add_rig_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of several cameras."""
    group = parser.add_argument_group(
        'several cameras', 'Cameras that move together are calibrated in one, with their poses to '
        'each other. They need not see the same things. With --robot the first one gets its place '
        'on the robot, and all lengths metres.')
    group.add_argument('--cameras', metavar='NAMES',
                       help='names, separated by commas, of the cameras of the INPUTs, such as '
                            'left,right; with one bag the image topics, such as '
                            '/left/image_raw,/right/image_raw; with one folder the folders in it')
    group.add_argument('--baseline', type=_length, metavar='METRES[:SIGMA]',
                       help='distance of the first two cameras, such as 0.11:0.0005 (default: '
                            'lengths in steps of the path; sigma 0: exact)')


def _length(text: str) -> tuple[float, float]:
    """Read a length with its sigma."""
    try:
        value, _, sigma = text.partition(':')
        found = float(value), float(sigma or 0)
    except ValueError:
        found = 0.0, 0.0
    if not (0 < found[0] < 1e4 and 0 <= found[1] < 1e4):
        raise argparse.ArgumentTypeError(f'{text!r:.40} is no length in metres with a sigma, such '
                                         'as 0.11:0.0005')
    return found


def run_rig(args: argparse.Namespace, settings: CalibrationSettings) -> int:
    """Calibrate a rig; returns the exit status."""
    from selfcal_ros.errors import ArgumentError
    from selfcal_ros.pipeline.rig_input import calibrate_rig_input, rig_inputs
    from selfcal_ros.report.rig_colmap import rig_config, rig_config_path
    from selfcal_ros.report.rig_files import (camchain, output_names, rig_camera_yaml, rig_text,
                                              why_no_camchain)
    for name in OF_ONE_CAMERA:
        if getattr(args, name, None):
            raise ArgumentError(f'--{name.replace("_", "-")} is for a single camera; leave it out '
                                'beside --cameras.')
    if args.motion not in MOTIONS:
        raise ArgumentError(f'--motion of several cameras is one of {", ".join(MOTIONS)}, not '
                            f'{args.motion}.')
    inputs = rig_inputs(args.input, args.cameras)
    base = args.output or Path('camera.yaml')
    if not base.name:
        raise ArgumentError(f'--output {base} is a folder; name a file, such as camera.yaml.')
    files = output_names(base, [one.name for one in inputs])
    chain = base.with_name(f'{base.stem}_camchain.yaml')
    of_colmap = rig_config_path(args.colmap) if args.colmap else None
    table = None if settings.robot is None else settings.robot.table
    # nobody has named them: those of an earlier run are replaced
    own = set() if args.output else {path for path in (*files.values(), chain)
                                     if is_made_here(path)}
    kept = [path for path in (*files.values(), chain) if path not in own]
    check_outputs((*kept, args.mount_output), (*args.input, args.mask, table),
                  args.force, (*own, args.json, args.report),
                  {'--mount-output': args.mount_output, '--json': args.json,
                   '--report': args.report})
    if args.colmap is not None and args.colmap.is_file():
        raise ArgumentError(f'{args.colmap} is a file; --colmap takes the name of a folder.')
    with Progress.of(args, rig_courses([one.name for one in inputs])) as progress:
        result, reading = calibrate_rig_input(inputs, settings, args.baseline, progress)
        progress('writing')
        text = (rig_text(result, frozenset(settings.mount_facts.stated), args.baseline)
                if result else str(result))
        written: list[Path] = []
        left_out: list[LeftOut] = []
        if result:
            cameras = {path: rig_camera_yaml(result, name, reading.description)
                       for name, path in files.items()}
            written += _camera_files(args, cameras, chain, camchain(result, reading.topics), own,
                                     left_out, why_no_camchain(result))
            written += _for_colmap(of_colmap, rig_config(result), left_out)
            written += _mount_of_first(args, result, left_out)
        written += _accounts(args, result, reading, text, settings.seed)
    if not (args.quiet or is_standard_output(args.json)):
        print(coloured(text))
        print(written_line(written, own))
    elif not result:
        print(result, file=sys.stderr)
    for one in left_out:
        if one.status or not args.quiet:
            print(one.sentence, file=sys.stderr)
    return status_of(bool(result), left_out)


def _camera_files(args: argparse.Namespace, cameras: dict[Path, str], chain: Path,
                  of_kalibr: str | None, own: set[Path], left_out: list[LeftOut],
                  why_not: str) -> list[Path]:
    """Write the file of every camera, and their chain for Kalibr where there is one."""
    from selfcal_ros.cli.outputs import written_or_left_out
    from selfcal_ros.values.output_files import atomic_write
    written: list[Path] = []
    if of_kalibr is None:
        # nobody has asked for it
        left_out.append(LeftOut(f'{chain}, a chain of Kalibr, was not written: '
                                f'{why_not}.', EXIT_DONE))
    else:
        cameras = {**cameras, chain: of_kalibr}
    for path, camera_file in cameras.items():
        written += written_or_left_out(path, left_out, partial(
            atomic_write, data=camera_file, replace=args.force or path in own))
    return written


def _accounts(args: argparse.Namespace, result: RigCalibration | NotCalibrated,
              reading: RigReading, text: str, seed: int) -> list[Path]:
    """Write what tells of the result, or why there is none: the page and the JSON."""
    from selfcal_ros.report.rig_files import rig_to_dict
    written: list[Path] = []
    if args.report:
        from selfcal_ros.report.provenance import Provenance
        from selfcal_ros.report.rig_page import write_rig_page
        written.append(write_rig_page(
            args.report, result, text, reading.description, reading.tracks, reading.shared,
            Provenance.of_this_run(getattr(args, 'command_line', ()), args.input),
            args.baseline))
    if args.json:
        content = rig_to_dict(result)
        content['seed'] = seed
        write_json(args.json, content)
        if not is_standard_output(args.json):
            written.append(args.json)
    return written


def _mount_of_first(args: argparse.Namespace, result: RigCalibration, left_out: list[LeftOut],
                    ) -> list[Path]:
    """Write where the first camera sits on the robot, if it is asked for and known."""
    from selfcal_ros.cli.outputs import write_mount, written_or_left_out
    if args.mount_output is None:
        return []
    return written_or_left_out(args.mount_output, left_out, lambda path: write_mount(
        path, next(iter(result.cameras.values())), args.camera_frame, force=args.force))


def _for_colmap(path: Path | None, content: str | None, left_out: list[LeftOut]) -> list[Path]:
    """Write the rig for COLMAP, if it is asked for and can hold it."""
    from selfcal_ros.values.output_files import atomic_write
    if path is None:
        return []
    if content is None:
        left_out.append(LeftOut('A rig of COLMAP needs all poses, and lenses without skew that '
                                f'COLMAP knows: {path} was not written.'))
        return []
    make_folder(path.parent)
    return [atomic_write(path, content)]
