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
Does something move every view by itself, in a way that neither path nor camera explains?

What an optimum says by one linear step: derivatives by what each view may have of its own are
appended to its normal equations, and everything else is eliminated. So is what all views share: a
mean, which a lens may feign, and an aspect ratio or a skew that a fact may have wrong. The size is
the one under which the images are most probable (type-II maximum likelihood; Bishop 2006, 3.5).
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.estimators.zoom_selection import zoomed_fit
from selfcal_ros.calibration.uncertainty.distortion_misfit import displacement_modes
from selfcal_ros.calibration.uncertainty.focal_course import focal_evidence
from selfcal_ros.calibration.uncertainty.random_effects import most_probable_size
from selfcal_ros.calibration.uncertainty.suppositions import joint_information, Supposition

#: Degree of the polynomials that all images may be displaced by, as a lens does.
HIGHEST_DEGREE = 4


def evidence_of_views(fit: RobustFit, size: tuple[int, int], effect: Supposition,
                      sizes: np.ndarray) -> tuple[float, float]:
    """
    Tell how large something is that every view has of its own, and how sure that is.

    Parameters
    ----------
    fit : RobustFit
        At its optimum, without it.
    size : (int, int)
        Width and height of the image.
    effect : Supposition
        Of views, m unknowns each.
    sizes : ndarray, shape (s,)
        Standard deviations that are tried.

    Returns
    -------
    size : float
        One of `sizes`.
    gain : float
        Log of the probability over that without the effect, were the errors independent. What
        moves views makes those of neighbours in an image alike, so that is no argument against it.

    """
    bundle, lens = fit.bundle, fit.state.lens
    projected = bundle.xy + fit.linearisation.residual
    seen = projected - lens.values[2:4]
    free = dict(zip(lens.names, bundle.unknowns.free[bundle.unknowns.lens]))
    none = np.zeros(len(seen))
    shared = [Supposition(name, (name,), np.column_stack(columns)[:, :, None] / max(size))
              for name, columns in (('aspect', (none, seen[:, 1])), ('skew', (seen[:, 1], none)))
              if not free[name]]
    # what a lens does beyond the simple model of the first fit differs from view to view, too
    field = displacement_modes(projected, size, HIGHEST_DEGREE)
    shared.append(Supposition('field', ('field',) * field.shape[2], field))
    joint = joint_information(fit, [*shared, effect], 1.0)
    # what all views share: the further unknowns before these, and the mean of these
    of_views, each = joint.places[effect.name], len(effect.unknowns)
    common = np.zeros((len(joint.score), of_views.min() + each))
    common[np.arange(of_views.min()), np.arange(of_views.min())] = 1
    common[of_views, of_views.min() + np.arange(each)] = 1
    by_common, own = joint.information @ common, of_views.ravel()
    follows = np.linalg.lstsq(common.T @ by_common, np.column_stack(
        [by_common[own].T, common.T @ joint.score]), rcond=1e-9)[0]
    left = joint.information[np.ix_(own, own)] - by_common[own] @ follows[:, :-1]
    pull = joint.score[own] - by_common[own] @ follows[:, -1]
    values, vectors = np.linalg.eigh((left + left.T) / 2)
    return most_probable_size(np.maximum(values, 0), vectors.T @ pull, sizes)


def left_otherwise_px(fit: RobustFit, instants: tuple[float, ...], gain: float) -> float:
    """Return the noise that is left without an effect, with a zoom if that gains more."""
    left_px = fit.bundle.sigma_px
    evidence = None if fit.motion.zoom is not None else focal_evidence(fit, instants, 1.0)
    if evidence is None or evidence.gain < gain:
        return left_px
    zoomed = zoomed_fit(fit, instants)
    return min(left_px, zoomed.bundle.noise_rms(zoomed.state))
