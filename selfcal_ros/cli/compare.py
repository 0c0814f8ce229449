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
"""`selfcal compare`: how far apart two calibrations are, in pixels and in sigmas."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys
from typing import Any, TYPE_CHECKING

from selfcal_ros.cli.force import check_outputs
from selfcal_ros.cli.machine_output import add_json_argument, is_standard_output, write_json
from selfcal_ros.cli.parsing import output_path
from selfcal_ros.cli.status import EXIT_DIFFER, EXIT_DONE
from selfcal_ros.cli.verbosity import add_quiet_argument
from selfcal_ros.errors import ArgumentError, InputError

if TYPE_CHECKING:
    import numpy as np
    from selfcal_ros.geometry.camera import Camera
    from selfcal_ros.report.camera_files.stored import StoredCamera
    from selfcal_ros.report.comparison import Comparison
    from selfcal_ros.report.mounts.comparison import MountComparison

#: What scales with the focal length.
_FOCAL = ('fx', 'fy', 'skew')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `selfcal compare`."""
    kinds = ('camera file of ROS, OpenCV, Kalibr, COLMAP or mrcal, or result.json; the '
             'covariance of our own files is used; or the transform of a camera on a robot '
             '(.urdf, .yaml, .launch.py, .calib)')
    parser.add_argument('first', metavar='A', help=kinds)
    parser.add_argument('second', metavar='B', help='the same, of the same image size')
    for letter in 'ab':
        parser.add_argument(f'--result-{letter}', type=Path, metavar='RESULT.JSON',
                            help=f'covariance of {letter.upper()} (default: its own, or that of '
                                 'NAME.json or result.json beside it, if it is of the same '
                                 'camera)')
        parser.add_argument(f'--camera-{letter}', metavar='NAME',
                            help=f'which of several cameras in {letter.upper()}')
    parser.add_argument('--image-size', type=int, nargs=2, metavar=('W', 'H'),
                        help='image size in pixels, for OpenCV files without it')
    parser.add_argument('--sigmas', type=float, metavar='N',
                        help='exit status 1 if they differ by more than N sigmas, all parameters '
                             'together (default: the status is 0 however far they are apart)')
    output = parser.add_argument_group('output')
    add_json_argument(output)
    output.add_argument('--picture', type=output_path, metavar='PICTURE.PNG',
                        help='the difference over the image, in pixels and in sigmas, as .png or '
                             '.svg')
    add_quiet_argument(output, 'print nothing but errors')


def run(args: argparse.Namespace) -> int:
    """Compare; returns the exit status."""
    from selfcal_ros.report.camera_files.formats import read_camera
    from selfcal_ros.report.comparison import compare_cameras
    _check_options(args)
    mounts = _mounts(args)
    if mounts is not None and not _hold_cameras(args):
        return _run_mounts(args, mounts)
    size = tuple(args.image_size) if args.image_size else None
    a = read_camera(args.first, args.camera_a, '--camera-a', image_size=size)
    b = read_camera(args.second, args.camera_b, '--camera-b', image_size=size)
    covariances = [_covariance(args.first, a, args.result_a),
                   _covariance(args.second, b, args.result_b)]
    if args.sigmas is not None and all(C is None for C in covariances):
        raise InputError('Neither calibration tells its uncertainty, so that --sigmas cannot be '
                         'judged; put result.json beside a camera file, or name it with '
                         '--result-a.')
    found = compare_cameras(a.camera, b.camera, *covariances)
    rows = _rows(a.camera, b.camera, covariances)
    if args.json:
        write_json(args.json, _content(args, found, rows) | (
            {} if mounts is None else {'mount': mounts.as_dict()}))
    if args.picture:
        _draw(args, found, a.camera)
    beyond = args.sigmas is not None and bool(found.beyond(args.sigmas))
    if not (args.quiet or is_standard_output(args.json)):
        print('\n'.join([_text(args, found, rows, covariances),
                         *(() if mounts is None else ('', *mounts.sentences()))]))
    elif beyond:
        print(_judged(args, found), file=sys.stderr)
    return EXIT_DIFFER if beyond else EXIT_DONE


def _mounts(args: argparse.Namespace) -> MountComparison | None:
    """Compare where the cameras sit on their robots; None unless both files tell."""
    from selfcal_ros.report.mounts.comparison import compare_mounts, placed_camera
    from selfcal_ros.report.mounts.transform_reading import is_transform_file
    a = placed_camera(args.first, args.camera_a)
    b = placed_camera(args.second, args.camera_b)
    for path, found in ((args.first, a), (args.second, b)):
        if found is None and any(map(is_transform_file, (args.first, args.second))):
            raise InputError(f'{path} has no transform of a camera, and the other file has '
                             'nothing else; give result.json of a calibration with --robot.')
    return None if a is None or b is None else compare_mounts(a, b)


