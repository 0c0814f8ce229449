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
Single runs of the bench of lenses: a measured lens drawn, a recording of it, `auto` and the truth.

Runs can be kept in a file of JSON lines, so that many are made in several sittings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache

from bench.lenses.lens_population import (brand_weights, lenses_of, profile_path, Profiles,
                                          read_profiles)
from bench.monte_carlo import kept_runs
import numpy as np
from selfcal_ros import calibrate, Camera, CameraFacts
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES
from selfcal_ros.geometry.lenses.model import fitted_coefficients
from selfcal_ros.synthetic.scenes import PointSequence
from selfcal_ros.synthetic.special_scenes import drive, hand_held

WIDTH, HEIGHT = 640, 480
VIEWS, TRACKS, TRACK_LENGTH = 20, 600, 12
NOISES_PX = (0.2, 0.5)
#: Lenses whose corner is nearer than this determine the focal length too badly to be a test.
NARROWEST = 0.45
#: Fields of view of the fisheyes, degrees, across the image.
FIELDS_DEG = (120, 150, 185)
#: From the axis to the corner, radians: what a lens shows from which a fisheye is made.
WIDE = np.radians(60.0)
LENSES = ('none', 'radial1', 'radial2', 'radial3', 'plumb_bob', 'rational',
          *(f'equidistant {field}' for field in FIELDS_DEG))
MOTIONS: dict[str, Callable[..., PointSequence]] = {'drive': drive, 'hand': hand_held}
#: p1 = p2 of the second table.
DECENTRING = (0.0, 0.0003, 0.001, 0.003, 0.005)
#: Where the ray is judged, in shares of the image: middle, edges, corners.
PLACES = {'middle': ((0.5, 0.5),), 'edges': ((0, 0.5), (1, 0.5), (0.5, 0), (0.5, 1)),
          'corners': ((0, 0), (1, 0), (0, 1), (1, 1))}
#: A fisheye is judged up to this share of its widest ray.
CIRCLE = 0.95
#: Derivatives by parameters: steps in sigmas.
_STEP = 1e-3


@cache
def profiles() -> Profiles:
    """Return the measured lenses; SystemExit where they are not there."""
    path = profile_path()
    if path is None:
        raise SystemExit('The bench of lenses needs ../shared/data/lens_profiles.csv.')
    return read_profiles(path)


@cache
def _profile_weights() -> np.ndarray:
    """Probability of each measured lens to be drawn: a brand counts by the root of its number."""
    weight = brand_weights(profiles().brand) * (profiles().corner > NARROWEST)
    return weight / weight.sum()


def _drawn(rng, member: str) -> tuple[np.ndarray, float]:
    """Draw a measured lens: its coefficients as a member, and its corner."""
    while True:
        row = rng.choice(len(_profile_weights()), p=_profile_weights())
        lens = lenses_of(profiles()[[row]], member)
        if len(lens.corner):
            powers = 2 * np.arange(1, 1 + lens.scaled.shape[1])
            return lens.scaled[0] / lens.corner[0]**powers, float(lens.corner[0])


def draw_camera(rng, lens: str) -> Camera:
    """
    Draw a camera of 640 x 480 with a measured lens.

    Parameters
    ----------
    rng : numpy.random.Generator
    lens : str
        One of `LENSES`.

    """
    middle = np.array([WIDTH - 1, HEIGHT - 1]) / 2 + rng.uniform(-0.02, 0.02, 2) * WIDTH
    half = np.hypot(WIDTH, HEIGHT) / 2
    if lens.startswith('equidistant'):
        return _fisheye(rng, np.radians(float(lens.split()[1])), middle)
    if lens == 'rational':
        return _rational(rng, middle)
    member = {'none': 'radial1', 'plumb_bob': 'radial3'}.get(lens, lens)
    radial, corner = _drawn(rng, member)
    values = np.zeros(5)
    if lens != 'none':
        values[[0, 1, 4][:len(radial)]] = radial
    if lens == 'plumb_bob':
        values[2:4] = _decentring(rng)
    return _camera(half / corner, middle, values, 'plumb_bob')


def _decentring(rng) -> np.ndarray:
    """Draw p1 and p2: sizes from 0.0002 to 0.005, each octave as likely, any direction."""
    angle = rng.uniform(0, 2 * np.pi)
    return 0.005 * 25**-rng.random() * np.array([np.cos(angle), np.sin(angle)])


def _camera(f, middle, values, model) -> Camera:
    return Camera([[f, 0, middle[0]], [0, f, middle[1]], [0, 0, 1]], values, WIDTH, HEIGHT, model)


