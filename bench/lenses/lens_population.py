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
The prior over real lenses: made from measured ones, and held against lenses it has not seen.

`python -m bench lens_population` prints the shares of held-out lenses inside the ellipsoids;
`python -m bench.lenses.lens_population --write` makes the table anew,
`selfcal_ros/geometry/lenses/population_table.py`. Both need the measured lenses,
lens_profiles.csv of the gyroflow project (CC0).
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path

from bench.inputs import data_folder, ROOT
from bench.tables import Report
import numpy as np
from scipy.stats import chi2

TABLE = ROOT / 'selfcal_ros' / 'geometry' / 'lenses' / 'population_table.py'
SHARES = np.array([0.60, 0.80, 0.90, 0.95, 0.99])
#: Corners at which the population is tabulated: distance from the middle over focal length.
KNOTS = np.array([0.15, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0, 1.2, 1.4, 1.7, 2.1])
#: Members of both families and how many radial coefficients each has.
MEMBERS = {'radial1': 1, 'radial2': 2, 'radial3': 3, 'equidistant': 4}
#: Widest angle from the axis at which a perspective member is fitted, and how well it must fit
#: to count as a lens of that kind: rms over the image, of the corner's distance.
_WIDEST, _MISFIT = np.radians(70.0), {1: 0.024, 2: 0.006, 3: 0.0015}
#: No lens stretches its corner by more than this; a polynomial beyond its measurements does.
_PINCUSHION = 0.12
_BANDWIDTH, _FREEDOM, _FOLDS = 0.2, 30.0, 5
#: The spread is broadened in a window this much wider, where the rare lenses are counted.
_WIDE_WINDOW = 0.35
_ANGLE_END = 1.15 * np.pi / 2


@dataclass(frozen=True)
class Lenses:
    """
    Measured lenses as coefficients of one member.

    Attributes
    ----------
    scaled : ndarray, shape (N, k)
        ki · corner^(2i).
    corner : ndarray, shape (N,)
    brand : ndarray of str, shape (N,)

    """

    scaled: np.ndarray
    corner: np.ndarray
    brand: np.ndarray

    def __getitem__(self, rows) -> Lenses:
        """Take some of them."""
        return Lenses(self.scaled[rows], self.corner[rows], self.brand[rows])

    def weights(self) -> np.ndarray:
        """Return the weights of `brand_weights`."""
        return brand_weights(self.brand)


@dataclass(frozen=True)
class Profiles:
    """Whole rows of the table that make sense, with f as unit; `size` is half the image."""

    size: np.ndarray
    k: np.ndarray
    corner: np.ndarray
    brand: np.ndarray
    read: int

    def __getitem__(self, rows) -> Profiles:
        """Take some of them."""
        return Profiles(self.size[rows], self.k[rows], self.corner[rows], self.brand[rows],
                        self.read)


def brand_weights(brand: np.ndarray) -> np.ndarray:
    """Weigh a brand by the root of its number, lest the largest be the population."""
    _, which, count = np.unique(brand, return_inverse=True, return_counts=True)
    return (count**-0.5)[which]


def read_profiles(path: Path) -> Profiles:
    """Read rows below a pixel of rms with square pixels whose polynomial reaches the corner."""
    with path.open(encoding='utf-8', newline='') as file:
        table = list(csv.DictReader(file))
    names = ('width', 'height', 'fx', 'fy', 'cx', 'cy', 'k1', 'k2', 'k3', 'k4', 'rms_px')
    values = np.array([[float(row[name] or 'nan') for name in names] for row in table])
    width, height, fx, fy, cx, cy = values[:, :6].T
    k, rms = values[:, 6:10], values[:, 10]
    corner = np.hypot(width / fx, height / fy) / 2
    reach = _radius(k, _fold(k)[:, None])[:, 0]
    plain = np.array([not row['horizontal_stretch'] for row in table])
    kept = (plain & (rms > 0) & (rms < 1) & (np.abs(fx / fy - 1) < 0.05)
            & (np.abs(cx - (width - 1) / 2) < 0.06 * width)
            & (np.abs(cy - (height - 1) / 2) < 0.08 * height) & (reach > corner))
    brand = np.array([row['brand'].lower() for row in table])
    size = np.column_stack([width / fx, height / fy]) / 2
    return Profiles(size[kept], k[kept], corner[kept], brand[kept], len(table))


def _radius(k: np.ndarray, angle: np.ndarray) -> np.ndarray:
    k1, k2, k3, k4 = np.moveaxis(k, -1, 0)[..., None]
    s = angle * angle
    return angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))


def _slope(k: np.ndarray, angle: np.ndarray) -> np.ndarray:
    k1, k2, k3, k4 = np.moveaxis(k, -1, 0)[..., None]
    s = angle * angle
    return 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))


def _fold(k: np.ndarray) -> np.ndarray:
    """Return the angle up to which the polynomial of each row, (N, 4), grows."""
    angle = np.linspace(0, _ANGLE_END, 1500)
    growing = np.logical_and.accumulate(_slope(k, angle[None]) > 0, axis=1)
    return angle[growing.sum(axis=1) - 1]


