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
"""Textured scenes to render: a hall with boxes and pillars, a bench top, a turntable."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from selfcal_ros.synthetic.render import PYRAMID_LEVELS, Surface


@dataclass(frozen=True)
class Style:
    """
    How a texture looks.

    Parameters
    ----------
    texel_m : float
        Side of a texel in metres, at most.
    smallest_m, largest_m : float
        Radii of the shapes.
    cover : float
        Total area of the shapes over the area of the surface.
    contrast : float
        Largest departure of a shape from the mean grey level.

    """

    texel_m: float = 0.004
    smallest_m: float = 0.02
    largest_m: float = 0.3
    cover: float = 1.0
    contrast: float = 70.0


def texture(rng: np.random.Generator, width_m: float, height_m: float, style: Style, mean: float,
            ) -> np.ndarray:
    """
    Draw a band-limited texture of polygons and ellipses at several scales.

    The radii follow a density of r^-3, so that every octave of size covers the same area; the
    small shapes lie on the large ones. Edges are one and a half texels soft.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of every choice.
    width_m, height_m : float
        Size of the surface.
    style : Style
        What to draw.
    mean : float
        Mean grey level.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        Sides as `Scene` needs them.

    """
    unit = 2 ** (PYRAMID_LEVELS - 1)
    columns, rows = (max(2, int(np.ceil(side / (style.texel_m * unit)))) * unit
                     for side in (width_m, height_m))
    texels = np.array([columns / width_m, rows / height_m])  # per metre
    smooth = ndimage.gaussian_filter(rng.normal(size=(rows // 16, columns // 16)), 2.0)
    smooth *= 0.25 * style.contrast / max(smooth.std(), 1e-9)
    canvas = mean + ndimage.zoom(smooth, 16, order=1, grid_mode=True, mode='nearest')
    radii = _radii(rng, width_m * height_m, style)
    for radius in radii:
        _draw_shape(canvas, rng, radius * texels.mean(), mean, style.contrast)
    return np.asarray(np.clip(ndimage.gaussian_filter(canvas, 0.6), 5, 250).astype(np.float32))


def _radii(rng: np.random.Generator, area_m2: float, style: Style) -> np.ndarray:
    """Radii in metres, largest first."""
    low, high = style.smallest_m ** -2, style.largest_m ** -2
    mean_square = 2 * np.log(style.largest_m / style.smallest_m) / (low - high)
    count = max(8, int(style.cover * area_m2 / (2.2 * mean_square)))
    return np.sort((high + (low - high) * rng.random(count)) ** -0.5)[::-1]


def _draw_shape(canvas: np.ndarray, rng: np.random.Generator, radius: float, mean: float,
                contrast: float) -> None:
    """Draw one ellipse or regular polygon, stretched and turned, `radius` texels large."""
    rows, columns = canvas.shape
    x, y, angle, stretch = rng.random(4) * [columns, rows, 2 * np.pi, 0.6] + [0, 0, 0, 0.4]
    corners = rng.integers(2, 6)  # 2 stands for an ellipse
    grey = mean + contrast * rng.uniform(0.35, 1.0) * rng.choice([-1, 1])
    reach = radius + 2
    left, right = max(0, int(x - reach)), min(columns, int(x + reach) + 2)
    top, bottom = max(0, int(y - reach)), min(rows, int(y + reach) + 2)
    dx = np.arange(left, right)[None, :] + 0.5 - x
    dy = np.arange(top, bottom)[:, None] + 0.5 - y
    along = np.cos(angle) * dx + np.sin(angle) * dy
    across = (np.cos(angle) * dy - np.sin(angle) * dx) / stretch
    if corners == 2:
        outside = np.hypot(along, across) - radius
    else:
        turn = 2 * np.pi * (np.arange(corners) + 0.5) / corners
        outside = -radius * np.cos(np.pi / corners) + reduce(
            np.maximum, [np.cos(t) * along + np.sin(t) * across for t in turn])
    alpha = np.clip(0.5 - outside * stretch ** 0.5 / 1.5, 0, 1)
    patch = canvas[top:bottom, left:right]
    patch += alpha * (grey - patch)


def rectangle(rng: np.random.Generator, origin: ArrayLike, edge_u: ArrayLike, edge_v: ArrayLike,
              style: Style, mean: float, body: int = 0) -> Surface:
    """Make a surface with a texture of its own."""
    size = float(np.linalg.norm(edge_u)), float(np.linalg.norm(edge_v))
    return Surface(np.asarray(origin, float), np.asarray(edge_u, float),
                   np.asarray(edge_v, float), texture(rng, *size, style, mean), body)


def box(rng: np.random.Generator, centre: ArrayLike, size: ArrayLike, yaw_rad: float, style: Style,
        body: int = 0) -> list[Surface]:
    """
    Make the four sides and the top of an upright box.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the textures.
    centre : array_like, shape (3,)
        Centre of the bottom face, world, metres, z up.
    size : array_like, shape (3,)
        Length, width, height.
    yaw_rad : float
        Rotation about z.
    style : Style
        Of the textures.
    body : int
        Rigid body.

    Returns
    -------
    list of Surface, length 5

    """
    length, width, height = np.asarray(size, float)
    x = np.array([np.cos(yaw_rad), np.sin(yaw_rad), 0.0]) * length
    y = np.array([-np.sin(yaw_rad), np.cos(yaw_rad), 0.0]) * width
    z = np.array([0.0, 0.0, height])
    corner = np.asarray(centre, float) - (x + y) / 2
    mean = rng.uniform(70, 180)
    faces = [(corner, x, z), (corner + x, y, z), (corner + x + y, -x, z), (corner + y, -y, z),
             (corner + z, x, y)]
    # v runs down the image on the sides: start at the top edge and let u run the other way
    return [rectangle(rng, o, u, v, style, np.clip(mean + rng.uniform(-35, 35), 55, 180), body)
            for o, u, v in faces]


def room(rng: np.random.Generator, low: ArrayLike, high: ArrayLike, style: Style,
         ceiling_style: Style) -> list[Surface]:
    """Make floor, ceiling and four walls that face inwards, between corners `low` and `high`."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    x, y, z = np.diag(high - low)
    return [
        rectangle(rng, low, x, y, style, 115.0),
        rectangle(rng, low + z, y, x, ceiling_style, 190.0),
        rectangle(rng, low, z, x, style, 150.0),
        rectangle(rng, low + y, x, z, style, 95.0),
        rectangle(rng, low, y, z, style, 130.0),
        rectangle(rng, low + x, z, y, style, 165.0),
    ]


