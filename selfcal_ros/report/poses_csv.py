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
"""poses.csv: one line an image, as `selfcal track` writes it and the benches read it."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState
from selfcal_ros.values.output_files import atomic_write

COLUMNS = ('frame', 'stamp_ns', 'state', 'tx', 'ty', 'tz', 'rx', 'ry', 'rz', 'focal_px',
           'sigma_t', 'sigma_r')


class PosesTable:
    """
    Gathers the poses of a sequence.

    A LOST image has no pose: its cells are empty.
    """

    def __init__(self) -> None:
        self._rows: list[list[int | str]] = []

    def __len__(self) -> int:
        """Count the rows."""
        return len(self._rows)

    def add(self, frame: Frame, tracked: TrackedFrame) -> None:
        """
        Append the pose of one image.

        Parameters
        ----------
        frame : Frame
        tracked : TrackedFrame

        """
        row: list[int | str] = [int(frame.index), int(frame.stamp_ns), tracked.state.value]
        if tracked.state is TrackerState.LOST:
            self._rows.append(row + [''] * (len(COLUMNS) - 3))
            return
        variance = np.diag(tracked.covariance)
        values = [*tracked.translation, *rotation_vector(tracked.rotation), tracked.focal_px,
                  np.sqrt(variance[:3].sum()), np.sqrt(variance[3:].sum())]
        self._rows.append([*row, *(f'{float(value):.9g}' for value in values)])

    def text(self) -> str:
        """Return the table as CSV."""
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator='\n')
        writer.writerow(COLUMNS)
        writer.writerows(self._rows)
        return buffer.getvalue()

    def write(self, path: str | Path) -> Path:
        """
        Write the file, whole or not at all.

        Raises
        ------
        InputError
            If it cannot be written.

        """
        return atomic_write(path, self.text())


def read_poses(path: str | Path) -> dict[str, np.ndarray]:
    """
    Read poses.csv.

    Returns
    -------
    dict
        frame and stamp_ns (N,) int, state (N,) str, rotation (N, 3, 3), translation (N, 3)
        metres, focal_px, sigma_t, sigma_r (N,); NaN where there is no pose.

    Raises
    ------
    InputError
        If the file is missing or has other columns or values.

    """
    path = Path(path)
    try:
        with path.open(encoding='utf-8', newline='') as stream:
            header, *rows = list(csv.reader(stream)) or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f'{path} cannot be read ({error}).') from None
    if tuple(header) != COLUMNS:
        raise InputError(f'{path} is no table of poses; its columns must be {",".join(COLUMNS)}.')
    try:
        numbers = np.array([[float(cell or 'nan') for cell in row[3:]] for row in rows],
                           float).reshape(-1, len(COLUMNS) - 3)
        frame, stamp = (np.array([int(row[k]) for row in rows], np.int64) for k in (0, 1))
        state = np.array([row[2] for row in rows])
    except (ValueError, IndexError):
        raise InputError(f'{path} holds a line that is no pose.') from None
    return {'frame': frame, 'stamp_ns': stamp, 'state': state, 'translation': numbers[:, :3],
            'rotation': rotation_matrix(numbers[:, 3:6]), 'focal_px': numbers[:, 6],
            'sigma_t': numbers[:, 7], 'sigma_r': numbers[:, 8]}
