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
Recordings of a known object that moves before a fixed camera, with its exact pose.

The background is rendered once; each image then renders the window around the object only, with
the same rays as a whole image would have.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.synthetic.object_shapes import cube, SHAPES, SolidObject, spool, step_block
from selfcal_ros.synthetic.paths import look_at
from selfcal_ros.synthetic.recordings import default_camera, FIRST_STAMP_NS, Recording
from selfcal_ros.synthetic.render import quantise, Renderer, Scene, Surface
from selfcal_ros.synthetic.worlds import rectangle, Style
from selfcal_ros.values.wireframe import WireframeModel

__all__ = ['cube', 'MOTIONS', 'object_poses', 'ObjectRecording', 'SHAPES', 'SolidObject', 'spool',
           'step_block', 'tracked_object']

MOTIONS = ('general', 'translation', 'planar')
#: Pixels around the object's outline that are rendered anew.
_MARGIN_PX = 6
#: Rows that are rendered as if they were read at once.
_STRIP = 4
#: The wall behind is seen up to this angle from the axis of a fisheye.
_WALL_RAD = np.deg2rad(72.0)


@dataclass(frozen=True)
class ObjectRecording(Recording):
    """
    A recording of one object; `cam_from_world` is its pose, object -> camera, exact.

    Parameters
    ----------
    model : WireframeModel
        What the tracker is given.
    focal_px : ndarray, shape (V,), optional
        True fx of each image where the lens zooms; fy changes in proportion.
    supersampling : int
        Samples along each side of a pixel.
    strips : ndarray, shape (V, S, 3, 4), optional
        Poses while each of S equal strips of rows is read, where rows are read one after the
        other.

    """

    model: WireframeModel | None = None
    focal_px: np.ndarray | None = None
    supersampling: int = 3
    strips: np.ndarray | None = None

    @property
    def rotations(self) -> np.ndarray:
        """True rotations object -> camera, (V, 3, 3)."""
        return self.cam_from_world[:, :, :3]

    @property
    def translations(self) -> np.ndarray:
        """True translations object -> camera, (V, 3) metres."""
        return self.cam_from_world[:, :, 3]

    def camera_at(self, index: int) -> Camera:
        """Return the true camera of image `index`."""
        if self.focal_px is None:
            return self.camera
        K = self.camera.K.copy()
        K[:2, :2] *= self.focal_px[index] / K[0, 0]
        return replace(self.camera, K=K)

    def read_at(self, index: int) -> Iterator[tuple[np.ndarray, int, int]]:
        """Yield the poses of the bodies while rows are read: (poses, first row, row after)."""
        poses, height = self.poses(index), self.camera.height
        if self.strips is None:
            yield poses, 0, height
            return
        ends = np.linspace(0, height, len(self.strips[index]) + 1).round().astype(int)
        for moved, first, end in zip(self.strips[index], ends[:-1].tolist(), ends[1:].tolist()):
            bodies = poses.copy()
            bodies[... if poses.ndim == 2 else 0] = moved
            yield bodies, first, end

    # its renderer draws a window of the image, and takes none of the options of a whole scene
    def renderer(self, supersampling: int | None = None,  # type: ignore[override]
                 ) -> _WindowRenderer:
        """Return a renderer of this sequence; keep it, it holds the background."""
        return _WindowRenderer(self, supersampling or self.supersampling)

    def frame(self, index: int,  # type: ignore[override]
              renderer: _WindowRenderer | None = None) -> np.ndarray:
        """Render image `index` as in `Recording.frame`, (height, width) uint8."""
        grey = (renderer or self.renderer()).intensity_of(index)
        return quantise(grey, np.random.default_rng([self.seed, index]), self.noise_sigma)

    def truth(self) -> dict[str, Any]:
        """Return camera, poses, object and recipe as plain values for JSON."""
        truth = super().truth()
        truth['object'] = self.model.name if self.model else None
        truth['cam_from_object'] = truth.pop('cam_from_world')
        if self.focal_px is not None:
            truth['focal_px'] = np.round(self.focal_px, 9).tolist()
        return truth


