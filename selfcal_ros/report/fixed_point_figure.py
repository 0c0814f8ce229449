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
"""The fixed points of planar motion over the image plane, after the thesis's figure 5.14."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.patches import Ellipse
import numpy as np

from selfcal_ros.calibration.result import Calibration, FixedPoints
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.observations import ObservationTable
from selfcal_ros.report.pair_geometry import (EpipolesAndAxes, flat_enough, pair_geometry,
                                              single_pairs)
from selfcal_ros.report.style import (BLUE, Drawing, figure_of, GREEN, GREY, image_axes, INK,
                                      legend_below, new_panel, ORANGE, PAPER, PURPLE, RED, styled)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: The whole view reaches no farther from the image than so many of its longer sides.
FARTHEST = 3.0
#: More lines than this make a black patch.
MAX_LINES = 60
#: Radius of a two-dimensional 95 % ellipse in sigmas.
SIGMAS_95 = 2.4477


def fixed_points_figure(result: Calibration,
                        seen: ObservationTable | None = None) -> Drawing | None:
    """
    Draw horizon, epipoles, screw axes, vanishing point and principal point.

    Parameters
    ----------
    result : Calibration
    seen : ObservationTable, optional
        With it, every pair's epipoles and screw axis come from its matches alone; without, from
        the reconstruction.

    Returns
    -------
    Drawing or None
        None if the calibration has no fixed points.

    """
    fixed, size = result.fixed_points, (result.camera.width, result.camera.height)
    if fixed is None or min(size) <= 0 or not all(np.isfinite(part).all() for part in (
            fixed.horizon, fixed.vanishing_point, result.reconstructed.cam_from_world)):
        return None
    pairs = None if seen is None else single_pairs(result, seen)
    single = pairs is not None and len(pairs.pairs) > 0
    if pairs is None or not single:
        pairs = pair_geometry(result.reconstructed, result.camera.K)
    with styled():
        whole, zoom = new_panel(5.5), new_panel(5.5)
        window = _whole_window(result, fixed, pairs)
        _draw(whole, result, fixed, pairs, window, 'The whole image plane')
        _draw(zoom, result, fixed, pairs, _zoom_window(result.camera), 'The image')
        note = _principal_point(zoom, result)
        _vanishing_point(whole, result, fixed)
        circular = _circular_points(whole, fixed)
        for axes in (whole, zoom):
            legend_below(axes, 3, columnspacing=1.4, handlelength=1.6, frameon=False)
    caption = ('In undistorted pixels. Under planar motion all epipoles lie on the horizon and '
               'all screw axes pass through the vanishing point of the rotation axis')
    caption += _distances(result, fixed, pairs) if single else '.'
    if circular:
        caption += (' The bar on the horizon is the pair of circular points, i and j = Re ± i Im, '
                    'from Re − Im to Re + Im: its ends are directions of the plane at right '
                    'angles, which is how the focal length shows.')
    return Drawing('fixed-points', 'Fixed points of the motion',
                   caption + (f' {note}.' if note else ''), (figure_of(whole), figure_of(zoom)),
                   'geometry')


def _distances(result: Calibration, fixed: FixedPoints, pairs: EpipolesAndAxes) -> str:
    """Say how far the epipoles of single pairs are from the horizon."""
    line = fixed.horizon
    slope = float(np.linalg.norm(line[:2]))
    longer = max(result.camera.width, result.camera.height)
    epipoles = _finite(pairs.epipoles)
    near = epipoles[np.abs(epipoles - _centre(result.camera)).max(axis=1) < longer]
    start = f'; here each of {len(pairs.pairs)} pairs of views was taken for itself'
    if len(near) < 5 or slope == 0:
        return start + '.'
    distance = np.median(np.abs(near @ line[:2] + line[2])) / slope
    return start + (f', and the median epipole near the image is {distance:.2g} px from the '
                    'horizon.')


def outline(camera: Camera, steps: int = 40) -> np.ndarray:
    """Return the border of the image in undistorted pixels, closed, (n, 2); NaN far out."""
    s = np.linspace(0, 1, steps, endpoint=False)
    zero, one = np.zeros(steps), np.ones(steps)
    border = np.concatenate([np.stack(side, axis=1) for side in
                             ((s, zero), (one, s), (1 - s, one), (zero, 1 - s))])
    border = border * [camera.width, camera.height] - 0.5
    xy = flat_enough(camera.normalised(np.concatenate([border, border[:1]])))
    return np.asarray(xy @ camera.K[:2, :2].T + camera.K[:2, 2])


def _finite(points: np.ndarray) -> np.ndarray:
    """Return the homogeneous points that are not at infinity as pixels, shape (n, 2)."""
    points = points.reshape(-1, 3)
    points = points[np.abs(points[:, 2]) > 1e-9 * np.linalg.norm(points, axis=1)]
    return np.asarray(points[:, :2] / points[:, 2:])


def _centre(camera: Camera) -> np.ndarray:
    return np.array([camera.width - 1, camera.height - 1]) / 2


def _zoom_window(camera: Camera) -> tuple[np.ndarray, float]:
    border = outline(camera)
    half = 0.56 * max(camera.width, camera.height)
    border = border[np.isfinite(border).all(axis=1)]
    if len(border):
        half = min(max(half, 1.04 * np.abs(border - _centre(camera)).max()), 2 * half)
    return _centre(camera), half


def _whole_window(result: Calibration, fixed: FixedPoints,
                  pairs: EpipolesAndAxes) -> tuple[np.ndarray, float]:
    """Choose a square that shows the image, the vanishing point and most epipoles."""
    camera = result.camera
    longer = max(camera.width, camera.height)
    centre = _centre(camera)
    low, high = centre - 0.7 * longer, centre + 0.7 * longer
    lines = pairs.screw_axes[np.isfinite(pairs.screw_axes).all(axis=1)]
    feet = np.cross(lines, fixed.horizon)
    epipoles = np.concatenate([_finite(pairs.epipoles), _finite(feet)])
    near = epipoles[np.abs(epipoles - centre).max(axis=1) < FARTHEST * longer]
    if len(near) > 4:
        low = np.minimum(low, np.percentile(near, 10, axis=0))
        high = np.maximum(high, np.percentile(near, 90, axis=0))
    v = _finite(fixed.vanishing_point)
    if len(v) and np.abs(v[0] - centre).max() < FARTHEST * longer:
        low, high = np.minimum(low, v[0]), np.maximum(high, v[0])
    bar = _circular_bar(fixed)
    if len(bar) and np.abs(bar - centre).max() < FARTHEST * longer:
        low, high = np.minimum(low, bar.min(axis=0)), np.maximum(high, bar.max(axis=0))
    half = 0.5 * float((high - low).max()) + 0.15 * longer
    return (low + high) / 2, half


def _segment(line: np.ndarray, centre: np.ndarray, half: float) -> np.ndarray | None:
    """Clip a line to a square; returns two points (2, 2) or None."""
    slope = float(np.linalg.norm(line[:2]))
    # a camera that looks along the axis has its horizon at infinity
    if slope * 1.5 * half <= abs(line[:2] @ centre + line[2]):
        return None
    foot = centre - line[:2] * (line[:2] @ centre + line[2]) / slope**2
    along = np.array([-line[1], line[0]]) / slope
    return np.stack([foot - 3 * half * along, foot + 3 * half * along])


def _draw(axes: Axes, result: Calibration, fixed: FixedPoints, pairs: EpipolesAndAxes,
          window: tuple[np.ndarray, float], title: str) -> None:
    """Draw what both panels share."""
    camera = result.camera
    centre, half = window
    lines = pairs.screw_axes[np.isfinite(pairs.screw_axes).all(axis=1)]
    shown = lines[np.unique(np.linspace(0, len(lines) - 1, MAX_LINES).astype(int))] \
        if len(lines) else lines
    label: str | None = 'screw axes m'
    for line in shown:
        segment = _segment(line, centre, half)
        if segment is not None:
            axes.plot(*segment.T, color=PURPLE, linewidth=0.5, alpha=0.45, label=label)
            label = None
    horizon = _segment(fixed.horizon, centre, half)
    if horizon is not None:
        axes.plot(*horizon.T, color=BLUE, linewidth=1.4, label='horizon l')
    epipoles = _finite(pairs.epipoles)
    axes.plot(*epipoles.T, '.', color=ORANGE, markersize=4.5, markeredgewidth=0, alpha=0.8,
              label='epipoles e')
    axes.plot(*outline(camera).T, color=INK, linewidth=1.2, label='image border')
    image_axes(axes, camera.width, camera.height)
    axes.set_xlim(centre[0] - half, centre[0] + half)
    axes.set_ylim(centre[1] + half, centre[1] - half)
    axes.set_title(title)


def _vanishing_point(axes: Axes, result: Calibration, fixed: FixedPoints) -> None:
    """Mark v, or point to it where it lies outside the panel."""
    v = fixed.vanishing_point
    left, right = axes.get_xlim()
    low, high = axes.get_ylim()[::-1]
    K = result.camera.K
    axes.plot(K[0, 2], K[1, 2], '+', color=RED, markersize=6, label='principal point')
    points = _finite(v)
    if len(points) and left < points[0, 0] < right and low < points[0, 1] < high:
        axes.plot(*points[0], 'D', color=GREEN, markersize=5, label='vanishing point v')
        _label(axes, 'v ({:.0f}, {:.0f})'.format(*points[0]), points[0])
        return
    start = _centre(result.camera)
    direction = v[:2] - v[2] * start
    direction = direction * (1 if v[2] >= 0 else -1)
    direction = direction / max(np.linalg.norm(direction), 1e-300)
    # as far as the border of the panel
    with np.errstate(divide='ignore'):
        room = np.where(direction > 0, [right, high] - start, start - [left, low])
        reach = np.min(room / np.maximum(np.abs(direction), 1e-12))
    tip = start + 0.97 * reach * direction
    tail = start + 0.80 * reach * direction
    axes.annotate('', tip, tail, arrowprops={'arrowstyle': '-|>', 'color': GREEN,
                                             'linewidth': 1.6})
    where = 'at infinity'
    if len(points):
        where = 'at ({:.0f}, {:.0f})'.format(*points[0])
    _label(axes, f'v {where}', (tip + tail) / 2)
    axes.plot([], [], marker='>', linestyle='none', color=GREEN, label='towards v')


def _circular_bar(fixed: FixedPoints) -> np.ndarray:
    """Return real part less and plus imaginary part of i, shape (2, 2); empty if infinite."""
    i = np.asarray(fixed.circular_point, complex)
    if not np.isfinite(i).all() or abs(i[2]) <= 1e-9 * np.linalg.norm(i):
        return np.empty((0, 2))
    i = i[:2] / i[2]
    return np.stack([i.real - i.imag, i.real + i.imag])


def _circular_points(axes: Axes, fixed: FixedPoints) -> bool:
    """Mark the circular points on the horizon; tells whether they are in the panel."""
    bar = _circular_bar(fixed)
    window = np.array([axes.get_xlim(), sorted(axes.get_ylim())])
    if not len(bar) or (bar < window[:, 0]).any() or (bar > window[:, 1]).any():
        return False
    axes.plot(*bar.T, color=RED, linewidth=3.2, alpha=0.35, solid_capstyle='butt',
              label='circular points i, j')
    axes.plot(*bar.T, 'o', color=RED, markersize=3.2)
    axes.plot(*bar.mean(axis=0), '|', color=RED, markersize=9, markeredgewidth=1.4)
    return True


def _label(axes: Axes, text: str, point: np.ndarray) -> None:
    """Write beside a point, on the side that has room."""
    side = 1 if point[0] < np.mean(axes.get_xlim()) else -1
    axes.annotate(text, (point[0], point[1]), (9 * side, 6), textcoords='offset points',
                  color=GREEN, ha='left' if side > 0 else 'right', va='center', zorder=9,
                  bbox={'facecolor': PAPER, 'edgecolor': 'none', 'alpha': 0.85, 'pad': 1})


def _principal_point(axes: Axes, result: Calibration) -> str:
    """Mark the principal point with its ellipse; returns what the caption must say of it."""
    K = result.camera.K
    point = K[:2, 2]
    axes.plot(*point, '+', color=RED, markersize=8, label='principal point')
    covariance = np.asarray(result.covariance, float)[2:4, 2:4]
    if not np.isfinite(covariance).all() or covariance.trace() <= 0:
        return ''
    values, vectors = np.linalg.eigh(covariance)
    half = SIGMAS_95 * np.sqrt(np.maximum(values, 0))
    longer = max(result.camera.width, result.camera.height)
    scale = 1.0
    while scale * half[1] < 0.015 * longer and scale < 1e6:
        scale *= 10
    axes.add_patch(Ellipse((point[0], point[1]), 2 * scale * half[1], 2 * scale * half[0],
                           angle=np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])),
                           fill=False, edgecolor=RED, linewidth=1.2, label='its 95 % ellipse'
                           + (f', ×{scale:.0f}' if scale > 1 else '')))
    axes.axhline(point[1], color=GREY, linewidth=0.4, linestyle=':')
    axes.axvline(point[0], color=GREY, linewidth=0.4, linestyle=':')
    return ('The ellipse of the principal point is drawn '
            + (f'{scale:.0f} times its size' if scale > 1 else 'to scale'))
