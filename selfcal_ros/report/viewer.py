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
"""Shows a calibration in the Rerun viewer: images with their tracks, camera path, structure."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.metric_structure import metres_a_step, metric_structure
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.report.open_frames import OpenFrames
from selfcal_ros.values.output_files import check_writable
from selfcal_ros.values.tracks import Tracks

#: Length of the drawn cameras, in steps between views.
_FRUSTUM = 0.5


def load_rerun() -> ModuleType:
    """
    Return the module of Rerun.

    Raises
    ------
    ArgumentError
        If it is not installed.

    """
    try:
        return import_module('rerun')
    except ImportError:
        raise ArgumentError("--view needs Rerun: pip install rerun-sdk (or '.[view]' in the "
                            'clone).') from None


def view(calibration: Calibration, tracks: Tracks, open_frames: OpenFrames | None = None,
         recording: Path | None = None) -> None:
    """
    Open the viewer with a calibration, or write a recording for it.

    Parameters
    ----------
    calibration : Calibration
        Of any motion but rotation alone, which shows no depth.
    tracks : Tracks
        What it was made from.
    open_frames : callable, optional
        Opens the images again, as a context manager.
    recording : Path, optional
        A file to write (.rrd); by default the viewer is started.

    Raises
    ------
    ArgumentError
        If Rerun is not installed, or the camera only rotated.
    InputError
        If the recording cannot be written.

    """
    if calibration.motion == 'rotation':
        raise ArgumentError('--view shows path and structure, and a camera that only rotates has '
                            'neither.')
    rr = load_rerun()
    rr.init('selfcal_ros', spawn=recording is None)
    if recording is not None:
        check_writable(recording)
        rr.save(str(recording))
    scene, camera = metric_structure(calibration, tracks), calibration.camera
    step = metres_a_step(calibration) or 1.0
    rr.log('world', rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    rr.log('world/structure', rr.Points3D(scene.points, radii=0.03 * step), static=True)
    rr.log('world/path', rr.LineStrips3D([camera_centres(scene.cam_from_world)]), static=True)
    poses = dict(zip(scene.frames.tolist(), scene.cam_from_world))
    for number, image in _images(poses, open_frames):
        rr.set_time('image', sequence=number)
        pose = poses[number]
        rr.log('world/camera', rr.Transform3D(translation=-pose[:, :3].T @ pose[:, 3],
                                              mat3x3=pose[:, :3].T))
        rr.log('world/camera/image', rr.Pinhole(
            image_from_camera=camera.K, width=camera.width, height=camera.height,
            image_plane_distance=_FRUSTUM * step))
        if image is not None:
            rr.log('world/camera/image', rr.Image(image))
        rr.log('world/camera/image/tracks', rr.Points2D(tracks.xy[tracks.frame == number],
                                                        radii=2.0))
    rr.disconnect()


def _images(poses: dict[int, np.ndarray], open_frames: OpenFrames | None,
            ) -> Iterator[tuple[int, np.ndarray | None]]:
    """Yield the numbers of the views, each with its image where there is one."""
    if open_frames is not None:
        with open_frames() as frames:
            if frames.kind != 'tracks':
                yield from ((frame.index, frame.image) for frame in frames.only(poses))
                return
    yield from ((number, None) for number in sorted(poses))
