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
A small anti-aliased renderer of textured rectangles, with exact truth.

A rectangle ``P + u U + v V`` (0 <= u, v <= 1, camera frame) is seen along the ray d at distance
t where ``[U V P] (u, v, 1)^T = t d``; rays have z = 1 under a perspective and unit length under a
fisheye, where they may point backwards. With ``A = [U V P]^-1`` the three values
``(a, b, w) = A d = (u, v, 1) / t`` are linear in the ray: w is the inverse distance, and the ray
hits where ``0 <= a, b <= w``. Nothing is approximated but the texture's filter, which is
symmetric: the mean of a regular grid of samples over the pixel, each looked up trilinearly in a
pyramid of box-filtered textures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector

#: Textures are halved this many times; their sides are multiples of 2 ** (PYRAMID_LEVELS - 1).
PYRAMID_LEVELS = 6
_TILE = 48
#: Surfaces are no nearer than this to a camera whose rows are read one after the other, metres.
NEAREST_M = 0.3

#: Rows and columns of a part of an image.
_Slices: TypeAlias = tuple[slice, slice]


@dataclass(frozen=True)
class Surface:
    """
    A textured rectangle, seen only from the side to which `edge_u` x `edge_v` points.

    Parameters
    ----------
    origin, edge_u, edge_v : array_like, shape (3,)
        The corner where u = v = 0 and the two edges that leave it, metres.
    texture : ndarray, shape (rows, columns)
        Grey levels, 0 to 255, linear in intensity; u runs along the columns, v along the rows,
        and each texel covers its share of the rectangle: the centre of texel (0, 0) lies at
        u = 0.5 / columns, v = 0.5 / rows.
    body : int
        Index of the rigid body to which the surface belongs.

    """

    origin: np.ndarray
    edge_u: np.ndarray
    edge_v: np.ndarray
    texture: np.ndarray
    body: int = 0


