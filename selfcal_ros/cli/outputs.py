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
"""The files that a calibration leaves behind, checked before the work and written after it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.cli.force import check_outputs, is_made_here
from selfcal_ros.cli.machine_output import is_standard_output, write_json
from selfcal_ros.cli.scene_outputs import SceneOutputs
from selfcal_ros.cli.status import EXIT_INPUT, LeftOut
from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.report.camera_uncertainty import uncertainty_comment
from selfcal_ros.report.camera_yaml import check_camera_name, write_camera_yaml
from selfcal_ros.report.page import write_page
from selfcal_ros.report.provenance import Provenance
from selfcal_ros.report.result_json import result_to_json
from selfcal_ros.report.shutter_comment import shutter_comment
from selfcal_ros.values.output_files import OutputTaken
from selfcal_ros.values.tracks import Tracks

if TYPE_CHECKING:
    from selfcal_ros.report.open_frames import OpenFrames


@dataclass(frozen=True)
class Outputs:
    """
    Where to write what; None: not wanted.

    Parameters
    ----------
    camera_yaml, result_json, report : Path or None
    scene : SceneOutputs
        Path and structure.
    camera_name : str
        Name inside the camera file.
    command : tuple of str
        Words of the command line, for the report.
    inputs : tuple of path
        What is read, for the report.
    seed : int, optional
        What was drawn at random was drawn from it.
    mount : Path or None
        The transform from the robot to the camera.
    camera_frame : str or None
        Its child; by default that of the images.
    replaces_own : bool
        Nobody has named the camera file: one that this package has made is replaced.

    """

    camera_yaml: Path | None = None
    result_json: Path | None = None
    report: Path | None = None
    scene: SceneOutputs = SceneOutputs()
    camera_name: str = 'camera'
    command: tuple[str, ...] = ()
    inputs: tuple[str | Path, ...] = ()
    seed: int | None = None
    mount: Path | None = None
    camera_frame: str | None = None
    replaces_own: bool = False

    def check(self, *inputs: str | Path | None, force: bool = True) -> None:
        """
        Make sure that everything can be written.

        Parameters
        ----------
        inputs : path or None
            What is read, and must not be replaced.
        force : bool
            Replace the camera file, if it exists already.

        Raises
        ------
        InputError, ArgumentError
            See `check_outputs`.

        """
        check_camera_name(self.camera_name)
        if self.mount:
            from selfcal_ros.report.mounts.transform_files import check_frame, kind_of_name
            kind_of_name(self.mount)
            check_frame(self.camera_frame or 'camera')
        own = self.camera_yaml if self.replaced else None
        check_outputs((None if own else self.camera_yaml, self.mount), inputs, force,
                      (own, self.result_json, self.report, *self.scene.files),
                      {'--output': self.camera_yaml, '--mount-output': self.mount,
                       '--json': self.result_json, '--report': self.report,
                       '--ply': self.scene.ply, '--poses': self.scene.poses,
                       '--transforms': self.scene.transforms})
        self.scene.check(inputs[0] if inputs else None, force)

    @property
    def replaced(self) -> Path | None:
        """The camera file of an earlier run that this one replaces without being told to."""
        is_own = self.replaces_own and self.camera_yaml and is_made_here(self.camera_yaml)
        return self.camera_yaml if is_own else None

    def write(self, result: Calibration | NotCalibrated, text: str,
              source: str = '', tracks: Tracks | None = None,
              open_frames: OpenFrames | None = None, notes: tuple[Finding | str, ...] = (),
              stamps_ns: Mapping[int, int] | None = None,
              figures: tuple[str, ...] = (),
              force: bool = True,
              known_before: bool = False) -> tuple[list[Path], list[LeftOut]]:
        """
        Write the files, each whole or not at all; a camera file only for a calibration.

        Parameters
        ----------
        result : Calibration or NotCalibrated
        text : str
            The result as it is printed, for the report.
        source : str
            What was calibrated from.
        tracks : Tracks, optional
            The observations, for the report's figures and for the structure.
        open_frames : callable, optional
            Opens the images again (as a context manager), for the report's pictures and the
            colours of the structure.
        notes : tuple of Finding or str
            Further ones for the report.
        stamps_ns : mapping of int to int, optional
            When the images were taken, where they tell.
        figures : tuple of str
            Further elements for the report, from this program alone.
        force : bool
            Replace the camera file and the transform, if they have been made meanwhile.
        known_before : bool
            `replaced` was there when the work began.

        Returns
        -------
        list of Path
            The files written.
        list of LeftOut
            Why others were not.

        """
        written: list[Path] = []
        left_out: list[LeftOut] = []
        may_replace = force or (known_before and self.replaced is not None)
        if self.camera_yaml and result:
            written += written_or_left_out(self.camera_yaml, left_out, lambda path: (
                write_camera_yaml(path, result.camera, self.camera_name,
                                  _camera_comments(result, source),
                                  replace=may_replace)))
        if self.result_json:
            write_json(self.result_json, result_to_json(result, self.seed))
            if not is_standard_output(self.result_json):
                written.append(self.result_json)
        if self.report:
            written.append(write_page(self.report, result, text, source, figures, tracks=tracks,
                                      camera_name=self.camera_name, notes=notes,
                                      open_frames=open_frames,
                                      made=Provenance.of_this_run(self.command, self.inputs)))
        if self.mount and result:
            written += written_or_left_out(self.mount, left_out, lambda path: write_mount(
                path, result, self.camera_frame, source, force))
        if result and tracks is not None:
            more, why_not = self.scene.write(result, source, tracks, open_frames, stamps_ns)
            written += more
            left_out += map(LeftOut, why_not)
        return written, left_out


def written_or_left_out(path: Path, left_out: list[LeftOut],
                        write: Callable[[Path], Path]) -> list[Path]:
    """
    Write a file so that one which cannot be written costs no other.

    Parameters
    ----------
    path : Path
    left_out : list of LeftOut
        Here it is added why it was not written: the result cannot be in it, or another run has
        made it meanwhile.
    write : callable
        Takes the path.

    Returns
    -------
    list of Path
        What was written.

    """
    try:
        return [write(path)]
    except OutputTaken as error:
        left_out.append(LeftOut(str(error), EXIT_INPUT))
    except ArgumentError as error:
        left_out.append(LeftOut(f'{path} was not written: {error}'))
    return []


def write_mount(path: Path, result: Calibration, frame: str | None, source: str = '',
                force: bool = True) -> Path:
    """
    Write the transform from the robot to the camera.

    Parameters
    ----------
    path : Path
    result : Calibration
    frame : str or None
        Of the camera; None: that of the images.
    source : str
        Where the images come from.
    force : bool
        Replace what is there.

    Raises
    ------
    ArgumentError
        If there is no mount, or not all of it is known.
    OutputTaken
        If the file is there, and may not be replaced.

    """
    from selfcal_ros.calibration.mount import Mount
    from selfcal_ros.report.mounts.transform_files import stored_mount, write_transform
    if not isinstance(result.mount, Mount):
        raise ArgumentError(result.mount.reason if result.mount is not None
                            else 'no robot was given.')
    about = f'{result.software}: {source}' if source else result.software
    return write_transform(path, stored_mount(result.mount, frame, about), replace=force)


def _camera_comments(result: Calibration, source: str) -> list[str]:
    """Say in a camera file where it comes from, and how good it is."""
    sigma = result.sigma
    varied = [] if result.focal is None else [
        'The focal length varied from {:.2f} to {:.2f} px: this is the mean; the result of '
        '--json has that of every image.'.format(result.focal.fx.min(), result.focal.fx.max())]
    return [f'{result.software}: {source}' if source else result.software,
            f'fx +- {sigma["fx"]:.3g} px, fy +- {sigma["fy"]:.3g} px, '
            f'cx +- {sigma["cx"]:.3g} px, cy +- {sigma["cy"]:.3g} px (one sigma)',
            *varied, *shutter_comment(result.shutter),
            *uncertainty_comment(result.camera, result.covariance)]
