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
"""Trackers on sequences: poses, states and times, and the cube sequence of ViSP."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
import time

from bench.inputs import data_folder, image_files, truth_of
import cv2
import numpy as np
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.rorapid.estimation.initial_pose import read_pose_file
from selfcal_ros.rorapid.model import read_model
from selfcal_ros.rorapid.tracked_frame import TrackedFrame
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerOptions, TrackerState

#: Beyond this mean distance of the projected corners the object is not followed.
FOLLOWED_PX = 5.0
#: A pose is wrong with a squared error of six numbers above this; one in 10^8 is by chance.
WRONG = 50.0


@dataclass(frozen=True)
class Track:
    """
    What a tracker made of a sequence.

    Attributes
    ----------
    rotations, translations : ndarray, shape (N, 3, 3) and (N, 3)
    covariances : ndarray, shape (N, 6, 6)
    states : list of TrackerState
    seconds : ndarray, shape (N,)
    rms_px, focal_px, focal_sigma_px : ndarray, shape (N,)

    """

    rotations: np.ndarray
    translations: np.ndarray
    covariances: np.ndarray
    states: list
    seconds: np.ndarray
    rms_px: np.ndarray
    focal_px: np.ndarray
    focal_sigma_px: np.ndarray

    @property
    def lost(self) -> np.ndarray:
        """Which images were reported lost, (N,) bool."""
        return np.array([state is TrackerState.LOST for state in self.states])

    def corners(self, points: np.ndarray, camera: Camera) -> np.ndarray:
        """Project points (P, 3) of the object at every pose: (N, P, 2)."""
        return project_all(points, self.rotations, self.translations, camera)


def frame_error(frame: TrackedFrame, rotation: np.ndarray,
                translation: np.ndarray) -> tuple[np.ndarray, float]:
    """Error (6,) of a pose, metres and radians, and its square in the stated covariance."""
    error = np.concatenate([frame.translation - translation,
                            rotation_vector(frame.rotation @ rotation.T)])
    return error, float(error @ np.linalg.solve(frame.covariance, error))


def project_all(points, rotations, translations, camera: Camera) -> np.ndarray:
    """Project points (P, 3) of an object at poses; (N, P, 2) pixels."""
    seen = points @ np.swapaxes(rotations, 1, 2) + translations[:, None]
    return camera.project(np.where(seen[..., 2:] > 1e-3, seen, np.nan))


def follow(images, model, camera: Camera, start, options: TrackerOptions | None = None,
           stamps_ns=None, each=None) -> Track:
    """Run the tracker over images; `start` is (rotation, translation)."""
    tracker = RorapidTracker(model, camera, options, rng=np.random.default_rng(0))
    tracker.start(*start)
    rows, seconds = [], []
    for number, image in enumerate(images):
        stamp = None if stamps_ns is None else int(stamps_ns[number])
        began = time.thread_time()
        tracked = tracker.track(image, stamp)
        seconds.append(time.thread_time() - began)
        rows.append((tracked.rotation, tracked.translation, tracked.covariance, tracked.rms_px,
                     tracked.focal_px, tracked.focal_sigma_px, tracked.state))
        if each:
            each(number, tracked)
    arrays = [np.array(column) for column in list(zip(*rows))[:6]]
    return Track(*arrays[:3], [row[6] for row in rows], np.array(seconds), *arrays[3:])


def pose_error(track: Track, recording) -> np.ndarray:
    """Errors (N, 6) against a rendered recording: metres, and a turn on the camera's side."""
    turn = rotation_vector(track.rotations @ np.swapaxes(recording.rotations, 1, 2))
    return np.concatenate([track.translations - recording.translations, turn], axis=1)


@dataclass(frozen=True)
class CubeSequence:
    """The cube sequence of visp-images-data."""

    model: object
    camera: Camera
    start: tuple
    files: list

    @cached_property
    def images(self) -> list:
        """The images, grey."""
        return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in self.files]

    @cached_property
    def reference(self) -> Track:
        """Our own tracker on the clean sequence."""
        return follow(self.images, self.model, self.camera, self.start)


@lru_cache(maxsize=1)
def cube_sequence() -> CubeSequence | None:
    """Return the sequence, or None where the recorded sets are not there."""
    folder = data_folder('visp_mbt_cube')
    if folder is None:
        return None
    files = image_files(folder)
    height, width = cv2.imread(str(files[0]), cv2.IMREAD_GRAYSCALE).shape
    camera = Camera(truth_of(folder)['K'], (), width, height)
    try:
        return CubeSequence(read_model(folder / 'cube.cao'), camera,
                            read_pose_file(folder / 'cube.0.pos'), files)
    except InputError:
        return None
