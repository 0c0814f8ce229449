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
"""Path and structure as files: what is asked for, checked before the work, written after it."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from selfcal_ros.cli.facts import FREE
from selfcal_ros.cli.force import check_suffix, make_folder
from selfcal_ros.cli.parsing import output_path
from selfcal_ros.errors import ArgumentError, InputError

if TYPE_CHECKING:
    from selfcal_ros.calibration.result import Calibration
    from selfcal_ros.report.open_frames import OpenFrames
    from selfcal_ros.report.scene_files.exported_scene import ExportedScene
    from selfcal_ros.report.scene_files.keyframe_files import KeyframeFiles
    from selfcal_ros.values.tracks import Tracks

#: Outputs that need depth, by option.
OF_STRUCTURE = ('ply', 'colmap', 'transforms')
#: Points beside transforms.json, by the name that nerfstudio gives them.
SPARSE_POINTS = 'sparse_pc.ply'


def add_scene_arguments(group: argparse._ActionsContainer) -> None:
    """Add the options of path and structure."""
    group.add_argument('--ply', type=output_path, metavar='STRUCTURE.PLY',
                       help='the points of the scene with their colours, and the cameras; the '
                            'median step between views is 1, or in metres with --robot')
    group.add_argument('--poses', type=output_path, metavar='FILE',
                       help='where the camera was in every image that was used: .tum or .txt '
                            '(stamp tx ty tz qx qy qz qw), or .csv with covariances')
    group.add_argument('--poses-format', choices=('tum', 'euroc', 'csv'),
                       help='format of --poses, if its name does not tell; euroc has w first; '
                            'with many recordings, poses of each in this format')
    group.add_argument('--colmap', type=output_path, metavar='FOLDER',
                       help='text model of COLMAP; images of a bag or a video as PNG in '
                            'FOLDER/images; of several cameras rig_config.json')
    group.add_argument('--transforms', type=output_path, metavar='TRANSFORMS.JSON',
                       help='cameras for nerfstudio and its like, with '
                            f'{SPARSE_POINTS} beside it; images as with --colmap')


@dataclass(frozen=True)
class SceneOutputs:
    """
    Where to write path and structure; None: not wanted.

    Parameters
    ----------
    ply, poses, colmap, transforms : Path or None
    poses_format : str, optional

    """

    ply: Path | None = None
    poses: Path | None = None
    poses_format: str | None = None
    colmap: Path | None = None
    transforms: Path | None = None

    @classmethod
    def of(cls, args: argparse.Namespace) -> SceneOutputs:
        """
        Take what the command line asks for.

        Raises
        ------
        ArgumentError
            If it contradicts the other options.

        """
        asked = [name for name in OF_STRUCTURE if getattr(args, name)]
        if args.poses_format and not args.poses:
            raise ArgumentError('--poses-format needs --poses FILE.')
        if args.poses:
            from selfcal_ros.report.scene_files.pose_files import format_of
            format_of(args.poses, args.poses_format)
        if asked:
            _check_structure(args, asked)
        return cls(args.ply, args.poses, args.poses_format, args.colmap, args.transforms)

    @property
    def files(self) -> list[Path]:
        """The files that are known beforehand; those of a folder that there is."""
        beside = [self.transforms.parent / SPARSE_POINTS] if self.transforms else []
        if self.colmap and self.colmap.is_dir():
            from selfcal_ros.report.scene_files.colmap_model import FILES
            beside += [self.colmap / name for name in FILES]
        return [*filter(None, (self.ply, self.poses, self.transforms)), *beside]

    @property
    def _image_folders(self) -> dict[Path, Path]:
        """Where images of a bag or a video go, each with the file that names them."""
        from selfcal_ros.report.scene_files.keyframe_files import FOLDER
        naming = (self.colmap and self.colmap / 'images.txt', self.transforms)
        return {file.resolve().parent / FOLDER: file for file in naming if file}

    def check(self, source: str | Path | None, force: bool) -> None:
        """
        Make sure that folders can be written to; files are checked with all others.

        Parameters
        ----------
        source : path or None
            What is calibrated from.
        force : bool
            Replace images that somebody else has made.

        Raises
        ------
        InputError, ArgumentError
            If they cannot, or hold what would be replaced.

        """
        if self.colmap:
            make_folder(self.colmap.parent)
            from selfcal_ros.report.scene_files.colmap_model import check_colmap_folder
            check_colmap_folder(self.colmap)
        if force or _is_photographs(source):
            return
        from selfcal_ros.report.scene_files.keyframe_files import PATTERN
        for folder, naming in self._image_folders.items():
            taken = next(folder.glob(PATTERN), None)
            # those of an earlier run are made anew
            if taken is not None and not naming.exists():
                raise InputError(f'{folder} holds images already, such as {taken.name}; choose '
                                 'another folder, or replace them with --force.')

    def write(self, result: Calibration, source: str, tracks: Tracks,
              open_frames: OpenFrames | None, stamps_ns: Mapping[int, int] | None,
              ) -> tuple[list[Path], list[str]]:
        """
        Write what a calibration has.

        Parameters
        ----------
        result : Calibration
        source : str
            What was calibrated from.
        tracks : Tracks
        open_frames : callable, optional
            Opens the images again, as a context manager.
        stamps_ns : mapping of int to int, optional
            When the images were taken, where they tell.

        Returns
        -------
        list of Path
            The files written.
        list of str
            Why others were not, a sentence each.

        """
        written: list[Path] = []
        about = f'{result.software}: {source}' if source else result.software
        if self.poses:
            from selfcal_ros.calibration.structure.camera_path import camera_path
            from selfcal_ros.report.scene_files.pose_files import format_of, write_poses
            written.append(write_poses(self.poses, format_of(self.poses, self.poses_format),
                                       camera_path(result), stamps_ns, about))
        asked = [name for name in OF_STRUCTURE if getattr(self, name)]
        if not asked:
            return written, []
        if result.motion == 'rotation':
            # a camera that only rotates sees no depth
            return written, [f'--{name} was not written: the camera only turned, and images '
                             'without parallax show no depth.' for name in asked]
        more, left_out = self._write_structure(asked, result, about, tracks, open_frames,
                                               stamps_ns)
        return written + more, left_out

    def _write_structure(self, asked: Iterable[str], result: Calibration, about: str,
                         tracks: Tracks, open_frames: OpenFrames | None,
                         stamps_ns: Mapping[int, int] | None) -> tuple[list[Path], list[str]]:
        """Gather the scene once, and write it in every way that is asked for."""
        from selfcal_ros.report.scene_files.exported_scene import exported_scene
        from selfcal_ros.report.scene_files.keyframe_files import (frame_name, KeyframeFiles,
                                                                   read_keyframes)
        scene = exported_scene(result, tracks)
        if open_frames is None:
            images = KeyframeFiles(tuple(map(frame_name, scene.path.frames.tolist())), None, None)
        else:
            with open_frames() as frames:
                images = read_keyframes(frames, scene.path.frames, tracks, scene.tracks,
                                        sorted(self._image_folders))
        written, left_out = [], []
        for name in asked:
            try:
                written += _WRITERS[name](getattr(self, name), scene, images, about, stamps_ns)
            except ArgumentError as error:
                left_out.append(f'--{name} was not written: {error}')
        return written, left_out


def _is_photographs(source: str | Path | None) -> bool:
    """Tell a folder of images, which are files already and stay where they are."""
    from selfcal_ros.pipeline.bag_source import is_bag_folder
    return source is not None and Path(source).is_dir() and not is_bag_folder(Path(source))


def _write_ply(path: Path, scene: ExportedScene, images: KeyframeFiles, about: str, _: object,
               ) -> list[Path]:
    from selfcal_ros.report.ply import camera_frusta, write_ply
    frusta = camera_frusta(scene.camera, scene.path.rotation, scene.path.centre,
                           scene.path.metres_a_step or 1.0)
    return [write_ply(path, scene.points, images.colours, [
        *_comments(scene, about), f'the first {len(scene.points)} vertices are points; then come '
        f'{len(frusta)} cameras of 5 vertices, the centre first (track -1)',
        'sigma: largest standard deviation of the point'],
        tracks=scene.tracks, sigma=scene.sigma, frusta=frusta)]


def _write_colmap(folder: Path, scene: ExportedScene, images: KeyframeFiles, about: str, _: object,
                  ) -> list[Path]:
    from selfcal_ros.report.scene_files.colmap_model import write_colmap
    write_colmap(folder, scene, images.names, images.colours, _comments(scene, about))
    return [folder]


def _write_transforms(path: Path, scene: ExportedScene, images: KeyframeFiles, about: str,
                      stamps_ns: Mapping[int, int] | None) -> list[Path]:
    from selfcal_ros.report.ply import write_ply
    from selfcal_ros.report.scene_files.transforms_json import write_transforms
    from selfcal_ros.report.scene_files.keyframe_files import FOLDER
    written = [write_transforms(path, scene, images.relative_to(path.parent), stamps_ns,
                                SPARSE_POINTS, about),
               write_ply(path.parent / SPARSE_POINTS, scene.points, images.colours,
                         _comments(scene, about))]
    return [*written, path.parent / FOLDER] if images.written else written


_WRITERS = {'ply': _write_ply, 'colmap': _write_colmap, 'transforms': _write_transforms}


def _comments(scene: ExportedScene, about: str) -> list[str]:
    """Say what the numbers of a file are."""
    from selfcal_ros.report.scene_files.world_words import unit_in_words, world_in_words
    return [about, f'unit: {unit_in_words(scene.path)}', f'axes: {world_in_words(scene.path)}']


def _check_structure(args: argparse.Namespace, asked: list[str]) -> None:
    """Refuse what cannot come out, before the long work."""
    if args.track:
        raise ArgumentError(f'--{asked[0]} writes points, and --track follows edges; leave it '
                            'out. --poses has the path.')
    check_suffix('structure', args.ply, 'is PLY', '.ply')
    if args.ply and args.object:
        raise ArgumentError('--ply writes the structure of an unknown scene; leave it out, the '
                            'object is known.')
    if args.motion == 'rotation':
        raise ArgumentError(f'--{asked[0]} needs depth, and a camera that only rotates sees none; '
                            'leave it out. --poses has how it turned.')
    if args.motion == 'repeated' and asked != ['ply']:
        raise ArgumentError(f'--{asked[-1]} needs an image for every view, and equal objects are '
                            'in one; leave it out.')
    if args.transforms and Path(args.input[0]).suffix.lower() == '.csv':
        raise ArgumentError('--transforms names an image for every view, and a table of tracks '
                            'has none; leave it out. --colmap has what the table tells.')
    if args.skew == FREE and asked != ['ply']:
        raise ArgumentError(f'--{asked[-1]} has no place for skew; leave --skew free out.')
    if args.transforms and args.distortion == 'rational':
        raise ArgumentError('--transforms has no model for the rational lens; choose --lens '
                            'plumb_bob, or leave it out.')