class _WindowRenderer:
    """Renders images of an `ObjectRecording`; keeps what does not change."""

    def __init__(self, recording: ObjectRecording, supersampling: int) -> None:
        self._recording, self._samples = recording, supersampling
        self._scene = Scene(recording.surfaces)
        self._static: dict[float, np.ndarray] = {}

    def intensity_of(self, index: int) -> np.ndarray:
        """Grey levels of image `index` as reals, (height, width)."""
        recording = self._recording
        camera, poses = recording.camera_at(index), recording.poses(index)
        focal = camera.K[0, 0]
        if focal not in self._static:
            # of a zoom no background is seen twice
            self._static = {focal: self._background(camera, poses)}
        image = self._static[focal].copy()
        for bodies, first, end in recording.read_at(index):
            left, top, right, bottom = self._window(camera, bodies)
            top, bottom = max(top, first), min(bottom, end)
            if right > left and bottom > top:
                K = camera.K.copy()
                K[:2, 2] -= left, top
                window = Camera(K, camera.distortion, right - left, bottom - top, camera.model)
                image[top:bottom, left:right] = Renderer(
                    self._scene, window, self._samples).intensity(bodies)
        return np.asarray(image)

    def _background(self, camera: Camera, poses: np.ndarray) -> np.ndarray:
        """Render what does not move, without the object."""
        still = [surface for surface in self._recording.surfaces if surface.body]
        if poses.ndim == 2 or not still:
            return np.full((camera.height, camera.width), 0.0)
        return Renderer(Scene(still), camera, self._samples).intensity(poses)

    def _window(self, camera: Camera, poses: np.ndarray) -> tuple[int, int, int, int]:
        """Pixels (left, top, right, bottom) around the object."""
        model = self._recording.model
        assert model is not None
        pose = poses[0] if poses.ndim == 3 else poses
        points = model.extent @ pose[:, :3].T + pose[:, 3]
        if camera.lens.is_perspective:
            if points[:, 2].min() < 0.05 * model.diameter_m:
                return 0, 0, camera.width, camera.height
        else:
            # the image of an edge bulges: what is between the corners counts, too
            share = np.linspace(0, 1, 9)[:, None, None, None]
            points = (share * points + (1 - share) * points[:, None]).reshape(-1, 3)
        pixels = camera.project(points)
        if not np.isfinite(pixels).all():
            return 0, 0, camera.width, camera.height
        low = np.floor(pixels.min(axis=0)).astype(int) - _MARGIN_PX
        high = np.ceil(pixels.max(axis=0)).astype(int) + _MARGIN_PX + 1
        size = [camera.width, camera.height]
        return (*np.clip(low, 0, size), *np.clip(high, 0, size))


def object_poses(motion: str, views: int, diameter_m: float, focal_px: float = 520.0,
                 speed: float = 1.0, rate_hz: float = 30.0, after_s: float = 0.0) -> np.ndarray:
    """
    Poses of an object that moves before a camera which looks down on it.

    Parameters
    ----------
    motion : {'general', 'translation', 'planar'}
        Planar: on the plane z = 0 of the object's first pose, turning about its normal.
    views : int
    diameter_m : float
        Of the object; it appears about 180 px large at 520 px focal length, whatever the lens.
    focal_px : float
    speed : float
        1: up to about 5 px between images at 30 Hz.
    rate_hz : float
    after_s : float
        So long after the stamp of each image.

    Returns
    -------
    ndarray, shape (V, 3, 4)
        Object -> camera, metres.

    """
    if motion not in MOTIONS:
        raise ArgumentError(f'The motion must be one of {", ".join(MOTIONS)}, not {motion!r}.')
    distance = 2.9 * diameter_m * focal_px / 520
    fixed = look_at(distance * np.array([0.55, -0.62, 0.56]), [0, 0, 0])
    time = speed * (np.arange(views) / rate_hz + after_s)
    # incommensurable periods: a long recording does not repeat itself
    wave = np.sin(np.multiply.outer(time, [0.97, 1.31, 0.73, 1.09, 0.83, 0.61]))
    moved = diameter_m * np.column_stack([0.5 * wave[:, 3], 0.5 * wave[:, 4], 0.35 * wave[:, 5]])
    turned = np.column_stack([0.45 * wave[:, 0], 0.4 * wave[:, 1],
                              0.5 * time + 0.3 * wave[:, 2]])
    if motion == 'translation':
        turned[:] = 0
    elif motion == 'planar':
        moved[:, 2] = turned[:, 0] = turned[:, 1] = 0
    R = fixed[:, :3] @ rotation_matrix(turned)
    t = moved @ fixed[:, :3].T + fixed[:, 3]
    return np.concatenate([R, t[:, :, None]], axis=2)


