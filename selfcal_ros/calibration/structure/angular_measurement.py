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
What the uncertainty of a calibration means for angles that are measured in its images.

Angles between the rays of two pixels come from the camera alone; first order.
"""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens, Projection
from selfcal_ros.calibration.reconstruction import Measured, StructureSample
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding, sentences
from selfcal_ros.geometry.camera import Camera

#: An angle across the middle of the image that the report speaks of, degrees.
COMMON_ANGLE_DEG = 30.0
#: A ratio or an angle whose sigma is a larger share of it is not told.
SAYS_NOTHING = 0.5


def ray_angles(result: Calibration | NotCalibrated, first: np.ndarray, second: np.ndarray,
               ) -> tuple[np.ndarray, np.ndarray]:
    """
    Angles between the rays of pixels, and what the uncertainty of the camera makes of them.

    Parameters
    ----------
    result : Calibration
    first, second : ndarray, shape (N, 2) or (2,)
        Pixels, exact: add the noise of what is measured there.

    Returns
    -------
    angle, sigma : ndarray, shape (N,)
        Radians; NaN where the distortion cannot be undone.

    Raises
    ------
    ArgumentError
        If there is no calibration, or the pixels are none.

    Examples
    --------
    >>> import numpy as np
    >>> from selfcal_ros import calibrate, CameraFacts, ray_angles
    >>> from selfcal_ros.synthetic.scenes import sequence_si
    >>> scene = sequence_si(np.random.default_rng(0), noise_px=0.1)
    >>> result = calibrate(scene.tracks, facts=CameraFacts(aspect_ratio=1.0, distortion='none'))
    >>> angle, sigma = ray_angles(result, [100, 240], [540, 240])
    >>> a, b = np.append(scene.camera.normalised([[100, 240], [540, 240]]), [[1], [1]], axis=1)
    >>> truth = np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
    >>> bool(abs(angle[0] - truth) < 4 * sigma[0])
    True

    """
    if not isinstance(result, Calibration):
        raise ArgumentError('Angles need a Calibration to be measured with.')
    try:
        first, second = np.broadcast_arrays(np.atleast_2d(np.asarray(first, float)),
                                            np.atleast_2d(np.asarray(second, float)))
    except (TypeError, ValueError):
        first = second = np.zeros(0)
    if first.ndim != 2 or first.shape[1] != 2:
        raise ArgumentError('The pixels must be two arrays of the same shape (N, 2).')
    return angles_between(result.camera, result.covariance, first, second)


def angles_between(camera: Camera, covariance: np.ndarray, first: np.ndarray, second: np.ndarray,
                   ) -> tuple[np.ndarray, np.ndarray]:
    """
    Angles between the rays of pixels, and what the camera's covariance makes of them.

    Parameters
    ----------
    camera : Camera
    covariance : ndarray, shape (k, k)
        Of the camera's parameters.
    first, second : ndarray, shape (N, 2)
        Pixels, exact.

    Returns
    -------
    angle, sigma : ndarray, shape (N,)
        Radians; NaN where the distortion cannot be undone.

    """
    a, along_a = _directions(camera, np.atleast_2d(np.asarray(first, float)))
    b, along_b = _directions(camera, np.atleast_2d(np.asarray(second, float)))
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    cosine = np.einsum('ni,ni->n', a, b)
    slope = -(np.einsum('nik,ni->nk', along_a, b) + np.einsum('nik,ni->nk', along_b, a))
    slope /= np.maximum(sine, 1e-300)[:, None]
    variance = np.einsum('ni,ij,nj->n', slope, np.asarray(covariance, float), slope)
    return np.arctan2(sine, cosine), np.sqrt(np.maximum(variance, 0))


def _directions(camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit rays (N, 3) of pixels, and their derivatives (N, 3, k) by the camera's parameters."""
    rays = camera.rays(pixels)
    model = Projection(Lens.of(camera), rays)
    by_camera = model.by_parameters()
    # the pixel stays: what the parameters move, the ray has to make good
    seen = np.isfinite(rays).all(axis=1)
    change = np.full((len(rays), 3, by_camera.shape[2]), np.nan)
    # across the ray alone: the pseudo-inverse of the derivative by it
    change[seen] = -np.linalg.pinv(model.by_points()[seen]) @ by_camera[seen]
    return rays, change


