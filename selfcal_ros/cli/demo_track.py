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
"""`selfcal demo --recording object`: track the recorded object, beside the truth."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
import json
from pathlib import Path
from typing import Any, TYPE_CHECKING

from selfcal_ros.cli.force import check_outputs, output_folder, written_line
from selfcal_ros.cli.progress import Progress
from selfcal_ros.cli.ros_environment import own_graph
from selfcal_ros.cli.status import EXIT_DONE, EXIT_NOT_CALIBRATED
from selfcal_ros.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from selfcal_ros.geometry.camera import Camera
    from selfcal_ros.pipeline.frame_source import Frame
    from selfcal_ros.pipeline.tracking_loop import Target
    from selfcal_ros.rorapid.tracked_frame import TrackedFrame

RECORDING = 'bags/tracked_object'
#: Where the nodes leave their poses, in the folder of the demo.
NODE_POSES = 'node_poses.json'


def run(args: argparse.Namespace) -> int:
    """Run the demo; returns the exit status."""
    from selfcal_ros.cli.demo import without_nodes
    from selfcal_ros.cli.shared_files import shared_file
    from selfcal_ros.pipeline.tracking_loop import Target
    from selfcal_ros.pipeline.tracking_run import read_start
    from selfcal_ros.report.camera_yaml import read_camera_yaml
    from selfcal_ros.rorapid.model import read_model
    bag = args.bag or shared_file(RECORDING)
    model, camera_file, start_file = (bag.with_name(bag.name + suffix) for suffix in (
        '.model.yaml', '.camera.yaml', '.pos'))
    no_nodes = without_nodes(args, bag, 'tracking straight in the bag')
    for path in (model, camera_file, start_file):
        if not path.is_file():
            raise InputError(f'{path} is not there; the recording of an object needs its '
                             '.model.yaml, .camera.yaml and .pos beside it.')
    camera, _ = read_camera_yaml(camera_file)
    target = Target(read_model(model), read_start(str(start_file), None, camera))
    with output_folder(args.output_dir):
        outputs = args.output_dir / 'poses.csv', args.output_dir / 'overlay.mp4'
        check_outputs((), (bag, model, camera_file, start_file), False, outputs)
        return _track(bag, target, camera, outputs, None if no_nodes else (
            model, camera_file, start_file, args.output_dir, args.rate))


def _track(bag: Path, target: Target, camera: Camera, outputs: Sequence[Path],
           for_nodes: tuple[Path, Path, Path, Path, float] | None) -> int:
    """Track through the nodes, if there is something for them, and without; returns the status."""
    from selfcal_ros.cli.demo import logged_since, logs_in
    from selfcal_ros.cli.track import track_recording
    truth, folder = _truth(bag), outputs[0].parent
    rows, logs = [], logs_in(folder)
    if for_nodes:
        print(f'Replaying {bag} through bag_player and rorapid_tracker ...', flush=True)
        poses = _through_nodes(bag, *for_nodes)
        if poses:
            rows.append(('through the nodes', *_errors(poses, truth)))
        else:
            print('Tracking straight in the bag instead.')
    of_nodes = [folder / NODE_POSES] if rows else []
    logged = logged_since(folder, logs)
    poses = []

    def gather(frame: Frame, objects: Sequence[TrackedFrame]) -> None:
        tracked, = objects
        if tracked:
            poses.append((frame.stamp_ns, _matrix(tracked), tracked.covariance))

    with Progress() as progress:
        (run,), (table,) = track_recording(bag, [target], camera, overlay=outputs[1],
                                           progress=progress, listeners=[gather])
    if poses:
        rows.append(('straight from the bag', *_errors(poses, truth)))
    written = [table.write(outputs[0]), outputs[1]]
    print(f'\n{run.text()}\n')
    if truth:
        print(_table(rows))
    print(f'\n{written_line([*written, *of_nodes, *logged])} The video shows what was found '
          '(green), what was not (orange), and what contradicts the pose (vermilion).')
    return EXIT_DONE if run.followed else EXIT_NOT_CALIBRATED


def _matrix(tracked: TrackedFrame) -> np.ndarray:
    import numpy as np
    return np.column_stack([tracked.rotation, tracked.translation])


def _truth(bag: Path) -> dict[int, np.ndarray]:
    """Read the true pose by stamp; empty where the recording comes without."""
    import numpy as np
    path = bag.with_name(bag.name + '.truth.json')
    if not path.is_file():
        return {}
    content = json.loads(path.read_text(encoding='utf-8'))
    return dict(zip(content['stamps_ns'], np.array(content['cam_from_object'], float)))


def _through_nodes(bag: Path, model: Path, camera: Path, start_pose: Path, folder: Path,
                   rate: float) -> list[Any]:
    """Return the poses of the nodes; none if they came to none."""
    from selfcal_ros.cli.demo import log_folder
    from selfcal_ros.cli.shared_files import shared_file
    from selfcal_ros.pipeline.child_process import run_module
    left = folder / NODE_POSES
    left.unlink(missing_ok=True)
    words = [bag, '--output', folder, '--model', model, '--camera', camera, '--start-pose',
             start_pose, '--rate', rate]
    with log_folder(folder) as log:
        run_module('selfcal_ros.nodes.tracking_supervisor', map(str, words),
                   own_graph(shared_file('config/fastdds.xml'), log))
    try:
        poses: list[Any] = json.loads(left.read_text(encoding='utf-8'))
        return poses
    except (OSError, ValueError):
        return []


def _errors(poses: Sequence[Any], truth: dict[int, np.ndarray]) -> tuple[float, ...]:
    """Compare poses with the truth: count, median and largest errors, squared sigmas."""
    import numpy as np
    from selfcal_ros.geometry.rotation import rotation_vector
    angles, shifts, squares = [], [], []
    for stamp, pose, covariance in poses:
        if stamp not in truth:
            continue
        found, true = np.array(pose, float), truth[stamp]
        turn = rotation_vector(found[:, :3] @ true[:, :3].T)
        error = np.concatenate([found[:, 3] - true[:, 3], turn])
        angles.append(np.rad2deg(np.linalg.norm(turn)))
        shifts.append(1000 * np.linalg.norm(error[:3]))
        squares.append(error @ np.linalg.solve(np.array(covariance, float), error) / 6)
    if not angles:
        return len(poses), *[float('nan')] * 5
    return (len(poses), np.median(angles), np.max(angles), np.median(shifts), np.max(shifts),
            float(np.sqrt(np.median(squares))))


def _table(rows: Iterable[Sequence[Any]]) -> str:
    """Lay the errors out for a person."""
    lines = [f'{"against the truth":22} {"poses":>6} {"rotation, deg":>16} {"position, mm":>16} '
             f'{"in sigmas":>10}',
             f'{"":22} {"":>6} {"median, most":>16} {"median, most":>16} {"median":>10}']
    for name, count, *turned, near, far, sigmas in rows:
        angle, shift = '{:.3f}, {:.3f}'.format(*turned), f'{near:.2f}, {far:.2f}'
        lines.append(f'{name:22} {count:>6} {angle:>16} {shift:>16} {sigmas:>10.2f}')
    return '\n'.join(lines)
