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
"""Which parameters the data determine, which a stated fact holds, and which neither."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES
from selfcal_ros.values.parameter_status import Status

#: A parameter counts as unobservable when its sigma exceeds these. Focal lengths, as a share of
#: themselves: beyond 15 % a guess from the lens's data sheet is as good. Principal point, as a
#: share of the image's diagonal, and skew, as a share of the focal length: no better than
#: assuming the middle and zero. Distortion: sigma of the displacement at the image's corner, as
#: a share of the corner's distance from the middle.
FOCAL_FRACTION = 0.15
PRINCIPAL_POINT_FRACTION = 0.10
SKEW_FRACTION = 0.10
DISTORTION_FRACTION = 0.15
#: The circle of a fisheye ends here at the latest, about: radius over focal length.
WIDEST_SEEN_RAD = 1.6
#: What exceeds these by such a factor on a share of the tracks does so with all of them, too.
UNOBSERVABLE_FACTOR = 1.5
#: No images are measured better than this. What is smaller is a simulation's rounding, by which
#: even what no image tells seems to be determined.
LEAST_NOISE_PX = 0.02


def held_facts(facts: CameraFacts) -> dict[str, str]:
    """
    Name the fact that holds each held parameter.

    Parameters
    ----------
    facts : CameraFacts

    Returns
    -------
    dict of str to str
        Keys among the camera's parameters. An exact aspect ratio ties fy to fx; it holds neither.

    """
    held = {}
    if facts.skew is not None and facts.skew_sigma_px == 0:
        held['skew'] = f'skew = {facts.skew:g}'
    if facts.principal_point is not None and facts.principal_point_sigma_px == 0:
        held['cx'] = held['cy'] = 'principal point = ({:g}, {:g})'.format(*facts.principal_point)
    model, free = LENS_CHOICES.get(facts.distortion, LENS_CHOICES['none'])
    for name in model.coefficients:
        if name not in free:
            held[name] = f'distortion = {facts.distortion}'
    return held


def without_held(covariance: np.ndarray, camera: Camera, facts: CameraFacts) -> np.ndarray:
    """
    Return a covariance (k, k) of a camera's parameters with zeros for what facts hold.

    Parameters
    ----------
    covariance : ndarray, shape (k, k)
    camera : Camera
    facts : CameraFacts

    Returns
    -------
    ndarray, shape (k, k)

    """
    held = held_facts(facts)
    free = np.array([name not in held for name in camera.parameter_names])
    # what is held may have come out infinite
    cleared: np.ndarray = np.where(np.outer(free, free), covariance, 0.0)
    return cleared


def observability_limits(camera: Camera) -> np.ndarray:
    """Sigma beyond which each of the camera's parameters counts as unobservable, shape (k,)."""
    diagonal = float(np.hypot(camera.width, camera.height))
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    corner, lens = diagonal / 2 / fx, camera.lens
    if not lens.is_perspective:
        # beyond the circle that a fisheye lights there is no image to be wrong
        corner = min(corner, WIDEST_SEEN_RAD)
    return np.array([
        FOCAL_FRACTION * fx, FOCAL_FRACTION * fy, PRINCIPAL_POINT_FRACTION * diagonal,
        PRINCIPAL_POINT_FRACTION * diagonal, SKEW_FRACTION * fx,
        *(DISTORTION_FRACTION / lens.corner_displacement(name, corner)
          for name in lens.coefficients)])


def parameter_status(camera: Camera, covariance: np.ndarray, facts: CameraFacts,
                     noise_px: float = LEAST_NOISE_PX) -> dict[str, Status]:
    """
    Tell 'estimated', 'held' or 'unobservable' for each of the camera's parameters.

    Parameters
    ----------
    camera : Camera
        With its image size.
    covariance : ndarray, shape (k, k)
    facts : CameraFacts
    noise_px : float
        What the covariance is for; below `LEAST_NOISE_PX`, it is judged for that.

    Returns
    -------
    dict of str to str

    """
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0))
    sigma *= max(LEAST_NOISE_PX / noise_px, 1.0)
    held = held_facts(facts)
    status: dict[str, Status] = {}
    for name, value, limit in zip(camera.parameter_names, sigma,
                                  observability_limits(camera)):
        if name in held:
            status[name] = 'held'
        else:
            status[name] = 'estimated' if value <= limit else 'unobservable'
    return status
