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
"""The calibration file of a camera, where its driver looks for it."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
import re
from typing import Any

import numpy as np
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.file_url import path_of
from selfcal_ros.report.camera_uncertainty import uncertainty_comment
from selfcal_ros.report.camera_yaml import write_camera_yaml
from selfcal_ros.report.shutter_comment import shutter_comment
from selfcal_ros.values.output_files import check_place

#: Of a sigma: an estimate that moves less, and whose sigmas fall by less, brings nothing new.
SAME = 0.1


class CalibrationFile:
    """
    Where and under which name a calibration is written.

    Parameters
    ----------
    camera_name : str
        Letters, digits and underscores.
    output : str
        Path or URL, see `path_of`; empty: ${ROS_HOME}/camera_info/${NAME}.yaml, where
        camera_info_manager looks.

    Raises
    ------
    ArgumentError, InputError
        If the name or the path is impossible.

    """

    def __init__(self, camera_name: str, output: str = '') -> None:
        if not re.fullmatch(r'[A-Za-z0-9_]+', camera_name):
            raise ArgumentError('The parameter camera_name takes letters, digits and underscores, '
                                f'not {camera_name!r}.')
        self.camera_name = camera_name
        self._saved: Calibration | None = None
        self._saved_at: datetime | None = None
        self.path = path_of(output or '${ROS_HOME}/camera_info/${NAME}.yaml', camera_name)
        # before the drive, and not when its calibration is to be written
        check_place(self.path, makes_folders=True)

    def write(self, calibration: Calibration, camera: Camera | None = None) -> Path:
        """
        Write the file, whole or not at all; the folder is made where it is missing.

        Parameters
        ----------
        calibration : Calibration
        camera : Camera, optional
            Of the full sensor, where the images were binned or cropped.

        Raises
        ------
        InputError
            If it cannot be written.

        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f'The folder {self.path.parent} cannot be made: '
                             f'{error.strerror}.') from None
        sigma = calibration.sigma
        comments = [
            f'{calibration.software}: from {len(calibration.frames)} views',
            ', '.join(f'{name} +- {sigma[name]:.3g} px' for name in ('fx', 'fy', 'cx', 'cy'))
            + ' (one sigma)']
        if camera is not None and camera is not calibration.camera:
            comments.append('the sigmas are in pixels of the images, which were binned or cropped '
                            f'to {calibration.camera.width}x{calibration.camera.height}')
        else:
            comments += [*shutter_comment(calibration.shutter),
                         *uncertainty_comment(calibration.camera, calibration.covariance)]
        written = write_camera_yaml(self.path, camera or calibration.camera, self.camera_name,
                                    comments)
        self._saved, self._saved_at = calibration, datetime.now()
        return written

    def values(self, calibration: Calibration | None) -> dict[str, Any]:
        """
        Return for a diagnostic status where the file is, and whether it holds a calibration.

        Parameters
        ----------
        calibration : Calibration or None
            That in force.

        """
        values: dict[str, Any] = {'calibration file': str(self.path)}
        if self._saved_at is not None:
            values |= {'saved at': f'{self._saved_at:%H:%M:%S}',
                       'saved': self._holds(calibration)}
        return values

    def _holds(self, calibration: Calibration | None) -> bool:
        """Tell whether what was written is as good as a calibration: nothing to save again."""
        if calibration is None or self._saved is None:
            return False
        if calibration is self._saved:
            return True
        new, old = calibration.camera, self._saved.camera
        if (new.model, new.width, new.height) != (old.model, old.width, old.height):
            return False
        now, then = (np.sqrt(np.diag(one.covariance)) for one in (calibration, self._saved))
        moved = np.abs(new.parameters - old.parameters)
        return bool(np.all(moved <= SAME * now) and np.all(now >= (1 - SAME) * then))