def hall(rng: np.random.Generator, path_xy: ArrayLike, heading_rad: ArrayLike, boxes: int = 18,
         clearance_m: float = 0.75) -> list[Surface]:
    """
    Furnish a hall around a drive: boxes and pillars near and far, none in the way.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the layout and the textures.
    path_xy : ndarray, shape (N, 2)
        Where the vehicle passes, metres.
    heading_rad : ndarray, shape (N,)
        Where it looks there.
    boxes : int
        How many boxes and pillars.
    clearance_m : float
        Free space beside the path.

    Returns
    -------
    list of Surface

    """
    path_xy, heading_rad = np.asarray(path_xy, float), np.asarray(heading_rad, float)
    low = np.append(path_xy.min(axis=0) - [2.0, 3.2], 0.0)
    high = np.append(path_xy.max(axis=0) + [4.5, 3.2], 3.0)
    floor = Style(texel_m=0.006, smallest_m=0.045, largest_m=0.7, cover=0.9, contrast=60.0)
    ceiling = Style(texel_m=0.02, smallest_m=0.1, largest_m=1.0, cover=0.8, contrast=40.0)
    surfaces = room(rng, low, high, floor, ceiling)
    placed: list[tuple[np.ndarray, float]] = []
    for attempt in range(400):
        if len(placed) == boxes:
            break
        size = np.exp(rng.uniform(np.log([0.25, 0.25, 0.25]), np.log([1.0, 0.8, 1.5])))
        if len(placed) % 4 == 3:
            size = np.array([0.3, 0.3, 3.0]) * [rng.uniform(0.7, 1.3), rng.uniform(0.7, 1.3), 1]
        start = rng.integers(len(path_xy))
        bearing = heading_rad[start] + rng.uniform(-0.7, 0.7)
        distance = np.exp(rng.uniform(np.log(1.2), np.log(6.0)))
        xy = path_xy[start] + distance * np.array([np.cos(bearing), np.sin(bearing)])
        radius = np.hypot(*size[:2]) / 2
        if ((xy - radius < low[:2] + 0.05) | (xy + radius > high[:2] - 0.05)).any():
            continue
        if np.linalg.norm(path_xy - xy, axis=1).min() < clearance_m + radius:
            continue
        if any(np.hypot(*(xy - other)) < radius + r + 0.1 for other, r in placed):
            continue
        placed.append((xy, radius))
        style = Style(smallest_m=rng.uniform(0.018, 0.035), largest_m=rng.uniform(0.15, 0.35),
                      cover=rng.uniform(0.7, 1.2), contrast=rng.uniform(45, 70))
        surfaces += box(rng, np.append(xy, 0.0), size, rng.uniform(0, np.pi), style)
    return surfaces