def _hold_cameras(args: argparse.Namespace) -> bool:
    """Tell whether both files hold cameras, too."""
    from selfcal_ros.report.mounts.transform_reading import is_transform_file
    return not any(map(is_transform_file, (args.first, args.second)))


def _run_mounts(args: argparse.Namespace, found: MountComparison) -> int:
    """Compare two transforms, without cameras; returns the exit status."""
    if args.picture:
        raise ArgumentError('--picture shows cameras, and these files hold transforms; leave it '
                            'out.')
    if args.sigmas is not None and found.joint_sigmas is None:
        raise InputError('Neither file tells the uncertainty of its transform, so that --sigmas '
                         'cannot be judged; give result.json of one.')
    beyond = args.sigmas is not None and found.joint_sigmas > args.sigmas
    if args.json:
        write_json(args.json, {'a': str(args.first), 'b': str(args.second),
                               'mount': found.as_dict()})
    if not (args.quiet or is_standard_output(args.json)):
        print('\n'.join([f'A {args.first}', f'B {args.second}', '', *found.sentences()]))
    elif beyond:
        print(found.verdict, file=sys.stderr)
    return EXIT_DIFFER if beyond else EXIT_DONE


def _check_options(args: argparse.Namespace) -> None:
    """Refuse what cannot be, before the work."""
    if args.sigmas is not None and not 0 < args.sigmas < float('inf'):
        raise ArgumentError('--sigmas takes a number above zero, such as 3.')
    if args.picture and args.picture.suffix.lower() not in ('.png', '.svg'):
        raise ArgumentError(f'The picture {args.picture} must be named .png or .svg.')
    check_outputs((), (args.first, args.second, args.result_a, args.result_b), False,
                  (args.json, args.picture))


def _draw(args: argparse.Namespace, found: Comparison, camera: Camera) -> None:
    """Write the picture."""
    from selfcal_ros.report.comparison_figure import comparison_figure
    from selfcal_ros.values.output_files import atomic_write
    drawing = comparison_figure(found, camera, (args.first, args.second))
    svg = args.picture.suffix.lower() == '.svg'
    atomic_write(args.picture, (drawing.svgs() if svg else drawing.pngs())[0])


def _judged(args: argparse.Namespace, found: Comparison) -> str:
    """Say on which side of --sigmas they are."""
    if found.contradiction and not found.joint_sigmas > args.sigmas:
        return 'They contradict each other in what both hold as known, which no sigmas explain.'
    return (f'They are {found.joint_sigmas:.1f} sigmas apart, all parameters together: '
            f'{"more" if found.beyond(args.sigmas) else "not more"} than {args.sigmas:g}.')


def _covariance(path: str | Path, stored: StoredCamera, named: Path | None) -> np.ndarray | None:
    """Return the covariance of a camera: its own, of a named file, or of a file beside it."""
    from selfcal_ros.report.camera_files.formats import read_cameras
    if stored.covariance is not None and named is None:
        return stored.covariance
    path = Path(path)
    beside = [path.with_suffix('.json'), path.with_name(path.stem + '.result.json'),
              path.with_name('result.json')]
    for candidate in [named] if named else beside:
        if not named and (not candidate.is_file() or candidate == path):
            continue
        try:
            others = read_cameras(candidate)[1]
        except InputError:
            if named:
                raise
            continue
        # a rig has several
        for other in others:
            if other.covariance is not None and _same(stored.camera, other.camera):
                return other.covariance
        if named:
            raise InputError(f'{named} is not the result that {path} comes from: it has no '
                             'covariance, or is of another camera.')
    return None


def _same(a: Camera, b: Camera) -> bool:
    """Tell whether two files hold one camera, up to rounding."""
    import numpy as np
    theirs = b.distortion_as(a.model)
    return (theirs is not None and (a.width, a.height) == (b.width, b.height)
            and np.allclose(a.K, b.K, rtol=1e-6, atol=1e-6)
            and np.allclose(a.distortion, theirs, rtol=1e-5, atol=1e-8))


