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
"""Image sequences with exact truth: an AGV's drive, an arm's moves, a turntable."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.synthetic import worlds
from selfcal_ros.synthetic.paths import drive_path, look_at, planar_poses
from selfcal_ros.synthetic.render import quantise, Renderer, Scene, Surface

#: k1, k2, p1, p2, k3 of a common wide-angle lens.
REALISTIC_DISTORTION = (-0.12, 0.05, 0.0, 0.0, 0.0)
#: Time of the first image.
FIRST_STAMP_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class Recording:
    """
    An image sequence that is rendered when it is asked for.

    Every image depends on the arguments and its own number alone. So a long sequence need not be
    held, and any image of it can be made again.

    Parameters
    ----------
    name : str
        What it shows.
    camera : Camera
        The true camera.
    cam_from_world : ndarray, shape (V, 3, 4)
        The true poses, metres; optical frame. World z points up.
    stamps_ns : ndarray of int, shape (V,)
        Acquisition times.
    surfaces : list of Surface
        What is seen.
    static_pose : ndarray, shape (3, 4), optional
        Pose of body 1 of the scene, which stays with the camera.
    noise_sigma : float
        Image noise in grey levels.
    transmission : ndarray, shape (height, width), optional
        What dirt on the lens lets through, 0 to 1.
    seed : int
        Seed of the noise.
    made : dict
        How it was made, for the record.
    labels : tuple of str
        The kind of move that each view belongs to; empty where there is only one.
    circle_deg : float, optional
        Angle across the image circle of a fisheye: the image is black beyond.
    magnification : ndarray, shape (V,), optional
        Focal length of each view over that of the camera, where it varies.

    """

    name: str
    camera: Camera
    cam_from_world: np.ndarray
    stamps_ns: np.ndarray
    surfaces: list[Surface]
    static_pose: np.ndarray | None = None
    noise_sigma: float = 1.0
    transmission: np.ndarray | None = None
    seed: int = 0
    made: dict[str, Any] = field(default_factory=dict)
    labels: tuple[str, ...] = ()
    circle_deg: float | None = None
    magnification: np.ndarray | None = None

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.cam_from_world)

    def renderer(self, supersampling: int = 3, camera: Camera | None = None) -> Renderer:
        """Return a renderer of this sequence's scene; keep it, it is costly to make."""
        circle = None if self.circle_deg is None else np.deg2rad(self.circle_deg)
        return Renderer(Scene(self.surfaces), camera or self.camera, supersampling,
                        circle_rad=circle)

    def camera_of(self, index: int) -> Camera:
        """Return the true camera of a view."""
        return (self.camera if self.magnification is None
                else self.camera.magnified(float(self.magnification[index])))

    def poses(self, index: int) -> np.ndarray:
        """Poses of the rigid bodies in view `index`: (3, 4), or (2, 3, 4) with a static body."""
        moving = self.cam_from_world[index]
        return moving if self.static_pose is None else np.stack([moving, self.static_pose])

    def frame(self, index: int, renderer: Renderer | None = None) -> np.ndarray:
        """
        Render image `index`.

        Parameters
        ----------
        index : int
            Which image, 0 to V - 1.
        renderer : Renderer, optional
            What `renderer` returned, to make several images with; where the focal length
            varies, every image has its own instead.

        Returns
        -------
        ndarray of uint8, shape (height, width)

        """
        if self.magnification is not None:
            renderer = self.renderer(camera=self.camera_of(index))
        renderer = renderer or self.renderer()
        grey = renderer.intensity(self.poses(index))
        if self.transmission is not None:
            grey = grey * self.transmission
        return quantise(grey, np.random.default_rng([self.seed, index]), self.noise_sigma)

    def frames(self) -> Iterator[tuple[np.ndarray, int]]:
        """Yield (image (height, width) uint8, stamp in ns) in order."""
        renderer = self.renderer()
        for index, stamp in enumerate(self.stamps_ns):
            yield self.frame(index, renderer), int(stamp)

    def truth(self) -> dict[str, Any]:
        """Return camera, poses and recipe as plain values for JSON."""
        camera = self.camera
        return {
            'name': self.name,
            'made': self.made,
            'width': camera.width,
            'height': camera.height,
            'K': camera.K.tolist(),
            'distortion_model': camera.model,
            'distortion': camera.distortion.tolist(),
            'stamps_ns': [int(stamp) for stamp in self.stamps_ns],
            'labels': list(self.labels),
            **({} if self.magnification is None
               else {'magnification': np.asarray(self.magnification).tolist()}),
            'cam_from_world': np.round(self.cam_from_world, 12).tolist(),
        }


def default_camera(size: tuple[int, int] = (640, 480), distortion: Sequence[float] = ()) -> Camera:
    """Return the recordings' camera: f = 520, principal point (328, 235) at 640 x 480."""
    scale = size[0] / 640
    K = [[520 * scale, 0, 328.5 * scale - 0.5],
         [0, 520 * scale, (235.5 - 240) * scale + size[1] / 2 - 0.5], [0, 0, 1]]
    return Camera(np.array(K), distortion, *size)


