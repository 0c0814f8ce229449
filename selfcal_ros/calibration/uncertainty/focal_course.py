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
Does the focal length vary? What an optimum says, by one linear step.

The derivative by each view's focal length is appended to the normal equations of the optimum.
Everything else is eliminated by its covariance, which is the inverse of these. What remains is a
quadratic in the logs of the focal lengths. From it follow the best steady growth, and how probable
random walks of several sizes are (type-II maximum likelihood; Bishop 2006, 3.5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.bundle import BEHIND_SIGMAS, Bundle
from selfcal_ros.calibration.bundle.information import HUBER_SIGMAS
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_COMPARE_ROUGHLY
from selfcal_ros.calibration.bundle.zoom import RATE_NAME, VIEW_NAME, Zoom, ZoomModel
from selfcal_ros.calibration.result import FocalCourse
from selfcal_ros.calibration.uncertainty.random_effects import most_probable_size
from selfcal_ros.calibration.uncertainty.suppositions import joint_information, Supposition
from selfcal_ros.calibration.uncertainty.uneven_growth import UnevenGrowth
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.robust_loss import huber_loss

#: Least gain of log probability: half the square of four sigmas.
SURE = 8.0
#: Least gain of a random walk over steady growth: the size of the walk says how sure it is.
BEYOND = 2.0
#: Standard deviations of a step of the random walk that are tried.
SIZES = 1e-5 * 2.0**(0.5 * np.arange(30))

#: Less information on steady growth than this is none.
LEAST_TOLD = 1e-100

#: Share of the tracks on either side that a gain may not rest on, and how many at least.
FEW, LEAST_FEW = 0.02, 3


@dataclass(frozen=True)
class FocalEvidence:
    """
    What an optimum says of a focal length that varies.

    Attributes
    ----------
    rate : float
        Change of log f from the first view to the last, were it steady.
    walk_sigma : float
        Of `ZoomModel`: the size of random walk that is the most probable.
    steady_gain, walk_gain : float
        Log of the probability over that of a constant focal length.
    beyond_gain : float
        Log of the probability of a random walk about steady growth over that of the growth.

    """

    rate: float
    walk_sigma: float
    steady_gain: float
    walk_gain: float
    beyond_gain: float

    @property
    def gain(self) -> float:
        """The larger of both gains over a constant focal length."""
        return max(self.steady_gain, self.walk_gain)

    @property
    def varies(self) -> bool:
        """Tell whether the focal length is not constant, at four sigmas."""
        return self.gain > SURE

    @property
    def sigma(self) -> float:
        """Of `ZoomModel`: the simplest that is enough."""
        return self.walk_sigma if self.beyond_gain > BEYOND else 0.0


def focal_evidence(fit: RobustFit, instants: tuple[float, ...], variance_inflation: float,
                   ) -> FocalEvidence | None:
    """
    Test whether the focal length is constant.

    Parameters
    ----------
    fit : RobustFit
        At its optimum, of whatever zoom.
    instants : tuple of float
        Of `ZoomModel`.
    variance_inflation : float
        Variance of the estimate over that with independent errors.

    Returns
    -------
    FocalEvidence or None
        None where the normal equations cannot be solved.

    """
    model, views = ZoomModel(instants, 1.0), len(instants)
    gaps = np.sqrt(model.variances)
    # a zoom that the fit has is held: what is asked for is not eliminated with the rest
    held = fit if fit.motion.zoom is None else replace(fit, bundle=bundle_of(
        fit.observations, replace(fit.motion, zoom=None), fit.bundle.priors, fit.bundle.sigma_px))
    zoom = fit.state.zoom or Zoom.constant(views)
    try:
        at_optimum = held.information
    except np.linalg.LinAlgError:
        return None
    # a magnification about the principal point, of all that a view sees
    slope = held.bundle.xy + held.linearisation.residual - held.state.lens.values[2:4]
    system = at_optimum.system
    coupling, own, pull = system.of_views(slope * held.bundle.root_weights(held.linearisation))
    solved = at_optimum.covariance @ coupling / at_optimum.factor
    own -= coupling.T @ solved
    pull -= solved.T @ system.gradient
    # from log f of all views to the steps between them, whose mean is zero
    level = np.tri(views, views - 1, -1)
    level -= level.mean(axis=0)
    steps = level * gaps
    own = steps.T @ own @ steps / variance_inflation
    pull = steps.T @ pull / variance_inflation
    # about a constant focal length, not about that of the state
    there = np.diff(zoom.log_focal) / gaps
    pull = pull - own @ there
    steady = np.diff(model.course) / gaps
    rate, information, along = _steady_growth(own, pull, steady)
    walk_gain, walk_sigma = _best_walk(own, pull)
    beyond_gain, _ = _best_walk(own - np.outer(along, along), pull + rate * (own @ steady))
    return FocalEvidence(rate, walk_sigma, 0.5 * rate**2 * information, walk_gain, beyond_gain)


def _steady_growth(own: np.ndarray, pull: np.ndarray, steady: np.ndarray,
                   ) -> tuple[float, float, np.ndarray]:
    """Return the best rate of steps (k,), what is told of it, and what of the steps with it."""
    information = float(steady @ own @ steady)
    if information < LEAST_TOLD:
        # nothing tells of a course but rounding, which may be below zero
        return 0.0, 0.0, np.zeros(len(steady))
    return (-float(steady @ pull) / information, information,
            own @ steady / np.sqrt(information))


def gain_of_most(fit: RobustFit, instants: tuple[float, ...], found: FocalEvidence,
                 variance_inflation: float) -> float:
    """
    Tell what remains of the gain without the few tracks that say most for it, and against.

    A zoom shows in all that a view sees. A few gross errors along epipolar lines, which leave
    small residuals, can ask for another focal length where a view tells little of its own.

    Parameters
    ----------
    fit : RobustFit
        At its optimum of constant focal length.
    instants : tuple of float
        Of `ZoomModel`.
    found : FocalEvidence
    variance_inflation : float
        Variance of the estimate over that with independent errors.

    Returns
    -------
    float
        Log of the probability over that of a constant focal length.

    """
    less = np.sort(gains_of_tracks(fit, instants, found)) / variance_inflation
    few = max(LEAST_FEW, int(np.ceil(FEW * len(less))))
    if len(less) <= 4 * few:
        return found.gain
    most = less[few:-few].sum() * len(less) / (len(less) - 2 * few)
    return found.gain + float(most - less.sum())


def gains_of_tracks(fit: RobustFit, instants: tuple[float, ...],
                    found: FocalEvidence) -> np.ndarray:
    """What every track (P,) gains by a focal length that varies, in units of sigma²."""
    sigma = 0.0 if found.steady_gain >= found.walk_gain else found.walk_sigma
    model = ZoomModel(instants, sigma)
    bundle = bundle_of(fit.observations, replace(fit.motion, zoom=model), fit.bundle.priors,
                       fit.bundle.sigma_px)
    constant = replace(fit.state, zoom=Zoom.constant(len(instants)))
    varying = bundle.optimise(constant, iterations=4, tolerance=TO_COMPARE_ROUGHLY)
    gain: np.ndarray = _cost_of_tracks(bundle, constant) - _cost_of_tracks(bundle, varying)
    return gain


def _cost_of_tracks(bundle: Bundle[SceneState], state: SceneState) -> np.ndarray:
    """Robust cost of every track (P,), units of sigma²."""
    distance = np.linalg.norm(bundle.residuals(state), axis=1) / bundle.sigma_px
    loss = huber_loss(np.nan_to_num(distance, nan=BEHIND_SIGMAS), HUBER_SIGMAS)
    return bundle.blocks.sum_over_points(loss)


def shape_gain(fit: RobustFit, variance_inflation: float) -> float:
    """
    Tell how probable it is that images change their shape instead of their scale.

    A rolling shutter stretches each image along its columns and shears it along its rows, each
    by its own amount; a zoom does neither.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    variance_inflation : float
        Variance of the estimate over that with independent errors.

    Returns
    -------
    float
        Log of the probability over that of images of one shape, the larger of both.

    """
    below = (fit.bundle.xy + fit.linearisation.residual)[:, 1] - fit.state.lens['cy']
    columns = {'stretch': np.column_stack([0 * below, below]),
               'shear': np.column_stack([below, 0 * below])}
    tests = [Supposition(name, (name,), column[:, :, None], of_views=True)
             for name, column in columns.items()]
    joint = joint_information(fit, tests, variance_inflation)
    gains = []
    for name in columns:
        place = joint.places[name][:, 0]
        # what all images share is the aspect ratio, or the skew
        mean = np.eye(len(place)) - 1 / len(place)
        gains.append(_best_walk(mean @ joint.information[np.ix_(place, place)] @ mean,
                                mean @ joint.score[place])[0])
    return max(gains)


def _best_walk(own: np.ndarray, pull: np.ndarray) -> tuple[float, float]:
    """Return the largest gain of log probability, and the size of steps that has it."""
    values, vectors = np.linalg.eigh((own + own.T) / 2)
    size, gain = most_probable_size(np.maximum(values, 0), vectors.T @ pull, SIZES)
    return gain, size


def focal_course(fit: RobustFit, state: SceneState, frames: np.ndarray, covariance: np.ndarray,
                 variance_inflation: float, growth: UnevenGrowth | None = None,
                 ) -> FocalCourse | None:
    """
    Return the focal length of every view, with its spread.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    state : SceneState
        The estimate, which may differ from the optimum.
    frames : ndarray of int, shape (V,)
    covariance : ndarray, shape (k, k)
        Of the unknowns of the lens, with all that was added to it.
    variance_inflation : float
        Variance of the estimate over that with independent errors.
    growth : UnevenGrowth, optional
        What is open of steady growth.

    Returns
    -------
    FocalCourse or None
        None where the focal length is constant.

    """
    model, zoom = fit.motion.zoom, state.zoom
    if model is None or zoom is None:
        return None
    unknowns, f = fit.bundle.unknowns, state.lens['f']
    # of the log of each: that of the mean, and of its own
    rows = np.zeros((len(zoom), len(unknowns)))
    rows[:, unknowns.places(('f',))[0]] = 1 / f
    if model.is_steady:
        rows[:, unknowns.places((RATE_NAME,))[0]] = model.course
    else:
        rows[np.arange(len(zoom)), unknowns.of_views(VIEW_NAME)[:, 0]] = 1
    own = variance_inflation * np.einsum('vi,ij,vj->v', rows, fit.covariance, rows)
    if growth is not None:
        own = own + growth.of_views
    of_mean = covariance[0, 0] - variance_inflation * fit.lens_covariance[0, 0]
    spread = np.sqrt(own + max(of_mean, 0.0) / f**2)
    order = np.argsort(frames)
    fx = f * zoom.scale
    return FocalCourse(np.asarray(frames)[order], fx[order], (fx * spread)[order],
                       model.is_steady)


def course_findings(course: FocalCourse | None) -> tuple[Finding, ...]:
    """Tell how the focal length varied."""
    if course is None:
        return ()
    fx = course.fx
    values = {'first_px': float(fx[0]), 'last_px': float(fx[-1]),
              'fraction': float(fx.max() / fx.min() - 1)}
    if course.is_steady:
        return (Finding('focal_drifts', **values),)
    return (Finding('focal_varies', lowest_px=float(fx.min()), highest_px=float(fx.max()),
                    **values),)
