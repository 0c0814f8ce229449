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
What the uncertainty of a calibration means for lengths and angles of the structure.

They come from the adjustment of everything, and their sigma holds the noise of the points, the
poses and the camera together; the camera's part is that of the result, with the errors that
observations share. Lengths are compared with each other, since images show no scale. First order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from operator import index

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens, to_intrinsics
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.reconstruction import Measured, StructurePrecision, StructureSample
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.projective import tangent_basis
from selfcal_ros.geometry.scaled_inverse import scaled_pseudo_inverse

#: Correlations of the internal parameters with less than this share of the largest eigenvalue
#: are rounding.
_ROUNDING = 1e-12
#: Share of an extent within which points count as equally far out.
ABOUT = 0.05
#: Points whose last coordinate (of a unit vector) is smaller lie at infinity.
_INFINITY = 1e-9


def length_ratio(result: Calibration | NotCalibrated, first: tuple[int, int],
                 second: tuple[int, int]) -> Measured:
    """
    Ratio of two lengths of the structure, with its standard deviation.

    Parameters
    ----------
    result : Calibration
        With the reconstruction that `calibrate` gives to planar, general and translating motion.
    first, second : (int, int)
        Track identities of the points that each length lies between, among
        `result.reconstruction.tracks`. One of a known length turns ratios to it into lengths.

    Returns
    -------
    Measured
        Length of `first` over that of `second`; the sigma holds the noise of the points, the
        poses and the camera together. NaN with a point at infinity.

    Raises
    ------
    ArgumentError
        If there is no such reconstruction or track, or a length has the same point twice.

    Examples
    --------
    >>> import numpy as np
    >>> from selfcal_ros import calibrate, CameraFacts, length_ratio
    >>> from selfcal_ros.synthetic.scenes import sequence_si
    >>> scene = sequence_si(np.random.default_rng(0), noise_px=0.1)
    >>> result = calibrate(scene.tracks, facts=CameraFacts(aspect_ratio=1.0, distortion='none'))
    >>> a, b, c = result.reconstruction.tracks[[0, 10, 20]]
    >>> ratio = length_ratio(result, (a, b), (b, c))
    >>> lengths = np.linalg.norm(np.diff(scene.points[[a, b, c], :3], axis=0), axis=1)
    >>> bool(abs(ratio.value - lengths[0] / lengths[1]) < 4 * ratio.sigma)
    True

    """
    precision, points, rows = _found(result, [(first, 2), (second, 2)])
    a, b, c, d = rows
    return distance_ratio(precision, (a, b), (c, d), result.covariance, points)


def structure_angle(result: Calibration | NotCalibrated, corner: tuple[int, int, int]) -> Measured:
    """
    Angle at a point of the structure, with its standard deviation.

    Parameters
    ----------
    result : Calibration
        As for `length_ratio`.
    corner : (int, int, int)
        Track identities of three points; the angle is at the middle one.

    Returns
    -------
    Measured
        Radians; the sigma holds the noise of the points, the poses and the camera together. NaN
        with a point at infinity or all three on one line.

    Raises
    ------
    ArgumentError
        If there is no such reconstruction or track, or a point is named twice.

    Examples
    --------
    >>> import numpy as np
    >>> from selfcal_ros import calibrate, CameraFacts, structure_angle
    >>> from selfcal_ros.synthetic.scenes import sequence_si
    >>> scene = sequence_si(np.random.default_rng(0), noise_px=0.1)
    >>> result = calibrate(scene.tracks, facts=CameraFacts(aspect_ratio=1.0, distortion='none'))
    >>> a, b, c = result.reconstruction.tracks[[0, 10, 20]]
    >>> angle = structure_angle(result, (a, b, c))
    >>> one, other = scene.points[[a, c], :3] - scene.points[b, :3]
    >>> truth = np.arccos(one @ other / np.linalg.norm(one) / np.linalg.norm(other))
    >>> bool(abs(angle.value - truth) < 4 * angle.sigma)
    True

    """
    precision, points, (a, b, c) = _found(result, [(corner, 3)])
    return corner_angle(precision, (a, b, c), result.covariance, points)


def _found(result: object, groups: Iterable[tuple[Sequence[int], int]],
           ) -> tuple[StructurePrecision, np.ndarray, list[int]]:
    """Return precision, points and the rows of tracks; groups are pairs (tracks, how many)."""
    shape = result.reconstruction if isinstance(result, Calibration) else None
    if shape is None or shape.precision is None:
        raise ArgumentError('There is no adjusted structure to measure in; use what calibrate '
                            'returns for a camera that moves and is calibrated.')
    rows: list[int] = []
    for given, count in groups:
        try:
            names = np.array([index(name) for name in given], np.int64)
        except (TypeError, OverflowError):
            names = np.zeros(0, np.int64)
        if len(names) != count:
            raise ArgumentError(f'{given!r} must be {count} track identities.')
        _all_different(names, 'Track')
        at = np.minimum(np.searchsorted(shape.tracks, names), len(shape.tracks) - 1)
        missing = names[shape.tracks[at] != names]
        if len(missing):
            raise ArgumentError(f'Track {missing[0]} is not in the reconstruction; choose from '
                                'result.reconstruction.tracks.')
        rows += at.tolist()
    return shape.precision, shape.points, rows


