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
"""Objects to be tracked: surfaces to render, and the wireframe model that is true of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from selfcal_ros.synthetic.render import PYRAMID_LEVELS, Surface
from selfcal_ros.synthetic.worlds import Style, texture
from selfcal_ros.values.wireframe import Conic, Cylinder, Polygon, WireframeModel

#: Facets of a round part; its outline is true to 0.05 % of the radius.
FACETS = 72
_TEXEL_M = 0.0005


@dataclass(frozen=True)
class SolidObject:
    """
    An object with its model.

    Parameters
    ----------
    model : WireframeModel
        Exact: every edge of it is where the grey level changes.
    surfaces : list of Surface
        Body 0, object frame.

    """

    model: WireframeModel
    surfaces: list[Surface]


@dataclass(frozen=True)
class Disc:
    """A round marking: centre (u, v) and radius in metres on the face, and its grey level."""

    centre: tuple[float, float]
    radius_m: float
    grey: float


@dataclass(frozen=True)
class Patch:
    """A rectangular marking: low and high corner (u, v) in metres, and its grey level."""

    low: tuple[float, float]
    high: tuple[float, float]
    grey: float


#: Corners of a box's faces, counter-clockwise from outside: +x, -x, +y, -y, +z, -z.
_BOX_FACES = ((1, 3, 7, 5), (2, 0, 4, 6), (3, 2, 6, 7), (0, 1, 5, 4), (4, 5, 7, 6), (2, 3, 1, 0))
_BOX_GREYS = (175, 150, 95, 80, 225, 45)


def cube(side_m: float = 0.084, rng: np.random.Generator | None = None, clutter: float = 0.0,
         ) -> SolidObject:
    """
    Make a cube with a rectangle on the faces +x and -x and a disc on +y, -y and the top.

    Parameters
    ----------
    side_m : float
        Side; the centre is the origin, z points up.
    rng : numpy.random.Generator, optional
        Source of the faces' texture; plain grey without.
    clutter : float
        Strength, 0 to 1, of markings that are not in the model.

    Returns
    -------
    SolidObject

    """
    s = side_m
    marks: dict[int, list[Patch | Disc]] = {}
    for face, grey in ((0, 60), (1, 40)):
        marks[face] = [Patch((0.2 * s, 0.25 * s), (0.8 * s, 0.7 * s), grey)]
    for face, grey in ((2, 190), (3, 175), (4, 120)):
        marks[face] = [Disc((0.5 * s, 0.5 * s), 0.3 * s, grey)]
    vertices, faces, surfaces = _box([-s / 2] * 3, [s / 2] * 3, _BOX_GREYS, marks, rng, clutter)
    lines, conics = [], []
    for face, found in marks.items():
        a, b, _, d = (vertices[i] for i in _BOX_FACES[face])
        u, v = (b - a) / s, (d - a) / s
        for mark in found:
            if isinstance(mark, Disc):
                centre = a + mark.centre[0] * u + mark.centre[1] * v
                conics.append(Conic(centre, mark.radius_m * u, mark.radius_m * v, f'disc {face}'))
            else:
                (u0, v0), (u1, v1) = mark.low, mark.high
                first = len(vertices)
                vertices = np.concatenate([vertices, [
                    a + p * u + q * v for p, q in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))]])
                lines += [(first + k, first + (k + 1) % 4) for k in range(4)]
    model = WireframeModel.build(vertices, lines, faces, conics=conics, name='cube')
    return SolidObject(model, surfaces)


def step_block(size_m: float = 0.1, rng: np.random.Generator | None = None, clutter: float = 0.0,
               ) -> SolidObject:
    """
    Make a block with a step: a concave prism that hides parts of its own edges.

    Parameters
    ----------
    size_m : float
        Length along x and height; the step is half of each, the width (y) 0.7 of it.
    rng, clutter
        As in `cube`.

    Returns
    -------
    SolidObject

    """
    return _l_prism('step_block', size_m, size_m, 0.7 * size_m, 0.5 * size_m, 0.5 * size_m, rng,
                    clutter)


def l_block(size_m: float = 0.1, rng: np.random.Generator | None = None, clutter: float = 0.0,
            ) -> SolidObject:
    """
    Make a letter L of unequal arms, each a quarter of the length thick.

    Parameters
    ----------
    size_m : float
        Height; the foot is 0.7 of it, the width (y) 0.4.
    rng, clutter
        As in `cube`.

    Returns
    -------
    SolidObject

    """
    return _l_prism('l_block', 0.7 * size_m, size_m, 0.4 * size_m, 0.25 * size_m, 0.25 * size_m,
                    rng, clutter)


def box(size_m: float = 0.1, rng: np.random.Generator | None = None, clutter: float = 0.0,
        ) -> SolidObject:
    """
    Make a box of sides 1 : 0.8 : 0.6 with plain faces.

    Parameters
    ----------
    size_m : float
        Longest side, along x.
    rng, clutter
        As in `cube`.

    Returns
    -------
    SolidObject

    """
    half = 0.5 * size_m * np.array([1, 0.8, 0.6])
    vertices, faces, surfaces = _box(-half, half, _BOX_GREYS, {}, rng, clutter)
    return SolidObject(WireframeModel.build(vertices, (), faces, name='box'), surfaces)


def _l_prism(name: str, length: float, height: float, width: float, upright: float, foot: float,
             rng: np.random.Generator | None, clutter: float) -> SolidObject:
    """Make a prism of L-shaped outline: an upright on a foot, so thick, metres."""
    x, z, w = length / 2, height / 2, width / 2
    inner = upright - x, foot - z
    outline = np.array([(-x, -z), (x, -z), (x, inner[1]), inner, (inner[0], z), (-x, z)])
    count = len(outline)
    front = np.column_stack([outline[:, 0], np.full(count, -w), outline[:, 1]])
    back = front * [1, -1, 1]
    vertices = np.concatenate([front, back])
    greys = (40, 165, 225, 130, 235, 120)
    faces, surfaces = [Polygon(tuple(range(count)), 'front'),
                       Polygon(tuple(range(2 * count - 1, count - 1, -1)), 'back')], []
    for k, grey in enumerate(greys):
        following = (k + 1) % count
        corners = (k, k + count, following + count, following)
        faces.append(Polygon(corners, f'side {k}'))
        surfaces.append(_facet(vertices[list(corners)], grey, (), rng, clutter))
    # the two L-shaped faces are rectangles side by side: plain, so that no seam shows
    for points, grey, order in ((front, 80, 1), (back, 95, -1)):
        y = points[0, 1]
        for (x0, z0), (x1, z1) in (((-x, -z), (x, inner[1])), ((-x, inner[1]), (inner[0], z))):
            around = np.array([(x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1)])
            surfaces.append(_facet(around[::order], grey))
    return SolidObject(WireframeModel.build(vertices, (), faces, name=name), surfaces)


def spool(width_m: float = 0.09, rng: np.random.Generator | None = None, clutter: float = 0.0,
          ) -> SolidObject:
    """
    Make a round post between two square plates: silhouettes, circles, and much that is hidden.

    Parameters
    ----------
    width_m : float
        Side of the plates; the height is the same.
    rng, clutter
        As in `cube`.

    Returns
    -------
    SolidObject

    """
    h, t, radius = width_m / 2, 0.17 * width_m, 0.25 * width_m
    low, under, below = _box([-h, -h, -h], [h, h, t - h], (150, 190, 110, 85, 215, 45), {}, rng,
                             clutter)
    top, over, above = _box([-h, -h, h - t], [h, h, h], (165, 200, 120, 95, 235, 35), {}, rng,
                            clutter)
    faces = under + [Polygon(tuple(i + 8 for i in face.indices)) for face in over]
    ends = np.array([[0, 0, t - h], [0, 0, h - t]])
    rings = [Conic(end, radius * np.eye(3)[0], radius * np.eye(3)[1], name)
             for end, name in zip(ends, ('foot', 'neck'))]
    post = Cylinder(ends[0], ends[1], radius, 'post')
    model = WireframeModel.build(np.concatenate([low, top]), (), faces, conics=rings,
                                 cylinders=[post], name='spool')
    return SolidObject(model, below + above + _tube(ends[0], ends[1], radius))


SHAPES = {'cube': cube, 'step_block': step_block, 'spool': spool, 'box': box, 'l_block': l_block}


def _box(low: ArrayLike, high: ArrayLike, greys: Sequence[float],
         marks: Mapping[int, Sequence[Patch | Disc]], rng: np.random.Generator | None,
         clutter: float) -> tuple[np.ndarray, list[Polygon], list[Surface]]:
    """Vertices (8, 3), faces and surfaces of a box."""
    bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
    vertices = np.where(bits, high, low).astype(float)
    surfaces = [_facet(vertices[list(corners)], grey, marks.get(k, ()), rng, clutter)
                for k, (corners, grey) in enumerate(zip(_BOX_FACES, greys))]
    return vertices, [Polygon(corners) for corners in _BOX_FACES], surfaces


def _tube(start: np.ndarray, end: np.ndarray, radius: float) -> list[Surface]:
    """Facets of an upright round post; darker on one side, without steps."""
    # half the facets' depth outside the true radius, half inside
    angles = (np.arange(FACETS + 1) - 0.5) * 2 * np.pi / FACETS
    ring = radius / np.sqrt(np.cos(np.pi / FACETS)) * np.column_stack(
        [np.cos(angles), np.sin(angles), 0 * angles])
    surfaces = []
    for k in range(FACETS):
        grey = 100 + 35 * np.cos(angles[k] - 0.6)
        corners = np.array([start + ring[k], start + ring[k + 1],
                            end + ring[k + 1], end + ring[k]])
        surfaces.append(_facet(corners, grey))
    return surfaces


def _facet(corners: np.ndarray, grey: float, marks: Sequence[Patch | Disc] = (),
           rng: np.random.Generator | None = None, clutter: float = 0.0) -> Surface:
    """Make a surface of four corners, counter-clockwise from outside."""
    origin, edge_u, edge_v = corners[0], corners[1] - corners[0], corners[3] - corners[0]
    size = float(np.linalg.norm(edge_u)), float(np.linalg.norm(edge_v))
    unit = 2 ** (PYRAMID_LEVELS - 1)
    if rng is None and not marks:
        return Surface(origin, edge_u, edge_v, np.full((2 * unit, 2 * unit), float(grey)))
    columns, rows = (max(2, int(np.ceil(side / (_TEXEL_M * unit)))) * unit for side in size)
    canvas = np.full((rows, columns), float(grey))
    if rng is not None:
        canvas += _fabric(rng, canvas.shape, size, clutter)
    for mark in marks:
        cover = _cover(mark, columns, rows, size)
        canvas += cover * (mark.grey - grey)
    return Surface(origin, edge_u, edge_v, np.clip(canvas, 0, 255))


def _fabric(rng: np.random.Generator, shape: tuple[int, ...], size: tuple[float, float],
            clutter: float) -> np.ndarray:
    """Slight unevenness of a face, and markings that the model does not know."""
    uneven = ndimage.gaussian_filter(rng.normal(size=shape), 6)
    uneven *= 2.0 / max(uneven.std(), 1e-9)
    if clutter:
        style = Style(texel_m=_TEXEL_M, smallest_m=0.03 * min(size), largest_m=0.2 * min(size),
                      cover=0.5, contrast=60.0 * clutter)
        uneven = uneven + texture(rng, *size, style, 0.0 + 128)[:shape[0], :shape[1]] - 128
    return np.asarray(uneven)


def _cover(mark: Patch | Disc, columns: int, rows: int, size: tuple[float, float]) -> np.ndarray:
    """Share of each texel that a marking covers, (rows, columns)."""
    texel_u, texel_v = size[0] / columns, size[1] / rows
    u = (np.arange(columns) + 0.5) * texel_u
    v = (np.arange(rows) + 0.5) * texel_v
    if isinstance(mark, Disc):
        distance = np.hypot(u - mark.centre[0], (v - mark.centre[1])[:, None])
        return np.asarray(np.clip(0.5 - (distance - mark.radius_m) / texel_u, 0, 1))
    (u0, v0), (u1, v1) = mark.low, mark.high
    across = np.clip(np.minimum(u + texel_u / 2, u1) - np.maximum(u - texel_u / 2, u0), 0, None)
    down = np.clip(np.minimum(v + texel_v / 2, v1) - np.maximum(v - texel_v / 2, v0), 0, None)
    return np.asarray(down[:, None] * across / (texel_u * texel_v))
