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
Endless drives with the geometry and the errors of the rendered one, for the monitor's bench.

The hall is rendered once and followed by the tracker of the live nodes; its keyframes give points,
what is seen from where, and the size of the errors. The drive then goes there and back for ever:
every pass sees the same points at the same places. Its errors are its own, and drift along each
track as those of the tracker do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from selfcal_ros import Calibration, Camera, CameraFacts, Tracks
from selfcal_ros.features.klt import KltTracker
from selfcal_ros.geometry.triangulation import triangulate
from selfcal_ros.pipeline.calibration_session import CalibrationSession, SessionSettings
from selfcal_ros.pipeline.monitoring import Monitoring
from selfcal_ros.synthetic.recordings import agv_drive

#: Images of the rendered drive; about every third becomes a keyframe.
IMAGES = 120
FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0)
#: Points that miss their own track by more are errors of the tracker, not of the scene.
SOUND_PX = 0.5
#: Tracks that drift more than others: spread of the logarithm of their standard deviations.
DRIFT_SPREAD = 0.8
#: Observations that are anywhere within so many pixels.
GROSS_FRACTION, GROSS_PX = 0.01, 8.0


@dataclass(frozen=True)
class MeasuredDrive:
    """
    What was measured on the rendered drive.

    Attributes
    ----------
    camera : Camera
        The true one.
    poses : ndarray, shape (V, 3, 4)
        True ones of the keyframes, cam_from_world.
    points : ndarray, shape (P, 4)
    seen : ndarray of bool, shape (V, P)
    white_px, drift_px : float
        Standard deviation of an image coordinate: its own part, and the step of the drift from
        one keyframe to the next; of the median track.
    calibration : Calibration
        Of the recorded tracks.

    """

    camera: Camera
    poses: np.ndarray
    points: np.ndarray
    seen: np.ndarray
    white_px: float
    drift_px: float
    calibration: Calibration


def measure_drive(images: int = IMAGES) -> MeasuredDrive:
    """Render, follow, choose keyframes as the node does, calibrate, and measure the errors."""
    recording, tracker = agv_drive(images), KltTracker(most=400)
    session = CalibrationSession(SessionSettings(motion='planar', facts=FACTS,
                                                 max_keyframes=400))
    size = recording.camera.width, recording.camera.height
    for image, stamp in recording.frames():
        session.add_tracks(stamp, *tracker.add(image), size)
    request = session.request()
    calibration, tracks = request.run(), request.tracks.with_at_least(3)
    view = np.searchsorted(tracks.frames, tracks.frame)
    _, point = np.unique(tracks.track, return_inverse=True)
    poses = recording.cam_from_world[tracks.frames]
    cameras = recording.camera.K @ poses
    points = triangulate(cameras, view, point, tracks.xy, 10)
    image = np.einsum('nij,nj->ni', cameras[view], points[point])
    error = tracks.xy - image[:, :2] / image[:, 2:]
    worst = np.zeros(len(points))
    np.maximum.at(worst, point, np.linalg.norm(error, axis=1))
    sound = worst < SOUND_PX
    # variance of differences along tracks: white noise, and a part that grows with the time
    lags = np.arange(1, 9)
    half = [_half_variance(error, point, view, sound, lag) for lag in lags]
    slope, white = np.polyfit(lags, half, 1)
    seen = np.zeros((len(poses), len(points)), bool)
    seen[view, point] = True
    return MeasuredDrive(recording.camera, poses, points[sound], seen[:, sound],
                         float(np.sqrt(max(white, 0))), float(np.sqrt(2 * max(slope, 0))),
                         calibration)


def _half_variance(error, point, view, sound, lag) -> float:
    """Half the variance of a difference of errors, from its quantiles."""
    at = np.arange(len(point) - lag)
    at = at[(point[at] == point[at + lag]) & (view[at + lag] - view[at] == lag)
            & sound[point[at]]]
    return float(np.mean(np.percentile(np.abs(error[at + lag] - error[at]), 68.3, axis=0)**2) / 2)


def keyframes(drive: MeasuredDrive, rng: np.random.Generator,
              camera_at=None) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """
    Drive there and back for ever.

    Parameters
    ----------
    drive : MeasuredDrive
    rng : numpy.random.Generator
    camera_at : callable, optional
        camera_at(index) is the Camera that takes keyframe `index`; the true one by default.

    Yields
    ------
    int
        Index of the keyframe.
    ndarray of int, shape (M,)
        Identities of the points, ascending.
    ndarray, shape (M, 2)
        Pixels.

    """
    pixels = ideal_places(drive)
    for index, place, at, identity, error, _ in measurement_errors(drive, rng):
        camera = drive.camera if camera_at is None else camera_at(index)
        order = np.argsort(identity)
        yield index, identity[order], (camera.pixels(pixels[place, at]) + error)[order]