def _all_different(ends: Sequence[int] | np.ndarray, name: str) -> None:
    again = [one for k, one in enumerate(ends) if one in ends[:k]]
    if again:
        raise ArgumentError(f'{name} {again[0]} is named twice; lengths and angles need '
                            'different points.')


def precision_of(fit: RobustFit) -> StructurePrecision:
    """Take from an optimum what the sigmas of lengths and angles need."""
    unknowns, system = fit.bundle.unknowns, fit.information.system
    factor, _ = fit.bundle.loss_factors(fit.linearisation)
    return StructurePrecision(
        fit.state.camera(), fit.state.points, unknowns.free_lens_names,
        fit.independent_covariance,
        system.elimination(unknowns.selection), factor)


def sample_structure(precision: StructurePrecision, tracks: np.ndarray, points: np.ndarray,
                     covariance: np.ndarray) -> StructureSample | None:
    """
    Measure a typical ratio of lengths and a typical angle.

    About the longest extent of that half of the points which lies nearest to the middle of all,
    over the longest across it; and the angle at the end of the latter between the ends of the
    former.

    Parameters
    ----------
    precision : StructurePrecision
    tracks : ndarray of int, shape (P,)
        Identity of each point.
    points : ndarray, shape (P, 4)
        Of the result, in the same order.
    covariance : ndarray, shape (k, k)
        Of the camera's parameters.

    Returns
    -------
    StructureSample or None
        None where the points do not span a plane, or a sigma cannot be told.

    """
    ends = _typical_ends(points)
    if ends is None:
        return None
    a, b, c, d, apex = ends
    ratio = distance_ratio(precision, (a, b), (c, d), covariance, points)
    angle = corner_angle(precision, (a, apex, b), covariance, points)
    if not np.isfinite([ratio.value, ratio.sigma, angle.value, angle.sigma]).all():
        return None
    a, b, c, d, apex = (int(tracks[k]) for k in ends)
    return StructureSample(ratio, (a, b), (c, d),
                           Measured(*np.degrees([angle.value, angle.sigma]).tolist()),
                           (a, apex, b))


def _typical_ends(points: np.ndarray) -> tuple[int, ...] | None:
    """Rows of the ends of the longest extent and of that across it, and the apex over it."""
    rows = np.flatnonzero(np.abs(points[:, 3]) > _INFINITY)
    if len(rows) < 4:
        return None
    X = points[rows, :3] / points[rows, 3:]
    # far points are known badly, and are not what anybody measures
    away = np.linalg.norm(X - np.median(X, axis=0), axis=1)
    near = away <= np.median(away)
    X, rows = X[near], rows[near]
    a, b = _extremes(X)
    along = (X[b] - X[a]) / max(np.linalg.norm(X[b] - X[a]), 1e-300)
    rest = X - X[a] - ((X - X[a]) @ along)[:, None] * along
    c, d = _extremes(rest)
    height = np.linalg.norm(rest, axis=1)
    apex = c if height[c] > height[d] else d
    if a == b or c == d or apex in (a, b):
        return None
    return tuple(int(rows[k]) for k in (a, b, c, d, apex))


def _extremes(X: np.ndarray) -> tuple[int, int]:
    """Points (N, 3) that lie far out, to either side, along the principal axis."""
    spread = X - X.mean(axis=0)
    place = spread @ np.linalg.eigh(spread.T @ spread)[1][:, -1]
    # the first that lies about as far out as any: that the noise chose the very farthest would
    # make every extent look longer
    margin = ABOUT * np.ptp(place)
    return (int(np.argmax(place <= place.min() + margin)),
            int(np.argmax(place >= place.max() - margin)))


# ---------------------------------------------------------------------- by rows of points

def distance_ratio(precision: StructurePrecision, first: tuple[int, int], second: tuple[int, int],
                   covariance: np.ndarray | None = None,
                   points: np.ndarray | None = None) -> Measured:
    """
    Ratio of the lengths of two segments of the structure.

    Parameters
    ----------
    precision : StructurePrecision
    first, second : (int, int)
        Points (rows of the points) that each segment connects.
    covariance : ndarray, shape (k, k), optional
        Of the camera's parameters, if it is to count in place of that for independent errors.
    points : ndarray, shape (P, 4), optional
        Where the points are thought to be, if not where the adjustment has them.

    Returns
    -------
    Measured
        NaN with a point at infinity.

    Raises
    ------
    ArgumentError
        If a segment connects a point with itself.

    """
    _all_different(first, 'Point')
    _all_different(second, 'Point')
    return _measured(precision, [*first, *second], _ratio, covariance, points)