def fields_of_view(camera: Camera, covariance: np.ndarray) -> dict[str, Measured]:
    """
    Horizontal, vertical and diagonal field of view, edge to edge, in degrees.

    Parameters
    ----------
    camera : Camera
        With its image size.
    covariance : ndarray, shape (k, k)

    Returns
    -------
    dict of str to Measured
        'horizontal' and 'vertical' through the middle of the image, 'diagonal' from corner to
        corner; without those whose ends the distortion does not reach.

    """
    right, bottom = camera.width - 0.5, camera.height - 0.5
    middle = (camera.width - 1) / 2, (camera.height - 1) / 2
    ends = {'horizontal': ((-0.5, middle[1]), (right, middle[1])),
            'vertical': ((middle[0], -0.5), (middle[0], bottom)),
            'diagonal': ((-0.5, -0.5), (right, bottom))}
    first, second = np.array(list(ends.values())).swapaxes(0, 1)
    angle, sigma = np.degrees(angles_between(camera, covariance, first, second))
    # two rays are never more than 180 degrees apart, but a fisheye sees what lies between
    from_axis = [np.degrees(np.arccos(camera.rays(end)[:, 2])) for end in (first, second)]
    angle = np.where(np.add(*from_axis) > 180, 360 - angle, angle)
    return {name: Measured(float(value), float(spread))
            for name, value, spread in zip(ends, angle, sigma) if np.isfinite(value + spread)}


def central_angle(camera: Camera, covariance: np.ndarray) -> Measured | None:
    """
    Sigma of `COMMON_ANGLE_DEG` measured across the middle of the image, along its longer side.

    Parameters
    ----------
    camera : Camera
        With its image size.
    covariance : ndarray, shape (k, k)

    Returns
    -------
    Measured or None
        Degrees; half the field of view where the image does not span the common angle, None
        where the distortion cannot be undone.

    """
    size = np.array([camera.width, camera.height])
    middle = (size - 1) / 2
    axis = np.eye(2)[int(np.argmax(size))]
    along = np.linspace(0.01, 0.5, 400)[:, None] * size.max() * axis
    angle, sigma = np.degrees(angles_between(camera, covariance, middle - along,
                                             middle + along))
    # beyond 180 degrees the angle falls again
    seen = np.isfinite(angle) & np.isfinite(sigma) & (angle == np.fmax.accumulate(angle))
    if not seen.any():
        return None
    wanted = (COMMON_ANGLE_DEG if angle[seen][-1] >= COMMON_ANGLE_DEG >= angle[seen][0]
              else angle[seen][-1] / 2)
    return Measured(float(wanted), float(np.interp(wanted, angle[seen], sigma[seen])))


def measurement_sentences(camera: Camera, covariance: np.ndarray,
                          sample: StructureSample | None = None) -> tuple[str, ...]:
    """Say what the covariance means for what is measured in images of the camera."""
    return sentences(measurement_findings(camera, covariance, sample))


def measurement_findings(camera: Camera, covariance: np.ndarray,
                         sample: StructureSample | None = None) -> tuple[Finding, ...]:
    """Tell what the covariance means for what is measured in images of the camera."""
    found = []
    sized = min(camera.width, camera.height) > 0
    wide = fields_of_view(camera, covariance).get('horizontal') if sized else None
    if wide:
        found.append(Finding('field_of_view', angle_deg=asdict(wide)))
    angle = central_angle(camera, covariance) if sized else None
    if angle:
        found.append(Finding('central_angle', angle_deg=angle.value, sigma_deg=angle.sigma))
    if sample and all(one.sigma < SAYS_NOTHING * one.value
                      for one in (sample.length_ratio, sample.angle_deg)):
        found.append(Finding(
            'typical_measurements', first=sample.first, second=sample.second,
            ratio=asdict(sample.length_ratio), at=sample.corner[1],
            angle_deg=sample.angle_deg.value, sigma_deg=sample.angle_deg.sigma))
    return tuple(found)