def ideal_places(drive: MeasuredDrive) -> np.ndarray:
    """Normalised image coordinates (V, P, 2) of all points in all views."""
    local = np.einsum('vij,pj->vpi', drive.poses, drive.points)
    return local[..., :2] / local[..., 2:]


def measurement_errors(drive: MeasuredDrive, rng: np.random.Generator) -> Iterator[tuple]:
    """
    Draw the tracker's errors on a drive there and back for ever.

    Parameters
    ----------
    drive : MeasuredDrive
    rng : numpy.random.Generator

    Yields
    ------
    int
        Index of the keyframe.
    int
        View of the recorded drive that it repeats.
    ndarray of int, shape (M,)
        Points seen.
    ndarray of int, shape (M,)
        Identities of their tracks.
    ndarray, shape (M, 2)
        Errors, pixels.
    ndarray of bool, shape (M,)
        Whether they are gross.

    """
    views, count = drive.seen.shape
    route = [*range(views), *range(views - 2, 0, -1)]
    identity = np.zeros(count, np.int64)
    drift, scale = np.zeros((count, 2)), np.ones(count)
    before, fresh, index = np.zeros(count, bool), 0, 0
    while True:
        for place in route:
            now = drive.seen[place]
            born = np.flatnonzero(now & ~before)
            identity[born] = fresh + np.arange(len(born))
            fresh += len(born)
            drift[born] = 0
            scale[born] = np.exp(DRIFT_SPREAD * rng.standard_normal(len(born)))
            drift += drive.drift_px * scale[:, None] * rng.standard_normal((count, 2))
            at = np.flatnonzero(now)
            error = drift[at] + drive.white_px * scale[at, None] * rng.standard_normal(
                (len(at), 2))
            gross = rng.random(len(at)) < GROSS_FRACTION
            error[gross] += rng.uniform(-GROSS_PX, GROSS_PX, (int(gross.sum()), 2))
            yield index, place, at, identity[at], error, gross
            before, index = now, index + 1


def window_of(frames, size) -> Tracks:
    """Make Tracks of keyframes (index, identities, xy)."""
    return Tracks(np.repeat([f[0] for f in frames], [len(f[1]) for f in frames]),
                  np.concatenate([f[1] for f in frames]), np.concatenate([f[2] for f in frames]),
                  size)


def displaced(camera: Camera, focal: float = 1.0, shift=(0.0, 0.0)) -> Camera:
    """Camera after a zoom by a factor, and a shift of its principal point in pixels."""
    values = camera.parameters
    values[:2] *= focal
    values[2:4] += shift
    return Camera.from_parameters(values, camera.width, camera.height)


def recalibrated(drive: MeasuredDrive, rng: np.random.Generator) -> Calibration:
    """Calibration of the true camera with an error drawn from its stated covariance."""
    values, vectors = np.linalg.eigh(drive.calibration.covariance)
    error = vectors @ (np.sqrt(np.maximum(values, 0)) * rng.standard_normal(len(values)))
    return replace(drive.calibration, camera=Camera.from_parameters(
        drive.camera.parameters + error, drive.camera.width, drive.camera.height))


def end_to_end(focal: float, shift, images: int = 160, changed_at: int = 70):
    """
    From images to the alarm, as in the node, with a camera that changes on the way.

    Parameters
    ----------
    focal : float
        Factor of the focal length.
    shift : (float, float)
        Of the principal point, pixels.
    images, changed_at : int
        Of the rendered drive; the first that the changed camera takes.

    Returns
    -------
    delay : int
        Keyframes from the change to the alarm.
    left : int
        Keyframes after the change.
    change : str
        What the monitor says at the end; empty without an alarm.

    """
    before = agv_drive(images)
    after = replace(before, camera=displaced(before.camera, focal, shift))
    size = before.camera.width, before.camera.height
    tracker, renderers = KltTracker(most=400), [before.renderer(), after.renderer()]
    settings = SessionSettings(motion='planar', facts=FACTS, max_keyframes=400)
    session, change, delay, after_count = CalibrationSession(settings), None, 0, 0
    for index in range(images):
        late = index >= changed_at
        image = (after if late else before).frame(index, renderers[late])
        session.add_tracks(int(before.stamps_ns[index]), *tracker.add(image), size)
        if index == changed_at - 1:
            request = session.request()
            monitoring = Monitoring()
            monitoring.watch(request.run(), request.tracks)
            monitoring.work_off()
            known = session.keyframes[-1].index
        elif late and session.keyframes[-1].index > known:
            known = session.keyframes[-1].index
            after_count += 1
            monitoring.add_keyframe(session.keyframes[-1], size)
            monitoring.work_off()
            if change is None and monitoring.change is not None:
                change, delay = monitoring.change, after_count
    return delay, after_count, str(monitoring.change) if change else ''
