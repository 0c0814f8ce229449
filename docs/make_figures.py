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
Draw the figures of the documents: `PYTHONPATH=. python docs/make_figures.py [NAME ...]`.

Diagrams are in `diagrams.py`; the others are computed by the package itself, with fixed seeds, so
that the same versions of the libraries give the same files.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path
import re
import sys

import diagrams
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
from scipy.optimize import least_squares

from selfcal_ros import calibrate, Camera, CameraFacts
from selfcal_ros.report.pair_geometry import pair_geometry
from selfcal_ros.report.projection_uncertainty import projection_uncertainty
from selfcal_ros.report.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, styled
from selfcal_ros.synthetic.paths import drive_path, look_at, planar_poses
from selfcal_ros.synthetic.special_scenes import drive
from selfcal_ros.values.output_files import atomic_write

HERE = Path(__file__).resolve().parent
FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0)
#: The drive of the figures: a camera that looks down by 35 degrees and leans by 4.
PITCH_DEG, ROLL_DEG = 35.0, 4.0


def _drive():
    """Calibrate a simulated drive; returns it and the result."""
    scene = drive(np.random.default_rng(1), 0.1, views=12, tracks=500, pitch_deg=PITCH_DEG,
                  roll_deg=ROLL_DEG)
    return scene, calibrate(scene.tracks, facts=FACTS)


def planar_geometry(figure) -> None:
    """Draw what planar motion leaves in its place, from a calibrated drive."""
    figure.set_size_inches(9.2, 6.4)
    _, result = _drive()
    fixed, K = result.fixed_points, result.camera.K
    width, height = result.camera.width, result.camera.height
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.98))
    axes.set(xlim=(-620, 1420), ylim=(1190, -230), aspect='equal')
    axes.axis('off')
    plain = {'facecolor': 'white', 'edgecolor': 'none', 'pad': 1.5}
    axes.fill([0, width, width, 0], [0, 0, height, height], facecolor='#f4f5f6', edgecolor=GREY)
    axes.text(8, height - 26, 'image', fontsize=10, color=GREY)
    v = fixed.vanishing_point[:2] / fixed.vanishing_point[2]
    a, b, c = fixed.horizon
    x = np.array([-600, 1400])
    axes.plot(x, -(a * x + c) / b, color=BLUE, linewidth=1.8)
    axes.text(-600, -(a * -600 + c) / b - 22, 'horizon l: where all planes of motion meet',
              color=BLUE, fontsize=10.5)
    # screw axes of single pairs: lines through v; of all directions that there are
    pairs = pair_geometry(result.reconstruction, K)
    turn = np.arctan2(-pairs.screw_axes[:, 0], pairs.screw_axes[:, 1]) % np.pi
    order = np.argsort(np.where(np.isfinite(turn), turn, np.inf))[:np.isfinite(turn).sum()]
    for k in order[np.linspace(0, len(order) - 1, 6).astype(int)]:
        along = np.array([np.cos(turn[k]), np.sin(turn[k])])
        axes.plot(*(v + np.array([[-3000.0], [3000.0]]) * along).T, color=PURPLE, linewidth=0.9,
                  linestyle=(0, (6, 3)))
    spots = pairs.epipoles[order, 0]
    spots = spots[:, :2] / spots[:, 2:]
    spots = spots[np.abs(spots[:, 0] - 320) < 900][::4]
    axes.plot(*spots.T, 'o', color=BLUE, markersize=4, alpha=0.7)
    axes.text(spots[:, 0].min() - 30, spots[:, 1].min() + 75, 'epipoles (dots)', color=BLUE,
              fontsize=10)
    axes.plot(*v, 'o', color=ORANGE, markersize=8, zorder=3)
    axes.text(v[0], v[1] + 85, 'v: vanishing point of the axis of rotation', color=ORANGE,
              fontsize=10.5, va='center', ha='center', bbox=plain)
    axes.text(-600, v[1] - 420, 'm (dashed): images of\nthe screw axes of pairs,\nall through v',
              color=PURPLE, fontsize=10)
    i = fixed.circular_point / fixed.circular_point[2]
    middle, apart = i.real[:2], i.imag[:2]
    ends = np.stack([middle - apart, middle + apart])
    axes.plot(*ends.T, color=RED, linewidth=5, alpha=0.55, solid_capstyle='butt')
    axes.text(690, -30, 'circular points i, j = Re ± i Im:\nthe bar goes from Re - Im to Re + Im',
              color=RED, fontsize=10, va='top', bbox=plain)
    centre = K[:2, 2]
    axes.plot(*np.stack([middle, centre]).T, color=GREY, linewidth=1, linestyle=':')
    axes.plot(*centre, '+', color=INK, markersize=11)
    axes.plot(*middle, 'o', color=RED, markersize=5)
    axes.text(centre[0] + 16, centre[1] + 4, 'principal point', fontsize=10, va='center')
    d, f = np.linalg.norm(middle - centre), K[0, 0]
    axes.text(690, 130, f'd = {d:.0f} px from the principal point to l\n'
              f'|Im| = {np.linalg.norm(apart):.0f} px = √(f² + d²), half of the bar\n'
              f'so f = {np.sqrt(apart @ apart - d * d):.1f} px '
              f'(adjusted {f:.1f} px, true 520)', fontsize=10, va='top', bbox=plain)


