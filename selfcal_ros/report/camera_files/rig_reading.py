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
"""Rigs from files: result.json of `selfcal calibrate --cameras`, and chains of Kalibr."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import json
from pathlib import Path
from typing import Any

import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.report.camera_files.kalibr_chain import parse_kalibr
from selfcal_ros.report.camera_files.known_camera import check_unfolded
from selfcal_ros.report.result_json import result_from_dict
from selfcal_ros.report.yaml_text import decoded, load_yaml, MAX_BYTES, numbers, read_bytes
from selfcal_ros.values.camera_rig import placed_beside, PlacedCamera

#: What a transform is worth where the file does not say: degrees, metres.
ROUGH_DEG, ROUGH_M = 0.05, 0.0005


def read_rig(path: str | Path, names: Sequence[str] | None = None,
             topics: Sequence[str | None] = (), sigma: tuple[float, float] | None = None,
             ) -> tuple[PlacedCamera, ...]:
    """
    Read cameras with the transforms between them.

    Parameters
    ----------
    path : str or Path
        result.json of `selfcal calibrate --cameras --json`, or Kalibr's camchain.yaml.
    names : sequence of str, optional
        The cameras that are wanted, in this order; all of them in that of the file by default.
        Kalibr's cameras are called cam0, cam1, ...; their topics name them, too.
    topics : sequence of str or None
        Image topics of these cameras, where they are known.
    sigma : (float, float), optional
        Standard deviations of the transforms, degrees and metres; by default those of the file,
        or `ROUGH_DEG` and `ROUGH_M` where it has none.

    Returns
    -------
    tuple of PlacedCamera
        In the frame of the first one.

    Raises
    ------
    InputError
        If a camera or a transform is missing, or its lengths are not metres.

    """
    source = str(path)
    text = decoded(read_bytes(Path(path), MAX_BYTES), source)
    try:
        if text.lstrip().startswith('{'):
            found = _of_result(json.loads(text), source)
        else:
            found = _of_chain(load_yaml(text, source), source)
        if not found:
            raise LookupError('no camera')
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError,
            ArgumentError):
        raise InputError(f'{source} holds no rig: give the result.json of `selfcal calibrate '
                         "--cameras --json`, or Kalibr's camchain.yaml.") from None
    if names is not None:
        beside = [*topics, *[None] * len(names)]
        found = [_chosen(found, name, topic, source) for name, topic in zip(names, beside)]
    if len(found) < 2:
        raise InputError(f'{source} holds {len(found)} cameras; two or more are needed.')
    if len({id(one) for one, _ in found}) < len(found):
        raise InputError(f'{source}: two of the cameras named are the same one.')
    if sigma is not None:
        spread = rough_spread(sigma)
        found = [(replace(one, covariance=spread if k else np.zeros((6, 6))), topic)
                 for k, (one, topic) in enumerate(found)]
    cameras = placed_beside([one for one, _ in found])
    for one in cameras:
        if min(one.camera.width, one.camera.height) <= 0:
            raise InputError(f'{source} does not tell the image size of {one.name}.')
        check_unfolded(one.camera, f'{source}, {one.name}')
    return tuple(replace(one, name=name) for one, name in zip(
        cameras, [one.name for one in cameras] if names is None else names))


def rough_spread(sigma: tuple[float, float] | None = None) -> np.ndarray:
    """Covariance (6, 6) of a place known to so many degrees and metres, roughly by default."""
    degrees, metres = (ROUGH_DEG, ROUGH_M) if sigma is None else sigma
    return np.diag([metres**2] * 3 + [np.deg2rad(degrees)**2] * 3)


def _of_result(stored: dict[str, Any], source: str) -> list[tuple[PlacedCamera, str]]:
    """Read our result.json; each camera with its topic, which is not there."""
    if 'rig' not in stored:
        raise InputError(f'{source} is of a single camera; a rig is calibrated with --cameras.')
    if stored['unit'] != 'm':
        raise InputError(f'The lengths of {source} are no metres; calibrate with --baseline or '
                         '--robot.')
    found = []
    for name, pose in stored['rig'].items():
        if 'unobservable' in pose['status'].values():
            raise InputError(f'{source} leaves the place of {name} open; state what is known, or '
                             'record other motions.')
        result = result_from_dict(stored['cameras'][name])
        if not result:
            raise InputError(f'{source} has no calibration of {name}.')
        found.append((PlacedCamera(str(name), result.camera,
                                   np.array(pose['T_rig_camera'], float).reshape(4, 4),
                                   np.array(pose['covariance'], float).reshape(6, 6)), ''))
    return found


def _of_chain(document: dict[str, Any], source: str) -> list[tuple[PlacedCamera, str]]:
    """Read a chain of Kalibr: T_cn_cnm1 takes points of the camera before to this one."""
    place, found = np.eye(4), []
    for k, stored in enumerate(parse_kalibr(document, source)):
        if k:
            entry = document[stored.name]
            if 'T_cn_cnm1' not in entry:
                raise InputError(f'{source}: {stored.name} lacks T_cn_cnm1, the transform from '
                                 'the camera before.')
            T = np.array([numbers(row, source, 'T_cn_cnm1') for row in entry['T_cn_cnm1']])
            place = place @ np.linalg.inv(T.reshape(4, 4))
        spread = rough_spread() if k else np.zeros((6, 6))
        found.append((PlacedCamera(stored.name, stored.camera, place, spread), stored.topic))
    return found


def _chosen(found: list[tuple[PlacedCamera, str]], name: str, topic: str | None, source: str,
            ) -> tuple[PlacedCamera, str]:
    """Find a camera by its name, by its topic, or by a part of its topic."""
    fits = ([one for one in found if one[0].name == name]
            or [one for one in found if topic and one[1] == topic]
            or [one for one in found if name in one[1].strip('/').split('/')])
    if len(fits) != 1:
        there = ', '.join(f'{one.name} ({topic})' if topic else one.name for one, topic in found)
        raise InputError(f'{source} has {len(fits) or "no"} cameras {name}; it has {there}.')
    return fits[0]