def _rows(a: Camera, b: Camera, covariances: Sequence[np.ndarray | None]) -> list[dict[str, Any]]:
    """Compare parameter by parameter, as far as both have the same ones."""
    import numpy as np
    from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
    from selfcal_ros.report.projection_uncertainty import axis_scale
    plumb = [camera.distortion_as('plumb_bob') for camera in (a, b)]
    if plumb[0] is not None and plumb[1] is not None:
        # rational lenses with a denominator of one are plumb bobs
        a, b = a.as_model('plumb_bob'), b.as_model('plumb_bob')
    # coefficients of different models have nothing but their names in common
    names = a.parameter_names if a.model == b.model else MATRIX_PARAMETERS
    # nor have focal lengths that do not hold on the axis
    scales = [axis_scale(camera) if a.model != b.model else 1.0 for camera in (a, b)]
    variances = [np.diag(C)[:len(names)].tolist() for C in covariances if C is not None]
    rows = []
    for k, name in enumerate(names):
        first, second = (float(camera.parameters[k]) * (scale if name in _FOCAL else 1.0)
                         for camera, scale in zip((a, b), scales))
        sigma = max(sum(variance[k] for variance in variances), 0.0)**0.5
        rows.append({'name': name, 'a': first, 'b': second, 'difference': second - first,
                     'sigma': sigma or None,
                     'sigmas': abs(second - first) / sigma if sigma > 0 else None})
    return rows


def _text(args: argparse.Namespace, found: Comparison, rows: list[dict[str, Any]],
          covariances: Sequence[np.ndarray | None]) -> str:
    """Say it for a person."""
    import numpy as np
    lines = [f'A {args.first}', f'B {args.second}', '',
             f'{"":>6} {"A":>12} {"B":>12} {"B - A":>12} {"sigma":>10} {"sigmas":>7}']
    for row in rows:
        if row['name'] not in ('fx', 'fy', 'cx', 'cy') and not row['a'] and not row['b']:
            continue
        judged = ('' if row['sigma'] is None else
                  f' {row["sigma"]:>10.3g} {row["sigmas"]:>7.1f}')
        lines.append(f'{row["name"]:>6} {row["a"]:>12.6g} {row["b"]:>12.6g} '
                     f'{row["difference"]:>+12.4g}{judged}')
    distance = found.distance_px
    u, v = found.pixels[found.worst]
    lines += ['', f'Over the image, after a rotation of {np.degrees(found.rotation_rad):.3g} '
              f'degrees that brings them closest: {np.nanmean(distance):.3f} px on average, '
              f'{np.nanmax(distance):.3f} px at most, at ({u:.0f}, {v:.0f}).']
    if found.sigmas is not None:
        lines.append(f'That is {found.sigmas[found.worst]:.1f} sigmas there, and '
                     f'{np.nanmedian(found.sigmas):.1f} in the median.')
    if not found.one_model:
        lines.append('Their lens models differ: focal lengths are those on the axis, and '
                     'coefficients are not compared one by one.')
    lone = [letter for letter, C in zip('AB', covariances) if C is None]
    if len(lone) == 1:
        lines.append(f'{lone[0]} has no covariance and counts as exact.')
    unseen = float(np.mean(~np.isfinite(distance)))
    if unseen:
        lines.append(f'{100 * unseen:.0f} % of the image is seen by one of them only.')
    lines.append(found.verdict)
    if args.sigmas is not None:
        lines.append(_judged(args, found))
    if args.picture:
        lines.append(f'Written: {args.picture}.')
    return '\n'.join(lines)


def _content(args: argparse.Namespace, found: Comparison, rows: list[dict[str, Any]],
             ) -> dict[str, Any]:
    """Say it for a program."""
    import numpy as np
    distance = found.distance_px
    return {
        'a': str(args.first), 'b': str(args.second),
        'parameters': {row.pop('name'): row for row in map(dict, rows)},
        'difference_px': {'mean': float(np.nanmean(distance)), 'max': float(np.nanmax(distance)),
                          'at': found.pixels[found.worst].tolist()},
        'rotation_deg': float(np.degrees(found.rotation_rad)),
        'chi2': found.chi2, 'degrees_of_freedom': None if found.sigmas is None else found.freedom,
        'p_value': found.p_value,
        'joint_sigmas': found.joint_sigmas,
        'sigmas_at_most': (
            None if found.sigmas is None else float(found.sigmas[found.worst])),
        'agree': found.agree, 'verdict': found.verdict,
        **({} if args.sigmas is None else {'limit_sigmas': args.sigmas,
                                           'beyond': found.beyond(args.sigmas)})}
