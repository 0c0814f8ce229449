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
The constraint that points lie ahead of the camera, for a lens that the images leave open.

Beside large rotations a short lever leaves a valley. Along it the focal length grows and all
points move away, through infinity and on behind the camera. Images alone do not say where in it
the truth lies, but a part of it would put points where nothing can be seen. That the inverse depth
ρ of a point is positive is a measurement like any other. With the lens at x, and what the images
say of ρ there, a Gaussian of mean ρ(x) and sigma s, its likelihood is

    P(ρ > 0 | x) = Φ(ρ(x) / s),

and that of all points is their product. Some tracks go astray, and stand for no point: of each a
small share tells nothing. Along the valley the product is summed up numerically (Hartley and
Zisserman 2004, chapter 21, on points ahead as an inequality).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from selfcal_ros.calibration.bundle.depths import inverse_depths, share_behind
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.uncertainty.lens_posterior import LensPosterior, moved_lens
from selfcal_ros.geometry.chain_inverse import ChainInverse

#: Share of the tracks that may stand for no point.
ASTRAY = 0.02
#: Places along the valley, in sigmas of what the images say. Beyond them they are contradicted.
PLACES = np.linspace(-6.0, 6.0, 481)
#: The valley is bent: it is looked at anew so often, or until the place moves by so few sigmas.
ROUNDS, SETTLED = 4, 0.1
#: The cost along the valley may rise by so much more than twice what the sigmas say.
MOST_RISE = 2.0
#: A sigma that is narrowed by less than this share, and a place that moves by less, stay.
LEAST_CHANGE = 0.01


@dataclass(frozen=True)
class _Depths:
    """
    Inverse depths over their sigmas, and how they follow the lens.

    Attributes
    ----------
    value : ndarray, shape (P,)
    by_lens : ndarray, shape (P, k)
        Derivatives by the free unknowns of the lens, path and points following.

    """

    value: np.ndarray
    by_lens: np.ndarray


def points_ahead(fit: RobustFit, state: SceneState, covariance: np.ndarray,
                 residual: np.ndarray) -> tuple[LensPosterior | None, float]:
    """
    Weigh an estimate by the knowledge that all points lie before the camera.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    state : SceneState
        The estimate, near that optimum.
    covariance : ndarray, shape (k, k)
        Of the unknowns of the lens block, all errors included.
    residual : ndarray, shape (N, 2)
        What the estimate leaves, pixels.

    Returns
    -------
    LensPosterior or None
        None where it tells nothing, or cannot be told.
    share : float
        Of the points that remain behind by more than noise; see `share_behind`.

    """
    lens = fit.bundle.unknowns.lens
    free = np.flatnonzero(fit.bundle.unknowns.free[lens])
    at, place, after, settled = replace(fit, state=state), 0.0, None, False
    before = share_behind(at)
    prior, values = covariance[np.ix_(free, free)], state.lens.values
    if isinstance(fit.covariance, ChainInverse) or not (np.diag(prior) > 0).all():
        return None, before
    for _ in range(ROUNDS):
        depths = _depths(at, free)
        valley = _valley(depths, prior)
        offset = depths.by_lens @ (at.state.lens.values - values)[free]
        mean, sigma = _summed_up(depths.value - offset, depths.by_lens @ valley)
        step = np.zeros(len(values))
        step[free] = values[free] + mean * valley - at.state.lens.values[free]
        moved = moved_lens(at, at.state, step, residual)
        if moved is None:
            return None, before
        at, residual = replace(fit, state=moved[0]), moved[1]
        narrowed = covariance.copy()
        narrowed[np.ix_(free, free)] -= (1 - sigma**2) * np.outer(valley, valley)
        after = LensPosterior(moved[0], narrowed, residual)
        settled, place = abs(mean - place) < SETTLED, mean
        if settled:
            break
    share = share_behind(at)
    # what lies so far along the valley, or costs so much more than its distance, is not known
    rise = fit.bundle.cost(at.state) - fit.bundle.cost(state)
    if not settled or abs(place) > PLACES[-1] / 2 or rise > place**2 + MOST_RISE:
        return None, max(before, share)
    changed = abs(place) > LEAST_CHANGE or sigma < 1 - LEAST_CHANGE
    return (after if changed else None), share


def _depths(fit: RobustFit, free: np.ndarray) -> _Depths:
    """Return inverse depths over what the images leave of them with the lens held."""
    system = fit.information.system
    along = fit.state.tangents[:, 3]
    half = np.einsum('pij,pj->pi', system.inverse_root, along)
    half /= np.maximum(np.linalg.norm(half, axis=1), 1e-300)[:, None]
    followed = system.point_rows(half)
    value = inverse_depths(fit)
    side = np.where(value * fit.state.points[:, 3] < 0, -1.0, 1.0)
    followed *= side[:, None]
    # of the path, what the lens does not settle widens every depth
    covariance = fit.information.covariance
    assert not isinstance(covariance, ChainInverse)
    inverse = covariance / fit.information.factor
    with_lens = followed @ inverse[:, free]
    of_lens = np.linalg.inv(inverse[np.ix_(free, free)])
    by_lens = with_lens @ of_lens
    left = np.einsum('pn,pn->p', followed @ inverse, followed) - np.einsum(
        'pk,pk->p', by_lens, with_lens)
    wider = np.sqrt(1 + np.maximum(left, 0))
    return _Depths(value / wider, by_lens / wider[:, None])


def _valley(depths: _Depths, prior: np.ndarray) -> np.ndarray:
    """Return the step (k,) of one sigma that moves the points on the wrong side most."""
    behind = depths.value < 0
    wrong = behind if behind.mean() < 0.5 else ~behind
    # near points change by more, and every one counts as much
    follows = np.einsum('pk,kl,pl->p', depths.by_lens, prior, depths.by_lens)
    slope = (depths.by_lens / np.sqrt(np.maximum(follows, 1e-300))[:, None])[
        wrong if wrong.any() else slice(None)].mean(axis=0)
    valley: np.ndarray = prior @ slope / np.sqrt(slope @ prior @ slope)
    return valley


def _summed_up(value: np.ndarray, slope: np.ndarray) -> tuple[float, float]:
    """
    Return mean and sigma of the place along the valley, in sigmas of what the images say.

    Parameters
    ----------
    value, slope : ndarray, shape (P,)
        Inverse depths in their sigmas at the estimate, and by the place.

    """
    depth = value[:, None] + slope[:, None] * PLACES
    # the mirror image of a scene, beyond infinity, has all points on the other side
    likelihood = np.logaddexp(*(
        np.log(ASTRAY + (1 - ASTRAY) * ndtr(side * depth)).sum(axis=0) for side in (1, -1)))
    likelihood -= 0.5 * PLACES**2
    weight = np.exp(likelihood - likelihood.max())
    weight /= weight.sum()
    mean = float(weight @ PLACES)
    return mean, float(np.sqrt(weight @ (PLACES - mean)**2))
