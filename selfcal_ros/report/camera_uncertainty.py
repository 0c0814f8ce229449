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
"""The covariance of a camera as a comment of its file, which other programs skip."""

from __future__ import annotations

import json

import numpy as np

from selfcal_ros.geometry.camera import Camera

#: What the line begins with; `selfcal compare` looks for it.
MARK = 'uncertainty: '
#: Digits of a covariance: more than any comparison can tell apart.
_DIGITS = 9


def uncertainty_comment(camera: Camera, covariance: np.ndarray) -> list[str]:
    """
    Return the line for a camera file that holds its covariance; none where it is not finite.

    Parameters
    ----------
    camera : Camera
    covariance : ndarray, shape (k, k)
        Of its parameters.

    """
    k = len(camera.parameter_names)
    if covariance.shape != (k, k) or not np.isfinite(covariance).all():
        return []
    return [MARK + json.dumps({
        'parameters': list(camera.parameter_names),
        'values': [float(value) for value in camera.parameters],
        # the upper triangle, row by row
        'covariance': [float(f'{value:.{_DIGITS}g}')
                       for value in covariance[np.triu_indices(k)]]})]


def stored_uncertainty(text: str, camera: Camera) -> np.ndarray | None:
    """
    Return the covariance that the comments of a camera file tell.

    Parameters
    ----------
    text : str
        Of the whole file.
    camera : Camera
        What the file holds.

    Returns
    -------
    ndarray, shape (k, k), or None
        None where there is none, or it is that of another camera: somebody has changed the file.

    """
    start = f'# {MARK}'
    line = next((line for line in text.splitlines() if line.startswith(start)), '')
    names = camera.parameter_names
    try:
        stored = json.loads(line.removeprefix(start))
        upper = np.array(stored['covariance'], float)
        is_same = (stored['parameters'] == list(names)
                   and np.allclose(stored['values'], camera.parameters, rtol=1e-9, atol=1e-12))
    except (ArithmeticError, LookupError, RecursionError, TypeError, ValueError):
        return None
    above = np.triu_indices(len(names))
    if not is_same or upper.shape != above[0].shape or not np.isfinite(upper).all():
        return None
    found = np.zeros((len(names), len(names)))
    found[above] = upper
    return np.asarray(found + np.triu(found, 1).T)
