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
"""The calibration that a calibrator wrote in an earlier run: in force until there is another."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from selfcal_ros.errors import SelfcalError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.calibration_file import CalibrationFile
from selfcal_ros.nodes.sensor_roi import SensorRoi
from selfcal_ros.report.camera_uncertainty import stored_uncertainty
from selfcal_ros.report.camera_yaml import read_camera_yaml

if TYPE_CHECKING:
    from rclpy.impl.rcutils_logger import RcutilsLogger

#: How times of files are told.
WHEN = '%Y-%m-%d %H:%M'


class StoredCamera:
    """
    What stands in a calibration file, for images of its size.

    Parameters
    ----------
    file : CalibrationFile
        It need not exist.
    logger : object
        rclpy's.

    Attributes
    ----------
    path : Path
        Of the file.
    camera : Camera or None
        What stands in it; None where it is not used.
    covariance : ndarray or None
        Of its parameters, where the file tells it.
    written : datetime or None
        When the file was written.
    used : bool
        Whether the newest images are those that it is for.

    """

    def __init__(self, file: CalibrationFile, logger: RcutilsLogger) -> None:
        self.path: Path = file.path
        self.camera: Camera | None = None
        self.covariance: np.ndarray | None = None
        self.written: datetime | None = None
        self._logger = logger
        self.used = False
        self._refused: tuple[int, int] | None = None
        if not file.path.is_file():
            return
        try:
            camera, name = read_camera_yaml(file.path)
            written = datetime.fromtimestamp(file.path.stat().st_mtime)
            self.covariance = stored_uncertainty(
                file.path.read_text(encoding='utf-8-sig'), camera)
        except (SelfcalError, OSError) as error:
            logger.warning(f'the calibration of an earlier run is not used: {error}')
            return
        if name != file.camera_name:
            logger.warning(f'{file.path} is of the camera {name!r:.60}, not of '
                           f'{file.camera_name!r}: it is not used')
            return
        self.camera, self.written = camera, written
        logger.info(f'begins with the calibration of {file.path}, written '
                    f'{written:{WHEN}}, until there is a new one')

    def of_images(self, driver: SensorRoi, image_size: tuple[int, int]) -> Camera | None:
        """
        Return the camera of images of a size; None where the file is not for them.

        Parameters
        ----------
        driver : SensorRoi
            What the driver says of the part of the sensor that is shown.
        image_size : (int, int)
            Width and height; (0, 0): not known yet.

        """
        if self.camera is None or 0 in image_size:
            return None
        camera = driver.image_camera(self.camera, image_size)
        if (camera.width, camera.height) == tuple(image_size):
            self.used = True
            return camera
        self.used = False
        if self._refused != tuple(image_size):
            self._refused = image_size
            self._logger.warning(
                f'the calibration of an earlier run is for {camera.width}x{camera.height} pixels, '
                f'the images have {image_size[0]}x{image_size[1]}: it is not used')
        return None

    def values(self) -> dict[str, Any]:
        """Return the parameters for a diagnostic status, named apart from estimated ones."""
        if self.camera is None or self.written is None:
            return {}
        sigma = None if self.covariance is None else np.sqrt(np.diag(self.covariance))
        values: dict[str, Any] = {'file written': f'{self.written:{WHEN}}'}
        for k, name in enumerate(self.camera.parameter_names):
            values[f'file {name}'] = float(self.camera.parameters[k])
            if sigma is not None:
                values[f'file {name} sigma'] = float(sigma[k])
        return values
