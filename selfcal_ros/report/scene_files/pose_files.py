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
"""
Poses of a calibration as files: TUM's, EuRoC's, and a table with covariances.

Each line is world_T_camera: where the camera's optical frame is in the world, and how it is
turned. What the world and the unit are stands in `CameraPath`, and in the head of every file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from selfcal_ros.calibration.structure.camera_path import CameraPath, OF_AN_OBJECT
from selfcal_ros.errors import ArgumentError
from selfcal_ros.report.scene_files.world_words import unit_in_words, world_in_words
from selfcal_ros.values.output_files import atomic_write

#: What each format is, for a person.
FORMATS = {'tum': "TUM's, as evo reads it", 'euroc': "EuRoC's, as evo and Kalibr have it",
           'csv': 'a table with covariances'}
#: Formats by the end of a name; EuRoC's has the end of any table.
SUFFIXES = {'.tum': 'tum', '.txt': 'tum', '.csv': 'csv'}
#: What names end in where we choose them.
ENDS = {'tum': '.tum', 'euroc': '.euroc.csv', 'csv': '.csv'}
#: Rows and columns of a covariance, in the order of PoseWithCovariance of ROS.
COORDINATES = ('x', 'y', 'z', 'rx', 'ry', 'rz')
#: Columns of the table.
COLUMNS = ('frame', 'stamp_ns', 'tx', 'ty', 'tz', 'qx', 'qy', 'qz', 'qw',
           *(f'cov_{row}_{column}' for row in COORDINATES for column in COORDINATES))
_NS = 1_000_000_000


def format_of(path: Path, stated: str | None = None) -> str:
    """
    Return the format that is stated, or that of a name.

    Raises
    ------
    ArgumentError
        If the name tells none.

    """
    chosen = stated or SUFFIXES.get(path.suffix.lower())
    if chosen is None:
        raise ArgumentError(f'The name {path.name!r:.80} tells no format of poses; end it in '
                            f'{", ".join(SUFFIXES)}, or add --poses-format '
                            f'{"|".join(FORMATS)}.')
    return chosen


def write_poses(path: Path, form: str, poses: CameraPath, stamps_ns: Mapping[int, int] | None,
                source: str) -> Path:
    """
    Write poses, whole or not at all.

    Parameters
    ----------
    path : Path
    form : str
        One of `FORMATS`.
    poses : CameraPath
    stamps_ns : mapping of int to int, optional
        When each frame was taken; without them frames are counted.
    source : str
        What the poses come from, for the head of the file.

    Returns
    -------
    Path

    """
    texts = {'tum': tum_text, 'euroc': euroc_text, 'csv': table_text}
    return atomic_write(path, texts[form](poses, stamps_ns, source))


def tum_text(poses: CameraPath, stamps_ns: Mapping[int, int] | None, source: str = '') -> str:
    """Return lines `stamp tx ty tz qx qy qz qw`: seconds, or the number of the frame."""
    lines = [*_head(poses, stamps_ns, source), '# timestamp tx ty tz qx qy qz qw']
    for k, stamp in _in_order(poses, stamps_ns):
        when = str(stamp) if stamps_ns is None else _seconds(stamp)
        lines.append(' '.join((when, *_numbers(poses.centre[k]),
                               *_numbers(_quaternion(poses.rotation[k])))))
    return '\n'.join(lines) + '\n'


def euroc_text(poses: CameraPath, stamps_ns: Mapping[int, int] | None, source: str = '') -> str:
    """Return a table `stamp,px,py,pz,qw,qx,qy,qz`: nanoseconds, or the number of the frame."""
    # other readers skip one line and no more
    when = 'frame' if stamps_ns is None else 'timestamp [ns]'
    unit = poses.unit or 'no length'
    lines = [','.join([f'#{when}', *(f'p_RS_R_{axis} [{unit}]' for axis in 'xyz'),
                       *(f'q_RS_{part} []' for part in 'wxyz')])]
    for k, stamp in _in_order(poses, stamps_ns):
        x, y, z, w = _quaternion(poses.rotation[k])
        lines.append(','.join((str(stamp), *_numbers(poses.centre[k]),
                               *_numbers((w, x, y, z)))))
    return '\n'.join(lines) + '\n'


def table_text(poses: CameraPath, stamps_ns: Mapping[int, int] | None, source: str = '') -> str:
    """Return the table of `COLUMNS`; cells of what is not known are empty."""
    about = 'the known object' if poses.motion == OF_AN_OBJECT else 'the first image'
    lines = [*_head(poses, stamps_ns, source),
             '# covariance: row by row, of x y z and of turns about the x y z axes of the world '
             f'(rad), relative to {about}', ','.join(COLUMNS)]
    for k, stamp in _in_order(poses, stamps_ns):
        cells = [''] * 36
        if poses.covariance is not None:
            cells = list(_numbers(poses.covariance[k].ravel()))
        lines.append(','.join((
            str(int(poses.frames[k])), '' if stamps_ns is None else str(stamp),
            *_numbers(poses.centre[k]), *_numbers(_quaternion(poses.rotation[k])), *cells)))
    return '\n'.join(lines) + '\n'


def _head(poses: CameraPath, stamps_ns: Mapping[int, int] | None, source: str) -> list[str]:
    """Say what the numbers are, each in a comment of one line."""
    stamps = ('none: images are counted from 0' if stamps_ns is None
              else 'those of the images')
    return ['# ' + ' '.join(line.split()) for line in (
        source, "world_T_camera: place and turn of the camera's optical frame (x right, y down, "
        'z forward) in the world', f'world: {world_in_words(poses)}',
        f'unit of length: {unit_in_words(poses)}', f'stamps: {stamps}') if line]


def _in_order(poses: CameraPath, stamps_ns: Mapping[int, int] | None) -> list[tuple[int, int]]:
    """Return the rows by their stamps, each with its own."""
    stamps = [int(frame) if stamps_ns is None else int(stamps_ns[int(frame)])
              for frame in poses.frames]
    return sorted(enumerate(stamps), key=lambda one: one[1])


def _seconds(stamp_ns: int) -> str:
    """Return nanoseconds as seconds, all digits kept."""
    return f'{"-" * (stamp_ns < 0)}{abs(stamp_ns) // _NS}.{abs(stamp_ns) % _NS:09d}'


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """Return x, y, z, w of a rotation, w not negative."""
    found: np.ndarray = Rotation.from_matrix(rotation).as_quat(canonical=True)
    return found


def _numbers(values: Iterable[float]) -> tuple[str, ...]:
    """Return numbers so that they come back as they are; no negative zero."""
    return tuple(repr(float(value) + 0.0) for value in values)
