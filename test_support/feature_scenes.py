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
"""A textured room with exact geometry, for the tests of the features."""

from functools import cache

import cv2
import numpy as np

WIDTH, HEIGHT = 400, 300
K = np.array([[330.0, 0, 204], [0, 330, 146], [0, 0, 1]])
#: Planes n . X = d of the room: floor, wall ahead, wall on the left, wall on the right.
_PLANES = ((1, 1.2), (2, 6.0), (0, -3.0), (0, 3.0))
_PIXELS_PER_METRE = 110


def texture(rng, size=1024):
    """Return noise of several scales, periodic, uint8."""
    image = np.zeros((size, size))
    for sigma in (1.5, 3, 6, 14):
        layer = cv2.GaussianBlur(rng.normal(size=(3 * size, 3 * size))[:size, :size], (0, 0),
                                 sigma, borderType=cv2.BORDER_REFLECT)
        image += layer / layer.std()
    return np.clip(128 + 40 * image, 0, 255).astype(np.float32)


def smooth_texture(seed, size, scale):
    """Return noise whose grains are of about `scale` pixels, (H, W), 0 to 255."""
    coarse = np.random.default_rng(seed).uniform(
        0, 255, (size[0] // scale + 1, size[1] // scale + 1)).astype(np.float32)
    return cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC).clip(0, 255)


def chessboard(square=26, size=1040):
    """Return a chessboard, uint8."""
    at = np.arange(size) // square
    return np.where((at[:, None] + at[None]) % 2, 220, 40).astype(np.float32)


def pose(x=0.0, z=0.0, yaw_deg=0.0, pitch_deg=0.0):
    """Return R, centre of a camera (x right, y down, z forward); pitch looks down."""
    yaw, pitch = np.deg2rad([yaw_deg, pitch_deg])
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)],
                     [0, np.sin(pitch), np.cos(pitch)]])
    return (turn @ tilt.T).T, np.array([x, 0.0, z])


@cache
def _painted(seed):
    """Paint the walls, which takes seconds; returns them, and the state of the generator then."""
    rng = np.random.default_rng(seed)
    textures = [texture(rng) for _ in _PLANES]
    for one in textures:
        one.flags.writeable = False
    return textures, rng.bit_generator.state


class Room:
    """The room, what a camera sees of it, and where its points are."""

    def __init__(self, seed=3, ahead=None):
        """Paint the walls; `ahead` replaces the texture of the wall in front."""
        textures, state = _painted(seed)
        self.textures, self.rng = list(textures), np.random.default_rng(seed)
        self.rng.bit_generator.state = state
        if ahead is not None:
            self.textures[1] = ahead

    def hit(self, xy, camera):
        """Return the scene points (N, 3) and planes (N,) behind pixels (N, 2)."""
        R, centre = camera
        rays = np.column_stack([xy, np.ones(len(xy))]) @ np.linalg.inv(K).T @ R
        distance = np.full((len(_PLANES), len(xy)), np.inf)
        for k, (axis, offset) in enumerate(_PLANES):
            with np.errstate(divide='ignore'):
                along = (offset - centre[axis]) / rays[:, axis]
            distance[k] = np.where(along > 0, along, np.inf)
        plane = distance.argmin(axis=0)
        return centre + rays * distance.min(axis=0)[:, None], plane

    def image(self, camera, noise=1.0):
        """Render an image, uint8, with the mean over 2x2 samples of each pixel."""
        x, y = np.meshgrid(np.arange(2 * WIDTH) / 2 - 0.25, np.arange(2 * HEIGHT) / 2 - 0.25)
        points, plane = self.hit(np.stack([x.ravel(), y.ravel()], axis=1), camera)
        grey = np.zeros(len(points), np.float32)
        for k, (axis, _) in enumerate(_PLANES):
            rows = plane == k
            u, v = (points[rows][:, [i for i in range(3) if i != axis]]
                    * _PIXELS_PER_METRE % (len(self.textures[k]) - 2)).T.astype(np.float32)
            if len(u):
                side = -(-len(u) // 30000)
                pad = np.zeros(side * 30000 - len(u), np.float32)
                u, v = (np.concatenate([w, pad]).reshape(side, -1) for w in (u, v))
                sampled = cv2.remap(self.textures[k], u, v, cv2.INTER_LINEAR).ravel()
                grey[rows] = sampled[:rows.sum()]
        grey = cv2.resize(grey.reshape(2 * HEIGHT, 2 * WIDTH), (WIDTH, HEIGHT),
                          interpolation=cv2.INTER_AREA)
        grey += self.rng.normal(0, noise, grey.shape)
        return np.clip(np.round(grey), 0, 255).astype(np.uint8)

    def transfer(self, xy, camera, other):
        """Return where the points seen at pixels xy by one camera appear in another."""
        points, _ = self.hit(xy, camera)
        R, centre = other
        projected = (points - centre) @ R.T @ K.T
        return projected[:, :2] / projected[:, 2:]


def true_fundamental(camera, other):
    """Return F with x_other' F x = 0."""
    R = other[0] @ camera[0].T
    t = other[0] @ (camera[1] - other[1])
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    inverse = np.linalg.inv(K)
    return inverse.T @ cross @ R @ inverse


def drive(count, step_m=0.03, turn_deg=0.4):
    """Return the cameras of a planar drive along a curve, pitched down."""
    cameras, x, z = [], 0.0, 0.0
    for k in range(count):
        yaw = k * turn_deg
        cameras.append(pose(x, z, yaw, 12.0))
        x += step_m * np.sin(np.deg2rad(yaw))
        z += step_m * np.cos(np.deg2rad(yaw))
    return cameras


def transfer_errors(room, cameras, tracks):
    """Return the distance of every observation to where the first of its track must appear."""
    errors, ages = [], []
    first = np.concatenate([[True], np.diff(tracks.track) != 0])
    start = np.maximum.accumulate(np.where(first, np.arange(len(tracks)), 0))
    for k in np.flatnonzero(~first):
        origin = start[k]
        errors.append((tracks.frame[origin], tracks.frame[k], origin, k))
    table = np.array(errors)
    result = np.full(len(tracks), np.nan)
    for a, b in np.unique(table[:, :2], axis=0):
        rows = table[(table[:, 0] == a) & (table[:, 1] == b)]
        expected = room.transfer(tracks.xy[rows[:, 2]], cameras[a], cameras[b])
        result[rows[:, 3]] = np.linalg.norm(tracks.xy[rows[:, 3]] - expected, axis=1)
    ages = tracks.frame - tracks.frame[start]
    return result[~first], ages[~first]


def waves(rng, spread=0.3, count=200):
    """
    Grey values that can be had between pixels, too: a function of pixels (..., 2).

    What warps an image by OpenCV's bicubic kernel moves it by up to 0.05 pixels.
    """
    turns, phases = rng.normal(0, spread, (count, 2)), rng.uniform(0, 2 * np.pi, count)
    return lambda xy: 128 + 4 * np.cos(xy @ turns.T + phases).sum(axis=-1)


def pixel_grid(size):
    """Pixels of a square image, shape (size, size, 2)."""
    return np.stack(np.meshgrid(*2 * [np.arange(float(size))]), axis=2)