def agv_drive(views: int = 24, size: tuple[int, int] = (640, 480), camera: Camera | None = None,
              distortion: Sequence[float] = (), pitch_deg: float = 20.0, roll_deg: float = 0.0,
              height_m: float = 1.1, noise_sigma: float = 1.0, dirt: bool = False,
              rate_hz: float = 15.0, seed: int = 1) -> Recording:
    """
    Drive an S through a furnished hall: planar motion, 65 degrees left, then 55 right.

    Parameters
    ----------
    views : int
        Number of images along the path, which is the same for every number.
    size : (int, int)
        Width and height, where no camera is given.
    camera : Camera, optional
        Default: `default_camera(size, distortion)`.
    distortion : sequence of float
        k1, k2, p1, p2[, k3], where no camera is given.
    pitch_deg, roll_deg, height_m : float
        How the camera is mounted: the optical axis points `pitch_deg` down.
    noise_sigma : float
        Image noise in grey levels.
    dirt : bool
        Put dark blobs on the lens, which stay where they are in the image.
    rate_hz : float
        Images a second.
    seed : int
        Seed of the hall, the dirt and the noise.

    Returns
    -------
    Recording

    """
    _check_views(views)
    made = {'function': 'agv_drive', 'views': views, 'pitch_deg': pitch_deg,
            'roll_deg': roll_deg, 'height_m': height_m, 'noise_sigma': noise_sigma,
            'dirt': dirt, 'rate_hz': rate_hz, 'seed': seed}
    camera = camera or default_camera(size, distortion)
    surfaces = list(_hall(seed))
    path_xy, heading_rad = drive_path(views)
    poses = planar_poses(path_xy, heading_rad, height_m, 0.35, pitch_deg, roll_deg)
    return Recording('agv_drive', camera, poses, _stamps(views, rate_hz), surfaces,
                     noise_sigma=noise_sigma, seed=seed, made=made,
                     transmission=_dirt(camera, seed) if dirt else None)


def arm_move(views: int = 24, size: tuple[int, int] = (640, 480), camera: Camera | None = None,
             distortion: Sequence[float] = (), noise_sigma: float = 1.0, rate_hz: float = 15.0,
             seed: int = 2) -> Recording:
    """
    Move a camera on an arm over a bench: translations, then rotations, then both.

    The first third of the views are pure translations along different axes. The second third turn
    about different axes at small translations. The rest move in general. The labels say which is
    which.

    Parameters
    ----------
    views : int
        Number of images, at least 6.
    size, camera, distortion, noise_sigma, rate_hz, seed
        As in `agv_drive`.

    Returns
    -------
    Recording

    """
    _check_views(views, least=6)
    made = {'function': 'arm_move', 'views': views, 'noise_sigma': noise_sigma,
            'rate_hz': rate_hz, 'seed': seed}
    camera = camera or default_camera(size, distortion)
    start = look_at([-0.75, -0.55, 0.85], [0.0, 0.0, 0.05])
    third = views // 3
    labels = ['translation'] * third + ['rotation'] * third
    labels += ['general'] * (views - len(labels))
    # offsets of the camera centre (m) and turns (rad) in the first view's axes, as way points
    moves = {
        'translation': ([[0, 0, 0], [.22, 0, 0], [.22, .16, 0], [.05, .16, .18]], [[0, 0, 0]]),
        'rotation': ([[.05, .16, .18], [.02, .1, .12], [0, .05, .05], [0, 0, 0]],
                     [[0, 0, 0], [0, .28, 0], [.22, .05, 0], [0, 0, .35]]),
        'general': ([[0, 0, 0], [-.15, -.1, .05], [.1, -.15, .1], [.2, .1, -.1]],
                    [[0, 0, .35], [-.15, -.1, .1], [.1, .1, -.2], [-.1, .25, .1]]),
    }
    offsets: list[np.ndarray] = []
    turns: list[np.ndarray] = []
    for label in moves:
        count = labels.count(label)
        at = np.arange(count) / max(count - 1, 1) if label == 'translation' else \
            np.arange(1, count + 1) / count
        for way, out in zip(moves[label], (offsets, turns)):
            way = np.array(way, float)
            knots = np.linspace(0, 1, len(way))
            out.append(np.stack([np.interp(at, knots, axis) for axis in way.T], axis=1))
    R = Rotation.from_rotvec(np.concatenate(turns)).as_matrix()
    to_camera = np.concatenate([R, -R @ np.concatenate(offsets)[:, :, None]], axis=2)
    poses = to_camera[:, :, :3] @ start
    poses[:, :, 3] += to_camera[:, :, 3]
    surfaces = list(_bench_top(seed))
    return Recording('arm_move', camera, poses, _stamps(views, rate_hz), surfaces,
                     noise_sigma=noise_sigma, seed=seed, made=made, labels=tuple(labels))


