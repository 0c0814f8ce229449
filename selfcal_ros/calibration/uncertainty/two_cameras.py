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
Images of two cameras in one folder: views that fall into two groups.

Every view gets a focal length and a principal point of its own, as further unknowns of the
optimum. Of all ways to part the views in two, the one is sought whose difference of cameras the
images favour most. It counts where it explains nearly all that views differ by: two levels explain
at most three quarters of a steady change, and 81 % of a sine. Where one camera follows the other
without alternating, they must differ in more than the focal length: else the lens was set anew.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.uncertainty.suppositions import (joint_information, JointInformation,
                                                              Supposition)
from selfcal_ros.geometry.distributions import chi2_sf

#: Views differ where that they do not would be an accident so rarely.
ACCIDENT = 1e-8
#: Share of what the views differ by that two cameras explain, at least.
EXPLAINED_SHARE = 0.85
#: Changes from one camera to the other that no zoom makes. With fewer, the principal point must
#: tell as much as the second, and as that share of all, in chi-square.
CHANGES, OF_PRINCIPAL_POINT = 3, (50.0, 0.2)
#: Two kinds of focal lengths are two where they spread by less than this share of the gap about a
#: common bend; an even spread would have 0.3.
TIGHT = 0.1
#: Rounds of single views that change sides.
ROUNDS = 100
_CAMERA = 'one camera'


def two_cameras(fit: RobustFit, variance_inflation: float) -> np.ndarray | None:
    """
    Look for images of two cameras.

    Parameters
    ----------
    fit : RobustFit
        At its optimum, of one camera.
    variance_inflation : float
        Variance of the estimate over that with independent errors.

    Returns
    -------
    ndarray of bool, shape (V,)
        Views of the camera that did not take the first; None where there is one camera.

    """
    shared, f = fit.linearisation.shared, fit.state.lens['f']
    places = fit.state.lens.places(('f', 'cx', 'cy'))
    # in units of the focal length, all three
    own = Supposition(_CAMERA, ('f', 'cx', 'cy'), f * shared[:, :, places], True)
    joint = joint_information(fit, [own], variance_inflation)
    views = len(joint.places[_CAMERA])
    every = joint.test_along(np.eye(len(joint.score)), _CAMERA, ('f',) * len(joint.score))
    if views < 6 or chi2_sf(every.chi2, every.freedom) > ACCIDENT:
        return None
    starts = (np.arange(views) % 2 == 1, np.arange(views) >= views // 2, *_halves(joint))
    found = [_improved(joint, start) for start in starts]
    total, second = max(found, key=lambda one: one[0])
    total *= joint.pull**2 / joint.factor
    if total - 3 < EXPLAINED_SHARE * (every.chi2 - every.freedom):
        return None
    if fit.observations.shutter is not None and len(set(second[1:-1].tolist())) < 2:
        # of the first and the last view few rows count, and those tell no camera
        return None
    if np.count_nonzero(np.diff(second)) < CHANGES:
        focal = np.zeros((len(joint.score), 1))
        focal[joint.places[_CAMERA][second, 0]] = 1
        of_point = total - joint.test_along(focal, _CAMERA, ('f',)).chi2
        least, share = OF_PRINCIPAL_POINT
        if of_point < max(least, share * total):
            return None
    # the first image is the first camera's; which is which says nothing else
    cameras: np.ndarray = second ^ second[0]
    return cameras


def two_focal_lengths(log_focal: np.ndarray) -> np.ndarray | None:
    """
    Look for two cameras among views that each have a focal length.

    Parameters
    ----------
    log_focal : ndarray, shape (V,)

    Returns
    -------
    ndarray of bool, shape (V,)
        Views of the longer focal length; None where the focal lengths are not of two kinds that
        alternate.

    """
    views = len(log_focal)
    # another principal point bends both kinds alike
    bend = np.polynomial.legendre.legvander(np.linspace(-1, 1, views), min(3, views // 5))
    straight = log_focal - bend @ np.linalg.lstsq(bend, log_focal, rcond=None)[0]
    ordered = np.sort(straight)
    second = straight > ordered[np.argmax(np.diff(ordered))]
    if min(second.sum(), (~second).sum()) < 2 or np.count_nonzero(np.diff(second)) < CHANGES:
        return None
    levels = np.column_stack([bend, second])
    found = np.linalg.lstsq(levels, log_focal, rcond=None)[0]
    spread = np.linalg.norm(log_focal - levels @ found) / np.sqrt(max(views - len(found), 1))
    return second if spread < TIGHT * found[-1] else None


def _halves(joint: JointInformation) -> list[np.ndarray]:
    """Part the views by their own focal length, and by their own principal point."""
    ridge = 1e4 * np.eye(len(joint.score))
    own = -np.linalg.solve(joint.information + ridge, joint.score)[joint.places[_CAMERA]]
    return [column > np.median(column) for column in own.T]


def _improved(joint: JointInformation, second: np.ndarray) -> tuple[float, np.ndarray]:
    """Let views change sides while the images favour it; returns uᵀ J⁻¹ u and the sides."""
    place = joint.places[_CAMERA]
    views = len(place)
    u = joint.score[place]
    J = joint.information[place.ravel()[:, None], place.ravel()].reshape(views, 3, views, 3)
    own = np.einsum('vivj->vij', J)
    best = -np.inf
    for _ in range(ROUNDS):
        across = np.einsum('viwj,w->vij', J, second.astype(float))
        total = np.einsum('vij,v->ij', across, second.astype(float))
        sign = np.where(second, -1.0, 1.0)[:, None]
        scores = u[second].sum(axis=0) + np.vstack([np.zeros(3), sign * u])
        change = sign[..., None] * (across + np.swapaxes(across, 1, 2)) + own
        matrices = total + np.concatenate([np.zeros((1, 3, 3)), change])
        ridge = 1e-9 * np.einsum('vii->v', own).max() * np.eye(3)
        solved = np.linalg.solve(matrices + ridge, scores[..., None])[..., 0]
        gains = np.einsum('vi,vi->v', scores, solved)
        # one view alone is no camera
        count = second.sum() + np.r_[0, np.where(second, -1, 1)]
        gains[(count < 2) | (count > views - 2)] = -np.inf
        step = int(np.argmax(gains))
        if gains[step] <= best * (1 + 1e-9) + 1e-9:
            break
        best = float(gains[step])
        if step:
            second = second.copy()
            second[step - 1] ^= True
    return best, second