def tracked_object(views: int = 300, shape: str | SolidObject = 'cube', motion: str = 'general',
                   size: tuple[int, int] = (640, 480), camera: Camera | None = None,
                   distortion: Sequence[float] = (), zoom_px: tuple[float, float] | None = None,
                   clutter: float = 0.0, background: bool = True, noise_sigma: float = 1.0,
                   speed: float = 1.0, rate_hz: float = 30.0, supersampling: int = 3,
                   readout_s: float = 0.0, seed: int = 4) -> ObjectRecording:
    """
    Move a known object before a fixed camera.

    Parameters
    ----------
    views : int
        Number of images.
    shape : {'cube', 'step_block', 'spool', 'box', 'l_block'} or SolidObject
    motion : {'general', 'translation', 'planar'}
        See `object_poses`.
    size, camera, distortion, noise_sigma, rate_hz, seed
        As in `recordings.agv_drive`.
    zoom_px : (float, float), optional
        fx of the first and the last image; the object moves away as the lens zooms in. 1500 to
        6000 px are 12 to 50 mm on pixels of 8 µm.
    clutter : float
        Strength, 0 to 1, of markings on the object that its model does not know.
    background : bool
        A wall full of shapes; black otherwise.
    speed : float
        Of the motion; see `object_poses`.
    supersampling : int
        Samples along each side of a pixel.
    readout_s : float
        Time in which the rows of an image are read, the middle one at the stamp; negative from
        the lowest row up.

    Returns
    -------
    ObjectRecording

    Raises
    ------
    ArgumentError
        If the shape or the motion is unknown, or there is no view.

    """
    own = shape if isinstance(shape, SolidObject) else None
    shape = own.model.name if own else shape
    if own is None and shape not in SHAPES:
        raise ArgumentError(f'The shape must be one of {", ".join(SHAPES)}, not {shape!r}.')
    if views < 1:
        raise ArgumentError(f'A recording needs at least one view, not {views!r}.')
    made = {'function': 'tracked_object', 'views': views, 'shape': shape, 'motion': motion,
            'zoom_px': zoom_px, 'clutter': clutter, 'noise_sigma': noise_sigma, 'speed': speed,
            'rate_hz': rate_hz, 'readout_s': readout_s, 'seed': seed}
    camera = camera or default_camera(size, distortion)
    thing = own or SHAPES[str(shape)](rng=np.random.default_rng([seed, 0]), clutter=clutter)
    focal = None if zoom_px is None else np.geomspace(zoom_px[0], zoom_px[1], views)
    first = camera.K[0, 0] if focal is None else focal[0]
    # the first focal length fixes how near the object is: it appears equally large
    poses = object_poses(motion, views, thing.model.diameter_m,
                         first * 640 / camera.width, speed, rate_hz)
    strips = None
    if readout_s:
        count = max(camera.height // _STRIP, 1)
        strips = np.stack([
            object_poses(motion, views, thing.model.diameter_m, first * 640 / camera.width, speed,
                         rate_hz, after_s=readout_s * ((k + 0.5) / count - 0.5))
            for k in range(count)], axis=1)
    if focal is not None:
        away = (focal / first) ** 0.85
        poses[:, 2, 3] *= away
        if strips is not None:
            strips[:, :, 2, 3] *= away[:, None]
    surfaces, static = list(thing.surfaces), None
    if background:
        static = np.eye(3, 4)
        depth = 1.6 * (poses[:, 2, 3].max() + thing.model.diameter_m)
        surfaces.append(_wall(np.random.default_rng([seed, 1]), camera, depth,
                              first if focal is None else focal.min()))
    stamps = FIRST_STAMP_NS + np.rint(np.arange(views) * 1e9 / rate_hz).astype(np.int64)
    return ObjectRecording(f'tracked_{shape}', camera, poses, stamps, surfaces, static,
                           noise_sigma, seed=seed, made=made, model=thing.model,
                           focal_px=focal, supersampling=supersampling, strips=strips)


def _wall(rng: np.random.Generator, camera: Camera, depth: float, focal: float) -> Surface:
    """Fill the view at a depth with a wall of shapes 4 to 60 pixels large; body 1."""
    pixel = depth / focal
    width, height = 1.6 * camera.width * pixel, 1.6 * camera.height * pixel
    if not camera.lens.is_perspective:
        # farther out the wall is seen so slantingly that it shows nothing
        across = [min(angle / 2, _WALL_RAD) for angle in camera.field_of_view()]
        width, height = (2.2 * depth * np.tan(np.nan_to_num(across, nan=_WALL_RAD))).tolist()
    style = Style(texel_m=1.2 * pixel, smallest_m=6 * pixel, largest_m=60 * pixel, cover=0.8,
                  contrast=45.0)
    middle = (np.array([camera.width, camera.height]) / 2 - camera.K[:2, 2]) * pixel
    # seen from the side to which u x v points: towards the camera, against z
    return rectangle(rng, [middle[0] - width / 2, middle[1] + height / 2, depth],
                     [width, 0, 0], [0, -height, 0], style, 125.0, body=1)


def perturbed(rotation: np.ndarray, translation: np.ndarray, rng: np.random.Generator,
              angle_rad: float, offset_m: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Disturb a pose: a guess to start a tracker with.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,)
    rng : numpy.random.Generator
    angle_rad, offset_m : float
        How far; the directions are random.

    Returns
    -------
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,)

    """
    axis, direction = rng.normal(size=(2, 3))
    turn = rotation_matrix(angle_rad * axis / np.linalg.norm(axis))
    return turn @ rotation, translation + offset_m * direction / np.linalg.norm(direction)


def pose_errors(rotation: np.ndarray, translation: np.ndarray, true_rotation: np.ndarray,
                true_translation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Differences between poses.

    Returns
    -------
    angle_rad : ndarray, shape (...,)
    distance : ndarray, shape (...,)
        Of the translations, as a share of the true distance.

    """
    turn = np.asarray(rotation) @ np.swapaxes(true_rotation, -1, -2)
    angle = np.linalg.norm(rotation_vector(turn), axis=-1)
    offset = np.linalg.norm(np.asarray(translation) - true_translation, axis=-1)
    return angle, offset / np.linalg.norm(true_translation, axis=-1)