class Scene:
    """
    Surfaces prepared for rendering: their frames, and all textures in one array.

    Parameters
    ----------
    surfaces : sequence of Surface
        At least one.

    Raises
    ------
    ArgumentError
        If there is no surface, or a texture's sides are not multiples of
        ``2 ** (PYRAMID_LEVELS - 1)`` and at least twice that.

    """

    def __init__(self, surfaces: Iterable[Surface]) -> None:
        """Stack the frames and build the pyramids."""
        surfaces = list(surfaces)
        if not surfaces:
            raise ArgumentError('A scene needs at least one surface.')
        #: (S, 3, 3): U, V and P as columns.
        self.frames = np.array([np.column_stack([s.edge_u, s.edge_v, s.origin])
                                for s in surfaces], dtype=float)
        self.body = np.array([s.body for s in surfaces])
        self.sides = np.array([s.texture.shape[::-1] for s in surfaces])
        step = 2 ** (PYRAMID_LEVELS - 1)
        if (self.sides % step).any() or (self.sides < 2 * step).any():
            raise ArgumentError(f'The sides of a texture must be multiples of {step} and at '
                                f'least {2 * step} texels.')
        self._offsets = np.zeros((len(surfaces), PYRAMID_LEVELS), dtype=np.int64)
        parts, length = [], 0
        for index, surface in enumerate(surfaces):
            level = np.asarray(surface.texture, dtype=np.float32)
            for k in range(PYRAMID_LEVELS):
                if k:
                    level = level.reshape(level.shape[0] // 2, 2, -1, 2).mean(axis=(1, 3))
                self._offsets[index, k] = length
                parts.append(level.ravel())
                length += level.size
        self._texels = np.concatenate(parts)

    def look_up(self, surface: int, u: np.ndarray, v: np.ndarray, level: np.ndarray) -> np.ndarray:
        """
        Sample one texture.

        Parameters
        ----------
        surface : int
        u, v : ndarray, shape (N,)
            Where in the rectangle, 0 to 1.
        level : ndarray, shape (N,)
            Pyramid level, real; 0 is the full resolution.

        Returns
        -------
        ndarray, shape (N,)
            Grey levels, interpolated between texels and between levels.

        """
        level = np.clip(level, 0, PYRAMID_LEVELS - 1)
        lower = np.minimum(level.astype(np.int64), PYRAMID_LEVELS - 2)
        fraction = level - lower
        lowest, highest = int(lower.min()), int(lower.max())
        if lowest == highest:
            return self._between(surface, lowest, u, v, fraction)
        value = np.empty(len(u))
        # most surfaces are seen at one level or two
        for first in range(lowest, highest + 1):
            here = np.flatnonzero(lower == first)
            if len(here):
                value[here] = self._between(surface, first, u[here], v[here], fraction[here])
        return value

    def _between(self, surface: int, level: int, u: np.ndarray, v: np.ndarray,
                 fraction: np.ndarray) -> np.ndarray:
        """Sample a texture at a level and, where `fraction` > 0, so far towards the next."""
        value = self._bilinear(surface, level, u, v)
        blurred = np.flatnonzero(fraction > 0)
        if len(blurred) == len(u):
            value += fraction * (self._bilinear(surface, level + 1, u, v) - value)
        elif len(blurred):
            upper = self._bilinear(surface, level + 1, u[blurred], v[blurred])
            value[blurred] += fraction[blurred] * (upper - value[blurred])
        return value

    def _bilinear(self, surface: int, level: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        width, height = self.sides[surface] >> level
        x, column = _texel(u, width)
        y, first = _texel(v, height)
        first *= width
        first += column
        first += self._offsets[surface, level]
        texels, left = self._texels, 1 - x
        top, bottom = (texels.take(first + below) * left for below in (0, width))
        first += 1
        top += texels.take(first) * x
        first += width
        bottom += texels.take(first) * x
        bottom -= top
        bottom *= y
        return np.asarray(np.add(top, bottom, out=top))


def _texel(share: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Split places, 0 to 1 along a side of a texture, into texels and the way to the next."""
    place = share * side
    place -= 0.5
    np.maximum(place, 0, out=place)
    np.minimum(place, side - 1, out=place)
    texel = place.astype(np.int64)
    np.minimum(texel, side - 2, out=texel)
    place -= texel
    return place, texel


class Renderer:
    """
    Renders one scene through one camera; the rays are computed once.

    Parameters
    ----------
    scene : Scene
        What is seen.
    camera : Camera
        With its image size. Lens distortion is exact: every sample's ray is undistorted.
    supersampling : int
        Samples along each side of a pixel.
    background : float
        Grey level where no surface is hit. Where the lens sees nothing, the image is black.
    circle_rad : float, optional
        Angle across the image circle: rays farther than half of it from the axis are black.

    Raises
    ------
    ArgumentError
        If the camera has no image size.

    """

    def __init__(self, scene: Scene, camera: Camera, supersampling: int = 3,
                 background: float = 0.0, circle_rad: float | None = None) -> None:
        """Cut the image into tiles and compute their rays."""
        if camera.width < 1 or camera.height < 1:
            raise ArgumentError('The camera to render with needs its image size.')
        self.scene, self.camera, self.background = scene, camera, float(background)
        self._samples = int(supersampling)
        self._circle = circle_rad
        self._tiles = [tile for tile in self._cut() if np.isfinite(tile[1][0]).any()]
        boxes = [[np.fmin.reduce(r, axis=1), np.fmax.reduce(r, axis=1)]
                 for _, r, _ in self._tiles]
        self._low, self._high = np.moveaxis(np.array(boxes), 1, 0)

    def _cut(self) -> Iterator[tuple[_Slices, np.ndarray, np.ndarray]]:
        """Yield (slices, rays (3, N), step (3, 2)) for every tile, samples in raster order."""
        n = self._samples
        for top in range(0, self.camera.height, _TILE):
            for left in range(0, self.camera.width, _TILE):
                rows = slice(top, min(top + _TILE, self.camera.height))
                columns = slice(left, min(left + _TILE, self.camera.width))
                # sample k of a pixel lies at (k + 1/2) / n - 1/2 from the pixel's centre
                y = (np.arange(rows.start * n, rows.stop * n) + 0.5) / n - 0.5
                x = (np.arange(columns.start * n, columns.stop * n) + 0.5) / n - 0.5
                rays = self._rays(x, y)
                yield (rows, columns), rays, self._step(rays.reshape(3, len(y), len(x)))

    def _rays(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the ray of every sample of a grid, shape (3, N), NaN where there is none."""
        rays = np.ones((3, len(y) * len(x)))
        if self.camera.is_pinhole and not self.camera.K[0, 1]:
            # columns and rows do not mix
            grid = rays.reshape(3, len(y), len(x))
            grid[0] = self.camera.normalised(np.stack([x, 0 * x], axis=-1))[:, 0]
            grid[1] = self.camera.normalised(np.stack([0 * y, y], axis=-1))[:, 1:]
        else:
            pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            if self.camera.lens.is_perspective:
                rays[:2] = self.camera.normalised(pixels).T
            else:
                rays = self.camera.rays(pixels).T
        if self._circle is not None:
            angle = np.arctan2(np.hypot(rays[0], rays[1]), rays[2])
            rays[:, ~(angle <= self._circle / 2)] = np.nan
        return rays

    def _step(self, rays: np.ndarray) -> np.ndarray:
        """
        Return how the ray (3, rows, columns) changes from sample to sample, shape (3, 2).

        One value a tile: only the texture's filter depends on it.
        """
        if self.camera.model == 'plumb_bob':
            # that of the pinhole will do, and it is the same for every window of an image
            return np.vstack([np.diag(1 / (self._samples * self.camera.K[[0, 1], [0, 1]])),
                              np.zeros(2)])
        steps = []
        for axis in (2, 1):
            change = np.diff(rays, axis=axis).reshape(3, -1)
            there = np.isfinite(change[0])
            steps.append(change[:, there].sum(axis=1) / max(there.sum(), 1))
        return np.stack(steps, axis=1)

    def render(self, cam_from_world: np.ndarray, rng: np.random.Generator | None = None,
               noise_sigma: float = 0.0) -> np.ndarray:
        """
        Render one image.

        Parameters
        ----------
        cam_from_world : ndarray, shape (3, 4) or (B, 3, 4)
            Pose of the world, or of each rigid body of the scene, in the optical frame.
        rng : numpy.random.Generator, optional
            Source of the noise; needed when there is any.
        noise_sigma : float
            Standard deviation of the Gaussian image noise in grey levels.

        Returns
        -------
        ndarray of uint8, shape (height, width)

        """
        return quantise(self.intensity(cam_from_world), rng, noise_sigma)

    def intensity(self, cam_from_world: np.ndarray) -> np.ndarray:
        """Render without noise or rounding: grey levels as reals, shape (height, width)."""
        image = np.zeros((self.camera.height, self.camera.width))
        n = self._samples
        for (rows, columns), rays, step, surfaces, inverse in self._candidates(cam_from_world):
            grey = self._shade(rays, step, surfaces, inverse)
            high, wide = rows.stop - rows.start, columns.stop - columns.start
            image[rows, columns] = grey.reshape(high, n, wide, n).mean(axis=(1, 3))
        return image

    def rolling_intensity(self, pose_at: Callable[[float], np.ndarray]) -> np.ndarray:
        """
        Render rows that are read one after the other, without noise or rounding.

        Within a tile the camera keeps its velocity, which is exact to second order in the time
        that some tens of rows take.

        Parameters
        ----------
        pose_at : callable
            pose_at(share) → (3, 4): where the world is while the row at this share of the image's
            height is read, from -1/2 to 1/2 about the middle row.

        Returns
        -------
        ndarray, shape (height, width)

        """
        image, n = np.zeros((self.camera.height, self.camera.width)), self._samples
        tops = np.array([tile[0][0].start for tile in self._tiles])
        for top in np.unique(tops):
            rows = self._tiles[int(np.flatnonzero(tops == top)[0])][0][0]
            shares = (np.array([rows.start, (rows.start + rows.stop) / 2, rows.stop])
                      / self.camera.height - 0.5)
            first, pose, last = (np.asarray(pose_at(share), float) for share in shares)
            # how the camera moves over the tile, in its own frame at the middle of it
            turn = rotation_vector(last[:, :3] @ first[:, :3].T)
            centres = [-one[:, :3].T @ one[:, 3] for one in (first, last)]
            move = pose[:, :3] @ (centres[1] - centres[0])
            reach = float(np.linalg.norm(turn) + np.linalg.norm(move) / NEAREST_M) / 2
            for (rows, columns), rays, step, surfaces, inverse in self._candidates(
                    pose, tops == top, reach):
                high, wide = rows.stop - rows.start, columns.stop - columns.start
                time = (np.arange(high * n) + 0.5) / (high * n) - 0.5
                back = np.swapaxes(rotation_matrix(time[:, None] * turn), 1, 2)
                lines = rays.reshape(3, high * n, wide * n)
                turned = np.einsum('rij,jrc->irc', back, lines).reshape(3, -1)
                grey = self._shade(turned, step, surfaces, inverse,
                                   (np.repeat(time, wide * n), move))
                image[rows, columns] = grey.reshape(high, n, wide, n).mean(axis=(1, 3))
        return image

    def depth(self, cam_from_world: np.ndarray) -> np.ndarray:
        """
        Depth (z in the optical frame, metres) at the pixel centres, NaN where nothing is hit.

        Shape (height, width); exact, and negative beside and behind a fisheye. The number of
        samples along a pixel must be odd.
        """
        if self._samples % 2 == 0:
            raise ArgumentError('A depth map needs an odd supersampling: only then does a '
                                'sample lie at the centre of the pixel.')
        image = np.full((self.camera.height, self.camera.width), np.nan)
        n = self._samples
        for (rows, columns), rays, _, surfaces, inverse in self._candidates(cam_from_world):
            high, wide = rows.stop - rows.start, columns.stop - columns.start
            centre = rays.reshape(3, high, n, wide, n)[:, :, n // 2, :, n // 2].reshape(3, -1)
            _, _, _, w = _nearest(centre, inverse)
            with np.errstate(divide='ignore'):
                depth = np.where(w > 0, centre[2] / w, np.nan)
            image[rows, columns] = depth.reshape(high, wide)
        return image

    def _candidates(self, cam_from_world: np.ndarray, tiles: np.ndarray | None = None,
                    reach: float = 0.0,
                    ) -> Iterator[tuple[_Slices, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """
        Yield (slices, rays, step, surfaces, their A) by tile, hidden surfaces left out.

        Of some tiles only, and allowing for rays that move by so much.
        """
        tiles = np.ones(len(self._tiles), bool) if tiles is None else tiles
        pose = np.asarray(cam_from_world, dtype=float)
        pose = np.broadcast_to(pose, (self.scene.body.max() + 1, 3, 4))[self.scene.body]
        frames = pose[:, :, :3] @ self.scene.frames
        frames[:, :, 2] += pose[:, :, 3]
        # facing the camera: the normal U x V points against the ray to P
        facing = np.flatnonzero(np.linalg.det(frames) < -1e-12)
        inverse = np.linalg.inv(frames[facing])
        a, b, w = np.moveaxis(inverse, 1, 0)
        tests = np.stack([w, a, b, w - a, w - b])
        # extremes of these linear forms over the box of each tile's rays: (tests, S, tiles)
        low = tests[..., None] * (self._low[tiles] - reach).T
        high = tests[..., None] * (self._high[tiles] + reach).T
        least = np.minimum(low, high).sum(axis=2)
        most = np.maximum(low, high).sum(axis=2)
        seen = (most >= 0).all(axis=0)
        covering = np.where((least >= 0).all(axis=0), least[0], 0.0).max(axis=0, initial=0.0)
        seen &= most[0] >= covering
        for place, chosen in zip(np.flatnonzero(tiles), seen.T):
            slices, rays, step = self._tiles[place]
            yield slices, rays, step, facing[chosen], inverse[chosen]

    def _shade(self, rays: np.ndarray, step: np.ndarray, surfaces: np.ndarray, inverse: np.ndarray,
               motion: tuple[np.ndarray, np.ndarray] | None = None) -> np.ndarray:
        """Grey level of every ray, shape (N,); motion: times (N,) and move of their origin."""
        grey = np.where(np.isfinite(rays[0]), self.background, 0.0)
        if not len(surfaces):
            return grey
        best, a, b, w = _nearest(rays, inverse, motion)
        best[~(w > 0)] = len(surfaces)
        for index in np.flatnonzero(np.bincount(best, minlength=len(surfaces))[:len(surfaces)]):
            there = np.flatnonzero(best == index)
            hit = slice(None) if len(there) == len(best) else there
            depth = w[hit]
            u, v = a[hit] / depth, b[hit] / depth
            # texels that one sample's spacing covers, along the longer side of its footprint
            sides = self.scene.sides[surfaces[index]]
            squared = 0.0
            for axis in range(2):
                slope = inverse[index] @ step[:, axis]
                du = slope[0] * sides[0] - u * slope[2] * sides[0]
                dv = slope[1] * sides[1] - v * slope[2] * sides[1]
                squared = np.maximum(squared, du * du + dv * dv)
            level = 0.5 * np.log2(np.maximum(squared, 1e-12) / (depth * depth))
            grey[hit] = self.scene.look_up(surfaces[index], u, v, level)
        return grey


def _nearest(rays: np.ndarray, inverse: np.ndarray,
             motion: tuple[np.ndarray, np.ndarray] | None = None,
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Index of the nearest surface on each ray, with its a, b and w; w = 0: nothing is hit.

    Rays that start at s · m see the surfaces moved by -s · m, a change of A of rank one.
    """
    if not len(inverse):
        return (np.zeros(rays.shape[1], dtype=int),) + (np.zeros(rays.shape[1]),) * 3
    a, b, w = np.moveaxis(inverse, 1, 0) @ rays
    if motion is not None:
        time, move = motion
        shift = -(inverse @ move)
        share = time * w / (1 + time * shift[:, 2:])
        a, b, w = (one - shift[:, k:k + 1] * share for k, one in enumerate((a, b, w)))
    inside = (a >= 0) & (b >= 0) & (a <= w) & (b <= w)
    w = np.where(inside, w, 0.0)
    best = np.zeros(rays.shape[1], dtype=int)
    a_best, b_best, w_best = a[0], b[0], w[0]
    for k in range(1, len(inverse)):
        nearer = np.flatnonzero(w[k] > w_best)
        if len(nearer):
            best[nearer] = k
            for chosen, one in ((a_best, a), (b_best, b), (w_best, w)):
                chosen[nearer] = one[k, nearer]
    return best, a_best, b_best, w_best


def quantise(intensity: np.ndarray, rng: np.random.Generator | None = None,
             noise_sigma: float = 0.0) -> np.ndarray:
    """
    Add Gaussian noise and round to 8 bits.

    Raises
    ------
    ArgumentError
        If there is noise to add and no `rng` to draw it from.

    """
    if noise_sigma:
        if rng is None:
            raise ArgumentError('Image noise needs an rng to draw from.')
        noise = rng.standard_normal(np.shape(intensity))
        noise *= noise_sigma
        noise += intensity
        intensity = noise
    grey = np.rint(intensity)
    np.maximum(grey, 0, out=grey)
    np.minimum(grey, 255, out=grey)
    return np.asarray(grey.astype(np.uint8))
