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
"""Recordings through wide lenses: cameras by their image circle, a drive and a walk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.lenses.catalogue import lens_model
from selfcal_ros.synthetic import worlds
from selfcal_ros.synthetic.paths import drive_path, planar_poses
from selfcal_ros.synthetic.recordings import agv_drive, FIRST_STAMP_NS, Recording

#: k1 to k4 of a common fisheye: near the equidistant map, a little flatter at the rim.
REALISTIC_FISHEYE = (-0.04, 0.008, -0.008, 0.0015)


def wide_camera(circle_deg: float, size: tuple[int, int] = (640, 480),
                coefficients: Sequence[float] = REALISTIC_FISHEYE, model: str = 'equidistant',
                filled: str = 'width', off_centre_px: tuple[float, float] = (5.0, -4.0)) -> Camera:
    """
    Make a camera of which a circle of rays fills the image.

    Parameters
    ----------
    circle_deg : float
        Angle across the circle.
    size : (int, int)
        Width and height.
    coefficients : sequence of float
        Of the lens model.
    model : str
        One of `LENS_MODELS`.
    filled : {'width', 'height', 'diagonal'}
        What of the image is as long as the circle is wide. 'height': the whole circle is seen.
    off_centre_px : (float, float)
        Principal point from the middle of the image.

    Returns
    -------
    Camera

    Raises
    ------
    ArgumentError
        If the lens does not reach that far.

    """
    width, height = size
    lengths = {'width': width, 'height': height, 'diagonal': np.hypot(width, height)}
    if filled not in lengths:
        raise ArgumentError(f'The circle fills one of {", ".join(lengths)}, not {filled!r}.')
    lens, values = lens_model(model), np.zeros(len(lens_model(model).coefficients))
    values[:len(coefficients)] = coefficients
    half = np.deg2rad(circle_deg) / 2
    reach = lens.widest_angle(values)
    if not 0 < half <= reach:
        raise ArgumentError(f'This lens sees a circle of {np.rad2deg(2 * reach):.0f}° at most, '
                            f'not {circle_deg:g}°.')
    edge = lens.image(np.array([np.sin(half), 0.0, np.cos(half)]), values).xy
    f = 0.5 * lengths[filled] / np.hypot(*edge)
    cx, cy = (np.array(size) - 1) / 2 + off_centre_px
    return Camera([[f, 0, cx], [0, f, cy], [0, 0, 1]], values, width, height, model)


def fisheye_drive(views: int = 24, circle_deg: float = 150.0, camera: Camera | None = None,
                  **options: Any) -> Recording:
    """
    Drive an S through the hall of `agv_drive` with a wide lens.

    Parameters
    ----------
    views : int
    circle_deg : float
        Angle across the image circle; the image is black beyond.
    camera : Camera, optional
        Default: `wide_camera(circle_deg)`.
    **options
        Of `agv_drive`.

    Returns
    -------
    Recording

    """
    drive = agv_drive(views, camera=camera or wide_camera(circle_deg), **options)
    made = {**drive.made, 'function': 'fisheye_drive', 'circle_deg': circle_deg}
    return replace(drive, name='fisheye_drive', circle_deg=circle_deg, made=made)


def hand_walk(views: int = 24, circle_deg: float | None = None, camera: Camera | None = None,
              noise_sigma: float = 1.0, rate_hz: float = 15.0, seed: int = 5) -> Recording:
    """
    Carry a camera by hand through the hall: it turns and moves about all axes.

    Parameters
    ----------
    views : int
        Number of images along the path, which is the same for every number.
    circle_deg : float, optional
        Angle across the image circle; None: none, the whole image sees.
    camera : Camera, optional
        Default: `wide_camera` of 150°.
    noise_sigma, rate_hz, seed
        As in `agv_drive`.

    Returns
    -------
    Recording

    """
    if views < 2:
        raise ArgumentError(f'A recording of this kind needs at least 2 views, not {views!r}.')
    made = {'function': 'hand_walk', 'views': views, 'circle_deg': circle_deg,
            'noise_sigma': noise_sigma, 'rate_hz': rate_hz, 'seed': seed}
    surfaces = worlds.hall(np.random.default_rng([seed, 0]), *drive_path(200))
    path_xy, heading_rad = drive_path(views)
    poses = planar_poses(path_xy, heading_rad, 1.3, 0.0, 15.0)
    # slow waves with periods that do not divide each other
    wave = np.sin(np.multiply.outer(np.linspace(0, 2 * np.pi, views),
                                    [1.9, 1.3, 2.3, 1.7, 2.9, 1.1]) + np.arange(6))
    turn = Rotation.from_rotvec(wave[:, :3] * [0.35, 0.3, 0.45]).as_matrix()
    shift = wave[:, 3:] * [0.25, 0.25, 0.2]
    poses = np.concatenate([turn @ poses[:, :, :3],
                            turn @ (poses[:, :, 3:] + shift[:, :, None])], axis=2)
    stamps = FIRST_STAMP_NS + np.rint(np.arange(views) * 1e9 / rate_hz).astype(np.int64)
    return Recording('hand_walk', camera or wide_camera(circle_deg or 150.0), poses, stamps,
                     surfaces, noise_sigma=noise_sigma, seed=seed, made=made,
                     circle_deg=circle_deg)