def _angle(k: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Invert the polynomial of each row, (N, 4), for its radii (N, M)."""
    low, high = np.zeros_like(radius), np.broadcast_to(_fold(k)[:, None], radius.shape)
    for _ in range(45):
        middle = (low + high) / 2
        far = _radius(k, middle) > radius
        low, high = np.where(far, low, middle), np.where(far, middle, high)
    return (low + high) / 2


def equidistant_lenses(profiles: Profiles) -> Lenses:
    """Take the rows as they are; they were measured with this member."""
    end = _angle(profiles.k, profiles.corner[:, None])[:, 0]
    stretch = profiles.corner / np.where(end < _WIDEST, np.tan(end), np.inf) - 1
    scaled = profiles.k * profiles.corner[:, None]**[2, 4, 6, 8]
    return Lenses(scaled, profiles.corner, profiles.brand)[stretch < _PINCUSHION]


def perspective_lenses(profiles: Profiles, count: int) -> Lenses:
    """Fit r = f (u + k1 u³ + ...) of u = tan θ to each row, evenly over its image, f free."""
    half = (np.arange(20) + 0.5) / 20
    radius = np.hypot(profiles.size[:, :1, None] * half[:, None],
                      profiles.size[:, 1:, None] * half).reshape(len(profiles.k), -1)
    end = _angle(profiles.k, profiles.corner[:, None])[:, 0]
    scaled, corners = np.full((len(end), count), np.nan), np.full(len(end), np.nan)
    odd = 2 * np.arange(count + 1) + 1
    for row in np.flatnonzero(end < _WIDEST):
        u = np.tan(_angle(profiles.k[row:row + 1], radius[row:row + 1])[0])
        edge = np.tan(end[row])
        design = (u / edge)[:, None]**odd
        fitted = np.linalg.lstsq(design, radius[row], rcond=None)[0]
        misfit = np.sqrt(np.mean((design @ fitted - radius[row])**2)) / profiles.corner[row]
        slope = (odd * fitted) @ np.linspace(0, 1, 100)**(odd[:, None] - 1)
        if (misfit < _MISFIT[count] and fitted[0] > 0 and slope.min() > 0
                and fitted[1:].sum() < _PINCUSHION * fitted[0]):
            corners[row] = profiles.corner[row] * edge / fitted[0]
            scaled[row] = fitted[1:] / fitted[0] * (corners[row] / edge)**(odd[1:] - 1)
    found = np.isfinite(corners)
    return Lenses(scaled[found], corners[found], profiles.brand[found])


def lenses_of(profiles: Profiles, member: str) -> Lenses:
    """Return the measured lenses in the coefficients of one member."""
    if member == 'equidistant':
        return equidistant_lenses(profiles)
    return perspective_lenses(profiles, MEMBERS[member])


def location_and_scatter(values: np.ndarray, weight: np.ndarray) -> tuple:
    """Fit a multivariate t, so that single nonsense rows count little."""
    mean, k = np.average(values, axis=0, weights=weight), values.shape[1]
    scatter = np.cov(values.T, aweights=weight).reshape(k, k)
    for _ in range(100):
        away = values - mean
        square = np.einsum('ni,ij,nj->n', away, np.linalg.inv(scatter), away)
        w = weight * (_FREEDOM + k) / (_FREEDOM + square)
        mean = w @ values / w.sum()
        scatter = np.einsum('n,ni,nj->ij', w, values - mean, values - mean) / weight.sum()
    return mean, scatter


def population(lenses: Lenses) -> tuple[np.ndarray, np.ndarray]:
    """
    Fit mean and covariance of the scaled coefficients at each of `KNOTS`.

    The covariance is broadened until 99 % of the lenses lie in its 99 % ellipsoid, and 95 % in
    that of 95 %.

    Returns
    -------
    mean : ndarray, shape (len(KNOTS), k)
    covariance : ndarray, shape (len(KNOTS), k, k)

    """
    weight, fits = lenses.weights(), []
    for knot in KNOTS:
        near = weight * _window(lenses.corner, knot, _BANDWIDTH)
        rows = near > 1e-3 * near.max()
        fits.append(location_and_scatter(lenses.scaled[rows], near[rows]))
    mean, covariance = (np.array(part) for part in zip(*fits))
    square = squared_distance((mean, covariance), lenses)
    broader = []
    for knot in KNOTS:
        near = weight * _window(lenses.corner, knot, _WIDE_WINDOW)
        order = np.argsort(square)
        below = np.cumsum(near[order]) / near.sum()
        broader.append(max(square[order][np.searchsorted(below, share)]
                           / chi2.ppf(share, mean.shape[1]) for share in (0.95, 0.99)))
    return mean, covariance * np.maximum(1.0, broader)[:, None, None]


def _window(corner: np.ndarray, knot: float, width: float) -> np.ndarray:
    return np.exp(-0.5 * (np.log(corner / knot) / width)**2)


def squared_distance(table: tuple[np.ndarray, np.ndarray], lenses: Lenses) -> np.ndarray:
    """Return the squared Mahalanobis distances of lenses, shape (N,)."""
    at = np.interp(np.log(lenses.corner), np.log(KNOTS), np.arange(len(KNOTS)))
    low = np.minimum(at.astype(int), len(KNOTS) - 2)
    high = (at - low)[:, None]
    mean = (1 - high) * table[0][low] + high * table[0][low + 1]
    high = high[..., None]
    covariance = (1 - high) * table[1][low] + high * table[1][low + 1]
    # beyond the last knot the coefficients themselves keep their spread
    powers = np.minimum(1.0, KNOTS[-1] / lenses.corner)[:, None]**(
        2 * np.arange(1, mean.shape[1] + 1))
    away = lenses.scaled * powers - mean
    return np.einsum('ni,nij,nj->n', away, np.linalg.inv(covariance), away)


def held_out_distances(lenses: Lenses) -> np.ndarray:
    """Return the squared distance of each lens from the population of the other brands."""
    brands = np.random.default_rng(13).permutation(np.unique(lenses.brand))
    square = np.empty(len(lenses.corner))
    for fold in range(_FOLDS):
        out = np.isin(lenses.brand, brands[fold::_FOLDS])
        square[out] = squared_distance(population(lenses[~out]), lenses[out])
    return square


def run(report: Report, options) -> None:
    """Print the shares of held-out lenses, a fifth of the brands at a time."""
    report.section('Prior over real lenses, held against brands it has not seen',
                   'Share of lenses inside the ellipsoids; a brand counts by the root of its '
                   'number.', 'The population has long tails, and the Gaussian is made to hold '
                   'them: its middle is too wide.')
    path = profile_path()
    if path is None:
        report.say('left out: there is no lens_profiles.csv')
        return
    profiles, rows = read_profiles(path), []
    report.say(f'{len(profiles.k)} of {profiles.read} rows kept\n')
    for member, count in MEMBERS.items():
        lenses = lenses_of(profiles, member)
        square, weight = held_out_distances(lenses), lenses.weights()
        bands = np.digitize(lenses.corner, [0.3, 0.6, 0.9, 1.2, 1.5])
        for name, part in [('all', bands >= 0), *(
                (text, bands == k) for k, text in enumerate(
                    ('to 0.3', '0.3-0.6', '0.6-0.9', '0.9-1.2', '1.2-1.5', 'beyond 1.5')))]:
            inside = square[part, None] < chi2.ppf(SHARES, count)
            share = weight[part] @ inside / weight[part].sum()
            rows.append((member, name, int(part.sum()), len(np.unique(lenses.brand[part])),
                         *(f'{100 * one:.1f}' for one in share)))
            if name == 'all':
                report.judge(share[-1] > 0.98, f'{member}: {100 * share[-1]:.1f} % of held-out '
                             'lenses in the 99 % ellipsoid, required 98')
    report.say('')
    report.table(('member', 'corner / f', 'lenses', 'brands',
                  *(f'{100 * share:.0f} %' for share in SHARES)), rows)


def profile_path() -> Path | None:
    """Return where the measured lenses are, or None."""
    folder = data_folder('fisheye_room')
    path = folder.parent / 'lens_profiles.csv' if folder else None
    return path if path and path.exists() else None


def write_table(path: Path) -> None:
    """Fit all members and write the module of constants."""
    profiles = read_profiles(path)
    head = Path(__file__).read_text(encoding='utf-8').split('"""', 1)[0]
    lines = [head + '"""', 'Constants of the prior over real lenses; made by '
             '`python -m bench.lenses.lens_population --write`.', '',
             f'{len(profiles.k)} of {profiles.read} measured lenses of the gyroflow project '
             '(CC0).', '"""', '',
             '#: Corners of the table: distance from the middle over the focal length.',
             f'KNOTS = ({", ".join(map(repr, KNOTS.tolist()))})',
             '#: For each knot, the means of ki · corner^(2i), then the rows of the lower',
             '#: Cholesky factor of their covariance.',
             'TABLE: dict[str, tuple[tuple[float, ...], ...]] = {']
    for member in MEMBERS:
        lines.append(f"    '{member}': (")
        for mean, covariance in zip(*population(lenses_of(profiles, member))):
            factor = np.linalg.cholesky(covariance)
            numbers = [f'{value:.4g}' for value in (*mean, *factor[np.tril_indices(len(mean))])]
            text = '        ('
            for number in numbers:
                if len(text.rsplit('\n', 1)[-1]) + len(number) > 94:
                    text = text.rstrip() + '\n         '
                text += number + ', '
            lines.append(text.rstrip() + '),' if len(numbers) == 1 else text[:-2] + '),')
        lines.append('    ),')
    TABLE.write_text('\n'.join([*lines, '}', '']), encoding='utf-8')


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--write', action='store_true', help='write the table into the package')
    if parser.parse_args().write:
        found = profile_path()
        if found is None:
            raise SystemExit('There is no ../shared/data/lens_profiles.csv.')
        write_table(found)
    else:
        run(Report(), None)