def turntable(views: int = 36, step_deg: float = 10.0, size: tuple[int, int] = (640, 480),
              camera: Camera | None = None, distortion: Sequence[float] = (),
              background: bool = True, noise_sigma: float = 1.0, dirt: bool = False,
              rate_hz: float = 2.0, seed: int = 3) -> Recording:
    """
    Turn objects before a fixed camera: circular motion.

    Parameters
    ----------
    views : int
        Number of images.
    step_deg : float
        Turn of the table between images.
    background : bool
        Show the room behind, which is static in the image; black otherwise.
    size, camera, distortion, noise_sigma, dirt, rate_hz, seed
        As in `agv_drive`.

    Returns
    -------
    Recording
        Poses are relative to the objects: the camera circles about z.

    """
    _check_views(views)
    made = {'function': 'turntable', 'views': views, 'step_deg': step_deg,
            'background': background, 'noise_sigma': noise_sigma, 'dirt': dirt,
            'rate_hz': rate_hz, 'seed': seed}
    camera = camera or default_camera(size, distortion)
    fixed = look_at([-0.6, 0.0, 0.36], [0.0, 0.0, 0.03])
    turn = Rotation.from_rotvec(
        np.deg2rad(step_deg) * np.arange(views)[:, None] * [0, 0, 1]).as_matrix()
    poses = np.concatenate([fixed[:, :3] @ turn,
                            np.broadcast_to(fixed[:, 3:], (views, 3, 1))], axis=2)
    surfaces = list(_turntable(seed))
    if not background:
        surfaces = [surface for surface in surfaces if surface.body == 0]
    return Recording('turntable', camera, poses, _stamps(views, rate_hz), surfaces,
                     static_pose=fixed if background else None, noise_sigma=noise_sigma,
                     seed=seed, made=made, transmission=_dirt(camera, seed) if dirt else None)


# Textures take longer to draw than an image of them; whoever films one world twice waits once.

@lru_cache(maxsize=2)
def _hall(seed: int) -> tuple[Surface, ...]:
    # laid out around the whole path, so that it is the same for every number of views
    return tuple(worlds.hall(np.random.default_rng([seed, 0]), *drive_path(200)))


@lru_cache(maxsize=2)
def _bench_top(seed: int) -> tuple[Surface, ...]:
    return tuple(worlds.bench_top(np.random.default_rng([seed, 0])))


@lru_cache(maxsize=2)
def _turntable(seed: int) -> tuple[Surface, ...]:
    return tuple(worlds.turntable(np.random.default_rng([seed, 0])))


def write_image_folder(recording: Recording, path: str | Path) -> Path:
    """
    Write the images as PNG files and the truth beside them.

    Parameters
    ----------
    recording : Recording
        What to write.
    path : str or Path
        Folder; it is made where it is missing. Its files are named by number, and
        ``truth.json`` holds `Recording.truth`.

    Returns
    -------
    Path
        The folder.

    """
    path = Path(path)
    path.mkdir(parents=True, exist_ok=True)
    for index, (image, _) in enumerate(recording.frames()):
        ok, data = cv2.imencode('.png', image)
        if not ok:
            raise RuntimeError('OpenCV cannot encode PNG.')
        _replace(path / f'{index:04d}.png', data.tobytes())
    write_truth(recording, path / 'truth.json')
    return path


def write_truth(recording: Recording, path: str | Path) -> None:
    """Write `Recording.truth` to the JSON file `path`."""
    _replace(Path(path), (json.dumps(recording.truth()) + '\n').encode())


def _replace(path: Path, data: bytes) -> None:
    """Write a file in one step: a reader sees the old one or the new one."""
    temporary = path.with_name(path.name + '.part')
    temporary.write_bytes(data)
    os.replace(temporary, path)


def _stamps(count: int, rate_hz: float) -> np.ndarray:
    return np.asarray(FIRST_STAMP_NS + np.rint(np.arange(count) * 1e9 / rate_hz).astype(np.int64))


def _check_views(views: int, least: int = 2) -> None:
    if views < least:
        raise ArgumentError(f'A recording of this kind needs at least {least} views, '
                            f'not {views!r}.')


def _dirt(camera: Camera, seed: int, count: int = 6) -> np.ndarray:
    """Transmission (height, width) of a lens with `count` blurred dark spots."""
    rng = np.random.default_rng([seed, 1])
    y, x = np.mgrid[:camera.height, :camera.width].astype(float)
    transmission = np.ones((camera.height, camera.width))
    for _ in range(count):
        centre = rng.uniform(0.1, 0.9, 2) * [camera.width, camera.height]
        radius = rng.uniform(0.012, 0.03) * camera.width
        distance = np.hypot(x - centre[0], y - centre[1])
        cover = 1 / (1 + np.exp((distance - radius) / 1.5))
        transmission *= 1 - rng.uniform(0.5, 0.8) * cover
    return transmission