def _fisheye(rng, field: float, middle) -> Camera:
    """
    Take the polynomial of a measured wide lens, and the focal length that shows the field.

    Nobody measured lenses beyond 150 degrees: there the polynomial goes on as it will.
    """
    lens = LENS_CHOICES['equidistant'][0]
    for _ in range(10_000):
        k, corner = _drawn(rng, 'equidistant')
        edge = lens.rays(np.array([corner, 0.0]), k)
        if not np.arctan2(edge[0], edge[2]) > min(field / 2, WIDE):
            continue
        angle = np.linspace(0, field / 2, 100)
        radius = lens.image(np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)]), k).xy[:, 0]
        slope = np.diff(radius) / np.diff(angle)
        # between the flattest and the steepest of designs
        if slope.min() > 0.25 and slope.max() < 2.2 and lens.widest_angle(k) > field / 2 + 0.05:
            return _camera(WIDTH / 2 / radius[-1], middle, k, 'equidistant')
    raise RuntimeError('No measured lens is so wide.')


def _rational(rng, middle) -> Camera:
    """Fit the rational model to a measured lens of 75 to 125 degrees over the diagonal."""
    model, names = LENS_CHOICES['rational'][0], ('k1', 'k2', 'k3', 'k4')
    lens = LENS_CHOICES['equidistant'][0]
    for _ in range(10_000):
        k, corner = _drawn(rng, 'equidistant')
        xy = np.linspace(0, corner, 60)[:, None] * [1.0, 0.0]
        rays = lens.rays(xy, k)
        if not np.radians(37) < np.arctan2(rays[-1, 0], rays[-1, 2]) < np.radians(62):
            continue
        values = fitted_coefficients(model, names, rays, xy, steps=8)
        miss = np.abs(model.image(rays, values).xy - xy).max()
        reached = model.widest_angle(values) > np.arctan2(rays[-1, 0], rays[-1, 2]) + 0.02
        if miss < 0.003 * corner and reached and abs(values[5]) < 3:
            values[2:4] = _decentring(rng)
            return _camera(np.hypot(WIDTH, HEIGHT) / 2 / corner, middle, values,
                           'rational_polynomial')
    raise RuntimeError('No measured lens is so near to the rational model.')


@dataclass(frozen=True)
class Outcome:
    """
    One calibration beside the truth.

    Attributes
    ----------
    reason : str
        Kind of the refusal; empty where there is a camera.
    choice : str
        The lens that was found.
    same_family : bool
    distance, size : float, int
        Squared Mahalanobis distance of the estimated parameters, and how many they are.
    worst : float
        Largest deviation of fx, cx, cy in sigmas.
    error : ndarray, shape (3,)
        Of fx, cx, cy, over their sigmas.
    error_px : ndarray, shape (3,)
        Of fx, cx, cy, pixels.
    rays : dict of str to ndarray
        Squared distance of the image of true rays from their pixels, two degrees of freedom.
    ray_px : dict of str to ndarray
        The same in pixels, not over the covariance.

    """

    reason: str
    choice: str = ''
    same_family: bool = False
    distance: float = np.nan
    size: int = 0
    worst: float = np.nan
    error: np.ndarray | None = None
    error_px: np.ndarray | None = None
    rays: dict | None = None
    ray_px: dict | None = None


def compared(result, truth: Camera) -> Outcome:
    """Hold a calibration against the truth."""
    if not result:
        return Outcome(result.kind)
    camera, names = result.camera, result.parameter_names
    matrix = ('fx', 'cx', 'cy')
    places = [names.index(name) for name in matrix]
    error_px = camera.parameters[places] - truth.parameters[:5][[0, 2, 3]]
    sigma = np.array([result.sigma[name] for name in matrix])
    judged = list(places)
    # a factor common to numerator and denominator changes coefficients, not the image
    comparable = (camera.model != 'rational_polynomial'
                  and truth.distortion_as(camera.model) is not None)
    if comparable:
        # fy goes with fx
        judged = [k for k, name in enumerate(names)
                  if result.status[name] == 'estimated' and name not in ('fy', 'skew')]
        away = camera.parameters - _as(truth, camera.model, names)
    else:
        away = np.zeros(len(names))
        away[places] = error_px
    covariance = result.covariance[np.ix_(judged, judged)]
    scale = np.sqrt(np.diag(covariance))
    white = away[judged] / scale
    distance = white @ np.linalg.solve(covariance / np.outer(scale, scale), white)
    rays, ray_px = ray_errors(result, truth)
    family = camera.lens.is_perspective == truth.lens.is_perspective
    return Outcome('', result.facts.distortion, family, float(distance), len(judged),
                   float(np.abs(error_px / sigma).max()), error_px / sigma, error_px, rays,
                   ray_px)


