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
"""The mount of a camera in words: for a terminal, and as a table of the page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.mount import Floor, Mount, NAMES, PLACE, TURN
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.report.mounts.record import shown_sigma

#: What each degree of freedom is, for a person.
MEANING = {'x': 'forward', 'y': 'to the left', 'z': 'up',
           'roll': 'to the right', 'pitch': 'downwards', 'yaw': 'to the left',
           'scale': 'metres in a step of the path', 'time_offset': "camera's clock minus robot's"}
#: The scale, before an object of known size.
OF_AN_OBJECT = 'metres of the robot in one of the object'
#: From this pitch on, up or down, the sigmas of roll and yaw grow, and those of both do not.
STEEP_DEG = 75.0
#: Name in a table, and unit.
SHOWN = {**{name: (name, 'm') for name in PLACE}, **{name: (name, '°') for name in TURN},
         'scale': ('scale', 'm/step'), 'time_offset': ('clock', 's')}


@dataclass(frozen=True)
class MountRow:
    """
    A degree of freedom in words.

    Attributes
    ----------
    name, meaning, value, sigma, unit, status : str
        Value and sigma are empty where there is none.
    why : str
        By what it is held, or what would show it.

    """

    name: str
    meaning: str
    value: str
    sigma: str
    unit: str
    status: str
    why: str


def mount_rows(mount: Mount, facts: frozenset[str] = frozenset(),
               motion: str = '') -> list[MountRow]:
    """
    Put each degree of freedom in words.

    Parameters
    ----------
    mount : Mount
    facts : set of str
        Names of what was stated.
    motion : str
        That of the calibration: before a known object, lengths are in metres already.

    """
    angles = mount.angles
    values = {**dict(zip(PLACE, mount.T_body_camera[:3, 3])),
              **{name: np.degrees(angles[name]) for name in TURN}, 'scale': mount.scale,
              'time_offset': mount.time_offset_s}
    rows, known_object = [], motion == 'known-object'
    for name, sigma in shown_sigma(mount).items():
        status = mount.status[name]
        spread = None if sigma is None else sigma * (180 / np.pi if name in TURN else 1.0)
        known = status != 'unobservable' and np.isfinite(values[name])
        rows.append(MountRow(
            SHOWN[name][0], OF_AN_OBJECT if known_object and name == 'scale' else MEANING[name],
            _digits(values[name], spread) if known else '',
            _digits(spread, spread) if known and spread and np.isfinite(spread) else '',
            'm/m' if known_object and name == 'scale' else SHOWN[name][1],
            status, mount.missing.get(name, '') if status == 'unobservable' else
            _held_by(name, mount, facts) if status == 'held' else
            '' if known else 'as far as the axis below tells'))
    return rows


def _held_by(name: str, mount: Mount, facts: frozenset[str]) -> str:
    """Name what holds a degree of freedom."""
    if name == 'scale' and name not in facts:
        return 'by the size of the object'
    if name == 'time_offset' and name not in facts:
        return 'each pose belongs to its image' if not mount.time_offset_s else ''
    return f'by the stated {name.replace("_", " ")}'


def _digits(value: float, sigma: float | None) -> str:
    """Write a number with two digits more than its sigma needs at least."""
    if not sigma or not np.isfinite(sigma):
        return f'{value:.6g}'
    return f'{value:.{int(np.clip(1 - np.floor(np.log10(sigma)), 1, 7))}f}'


def mount_lines(result: Calibration, facts: frozenset[str] = frozenset()) -> list[str]:
    """
    Return the mount for a terminal, a line each; nothing where no robot was given.

    Parameters
    ----------
    result : Calibration
    facts : set of str
        See `mount_rows`.

    """
    mount = result.mount
    if mount is None:
        return []
    if not isinstance(mount, Mount):
        return ['', no_mount_sentence(mount)]
    lines = ['', mount_sentence(mount), '']
    for row in mount_rows(mount, facts, result.motion):
        spread = {'held': '-', 'unobservable': 'unknown'}.get(row.status, row.sigma)
        if row.status == 'held' and row.sigma:
            spread = row.sigma
        text = (f'{row.name:>6} {row.value or "-":>12} ± {spread:>9} {row.unit:<6} '
                f'{row.status}')
        if row.why:
            text += f' {row.why}' if row.why.startswith('by ') else f': {row.why}'
        lines.append(text)
    lines += ['', 'x, y, z: where the camera is on the body (forward, left, up). Angles: against '
              'a level camera that looks straight ahead; pitch is positive downwards, yaw to the '
              'left, roll to the right.']
    return [*lines, *filter(None, (roll_and_yaw_sentence(mount), axis_sentence(mount),
                                   floor_sentence(mount)))]


def roll_and_yaw_sentence(mount: Mount) -> str:
    """Say what roll and yaw are together where a camera looks along the z of the body."""
    roll, pitch, yaw = (float(np.degrees(mount.angles[name])) for name in TURN)
    if abs(pitch) < STEEP_DEG or any(mount.status[name] != 'estimated' for name in TURN):
        return ''
    name, value = ('sum', yaw + roll) if pitch < 0 else ('difference (yaw less roll)', yaw - roll)
    sigma = float(np.degrees(np.sqrt(mount.covariance[NAMES.index('yaw'), NAMES.index('yaw')])))
    value = (value + 180) % 360 - 180
    return (f'The camera looks nearly along the z of {mount.frame}, and there roll and yaw do '
            f'nearly the same: their {name} is {_digits(value, sigma)} ± '
            f'{_digits(sigma, sigma)}°.')


def axis_sentence(mount: Mount) -> str:
    """Say which axis of the body the camera knows, where the turn about it is open."""
    if mount.axis is None:
        return ''
    axis, seen = (', '.join(f'{value:.4g}' for value in np.round(one, 4) + 0.0)
                  for one in (mount.axis.axis, mount.axis.in_camera))
    return (f'The direction ({axis}) of {mount.frame} is ({seen}) in the optical frame of the '
            f'camera (x right, y down, z forward), to {np.degrees(mount.axis.sigma):.2g}°. The '
            'turn about it is open.')


def floor_sentence(mount: Mount) -> str:
    """Say how high the camera is above the floor, or why not; '' where it was not asked."""
    floor = mount.floor
    if isinstance(floor, Floor):
        height, sigma = (_digits(one, floor.sigma_m) for one in (floor.height_m, floor.sigma_m))
        return (f'The camera is {height} ± {sigma} m above the floor, of which it sees '
                f'{floor.points} points.')
    return '' if floor is None else f'{floor.reason} {floor.advice}'.rstrip()


def no_mount_sentence(mount: NoEstimate) -> str:
    """Say why there is no mount, and what would help."""
    return f'Where the camera sits is not known: {mount.reason} {mount.advice}'.rstrip()


def mount_sentence(mount: Mount) -> str:
    """Say what was found in a sentence or two."""
    missing = [SHOWN[name][0] for name in NAMES if mount.status[name] == 'unobservable']
    aside = f' ({mount.outlier_count} set aside)' if mount.outlier_count else ''
    what = 'poses of the robot' if np.isfinite(mount.sigma_position_m) else 'turns of the gyro'
    text = f'The camera on {mount.frame}, from {mount.pose_count} {what}{aside}'
    if not missing:
        return f'{text}.'
    listed = ', '.join(missing[:-1]) + (' and ' if len(missing) > 1 else '') + missing[-1]
    return f'{text}; this motion leaves {listed} open.'
