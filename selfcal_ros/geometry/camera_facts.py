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
"""What may be known of a camera beforehand."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import get_args, Literal, TypeAlias, TypeGuard

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES, LensChoice

#: Ways to read the rows of an image.
ShutterChoice: TypeAlias = Literal['auto', 'global', 'rolling']
SHUTTERS: tuple[ShutterChoice, ...] = get_args(ShutterChoice)
#: No image sensor takes longer from one row to the next.
LONGEST_LINE_DELAY_S = 0.01
#: No image sensor takes longer for all of its rows.
LONGEST_READOUT_S = 1.0
#: No window of a larger sensor has its principal point farther from its middle, over its longer
#: side.
FARTHEST_CENTRE = 10
#: The square of a smaller standard deviation has no inverse that a computer can add to others;
#: that of a larger one is no more than 1 / LEAST_SIGMA, and says nothing.
LEAST_SIGMA, LARGEST_SIGMA = 1e-15, 1e15
#: What may be said of the focal length over time.
FocalChoice: TypeAlias = Literal['auto', 'constant', 'varying']
FOCAL_CHOICES: tuple[FocalChoice, ...] = get_args(FocalChoice)


@dataclass(frozen=True)
class CameraFacts:
    """
    What the user knows of the camera beforehand; a fact is data, with a sigma.

    Parameters
    ----------
    aspect_ratio : float, optional
        fy / fx. None: not known.
    skew : float, optional
        Skew in pixels. None: not known.
    principal_point : (float, float), optional
        In pixels. None: not known.
    aspect_ratio_sigma, skew_sigma_px, principal_point_sigma_px : float
        Standard deviation of each fact; 0 means exact, and the parameter is held.
    distortion : {'auto', 'none', 'radial1', 'radial2', 'radial3', 'radtan', 'plumb_bob', \
'rational', 'equidistant'}
        The lens model, and which of its coefficients are estimated; the others are held at
        zero. 'auto': the family and the richest member that the images determine.
    lens_population : bool
        Whether what real lenses are like counts as a measurement, where the lens is estimated.
    trusted : bool
        Whether the facts count also where the images contradict them; else such a calibration
        is refused.
    focal : {'auto', 'constant', 'varying'}
        Whether the focal length is the same in all views (zoom, refocusing, warm-up). 'auto':
        constant, unless the images contradict.
    shutter : {'auto', 'global', 'rolling'}
        Whether all rows are read at once or one after the other; 'auto': found out. Either is
        held against the images.
    line_delay_s : float, optional
        Seconds from one row to the next, negative from the lowest row up. None: not known.
    line_delay_sigma_s : float
        Its standard deviation; 0 means exact.

    Raises
    ------
    ArgumentError
        If a value is impossible.

    References
    ----------
    M. N. Armstrong (1996), section 5.3: what each fact determines.

    Examples
    --------
    Square pixels, exactly, and a principal point that is known to 20 px:

    >>> from selfcal_ros import CameraFacts
    >>> facts = CameraFacts(aspect_ratio=1.0, skew=0.0, principal_point=(320, 240),
    ...                     principal_point_sigma_px=20.0)
    >>> facts.principal_point
    (320.0, 240.0)

    """

    aspect_ratio: float | None = None
    skew: float | None = None
    principal_point: tuple[float, float] | None = None
    aspect_ratio_sigma: float = 0.0
    skew_sigma_px: float = 0.0
    principal_point_sigma_px: float = 0.0
    distortion: LensChoice = 'auto'
    lens_population: bool = True
    trusted: bool = False
    focal: FocalChoice = 'auto'
    shutter: ShutterChoice = 'auto'
    line_delay_s: float | None = None
    line_delay_sigma_s: float = 0.0

    def __post_init__(self) -> None:
        """Refuse impossible facts."""
        if self.focal not in FOCAL_CHOICES:
            raise ArgumentError(f'The focal length is one of {", ".join(FOCAL_CHOICES)}, not '
                                f'{self.focal!r:.40}.')
        if self.distortion not in ('auto', *LENS_CHOICES):
            raise ArgumentError(f'Distortion model {self.distortion!r:.40} is unknown; choose one '
                                f'of auto, {", ".join(LENS_CHOICES)}.')
        if self.aspect_ratio is not None and not (
                is_number(self.aspect_ratio) and 0.1 <= self.aspect_ratio <= 10):
            raise ArgumentError('The aspect ratio fy/fx must lie between 0.1 and 10, '
                                f'not {self.aspect_ratio!r}.')
        if self.skew is not None and not is_number(self.skew):
            raise ArgumentError(f'The skew must be a finite number, not {self.skew!r}.')
        if self.principal_point is not None:
            try:
                point = tuple(float(v) for v in self.principal_point)
            except (TypeError, ValueError):
                point = ()
            if len(point) != 2 or not all(map(math.isfinite, point)):
                raise ArgumentError('The principal point must be two finite numbers, '
                                    f'not {self.principal_point!r:.80}.')
            object.__setattr__(self, 'principal_point', point)
        if self.shutter not in SHUTTERS:
            raise ArgumentError(f'Shutter {self.shutter!r:.40} is unknown; choose one of '
                                f'{", ".join(SHUTTERS)}.')
        if self.line_delay_s is not None and not (
                is_number(self.line_delay_s) and abs(self.line_delay_s) < LONGEST_LINE_DELAY_S):
            raise ArgumentError('The line delay is that of a rolling shutter, in seconds from one '
                                f'row to the next, not {self.line_delay_s!r}: 480 rows that are '
                                'read in 20 ms have 4.2e-05.')
        if self.line_delay_s is not None and self.shutter == 'global':
            raise ArgumentError('A line delay is that of a rolling shutter, and the shutter is '
                                'stated as global; leave one of them out.')
        for name in ('aspect_ratio_sigma', 'skew_sigma_px', 'principal_point_sigma_px',
                     'line_delay_sigma_s'):
            value = getattr(self, name)
            if not is_sigma(value):
                raise ArgumentError(f'{name} must be 0 for exact, or a number from '
                                    f'{LEAST_SIGMA:g} to {LARGEST_SIGMA:g}, not {value!r}.')

    def check_for(self, size: tuple[int, int]) -> None:
        """
        Refuse what cannot be true of images of a size, before any work is done.

        Parameters
        ----------
        size : (int, int)
            Width and height of the images, pixels.

        Raises
        ------
        ArgumentError
            If a stated pixel is far outside of the images, or the skew larger than they are. So
            it is where the line delay is more than rows can have.

        """
        images, longer = f'images of {size[0]}x{size[1]} pixels', max(size)
        if self.principal_point is not None:
            u, v = self.principal_point
            if math.hypot(u - size[0] / 2, v - size[1] / 2) > FARTHEST_CENTRE * longer:
                raise ArgumentError(f'The principal point ({u:g}, {v:g}) is far outside of '
                                    f'{images}; state it in their pixels, or leave it open.')
        if self.skew is not None and abs(self.skew) > longer:
            raise ArgumentError(f'A skew of {self.skew:g} px is impossible in {images}; state '
                                'one near 0, or leave it open.')
        if self.line_delay_s is not None and abs(self.line_delay_s) * longer > LONGEST_READOUT_S:
            raise ArgumentError(f'A line delay of {self.line_delay_s:g} s is impossible in '
                                f'{images}; state the seconds from one row to the next, about '
                                f'{1 / 30 / size[1]:.0e}, or leave it open.')


def supposed_matrix(focal_px: float, size: tuple[int, int], facts: CameraFacts) -> np.ndarray:
    """
    Calibration matrix of a supposed focal length; the rest is as stated, or as usual.

    Parameters
    ----------
    focal_px : float
        fx.
    size : (int, int)
        Width and height of the image, pixels. The principal point is in its middle, unless a
        fact states it.
    facts : CameraFacts
        Square pixels and no skew where they do not say otherwise.

    Returns
    -------
    ndarray, shape (3, 3)
        K, pixels.

    """
    u, v = facts.principal_point or ((size[0] - 1) / 2, (size[1] - 1) / 2)
    return np.array([[focal_px, facts.skew or 0.0, u],
                     [0, focal_px * (facts.aspect_ratio or 1.0), v], [0, 0, 1]])


def is_number(value: object) -> TypeGuard[float]:
    """Tell whether something is a finite real number."""
    return isinstance(value, (int, float, np.integer, np.floating)) and math.isfinite(value)


def is_sigma(value: object) -> bool:
    """Tell whether a standard deviation of a fact is zero or has a square and an inverse."""
    return is_number(value) and (value == 0 or LEAST_SIGMA <= value <= LARGEST_SIGMA)