def frames(figure) -> None:
    """Draw the frames on a drive, seen by a camera of our own."""
    figure.set_size_inches(9.2, 5.3)
    xy, heading = drive_path(40)
    poses = planar_poses(xy, heading, 1.1, 0.0, 20.0)
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.98))
    onlooker = _onlooker()
    ground = np.column_stack([xy, np.zeros(len(xy))])
    axes.plot(*onlooker(ground).T, color=GREY, linewidth=1.2, linestyle='--')
    axes.plot(*onlooker(ground + [0, 0, 1.1]).T, color=GREY, linewidth=1.2)
    c, s = np.cos(heading[0]), np.sin(heading[0])
    world = 0.55 * np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    _triad(axes, onlooker, np.array([*xy[0], 1.1]), world, ('x forward', 'y left', 'z up'), 10)
    for k in (len(xy) // 2, len(xy) - 1):
        R, t = poses[k, :, :3], poses[k, :, 3]
        centre = -R.T @ t
        names = ('x right', 'y down', 'z forward') if k == len(xy) - 1 else ('', '', '')
        _triad(axes, onlooker, centre, 0.5 * R, names, 10)
        corners = np.array([[-0.62, -0.46, 1], [0.62, -0.46, 1], [0.62, 0.46, 1],
                            [-0.62, 0.46, 1]]) * 0.3
        seen = onlooker(corners @ R + centre)
        apex = onlooker(centre[None])[0]
        for corner in seen:
            axes.plot(*np.stack([apex, corner]).T, color=GREY, linewidth=0.8)
        axes.plot(*np.vstack([seen, seen[:1]]).T, color=GREY, linewidth=0.8)
    start, last = onlooker(np.array([[*xy[0], 1.1], [*xy[-1], 1.1]]))
    axes.text(start[0] - 10, start[1] + 62, 'calibration_world_unscaled:\nbody frame of the first '
              'view,\nmedian step between views = 1', fontsize=10, ha='center', va='top')
    axes.text(last[0] + 5, last[1] - 118, 'camera: optical frame', fontsize=10, ha='center')
    middle = onlooker(np.array([[*xy[len(xy) // 3], 0.0]]))[0]
    axes.text(middle[0], middle[1] + 34, 'path on the floor (dashed) and of the camera',
              fontsize=10, color=GREY, ha='center', va='top')
    axes.set(aspect='equal', xlim=(-60, 980), ylim=(560, -40))
    axes.axis('off')


def _onlooker():
    """Return what projects world points (N, 3) into the picture."""
    camera = Camera([[1450, 0, 450], [0, 1450, 250], [0, 0, 1]])
    pose = look_at((1.6, -6.2, 3.4), (1.5, 0.3, 0.75))
    return lambda points: camera.project(points @ pose[:, :3].T + pose[:, 3])


def _triad(axes, onlooker, origin, directions, names, size):
    """Draw three arrows from a point: x, y, z in red, green, blue."""
    for direction, name, colour in zip(directions, names, (RED, GREEN, BLUE)):
        tail, head = onlooker(np.stack([origin, origin + direction]))
        axes.annotate('', head, tail, arrowprops={'arrowstyle': '-|>', 'color': colour,
                                                  'linewidth': 1.8, 'shrinkA': 0, 'shrinkB': 0})
        if not name:
            continue
        length = np.linalg.norm(head - tail)
        way = (head - tail) / max(length, 1.0)
        # beside an arrow that comes at the reader, ahead of the others
        place = head + (16 * way if length > 60 else [12, 8])
        axes.text(*place, name, color=colour, fontsize=size, va='center', zorder=3,
                  bbox={'facecolor': 'white', 'edgecolor': 'none', 'pad': 0.6},
                  ha='left' if way[0] > 0.3 or length <= 60 else 'right' if way[0] < -0.3
                  else 'center')


class _Flatland:
    """
    Self-calibration in the plane: a camera with a line for an image turns about a point.

    Unknown are the focal length (pixels), the angle of each view but the first, and the points;
    the radius of the circle is the unit. The middle of the image is known.
    """

    def __init__(self, rng, views=7, points=25, focal_px=520.0, turn_deg=50.0, noise_px=0.3):
        """Simulate a sequence."""
        self.views = views
        angles = np.radians(np.linspace(0, turn_deg, views))
        bearing = rng.uniform(angles[1] - 0.45, angles[-2] + 0.45, points)
        inverse = 1 / rng.uniform(4.0, 15.0, points)
        self.truth = np.concatenate([[focal_px / 500], angles[1:], bearing, inverse])
        exact = self.image(self.truth)
        self.seen = np.abs(exact) < 360
        self.noise_px = noise_px
        self.pixels = exact + rng.normal(0, noise_px, exact.shape)

    def image(self, unknowns):
        """Project, shape (views, points)."""
        n = self.views
        focal, angles = 500 * unknowns[0], np.concatenate([[0.0], unknowns[1:n]])
        bearing, inverse = np.split(unknowns[n:], 2)
        turned = bearing - angles[:, None]
        # the camera is at distance 1 from the axis and looks outwards
        return focal * np.sin(turned) / (np.cos(turned) - inverse)

    def residuals(self, unknowns):
        """Differences over the noise."""
        return ((self.image(unknowns) - self.pixels)[self.seen]) / self.noise_px

    def cost_at(self, focal, start):
        """Hold the focal length, adjust the rest; returns the cost and where it is."""
        found = least_squares(lambda rest: self.residuals(np.concatenate([[focal], rest])),
                              start[1:], method='lm', xtol=1e-10)
        return found.cost, np.concatenate([[focal], found.x])


def profile_likelihood(figure) -> None:
    """Compare the profile of the cost with the parabola at the optimum."""
    figure.set_size_inches(8.4, 5.0)
    world = _Flatland(np.random.default_rng(3))
    best = least_squares(world.residuals, world.truth, method='lm', xtol=1e-12)
    sigma = np.sqrt(np.linalg.inv(best.jac.T @ best.jac)[0, 0])
    sides = []
    for side in (-1, 1):
        start, side_costs = best.x, []
        for step in np.arange(0.25, 3.51, 0.25):
            focal = best.x[0] + side * step * sigma
            cost, start = world.cost_at(focal, start)
            side_costs.append((500 * focal, cost - best.cost))
        sides.append(side_costs)
    profile = np.array(sides[0][::-1] + [(500 * best.x[0], 0.0)] + sides[1])
    focal = np.linspace(profile[0, 0], profile[-1, 0], 200)
    axes = figure.add_axes((0.09, 0.12, 0.88, 0.68))
    axes.plot(focal, 0.5 * ((focal / 500 - best.x[0]) / sigma)**2, '--', color=GREY,
              label=f'parabola at the optimum: σ = {500 * sigma:.0f} px')
    axes.plot(*profile.T, color=BLUE, linewidth=2, label='profile: all other unknowns adjusted '
              'again')
    axes.axhline(0.5, color=ORANGE, linewidth=0.9)
    ends = [np.interp(0.5, *(np.array(side)[:, ::-1]).T) for side in (
        [(500 * best.x[0], 0.0)] + sides[0], [(500 * best.x[0], 0.0)] + sides[1])]
    axes.plot(ends, [0.5, 0.5], 'o-', color=ORANGE, linewidth=2.5, label='rise of ½: '
              f'from {ends[0] - 500 * best.x[0]:+.0f} to {ends[1] - 500 * best.x[0]:+.0f} px')
    axes.axvline(520, color=GREEN, linewidth=1, linestyle=':')
    axes.text(520, 5.6, ' truth', color=GREEN, fontsize=10)
    axes.set(ylim=(0, 6), xlabel='focal length, held, in pixels',
             ylabel='cost above that of the optimum')
    axes.legend(loc='lower center', bbox_to_anchor=(0.5, 1.02), fontsize=10)


def projection_sigma(figure) -> None:
    """Draw how far a point of the scene may be from where the camera puts it."""
    figure.set_size_inches(9.2, 4.0)
    scene, result = _drive()
    shown = projection_uncertainty(result.camera, result.covariance, 48)
    left = figure.add_axes((0.05, 0.11, 0.40, 0.80))
    right = figure.add_axes((0.51, 0.11, 0.40, 0.80))
    xy = scene.tracks.xy
    left.plot(*xy[::6].T, '.', color=GREEN, markersize=2)
    left.set_title('where points were seen')
    mesh = right.contourf(shown.u, shown.v, shown.sigma_px, 12, cmap='viridis')
    lines = right.contour(shown.u, shown.v, shown.sigma_px, mesh.levels[1::2], colors='white',
                          linewidths=0.7)
    right.clabel(lines, fontsize=8.5, fmt='%.2f')
    right.set_title('σ of projection, pixels, worst direction')
    for axes in (left, right):
        axes.set(xlim=(0, 639), ylim=(479, 0), aspect='equal')
    figure.colorbar(mesh, cax=figure.add_axes((0.925, 0.145, 0.015, 0.73)))


#: What draws each figure, and what it shows.
FIGURES = {
    'house': (diagrams.house, 'the storeys of the package, and which may import which'),
    'calibrate': (diagrams.calibrate, 'the way of data through a calibration'),
    'tracker_frame': (diagrams.tracker_frame, 'what the object tracker does with an image'),
    'nodes': (diagrams.nodes, 'the nodes and the topics between them'),
    'planar_geometry': (planar_geometry, 'horizon, vanishing point and circular points'),
    'frames': (frames, 'world frame and optical frame on a drive'),
    'profile_likelihood': (profile_likelihood, 'profile and parabola of a weak focal length'),
    'projection_uncertainty': (projection_sigma, 'uncertainty of projection over the image'),
}


def main(argv: list[str] | None = None) -> int:
    """Run from the command line; returns the exit status."""
    parser = argparse.ArgumentParser(description='Draw the figures of the documents.')
    parser.add_argument('names', nargs='*', metavar='NAME', help=', '.join(FIGURES))
    parser.add_argument('--output-dir', type=Path, default=HERE / 'images')
    parser.add_argument('--format', choices=('svg', 'png'), default='svg')
    args = parser.parse_args(argv)
    unknown = set(args.names) - set(FIGURES)
    if unknown:
        parser.error(f'unknown: {", ".join(sorted(unknown))}')
    args.output_dir.mkdir(parents=True, exist_ok=True)
    for name in args.names or FIGURES:
        draw, _ = FIGURES[name]
        with styled():
            figure = Figure(facecolor='white')
            FigureCanvasAgg(figure)
            draw(figure)
            metadata = {'Date': None, 'Creator': None} if args.format == 'svg' else {}
            drawn = io.BytesIO()
            figure.savefig(drawn, format=args.format, dpi=100, metadata=metadata)
        content = drawn.getvalue()
        if args.format == 'svg':
            content = re.sub(rb'[ \t]+$', b'', content, flags=re.M)
        atomic_write(args.output_dir / f'{name}.{args.format}', content)
    return 0


if __name__ == '__main__':
    sys.exit(main())