def corner_angle(precision: StructurePrecision, corner: tuple[int, int, int],
                 covariance: np.ndarray | None = None,
                 points: np.ndarray | None = None) -> Measured:
    """
    Angle at the second of three points of the structure, radians; see `distance_ratio`.

    NaN with a point at infinity or all three on one line.
    """
    _all_different(corner, 'Point')
    return _measured(precision, list(corner), _angle, covariance, points)


def _ratio(X: np.ndarray) -> tuple[float, np.ndarray]:
    """Ratio of the distances of points (4, 3), and what it changes by when they move (4, 3)."""
    apart = np.array([X[1] - X[0], X[3] - X[2]])
    square = np.sum(apart**2, axis=1)
    ratio = float(np.sqrt(square[0] / square[1]))
    pull = ratio * apart / square[:, None]
    return ratio, np.array([-pull[0], pull[0], pull[1], -pull[1]])


def _angle(X: np.ndarray) -> tuple[float, np.ndarray]:
    """Angle of points (3, 3) at the second, and what it changes by when they move (3, 3)."""
    arms = X[[0, 2]] - X[1]
    length = np.linalg.norm(arms, axis=1)[:, None]
    a, b = arms / length
    sine, cosine = np.linalg.norm(np.cross(a, b)), a @ b
    pull = np.array([cosine * a - b, cosine * b - a]) / (sine * length)
    return float(np.arctan2(sine, cosine)), np.array([pull[0], -pull.sum(axis=0), pull[1]])


def _measured(precision: StructurePrecision, rows: list[int],
              quantity: Callable[[np.ndarray], tuple[float, np.ndarray]],
              covariance: np.ndarray | None, points: np.ndarray | None) -> Measured:
    """Value and sigma of a quantity that depends on some points and on no scale."""
    p = precision.points[rows]
    with np.errstate(divide='ignore', invalid='ignore'):
        X = p[:, :3] / p[:, 3:]
        value, slope = quantity(X)
        if points is not None:
            value, _ = quantity(points[rows, :3] / points[rows, 3:])
    if not (np.isfinite(value) and np.isfinite(slope).all()):
        return Measured(np.nan, np.nan)
    own, shared = _variances(precision, rows, slope, covariance)
    return Measured(value, float(np.sqrt(max(own + shared, 0))))


def by_camera_and_path(precision: StructurePrecision, rows: np.ndarray, slope: np.ndarray,
                       covariance: np.ndarray) -> float:
    """
    Return the sigma of a sum over points that errors of the camera and the path leave.

    That of the points' own noise is not in it.

    Parameters
    ----------
    precision : StructurePrecision
    rows : ndarray of int, shape (n,)
        Points of the adjustment; each once.
    slope : ndarray, shape (n, 3)
        By which each enters the sum, in the world of the adjustment.
    covariance : ndarray, shape (k, k)
        Of the camera's parameters.

    Returns
    -------
    float
        In the unit of the adjustment.

    """
    return float(np.sqrt(max(_variances(precision, rows, slope, covariance)[1], 0)))


def _variances(precision: StructurePrecision, rows: list[int] | np.ndarray, slope: np.ndarray,
               covariance: np.ndarray | None) -> tuple[float, float]:
    """Return the variance that the points' own noise makes, and that of camera and path."""
    p = precision.points[rows]
    # of X = p / w by steps along the tangents of the homogeneous unit vector
    basis, X = tangent_basis(p), p[:, :3] / p[:, 3:]
    by_point = (basis[:, :3] - X[:, :, None] * basis[:, 3:]) / p[:, 3:, None]
    form = np.zeros((len(precision.points), 3))
    np.add.at(form, rows, np.einsum('pi,pij->pj', slope, by_point))
    carried, own = precision.elimination.point_form(form)
    joint = precision.covariance
    variance = carried @ joint @ carried
    if covariance is not None:
        lens = Lens.of(precision.camera)
        count, places = len(precision.lens), lens.places(precision.lens)
        inner = joint[:count, :count]
        pull = regression(inner, joint[:count] @ carried)
        stated = to_intrinsics(covariance, lens)[np.ix_(places, places)]
        variance += pull @ (stated - inner) @ pull
    return precision.noise_factor * own, float(variance)


def regression(covariance: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """
    Solve covariance · x = shared: by how much something follows the parameters.

    Parameters
    ----------
    covariance : ndarray, shape (k, k)
        Of parameters in any units; zero rows for those that are held.
    shared : ndarray, shape (k, ...)
        Covariance of that something with each.

    Returns
    -------
    ndarray, shape (k, ...)
        Zero for what is held.

    """
    free = np.diag(covariance) > 0
    result = np.zeros_like(shared, dtype=float)
    # in sigmas: a variance of 1e-10 beside one of 1e4 is no rounding
    result[free] = scaled_pseudo_inverse(covariance[np.ix_(free, free)],
                                         _ROUNDING) @ shared[free]
    return result
