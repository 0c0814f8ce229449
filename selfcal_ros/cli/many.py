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
"""`selfcal calibrate` with many recordings: a line and a file each, one joint result a camera."""

from __future__ import annotations

import argparse
from pathlib import Path
import re
import sys
from typing import TYPE_CHECKING

from selfcal_ros.cli.colours import coloured
from selfcal_ros.cli.force import check_outputs, output_folder
from selfcal_ros.cli.machine_output import is_standard_output, write_json
from selfcal_ros.cli.parsing import output_path
from selfcal_ros.cli.progress import Progress
from selfcal_ros.cli.status import EXIT_DONE, EXIT_INPUT, EXIT_NOT_CALIBRATED
from selfcal_ros.errors import ArgumentError, InputError

if TYPE_CHECKING:
    from selfcal_ros.pipeline.calibrate_input import CalibrationSettings
    from selfcal_ros.pipeline.many_inputs import Outcome, Summary

DEFAULT_FOLDER = 'calibrations'
#: Name of the files about all recordings.
SUMMARY = 'summary'


def add_many_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options for many recordings."""
    group = parser.add_argument_group(
        'many recordings', 'Several INPUTs, a folder of recordings, or a quoted pattern: each is '
        'calibrated, in parallel processes, and each camera (image topic and size) jointly.')
    group.add_argument('--output-dir', type=output_path, metavar='FOLDER',
                       help='for the camera file and the result of each recording and of each '
                            'camera, and summary.html, .png and .json (default '
                            f'{DEFAULT_FOLDER})')
    group.add_argument('--jobs', type=_count, metavar='N', help='processes (default: one a core)')
    group.add_argument('--engine', choices=('processes', 'dask'), default='processes',
                       help='what runs them (default processes)')
    group.add_argument('--scheduler', metavar='ADDRESS',
                       help='Dask scheduler, as tcp://host:8786; its workers must see the same '
                            'files (default: a cluster of this machine)')


def _count(value: str) -> int:
    """Take a number of processes."""
    if not value.isdecimal() or len(value) > 5 or int(value) < 1:
        raise argparse.ArgumentTypeError(f'{ascii(value):.40} is no number of processes; give 1 '
                                         'or more')
    return int(value)


def run_many(args: argparse.Namespace, paths: list[Path], settings: CalibrationSettings) -> int:
    """
    Calibrate many recordings; returns the exit status.

    0: every camera has a joint result; 1: one has none; 2: no recording can be used at all.
    """
    from selfcal_ros.report.camera_yaml import check_camera_name
    if args.poses:
        raise ArgumentError('--poses is for a single recording; with many, --poses-format writes '
                            'the poses of each beside its result.')
    for name in ('output', 'ply', 'colmap', 'transforms'):
        if getattr(args, name):
            raise ArgumentError(f'--{name} is for a single recording; with many, --output-dir '
                                'takes the files.')
    check_camera_name(args.camera_name)
    if args.camera_name == SUMMARY:
        raise ArgumentError(f'The name {SUMMARY} is that of the table of all recordings; give the '
                            'camera another one.')
    folder = args.output_dir or Path(DEFAULT_FOLDER)

    def check_folder() -> None:
        taken = None if args.force else _result_in(
            folder, summaries=folder != Path(DEFAULT_FOLDER))
        if taken:
            raise InputError(f'{taken} exists already; name another folder with --output-dir, or '
                             'replace what is there with --force.')

    check_folder()
    with output_folder(folder, 'recordings'):
        # now that no other run can come between
        check_folder()
        return _run_in(folder, args, paths, settings)


def _run_in(folder: Path, args: argparse.Namespace, paths: list[Path],
            settings: CalibrationSettings) -> int:
    """Calibrate into a folder that is ours; returns the exit status."""
    from selfcal_ros.pipeline.many_inputs import calibrate_many
    from selfcal_ros.report.many_inputs_report import summary_to_dict, write_summary_page
    page = args.report or folder / 'summary.html'
    inputs = (*paths, args.mask)
    check_outputs((), inputs, args.force, (page, folder / 'summary.json', args.json))
    quiet = args.quiet or is_standard_output(args.json)
    files = _RecordingFiles(folder / 'recordings', paths, settings.seed, args.poses_format)
    with Progress.of(args) as progress:
        summary = calibrate_many(paths, settings, each=files.write, progress=progress,
                                 engine=args.engine, workers=args.jobs, scheduler=args.scheduler)
    content = summary_to_dict(summary)
    write_json(folder / 'summary.json', content)
    if args.json:
        write_json(args.json, content)
    write_summary_page(page, summary)
    pictures = _write_cameras(summary, folder, args.camera_name)
    if not quiet:
        print(coloured(_text(summary)))
        print(f'Written: {page}, {", ".join(map(str, [*pictures, folder / "summary.json"]))}, '
              f'and {files.count} result{"" if files.count == 1 else "s"} in '
              f'{folder / "recordings"}.')
    for outcome in summary.failures if quiet else ():
        print(outcome.error, file=sys.stderr)
    if not summary.cameras:
        return EXIT_INPUT
    every = all(camera.joint is not None for camera in summary.cameras)
    return EXIT_DONE if every else EXIT_NOT_CALIBRATED


def _result_in(folder: Path, summaries: bool) -> Path | None:
    """
    Return a file that a run might replace, or that would look like one of its results.

    Where summaries do not count, one that tells of no calibration at all is replaced.
    """
    kinds = ('.yaml', '.json', '.html', '.png') if summaries else ('.yaml',)
    recordings = folder / 'recordings'
    return next((path for place, some in ((folder, kinds), (recordings, ('.yaml', '.json')))
                 if place.is_dir() for path in sorted(place.iterdir()) if path.suffix in some),
                None)


class _RecordingFiles:
    """Writes the result of each recording as it comes, so that none is lost."""

    def __init__(self, folder: Path, paths: list[Path], seed: int, poses: str | None) -> None:
        self._folder, self._seed, self._poses = folder, seed, poses
        stems = [path.stem for path in paths]
        self._numbers = {str(path): stems[:k + 1].count(path.stem) for k, path in enumerate(paths)}
        self._names: set[str] = set()
        # of what was written already: a recording may be asked again
        self._written: dict[tuple[str, str], str] = {}

    @property
    def count(self) -> int:
        """Number of results."""
        return len(self._written)

    def write(self, outcome: Outcome) -> None:
        """Write camera file, result and poses, each whole or not at all."""
        from selfcal_ros.report.camera_uncertainty import uncertainty_comment
        from selfcal_ros.report.camera_yaml import write_camera_yaml
        from selfcal_ros.report.result_json import write_result_json
        from selfcal_ros.report.shutter_comment import shutter_comment
        if outcome.result is None:
            return
        key = outcome.path, outcome.topic
        if key not in self._written:
            # of one name in several folders: by the order of inputs, whichever is ready first
            number = self._numbers.get(outcome.path, 1)
            stem = Path(outcome.path).stem + (f' {number}' if number > 1 else '')
            self._written[key] = _free_name(_plain_name(f'{stem} {outcome.topic}'), self._names)
        name = self._written[key]
        write_result_json(self._folder / f'{name}.json', outcome.result, self._seed)
        if not outcome.result:
            return
        about = f'{outcome.result.software}: {outcome.path} {outcome.topic}'
        write_camera_yaml(self._folder / f'{name}.yaml', outcome.result.camera,
                          file_name(outcome.topic) or 'camera',
                          [about, *shutter_comment(outcome.result.shutter),
                           *uncertainty_comment(outcome.result.camera,
                                                outcome.result.covariance)])
        if self._poses and outcome.camera_path is not None:
            from selfcal_ros.report.scene_files.pose_files import ENDS, write_poses
            write_poses(self._folder / f'{name}{ENDS[self._poses]}', self._poses,
                        outcome.camera_path, outcome.stamps_ns, about)


def _plain_name(text: str) -> str:
    """Turn a name into one of letters of any script, never hidden, empty or too long."""
    return re.sub(r'\W+', '_', text).strip('_')[:60].strip('_') or 'recording'


def _free_name(base: str, names: set[str]) -> str:
    """Return a name that none has yet, numbered if need be, and remember it."""
    name, number = base, 1
    while name in names:
        number += 1
        name = f'{base}_{number}'
    names.add(name)
    return name


def file_name(text: str) -> str:
    """Turn a topic or another text into a name of letters, digits and underscores."""
    return re.sub(r'[^A-Za-z0-9]+', '_', text).strip('_')


def _write_cameras(summary: Summary, folder: Path, camera_name: str) -> list[Path]:
    """Write the joint result and the figure of each camera; returns the files."""
    from selfcal_ros.report.camera_uncertainty import uncertainty_comment
    from selfcal_ros.report.camera_yaml import write_camera_yaml
    from selfcal_ros.report.many_inputs_report import verdict_of
    from selfcal_ros.report.parameter_history import parameter_history, picture
    from selfcal_ros.report.result_json import write_result_json
    from selfcal_ros.values.output_files import atomic_write
    written: list[Path] = []
    names: set[str] = set()
    for camera in summary.cameras:
        if camera.joint is None:
            continue
        lone = len(summary.cameras) == 1
        name = camera_name if lone else file_name(
            f'{camera.topic or camera_name} {camera.image_size[0]}x{camera.image_size[1]}')
        name = _free_name(name, names)
        result = camera.joint.calibration
        written += [
            write_camera_yaml(folder / f'{name}.yaml', result.camera, name,
                              [f'{result.software}: {int(camera.joint.used.sum())} recordings '
                               'together', verdict_of(camera).replace('±', '+-'),
                               *uncertainty_comment(result.camera, result.covariance)]),
            write_result_json(folder / f'{name}.json', result)]
        figure = parameter_history(camera)
        if figure is not None:
            written.append(atomic_write(folder / ('summary.png' if lone else f'{name}.png'),
                                        picture(figure, 'png')))
    return written


def _text(summary: Summary) -> str:
    """Return the table for a terminal."""
    from selfcal_ros.report.many_inputs_report import COLUMNS, rows_of, verdict_of
    lines = []
    for camera in summary.cameras:
        size = '{}x{}'.format(*camera.image_size)
        rows = rows_of(camera)
        wide = min(max([len(row.name) for row in rows] + [9]), 40)
        lines += [f'{camera.topic or "Camera"}, {size}', '',
                  f'{"recording":<{wide}}' + ''.join(f' {name:>17}' for name in COLUMNS)
                  + f' {"rms":>6} {"px":>5} {"sigmas":>6}  status']
        for row in rows:
            name = row.name if len(row.name) <= wide else f'...{row.name[3 - wide:]}'
            lines.append(f'{name:<{wide}}' + ''.join(f' {value:>17}' for value in row.values)
                         + f' {row.rms:>6} {row.max_difference_px:>5} {row.deviation:>6}'
                         f'  {row.status}')
        lines += ['', verdict_of(camera), *camera.notes, '']
    if summary.failures:
        lines += ['Cannot be used:', *(f'  {outcome.error}' for outcome in summary.failures), '']
    return '\n'.join(lines)