def _as(truth: Camera, model: str, names) -> np.ndarray:
    """Parameters of the truth by the names of another model; zero where it has none."""
    have = dict(zip(truth.parameter_names, truth.parameters))
    return np.array([have.get(name, 0.0) for name in names])


def ray_errors(result, truth: Camera) -> tuple[dict, dict]:
    """Project the true rays of pixels by the estimate: squared distances and pixels."""
    distances, pixels_away = {}, {}
    corner = np.array([truth.width - 1, truth.height - 1])
    for place, shares in PLACES.items():
        pixels = _within_circle(truth, np.array(shares, float) * corner)
        rays = truth.rays(pixels)
        away = result.camera.project(rays) - pixels
        J = _by_parameters(result, rays)
        covariance = J @ result.covariance @ np.swapaxes(J, -1, -2)
        with np.errstate(all='ignore'):
            square = np.array([one @ np.linalg.pinv(C) @ one if np.isfinite(one).all()
                               and np.isfinite(C).all() else np.inf
                               for one, C in zip(away, covariance)])
        distances[place], pixels_away[place] = square, np.linalg.norm(away, axis=1)
    return distances, pixels_away


def _within_circle(truth: Camera, pixels: np.ndarray) -> np.ndarray:
    """Pull pixels towards the middle until the lens sees there."""
    middle = truth.K[:2, 2]
    for _ in range(200):
        rays = truth.rays(pixels)
        widest = CIRCLE * min(truth.lens.widest_angle(truth.distortion), np.radians(92.5))
        with np.errstate(invalid='ignore'):
            dark = ~(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]) < widest)
        if not dark.any():
            break
        pixels = np.where(dark[:, None], middle + 0.99 * (pixels - middle), pixels)
    return pixels


def _by_parameters(result, rays: np.ndarray) -> np.ndarray:
    """Derivative of pixels by all parameters, (N, 2, k), by differences."""
    camera = result.camera
    values, sigma = camera.parameters, np.sqrt(np.diag(result.covariance))
    J = np.zeros((len(rays), 2, len(values)))
    for k in np.flatnonzero(sigma):
        sides = []
        for sign in (1, -1):
            moved = values.copy()
            moved[k] += sign * _STEP * sigma[k]
            other = Camera.from_parameters(moved, camera.width, camera.height, camera.model)
            sides.append(other.project(rays))
        J[:, :, k] = (sides[0] - sides[1]) / (2 * _STEP * sigma[k])
    return J


def one_run(task: tuple) -> Outcome:
    """Draw a lens, record and calibrate; the task is (lens, motion, seed)."""
    lens, motion, seed = task
    rng = np.random.default_rng([seed, LENSES.index(lens), list(MOTIONS).index(motion), 13])
    camera = draw_camera(rng, lens)
    sequence = MOTIONS[motion](rng, rng.uniform(*NOISES_PX), VIEWS, TRACKS, TRACK_LENGTH, camera)
    return compared(calibrate(sequence.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0)),
                    camera)


def one_decentred(task: tuple, stated: str) -> Outcome:
    """Calibrate with p1 = p2; the task is (p, motion, seed). A stated lens has no prior."""
    p, motion, seed = task
    rng = np.random.default_rng([seed, round(1e4 * p), list(MOTIONS).index(motion), 17])
    middle = np.array([WIDTH - 1, HEIGHT - 1]) / 2 + rng.uniform(-0.02, 0.02, 2) * WIDTH
    camera = _camera(520.0, middle, [-0.12, 0.05, p, p, 0], 'plumb_bob')
    sequence = MOTIONS[motion](rng, 0.3, VIEWS, TRACKS, TRACK_LENGTH, camera)
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion=stated,
                        lens_population=stated == 'auto')
    return compared(calibrate(sequence.tracks, facts=facts), camera)


def kept_outcomes(tasks, options) -> dict[tuple, Outcome]:
    """Return all runs that lie in the cache, and those of the tasks that do not, made now."""
    runs = kept_runs(_fields, tasks, options.cache, options.processes)
    return {task: _outcome(fields) for task, fields in runs.items()}


def _fields(task: tuple) -> dict:
    return asdict(one_run(task))


def _outcome(fields: dict) -> Outcome:
    for name in ('error', 'error_px'):
        fields[name] = None if fields[name] is None else np.array(fields[name])
    for name in ('rays', 'ray_px'):
        if fields[name]:
            fields[name] = {place: np.array(one) for place, one in fields[name].items()}
    return Outcome(**fields)