def bench_top(rng: np.random.Generator, boxes: int = 16) -> list[Surface]:
    """
    Lay out a bench top inside a small room, for a camera about a metre above the origin.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the layout and the textures.
    boxes : int
        Objects that stand on the bench.

    Returns
    -------
    list of Surface

    """
    fine = Style(texel_m=0.002, smallest_m=0.011, largest_m=0.2, cover=0.8, contrast=60.0)
    coarse = Style(texel_m=0.006, smallest_m=0.04, largest_m=0.5, cover=0.8, contrast=50.0)
    surfaces = room(rng, [-2.5, -2.5, -0.75], [2.5, 2.5, 2.25], coarse, coarse)
    surfaces.append(rectangle(rng, [-0.9, -0.75, 0.0], [1.8, 0, 0], [0, 1.5, 0], fine, 140.0))
    return surfaces + scatter(rng, boxes, 0.55, fine, largest_m=0.4)


def turntable(rng: np.random.Generator, boxes: int = 7) -> list[Surface]:
    """
    Put objects on a round trip: body 0 turns, body 1 is the room behind, which does not.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the layout and the textures.
    boxes : int
        Objects on the table.

    Returns
    -------
    list of Surface

    """
    fine = Style(texel_m=0.0016, smallest_m=0.008, largest_m=0.1)
    coarse = Style(texel_m=0.006, smallest_m=0.03, largest_m=0.4)
    background = [Surface(s.origin, s.edge_u, s.edge_v, s.texture, 1) for s in
                  room(rng, [-2.0, -2.0, -0.8], [2.0, 2.0, 2.0], coarse, coarse)]
    table = rectangle(rng, [-0.25, -0.25, 0.0], [0.5, 0, 0], [0, 0.5, 0], fine, 120.0)
    return [table] + scatter(rng, boxes, 0.22, fine, largest_m=0.14) + background


def scatter(rng: np.random.Generator, count: int, radius_m: float, style: Style,
            largest_m: float = 0.3) -> list[Surface]:
    """Stand `count` boxes on z = 0 within `radius_m` of the origin, apart from each other."""
    surfaces: list[Surface] = []
    placed: list[tuple[np.ndarray, float]] = []
    for attempt in range(60 * count):
        if len(placed) == count:
            break
        size = rng.uniform([0.25, 0.25, 0.2], [0.6, 0.6, 1.0]) * largest_m
        xy = rng.uniform(-radius_m, radius_m, 2)
        radius = np.hypot(*size[:2]) / 2
        if any(np.hypot(*(xy - other)) < radius + r + 0.005 for other, r in placed):
            continue
        placed.append((xy, radius))
        surfaces += box(rng, np.append(xy, 0.0), size, rng.uniform(0, np.pi), style)
    return surfaces
