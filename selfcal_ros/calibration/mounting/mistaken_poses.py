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
Common mistakes in lists of poses: which of them, once undone, lets the images agree.

The usual mistakes are few. Poses are inverted, one image late or early, or by a clock of their
own; w of the quaternion stands in the wrong column, or roll, pitch and yaw for a rotation
vector; an axis of the positions is mirrored or swapped. Each is undone, and the closed forms
tell whether the images agree then. The answer is clear either way, but that in a plane all
mirrors are alike.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from selfcal_ros.calibration.mounting.body_track import BodyAt, BodyTrack
from selfcal_ros.calibration.mounting.camera_poses import CameraPoses
from selfcal_ros.calibration.mounting.clocks import Clocks
from selfcal_ros.calibration.mounting.disagreement import AGREES, misfits
from selfcal_ros.geometry.no_estimate import NoEstimate

#: What is meant leaves so many times less than what was given.
TIMES = 5.0
#: Without so many images anything may agree.
ENOUGH_IMAGES = 6
#: Mirrors that leave up to so many times as much are told together.
ALIKE = 1.2
_AXES = 'xyz'


def what_is_meant(camera: CameraPoses, track: BodyTrack, offset: float, rows: np.ndarray,
                  ) -> NoEstimate | None:
    """
    Name the mistake after which poses agree with the images, which they do not as given.

    Parameters
    ----------
    camera : CameraPoses
        Of the images with a pose.
    track : BodyTrack
    offset : float
        Of the clocks, seconds.
    rows : ndarray of int, shape (V,)
        Of these images in `track`.

    Returns
    -------
    NoEstimate or None

    """
    body = track.at(offset, rows)
    given = _best(camera, body)
    if max(given) < AGREES:
        return None
    found: list[tuple[float, NoEstimate]] = []
    for images, other, why in _alternatives(camera, track, body, rows):
        if len(images) < min(ENOUGH_IMAGES, len(camera)):
            continue
        left = _best(images, other)
        turns, ways = (a > AGREES and b * TIMES < a for a, b in zip(given, left))
        # ways may be noise, and then turns tell; of turns about one axis the inverse is as good
        if (turns or (ways and why.kind == 'body_poses_inverse')
                or (ways and why.kind == 'body_positions_mirrored' and given[0] < 2 * AGREES)):
            found.append((sum(left), why))
    if not found:
        return None
    left_over, best = min(found, key=lambda one: one[0])
    if best.kind != 'body_positions_mirrored':
        return best
    # in a plane all mirrors do the same, but for a turn of the fixed frame
    alike = [why.values['how'] for size, why in found
             if why.kind == best.kind and size < ALIKE * left_over]
    return NoEstimate(best.kind, count=len(camera), how=', or '.join(dict.fromkeys(alike)))


def clocks_apart(clocks: Clocks, offset: float, rows: np.ndarray) -> NoEstimate | None:
    """
    Tell that poses which do not agree with the images do so at a far offset of the clocks.

    Parameters
    ----------
    clocks : Clocks
    offset : float
        The best of those that were looked for, seconds.
    rows : ndarray of int, shape (V,)
        Of the images that have a pose there.

    Returns
    -------
    NoEstimate or None

    """
    camera, track = clocks.camera, clocks.track
    given, _ = _best(camera.chosen(rows), track.at(offset, rows))
    if not track.timed or given < AGREES:
        return None
    far = clocks.far_offset()
    if far is None:
        return None
    there = np.flatnonzero(track.known(far))
    turns, _ = _best(camera.chosen(there), track.at(far, there))
    if turns * TIMES > given:
        return None
    return NoEstimate('body_clocks_apart', offset_s=far)


def _alternatives(camera: CameraPoses, track: BodyTrack, body: BodyAt, rows: np.ndarray,
                  ) -> Iterator[tuple[CameraPoses, BodyAt, NoEstimate]]:
    """Undo one mistake after the other."""
    count = len(camera)
    back = np.swapaxes(body.rotation, 1, 2)
    yield camera, replace(body, rotation=back, position=-np.einsum(
        'vij,vj->vi', back, body.position)), NoEstimate('body_poses_inverse', count=count)
    x, y, z, w = Rotation.from_matrix(body.rotation).as_quat().T
    for named, truly, quaternion in (('w, x, y, z', 'x, y, z, w', (w, x, y, z)),
                                     ('x, y, z, w', 'w, x, y, z', (y, z, w, x))):
        yield camera, replace(body, rotation=Rotation.from_quat(
            np.column_stack(quaternion)).as_matrix()), NoEstimate(
                'body_quaternions_permuted', count=count, named=named, truly=truly)
    for angles in _as_angles(body.rotation):
        yield camera, replace(body, rotation=angles), NoEstimate('body_angles_as_vectors',
                                                                 count=count)
    for step, which in ((1, 'before'), (-1, 'after')):
        known, other = track.of_neighbours(rows, step)
        yield camera.chosen(np.flatnonzero(known)), other, NoEstimate(
            'body_poses_shifted', count=count, which=which)
    for k, name in enumerate(_AXES):
        mirrored, swapped = np.ones(3), [0, 1, 2]
        mirrored[k] = -1
        swapped[k], swapped[k - 1] = swapped[k - 1], swapped[k]
        yield camera, replace(body, position=body.position * mirrored), NoEstimate(
            'body_positions_mirrored', count=count, how=f'{name} has the wrong sign')
        yield camera, replace(body, position=body.position[:, swapped]), NoEstimate(
            'body_positions_mirrored', count=count,
            how=f'{_AXES[k - 1]} and {name} are swapped')


def _as_angles(rotation: np.ndarray) -> list[np.ndarray]:
    """
    Return turns (V, 3, 3) whose roll, pitch and yaw were taken for rotation vectors.

    A vector and the one of the other sense are the same turn, but not the same angles. So the
    first pose is tried with both, and each other with the one that is nearer to the pose before.
    """
    vectors = Rotation.from_matrix(rotation).as_rotvec()
    length = np.maximum(np.linalg.norm(vectors, axis=1), 1e-9)[:, None]
    both = [Rotation.from_euler('xyz', one).as_matrix()
            for one in (vectors, vectors * (1 - 2 * np.pi / length))]
    found = []
    for first in both:
        chosen = [first[0]]
        for pair in zip(both[0][1:], both[1][1:]):
            chosen.append(max(pair, key=lambda one: float((one * chosen[-1]).sum())))
        found.append(np.array(chosen))
    return found


def _best(camera: CameraPoses, body: BodyAt) -> tuple[float, float]:
    """Return the least misfit of turns, and of ways; 1 where nothing is explained."""
    found = misfits(camera, body)
    return (min([1.0, *(turns for turns, _, _ in found)]),
            min([1.0, *(ways for _, ways, scale in found if scale > 0)]))
