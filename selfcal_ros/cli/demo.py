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
"""`selfcal demo`: a recording through the real nodes, its calibration beside the truth."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
import json
from pathlib import Path
import re
import shutil
import sys
from typing import TYPE_CHECKING

from selfcal_ros.cli.force import add_force_argument, output_folder, written_line
from selfcal_ros.cli.parsing import output_path
from selfcal_ros.cli.progress import Progress
from selfcal_ros.cli.ros_environment import own_graph
from selfcal_ros.cli.status import EXIT_DONE, EXIT_NOT_CALIBRATED, status_of

if TYPE_CHECKING:
    from selfcal_ros.calibration.result import Calibration, NotCalibrated
    from selfcal_ros.values.tracks import Tracks

#: What lies there is of an earlier demo.
OWN_FOLDER = Path('selfcal_demo')
#: In the folder of a demo, what its nodes have logged; a log has the name of the program, its
#: number and the time.
LOG, _LOG_NAME = 'log', re.compile(r'.+_\d+_\d+\.log')
#: Recordings of this package, and the calibrator for their kind of motion.
RECORDINGS = {'agv': ('bags/agv_drive', 'planar_calibrator'),
              'arm': ('bags/arm_move', 'affine_calibrator')}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `selfcal demo`."""
    parser.add_argument('--output-dir', type=output_path, default=OWN_FOLDER, metavar='FOLDER',
                        help='for camera.yaml, result.json and report.html (default selfcal_demo)')
    parser.add_argument('--recording', choices=[*sorted(RECORDINGS), 'object'], default='agv',
                        help='calibrate on a robot that drives, or on an arm that moves; or '
                             'track an object (default agv)')
    parser.add_argument('--bag', type=Path, help='another bag of that kind of motion')
    parser.add_argument('--rate', type=_rate, default=1.0,
                        help='playback speed, from 0.01 to 100 (default 1)')
    add_force_argument(parser, 'replace what is in the FOLDER of --output-dir; the '
                       "default is the demo's own")
    parser.add_argument('--no-ros', action='store_true', help='without nodes in any case')


def _rate(value: str) -> float:
    """Take a speed that bag_player takes."""
    try:
        rate = float(value)
    except ValueError:
        rate = 0.0
    if not 0.01 <= rate <= 100:
        raise argparse.ArgumentTypeError(f'{ascii(value):.40} is no number from 0.01 to 100')
    return rate


def without_nodes(args: argparse.Namespace, bag: Path, instead: str) -> bool:
    """
    Tell whether the demo runs without nodes; where nobody asked for that, say why.

    The recording is opened before anything is said, made or started; nodes replay bags only.
    """
    from selfcal_ros.pipeline.replay import ImageRecording
    from selfcal_ros.pipeline.sources import open_source
    with open_source(bag):
        pass
    if args.no_ros:
        return True
    if find_spec('rclpy') is not None and find_spec('sensor_msgs') is not None:
        ImageRecording(bag).close()
        return False
    print(f'There is no ROS in this Python (rclpy is missing), so no nodes: {instead}.')
    return True


@contextmanager
def log_folder(folder: Path) -> Iterator[Path]:
    """
    Name the folder for the logs of nodes, and leave those of the last demo alone in it.

    One that is new goes with an interrupted demo.
    """
    log = folder / LOG
    is_new = not log.exists()
    earlier = logs_in(folder)
    try:
        yield log
    except Exception:
        raise
    except BaseException:
        # a signal: nodes that were stopped have nothing to tell
        if is_new:
            shutil.rmtree(log, ignore_errors=True)
        raise
    if logs_in(folder) - earlier:
        for one in earlier:
            one.unlink(missing_ok=True)


def logs_in(folder: Path) -> set[Path]:
    """Return the logs of nodes in the folder of a demo; a user may send them elsewhere."""
    return {one for one in (folder / LOG).glob('*.log') if _LOG_NAME.fullmatch(one.name)}


def logged_since(folder: Path, earlier: set[Path]) -> list[Path]:
    """Return the folder of the logs, if there are others than earlier."""
    return [folder / LOG] if logs_in(folder) - earlier else []


def run(args: argparse.Namespace) -> int:
    """Run the demo; returns the exit status."""
    if args.recording == 'object':
        from selfcal_ros.cli import demo_track
        return demo_track.run(args)
    from selfcal_ros.cli.shared_files import shared_file
    recording, calibrator = RECORDINGS[args.recording]
    bag = args.bag or shared_file(recording)
    no_nodes = without_nodes(args, bag, 'calibrating straight from the bag')
    with output_folder(args.output_dir):
        return _calibrate(args, bag, None if no_nodes else calibrator)


