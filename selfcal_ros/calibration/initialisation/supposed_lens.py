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
Cameras that are supposed, for starts: a focal length, and the bend that pairs of views show.

Epipolar geometry shows how a lens bends before anything is known of its focal length: the
division model, tan θ = (r / f) / (1 + λ r² + κ r⁴) (Fitzgibbon 2001). A supposed focal length
makes angles of it, and the lens model at hand is fitted to them.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts, supposed_matrix
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES
from selfcal_ros.geometry.lenses.model import fitted_coefficients, LensModel

#: A bend λ, in half image diagonals, beyond which a lens is started as a fisheye: its polynomial
#: of the angle follows a barrel as well, and does not fold.
STRONG_BEND = -0.15
#: Square of the radius about which λ alone stands for λ and κ.
_USUAL_SQUARE = 0.35
#: λ f² of a fisheye without distortion of its own, about; a stereographic one has -1/4.
EQUIDISTANT_BEND = -0.36
#: Rays that a perspective is fitted to lie within this angle of the axis.
WIDEST_PERSPECTIVE = np.radians(80.0)
_RADII = 60
#: λ, or λ and κ, for radii in half image diagonals; empty for straight lines.
Bend = tuple[float, ...]
#: Coefficients that starts leave zero: decentring, and what bends the outermost image alone.
_WAITING = ('p1', 'p2', 'k3', 'k4', 'k5', 'k6')


def supposed_camera(focal_px: float, size: tuple[int, int], facts: CameraFacts,
                    bend: Bend = ()) -> Camera:
    """
    Suppose a focal length; what no fact states is what most cameras have.

    Parameters
    ----------
    focal_px : float
    size : (int, int)
        Width and height of the image.
    facts : CameraFacts
    bend : tuple of float
        λ, or λ and κ, for radii in half image diagonals; none for straight lines.

    Returns
    -------
    Camera

    """
    model, names = supposed_model(facts, bend)
    half = float(np.hypot(*size)) / 2
    coefficients = np.zeros(len(model.coefficients))
    if is_strong(bend):
        coefficients = bent(model, names, bend, half / focal_px)
    K = supposed_matrix(focal_px, size, facts)
    try:
        return Camera(K, coefficients, size[0], size[1], model.name)
    except ArgumentError:
        # no lens of this family bends so: the adjustment begins without
        return Camera(K, (), size[0], size[1], model.name)


def supposed_model(facts: CameraFacts, bend: Bend) -> tuple[LensModel, tuple[str, ...]]:
    """Return the lens model of starts, and the coefficients that they may give it."""
    stated = facts.distortion
    if stated == 'auto':
        stated = 'radial2'
    # whatever is stated: a polynomial of the radius folds before it has found its place
    if is_strong(bend) and len(LENS_CHOICES[stated][1]) > 1:
        stated = 'equidistant'
    model, names = LENS_CHOICES[stated]
    if model.is_perspective:
        names = tuple(name for name in names if name not in _WAITING)
    return model, names


def is_strong(bend: Bend) -> bool:
    """Tell whether a lens bends so much that it is started as a fisheye."""
    return overall(bend) < STRONG_BEND


def overall(bend: Bend) -> float:
    """Return the one λ that is nearest to λ and κ."""
    return float(sum(value * _USUAL_SQUARE**k for k, value in enumerate(bend)))


def bent(model: LensModel, names: tuple[str, ...], bend: Bend, corner: float) -> np.ndarray:
    """
    Fit a lens model to a division model.

    Parameters
    ----------
    model : LensModel
    names : tuple of str
        Coefficients that may differ from zero.
    bend : tuple of float
        λ, or λ and κ, for radii in half image diagonals.
    corner : float
        Half the diagonal over the focal length.

    Returns
    -------
    ndarray, shape (k,)

    """
    radius = np.linspace(0, 1, _RADII + 1)[1:]
    straightened = 1 + sum(value * radius**(2 * k) for k, value in enumerate(bend, 1))
    rays = np.column_stack([corner * radius, np.zeros(_RADII), straightened])
    if model.is_perspective:
        seen = np.arctan2(rays[:, 0], rays[:, 2]) < WIDEST_PERSPECTIVE
        rays, radius = rays[seen], radius[seen]
    return fitted_coefficients(model, names, rays,
                               np.column_stack([corner * radius, np.zeros(len(radius))]))


def likely_focal_lengths(size: tuple[int, int], bend: Bend, sweep: tuple[float, ...],
                         ) -> list[float]:
    """
    Return focal lengths to try, pixels, the likely ones first.

    Parameters
    ----------
    size : (int, int)
    bend : tuple of float
    sweep : tuple of float
        Usual ones, in longer image sides.

    """
    usual = [share * max(size) for share in sweep]
    if not is_strong(bend):
        return usual
    fisheye = float(np.hypot(*size)) / 2 * float(np.sqrt(EQUIDISTANT_BEND / overall(bend)))
    return [factor * fisheye for factor in (1.0, 0.8, 1.25, 0.6, 1.6, 2.2)]
