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
"""The video that `selfcal track` writes: the images with the object drawn over them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import os
from pathlib import Path
import tempfile

import cv2
import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.report.overlay import draw_overlay
from selfcal_ros.rorapid.several_cameras.rig_frame import RigFrame
from selfcal_ros.rorapid.tracked_frame import TrackedFrame
from selfcal_ros.values.output_files import check_writable
from selfcal_ros.values.wireframe import WireframeModel

#: Containers that a video can be written to, and their codec.
CODECS = {'.mp4': 'mp4v', '.avi': 'MJPG'}


class OverlayVideo:
    """
    Writes a video; a context manager. The file appears when everything went well.

    Parameters
    ----------
    path : str or Path
        .mp4 or .avi.
    rate_hz : float
        Images a second.

    Raises
    ------
    InputError
        If the file cannot be written, or its name says another kind.

    """

    def __init__(self, path: str | Path, rate_hz: float = 30.0) -> None:
        self._path = check_video_path(path)
        self._rate_hz = rate_hz if 0.1 <= rate_hz <= 1000 else 30.0
        self._writer: cv2.VideoWriter | None = None
        self._temporary = ''
        self._count = 0

    def __enter__(self) -> OverlayVideo:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._writer is None:
            return
        self._writer.release()
        self._writer = None
        if kind is None and self._is_whole():
            os.replace(self._temporary, os.path.realpath(self._path))
            return
        os.unlink(self._temporary)
        if kind is None:
            raise InputError(f'{self._path} cannot be written whole; the disk may be full.')

    def _is_whole(self) -> bool:
        """Tell whether every image is in the file: OpenCV does not say what it could not write."""
        try:
            with open(self._temporary, 'rb') as stream:
                os.fsync(stream.fileno())
            capture = cv2.VideoCapture(self._temporary)
            count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
            capture.set(cv2.CAP_PROP_POS_FRAMES, self._count - 1)
            last, _ = capture.read()
            capture.release()
        except (OSError, cv2.error):
            return False
        return bool(last) and round(count) == self._count

    def add(self, image: np.ndarray) -> None:
        """Append an image (H, W, 3) uint8, bgr, of the size of the first."""
        height, width = image.shape[:2]
        if self._writer is None:
            descriptor, self._temporary = tempfile.mkstemp(
                prefix='.selfcal-', suffix=self._path.suffix.lower(),
                dir=os.path.dirname(os.path.realpath(self._path)))
            os.close(descriptor)
            code = cv2.VideoWriter.fourcc(*CODECS[self._path.suffix.lower()])
            writer = cv2.VideoWriter(self._temporary, code, self._rate_hz, (width, height))
            if not writer.isOpened():
                os.unlink(self._temporary)
                raise InputError(f'{self._path} cannot be written: this OpenCV cannot make '
                                 f'{self._path.suffix} videos; try another suffix of '
                                 f'{", ".join(CODECS)}.')
            mask = os.umask(0)
            os.umask(mask)
            os.chmod(self._temporary, 0o666 & ~mask)
            self._writer = writer
        self._writer.write(image)
        self._count += 1


def check_video_path(path: str | Path) -> Path:
    """Return the path of a video that can be written; InputError says why it cannot."""
    path = Path(path)
    if path.suffix.lower() not in CODECS:
        raise InputError(f'{path} must end in {" or ".join(CODECS)}: those are the videos that '
                         'can be written.')
    return check_writable(path)


def drawing_into(video: OverlayVideo, models: Sequence[WireframeModel], camera: Camera,
                 names: Sequence[str] = ('',)
                 ) -> Callable[[Frame, Sequence[TrackedFrame | None]], None]:
    """Return a listener of `track_objects` that appends each image with its overlay."""
    def add(frame: Frame, tracked: Sequence[TrackedFrame | None]) -> None:
        picture = frame.image if frame.bgr is None else frame.bgr
        for line, (model, one, name) in enumerate(zip(models, tracked, names)):
            picture = draw_overlay(picture, one, model, camera, line=line, name=name)
        video.add(picture)
    return add


def drawing_of_camera(video: OverlayVideo, models: Sequence[WireframeModel], camera: Camera,
                      which: int, names: Sequence[str] = ('',),
                      ) -> Callable[[Sequence[Frame | None], Sequence[RigFrame]], None]:
    """Return a listener of `track_in_rig` that appends the images of one of the cameras."""
    draw = drawing_into(video, models, camera, names)

    def add(frames: Sequence[Frame | None], found: Sequence[RigFrame]) -> None:
        frame, views = frames[which], [one.views[which] for one in found]
        if frame is not None:
            draw(frame, views)
    return add
