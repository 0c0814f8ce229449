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
"""The mount of a camera as plain values, and back."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, cast

import numpy as np

from selfcal_ros.calibration.known_directions import AxisInCamera, PlaceAlong
from selfcal_ros.calibration.mount import Floor, Mount, NAMES, PLACE, TURN
from selfcal_ros.findings.finding import KINDS
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.parameter_status import Status

#: The degrees of freedom of the pose.
POSE = (*PLACE, *TURN)


def mount_to_dict(mount: Mount | NoEstimate) -> dict[str, Any]:
    """
    Return a mount, or why there is none, as values for JSON.

    Both have the same keys; what is not known is NaN or None. A refusal has 'kind', 'values',
    'reason' and 'advice' besides, and each of its degrees of freedom is unobservable.

    Parameters
    ----------
    mount : Mount or NoEstimate

    Returns
    -------
    dict
        'frame', 'T_body_camera', 'angles' (roll, pitch and yaw against a level camera that looks
        straight ahead, rad) and 'angles_sigma', 'sigma' (metres; small turns about the axes of
        the body, rad), 'status', 'scale', 'scale_sigma',
        'time_offset_s', 'time_offset_sigma_s', 'covariance' in the order of 'names', 'missing'
        (what would show each open degree of freedom), 'poses', 'outliers', 'sigma_position_m',
        'sigma_rotation_rad'; where the images name their frame, 'camera_frame';
        where the floor was asked, 'floor': 'height_m' of the camera above it, 'sigma_m',
        'points', 'tilt_rad', or 'kind', 'values' and 'reason' of a refusal;
        where some is open, 'places' ('direction' in the body, 'value' and
        'sigma' along it) and 'axis' (about which the turn is open; 'axis' in the body,
        'in_camera', 'sigma' across it).

    """
    if not isinstance(mount, Mount):
        nothing = dict.fromkeys(POSE)
        return {'frame': None, 'T_body_camera': None, 'angles': dict.fromkeys(TURN),
                'angles_sigma': dict.fromkeys(TURN), 'sigma': nothing,
                'status': dict.fromkeys(NAMES, 'unobservable'), 'scale': None,
                'scale_sigma': None, 'time_offset_s': None, 'time_offset_sigma_s': None,
                'covariance': None, 'names': NAMES, 'missing': {}, 'poses': None,
                'outliers': None, 'sigma_position_m': None, 'sigma_rotation_rad': None,
                'kind': mount.kind, 'values': dict(mount.values), 'reason': mount.reason,
                'advice': mount.advice}
    sigma = known_sigma(mount)
    return {'frame': mount.frame, 'T_body_camera': known_matrix(mount),
            'angles': known_angles(mount),
            'angles_sigma': {name: shown_sigma(mount)[name] for name in TURN},
            'sigma': {name: sigma[name] for name in POSE},
            'status': {name: mount.status[name] for name in NAMES},
            'scale': mount.scale, 'scale_sigma': sigma['scale'],
            'time_offset_s': mount.time_offset_s, 'time_offset_sigma_s': sigma['time_offset'],
            'covariance': mount.covariance, 'names': NAMES, 'missing': mount.missing,
            'poses': mount.pose_count, 'outliers': mount.outlier_count,
            'sigma_position_m': mount.sigma_position_m,
            'sigma_rotation_rad': mount.sigma_rotation_rad,
            **({'camera_frame': mount.camera_frame} if mount.camera_frame else {}),
            **({'places': [one.as_dict() for one in mount.places]} if mount.places else {}),
            **({'axis': mount.axis.as_dict()} if mount.axis is not None else {}),
            **({} if mount.floor is None else {'floor': _floor_to_dict(mount.floor)})}


def _floor_to_dict(floor: Floor | NoEstimate) -> dict[str, Any]:
    if isinstance(floor, Floor):
        return {'height_m': floor.height_m, 'sigma_m': floor.sigma_m, 'points': floor.points,
                'tilt_rad': floor.tilt_rad}
    return {'height_m': None, 'sigma_m': None, 'points': None, 'tilt_rad': None,
            'kind': floor.kind, 'values': dict(floor.values), 'reason': floor.reason}


def _floor_from_dict(stored: dict[str, Any] | None) -> Floor | NoEstimate | None:
    if stored is None:
        return None
    if 'kind' in stored:
        return _reason(stored)
    return Floor(float(stored['height_m']), float(stored['sigma_m']), int(stored['points']),
                 float(stored['tilt_rad']))


def _reason(stored: dict[str, Any]) -> NoEstimate:
    """Return why something is not known; of a kind of another version the words alone."""
    if stored['kind'] not in KINDS:
        return NoEstimate('note', text=stored.get('reason', ''))
    return NoEstimate(stored['kind'], **stored.get('values', {}))


def known_sigma(mount: Mount) -> dict[str, float | None]:
    """Return standard deviations by name: zero where held, None where unobservable."""
    return {name: None if mount.status[name] == 'unobservable' else value
            for name, value in mount.sigma.items()}


def shown_sigma(mount: Mount) -> dict[str, float | None]:
    """Return `known_sigma`, that of roll, pitch and yaw as angles and not as small turns."""
    return {name: None if one is None else mount.angles_sigma.get(name, one)
            for name, one in known_sigma(mount).items()}


def known_matrix(mount: Mount) -> np.ndarray:
    """Return T_body_camera (4, 4) with NaN for coordinates that are not observable."""
    matrix = np.array(mount.T_body_camera, float)
    for row, name in enumerate(PLACE):
        if mount.status[name] == 'unobservable':
            matrix[row, 3] = np.nan
    return matrix


def known_angles(mount: Mount) -> dict[str, float | None]:
    """Return roll, pitch and yaw (rad), None where unobservable."""
    return {name: None if mount.status[name] == 'unobservable' else float(value)
            for name, value in mount.angles.items()}


def mount_from_dict(stored: dict[str, Any] | None) -> Mount | NoEstimate | None:
    """
    Turn what `mount_to_dict` gives back into a mount; None for None.

    Raises
    ------
    KeyError, TypeError, ValueError
        If the content is of another kind.

    """
    if stored is None:
        return None
    if 'kind' in stored:
        return _reason(stored)
    names = tuple(stored['names'])
    covariance = np.array([[np.inf if value is None and row == column else value
                            for column, value in enumerate(line)]
                           for row, line in enumerate(stored['covariance'])], float)
    if names != NAMES or covariance.shape != (len(NAMES),) * 2:
        raise ValueError(f'the covariance of the mount has the shape {covariance.shape}')
    matrix = _numbers(stored['T_body_camera'])
    if matrix.shape != (4, 4):
        raise ValueError(f'the mount has the shape {matrix.shape}')
    return Mount(
        frame=str(stored['frame']), T_body_camera=matrix, covariance=covariance,
        status={name: cast(Status, stored['status'][name]) for name in NAMES},
        scale=_number(stored['scale']), time_offset_s=_number(stored['time_offset_s']),
        missing={str(name): str(text) for name, text in stored.get('missing', {}).items()},
        pose_count=int(stored['poses']), outlier_count=int(stored['outliers']),
        sigma_position_m=_number(stored['sigma_position_m']),
        sigma_rotation_rad=_number(stored['sigma_rotation_rad']),
        floor=_floor_from_dict(stored.get('floor')),
        places=tuple(PlaceAlong(np.array(one['direction'], float), float(one['value']),
                                float(one['sigma'])) for one in stored.get('places', ())),
        axis=None if stored.get('axis') is None else AxisInCamera(
            np.array(stored['axis']['axis'], float), np.array(stored['axis']['in_camera'], float),
            float(stored['axis']['sigma'])),
        camera_frame=str(stored.get('camera_frame', '')))


def _number(value: float | None) -> float:
    return np.nan if value is None else float(value)


def _numbers(rows: Iterable[Iterable[float | None]]) -> np.ndarray:
    return np.array([[_number(value) for value in row] for row in rows], float)