def _calibrate(args: argparse.Namespace, bag: Path, calibrator: str | None) -> int:
    """Calibrate through the nodes, if there is a calibrator, and without; returns the status."""
    from selfcal_ros.cli.outputs import Outputs
    from selfcal_ros.cli.result_text import result_text
    from selfcal_ros.cli.shared_files import shared_file
    from selfcal_ros.pipeline.sources import open_source
    folder = args.output_dir
    camera_yaml, result_json = folder / 'camera.yaml', folder / 'result.json'
    outputs = Outputs(camera_yaml, result_json, folder / 'report.html',
                      command=getattr(args, 'command_line', ()), inputs=(bag,))
    outputs.check(bag, force=args.force or folder == OWN_FOLDER)
    for path in (camera_yaml, result_json):
        # of an earlier run
        path.unlink(missing_ok=True)
    result, written, logs = None, [], logs_in(folder)
    if calibrator:
        print(f'Replaying {bag} through bag_player, feature_tracker and {calibrator} ...',
              flush=True)
        result = _through_nodes(bag, calibrator, folder, args.rate,
                                shared_file('config/fastdds.xml'))
        if result is None:
            print('Calibrating straight from the bag instead.')
        elif result:
            # the nodes have written the rest
            written = [path for path in (camera_yaml, result_json) if path.exists()]
            outputs = replace(outputs, camera_yaml=None, result_json=None)
    logged = logged_since(folder, logs)
    direct, tracks = _from_bag(bag)
    if result:
        print(f'\n{result_text(result, truth=read_truth(bag))}\n\n{_agreement(result, direct)}')
    # the nodes send the camera and not the scene, which the report draws
    text = result_text(direct, truth=read_truth(bag))
    if not result:
        print(f'\n{text}')
    more, left_out = outputs.write(
        direct, text, str(bag), tracks, lambda: open_source(bag, colour=True))
    # or the figures of the page look like an error beside those of the camera file
    source = ' The report is of the calibration straight from the bag.' if result else ''
    print(f'\n{written_line([*written, *more, *logged])}{source}')
    for one in left_out:
        print(one.sentence, file=sys.stderr)
    return status_of(bool(result or direct), left_out)


def _agreement(live: Calibration, direct: Calibration | NotCalibrated) -> str:
    """Compare the nodes' result with that of the bag itself, in a sentence."""
    if not direct:
        return f'Straight from the bag, without nodes: {direct}'
    names = ('fx', 'cx', 'cy')
    shifts = (live.camera.parameters - direct.camera.parameters)[[0, 2, 3]]
    apart = ', '.join(f'{name} {shift:+.3f}' for name, shift in zip(names, shifts))
    return ('The same recording straight from the bag, as `selfcal calibrate` does it: '
            f'fx {direct.camera.K[0, 0]:.3f} ± {direct.sigma["fx"]:.3f}; '
            f'the nodes differ by {apart} px.')


def _through_nodes(bag: Path, calibrator: str, folder: Path, rate: float, profile: Path,
                   ) -> Calibration | NotCalibrated | None:
    """Return the result of the nodes, None if they came to none."""
    from selfcal_ros.pipeline.child_process import run_module
    from selfcal_ros.report.result_json import result_from_dict
    with log_folder(folder) as log:
        status = run_module('selfcal_ros.nodes.replay_supervisor',
                            [str(bag), '--output', str(folder), '--rate', str(rate),
                             '--calibrator', calibrator], own_graph(profile, log))
    if status not in (EXIT_DONE, EXIT_NOT_CALIBRATED):
        return None
    try:
        return result_from_dict(json.loads((folder / 'result.json').read_text(encoding='utf-8')))
    except (OSError, ValueError, KeyError) as error:
        print(f'The nodes left no usable result ({error}).', file=sys.stderr)
        return None


def _from_bag(bag: Path) -> tuple[Calibration | NotCalibrated, Tracks]:
    """Calibrate without nodes; returns the result and the tracks."""
    from selfcal_ros import calibrate, CameraFacts
    from selfcal_ros.pipeline.feature_session import read_tracks
    with Progress() as progress:
        reading = read_tracks(bag, progress=progress)
    return (calibrate(reading.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0)),
            reading.tracks)


def read_truth(bag: Path) -> dict[str, float] | None:
    """Read the truth beside a recording: the value of each parameter."""
    path = bag.with_name(bag.name + '.truth.json')
    if not path.is_file():
        return None
    truth = json.loads(path.read_text(encoding='utf-8'))
    K, d = truth['K'], list(truth.get('distortion', ())) + [0.0] * 5
    return {'fx': K[0][0], 'fy': K[1][1], 'cx': K[0][2], 'cy': K[1][2], 'skew': K[0][1],
            'k1': d[0], 'k2': d[1], 'p1': d[2], 'p2': d[3], 'k3': d[4]}
