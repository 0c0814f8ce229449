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
"""`selfcal compare`: how far apart two calibrations are, in pixels over the image."""

from __future__ import annotations

import argparse

from selfcal_ros.cli.status import EXIT_DONE
from selfcal_ros.errors import InputError

#: Points a side of the grid on which two cameras are compared.
GRID = 25


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `selfcal compare`."""
    parser.add_argument('first', metavar='A.YAML', help='calibration file')
    parser.add_argument('second', metavar='B.YAML', help='calibration file of the same image size')


def run(args: argparse.Namespace) -> int:
    """Compare; returns the exit status."""
    import numpy as np
    from selfcal_ros.geometry.camera import PARAMETER_NAMES
    from selfcal_ros.report.camera_yaml import read_camera_yaml
    cameras = [read_camera_yaml(path)[0] for path in (args.first, args.second)]
    sizes = [(camera.width, camera.height) for camera in cameras]
    if sizes[0] != sizes[1]:
        raise InputError(f'{args.first} is for {sizes[0][0]}x{sizes[0][1]} pixels, {args.second} '
                         f'for {sizes[1][0]}x{sizes[1][1]}; compare calibrations of one size.')
    print(f'{"":>6} {"A":>12} {"B":>12} {"B - A":>12}')
    for name, a, b in zip(PARAMETER_NAMES, *(camera.parameters for camera in cameras)):
        print(f'{name:>6} {a:>12.5g} {b:>12.5g} {b - a:>+12.5g}')
    distance = pixel_difference(*cameras)
    print(f'Over the image, after the rotation that brings them closest: '
          f'{np.nanmean(distance):.3f} px on average, {np.nanmax(distance):.3f} px at most.')
    return EXIT_DONE


def pixel_difference(a, b):
    """
    Compare where two cameras see the same rays.

    A rotation of one camera against the other cannot be told from a shift of its principal point
    by looking at images, so the best one is taken out first.

    Parameters
    ----------
    a, b : Camera
        Of one image size.

    Returns
    -------
    ndarray, shape (GRID, GRID)
        Pixels; NaN where the distortion cannot be undone.

    """
    import numpy as np
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation
    u, v = np.meshgrid(np.linspace(0, a.width - 1, GRID), np.linspace(0, a.height - 1, GRID))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays = a.normalised(pixels)
    good = np.isfinite(rays).all(axis=1)
    if not good.any():
        raise InputError('The distortion of the first calibration cannot be undone anywhere in '
                         'the image.')
    rays = np.column_stack([rays[good], np.ones(good.sum())])

    def difference(vector):
        return b.project(Rotation.from_rotvec(vector).apply(rays)) - pixels[good]

    best = least_squares(lambda vector: difference(vector).ravel(), np.zeros(3), x_scale=0.01)
    distance = np.full(len(pixels), np.nan)
    distance[good] = np.linalg.norm(difference(best.x), axis=1)
    return distance.reshape(GRID, GRID)
