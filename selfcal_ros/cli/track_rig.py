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
"""`selfcal track --rig`: several cameras that see the same objects."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from selfcal_ros.errors import ArgumentError

if TYPE_CHECKING:
    from selfcal_ros.pipeline.excerpt import Excerpt
    from selfcal_ros.pipeline.frame_source import Frame
    from selfcal_ros.pipeline.progress import Progress
    from selfcal_ros.pipeline.rig_input import RigInput
    from selfcal_ros.pipeline.tracking_loop import Target
    from selfcal_ros.pipeline.tracking_outcome import TrackingRun
    from selfcal_ros.report.poses_csv import PosesTable
    from selfcal_ros.rorapid.options import TrackerOptions
    from selfcal_ros.rorapid.several_cameras.rig_frame import RigFrame
    from selfcal_ros.values.camera_rig import PlacedCamera


def add_rig_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of several cameras."""
    group = parser.add_argument_group(
        'several cameras', 'Cameras that sit still to each other give one pose of an object, in '
        'the frame of the first one. Who does not see it adds nothing; who contradicts is told.')
    group.add_argument('--rig', type=Path, metavar='RIG',
                       help='in place of --camera: calibrations and places of the cameras, the '
                            "result.json of `selfcal calibrate --cameras --json` or Kalibr's "
                            'camchain.yaml')
    group.add_argument('--cameras', metavar='NAMES',
                       help='with --rig: names, separated by commas, of the cameras of the '
                            'INPUTs, such as left,right; with one bag image topics, too')
    group.add_argument('--rig-sigma', type=float, nargs=2, metavar=('DEGREES', 'METRES'),
                       help='standard deviations of the transforms between the cameras (default: '
                            'those of the file; of a camchain.yaml 0.05 0.0005)')


def rig_of(args: argparse.Namespace) -> tuple[list[RigInput], tuple[PlacedCamera, ...]]:
    """
    Read what is said of several cameras.

    Returns
    -------
    inputs : list of RigInput
    cameras : tuple of PlacedCamera

    Raises
    ------
    ArgumentError, InputError
        If it does not fit together.

    """
    from selfcal_ros.pipeline.rig_input import rig_inputs
    from selfcal_ros.report.camera_files.rig_reading import read_rig
    if args.camera is not None:
        raise ArgumentError('--rig has the calibrations of all cameras; leave --camera out.')
    if not args.cameras:
        raise ArgumentError('--rig needs --cameras, the names of the cameras of the INPUTs, such '
                            'as left,right.')
    for name in ('topic', 'depth_topic'):
        if getattr(args, name):
            raise ArgumentError(f'--{name.replace("_", "-")} is for a single camera; leave it '
                                'out beside --rig.')
    sigma = args.rig_sigma
    if sigma is not None and not (0 <= sigma[0] < 180 and 0 <= sigma[1] < 1e6):
        raise ArgumentError(f'--rig-sigma takes degrees and metres, not {sigma[0]:g} and '
                            f'{sigma[1]:g}.')
    inputs = rig_inputs(args.input, args.cameras)
    return inputs, read_rig(args.rig, [one.name for one in inputs],
                            [one.topic for one in inputs], None if sigma is None else tuple(sigma))


def check_single(args: argparse.Namespace) -> None:
    """
    Make sure that one camera is described.

    Raises
    ------
    ArgumentError
        If its calibration is missing, or options of several cameras are there.

    """
    for name in ('cameras', 'rig_sigma'):
        if getattr(args, name) is not None:
            raise ArgumentError(f'--{name.replace("_", "-")} needs --rig, the file of the '
                                'cameras.')
    if args.camera is None:
        raise ArgumentError('Say how the camera is calibrated: --camera CAMERA.YAML, or --rig '
                            'for several cameras.')
    if len(args.input) > 1:
        raise ArgumentError(f'There are {len(args.input)} INPUTs for one camera; several cameras '
                            'need --rig and --cameras.')


def overlays_of(overlay: Path | None, inputs: Sequence[RigInput]) -> list[Path]:
    """Name the video of each camera: out.mp4 gives out_left.mp4."""
    return [] if overlay is None else [
        overlay.with_name(f'{overlay.stem}_{one.name}{overlay.suffix}') for one in inputs]


def track_rig_recordings(inputs: Sequence[RigInput], cameras: Sequence[PlacedCamera],
                         targets: Sequence[Target], options: TrackerOptions | None = None, *,
                         overlays: Sequence[Path] = (), seed: int = 0,
                         progress: Progress | None = None,
                         listeners: Iterable[Callable[[Sequence[Frame | None], Sequence[RigFrame]],
                                                      object]] = (),
                         excerpt: Excerpt | None = None, names: Sequence[str] = ('',),
                         ) -> tuple[list[TrackingRun], list[PosesTable]]:
    """
    Track through the recordings of several cameras, and write overlays where they are wished for.

    Returns
    -------
    list of TrackingRun
        Of each target.
    list of PosesTable
        Not written yet.

    """
    from selfcal_ros.pipeline.rig_run import track_in_rig
    from selfcal_ros.pipeline.sources import Excerpt, open_source
    from selfcal_ros.pipeline.tracking_run import playing_rate_hz
    from selfcal_ros.report.overlay_video import drawing_of_camera, OverlayVideo
    from selfcal_ros.report.poses_csv import PosesTable
    tables = [PosesTable() for _ in targets]

    def add(frames: Sequence[Frame | None], found: Sequence[RigFrame]) -> None:
        first = next(frame for frame in frames if frame is not None)
        for table, one in zip(tables, found):
            table.add(first, one.tracked)

    part = excerpt or Excerpt()
    with ExitStack() as stack:
        sources = [stack.enter_context(open_source(
            one.path, one.topic, colour=bool(overlays),
            excerpt=replace(part, half=one.half or part.half))) for one in inputs]
        listeners = [add, *listeners]
        for which, (overlay, source) in enumerate(zip(overlays, sources)):
            video = stack.enter_context(OverlayVideo(overlay, playing_rate_hz(source)))
            listeners.append(drawing_of_camera(video, [target.model for target in targets],
                                               cameras[which].camera, which, names))
        runs = track_in_rig(sources, targets, cameras, options, seed=seed, progress=progress,
                            listeners=listeners)
    return runs, tables
