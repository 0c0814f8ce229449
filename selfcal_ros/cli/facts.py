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
"""What the user states about the camera: options of the command line ↔ `CameraFacts`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from selfcal_ros.geometry.camera_facts import CameraFacts

FREE = 'free'
#: Lens models that can be stated: those of `LENS_CHOICES`, which take NumPy to be imported.
LENSES = ('auto', 'none', 'radial1', 'radial2', 'radial3', 'radtan', 'plumb_bob', 'rational',
          'equidistant')


#: What others call the lenses.
_ELSEWHERE = {'pinhole': 'none', 'brown': 'plumb_bob', 'brown_conrady': 'plumb_bob',
              'opencv': 'plumb_bob', 'rational_polynomial': 'rational', 'fisheye': 'equidistant',
              'equi': 'equidistant', 'kannala_brandt': 'equidistant',
              'opencv_fisheye': 'equidistant'}


def _lens(value: str) -> str:
    """Take a lens; one that others know by another name is told by ours."""
    name = value.lower().replace('-', '_')
    if name in _ELSEWHERE:
        raise argparse.ArgumentTypeError(f'{value} is called {_ELSEWHERE[name]} here')
    return value


def _number_or_free(text: str) -> float | str:
    """Read a number, or the word free."""
    if text == FREE:
        return FREE
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r} is neither a number nor {FREE!r}') from None


def add_fact_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that state facts; square pixels are assumed unless released."""
    group = parser.add_argument_group(
        'facts about the camera', 'Square pixels are taken for granted unless released; with a '
        'known object they are found.')
    group.add_argument('--aspect-ratio', type=_number_or_free, metavar='FY/FX',
                       help='known ratio of the focal lengths, or "free" (default 1.0; free with '
                       '--object)')
    group.add_argument('--aspect-ratio-sigma', type=float, default=0.0, metavar='S',
                       help='standard deviation of the aspect ratio (default 0: exact)')
    group.add_argument('--skew', type=_number_or_free, default=0.0, metavar='PX',
                       help='known skew in pixels, or "free" (default 0)')
    group.add_argument('--skew-sigma', type=float, default=0.0, metavar='PX',
                       help='standard deviation of the skew (default 0: exact)')
    group.add_argument('--principal-point', type=float, nargs=2, metavar=('U', 'V'),
                       help='known principal point in pixels (default: estimated)')
    group.add_argument('--principal-point-sigma', type=float, default=0.0, metavar='PX',
                       help='standard deviation of the principal point (default 0: exact)')
    group.add_argument('--lens', '--distortion', dest='distortion', choices=LENSES, type=_lens,
                       default='auto', help='lens model to estimate: a pinhole with none to three '
                       'radial coefficients, plumb_bob (tangential ones, too), rational, or the '
                       'equidistant fisheye (default auto: the family, and its richest member '
                       'that the images determine); --distortion is the older name')
    group.add_argument('--focal', choices=('auto', 'constant', 'varying'), default='auto',
                       help='whether the focal length is the same in all images, or varies by '
                       'zoom, focus or warm-up (default auto: constant, unless the images '
                       'contradict)')
    group.add_argument('--no-lens-population', dest='lens_population', action='store_false',
                       help='do not count as a measurement what real lenses are like')
    group.add_argument('--trust-facts', action='store_true',
                       help='keep to the facts where the images contradict them, too; else such '
                       'a calibration is refused')
    group.add_argument('--shutter', choices=('auto', 'global', 'rolling'), default='auto',
                       help='whether all rows are read at once, or one after the other (default '
                       'auto: found out, but not with --object); global is refused if the images '
                       'contradict it')
    group.add_argument('--line-delay', type=float, metavar='S',
                       help='known time from one row to the next, in seconds; negative from the '
                       'lowest row up (default: estimated with a rolling shutter); of an upright '
                       'image of a phone, from one column to the next')
    group.add_argument('--line-delay-sigma', type=float, default=0.0, metavar='S',
                       help='standard deviation of the line delay (default 0: exact)')


def facts_from(args: argparse.Namespace, aspect_ratio: float | str = 1.0) -> CameraFacts:
    """
    Turn the options into `CameraFacts`.

    Parameters
    ----------
    args : argparse.Namespace
    aspect_ratio : float or 'free'
        Where the user says nothing of it.

    Raises
    ------
    ArgumentError
        If a value is impossible.

    """
    from selfcal_ros.geometry.camera import CameraFacts
    if args.aspect_ratio is not None:
        aspect_ratio = args.aspect_ratio
    return CameraFacts(
        aspect_ratio=None if aspect_ratio == FREE else float(aspect_ratio),
        skew=None if args.skew == FREE else args.skew,
        principal_point=tuple(args.principal_point) if args.principal_point else None,
        aspect_ratio_sigma=args.aspect_ratio_sigma,
        skew_sigma_px=args.skew_sigma,
        principal_point_sigma_px=args.principal_point_sigma,
        distortion=args.distortion,
        lens_population=args.lens_population,
        trusted=args.trust_facts,
        focal=args.focal,
        shutter=args.shutter,
        line_delay_s=args.line_delay,
        line_delay_sigma_s=args.line_delay_sigma)
