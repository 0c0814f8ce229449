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
Frames that transforms tie together, as TF does: chains of them, composed and interpolated.

A transform takes points of a child frame to its parent; a child has one parent. Between two
stamps a translation is interpolated on the line, a rotation about one axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from selfcal_ros.errors import InputError
from selfcal_ros.values.body_poses import ABSOLUTE, BodyPoses, ODOMETRY

#: Frames from which odometry is told (REP 105).
ODOMETRY_FRAMES = ('odom',)


@dataclass
class _Edge:
    """Transforms of one child."""

    parent: str
    is_static: bool
    matrices: dict[int, np.ndarray] = field(default_factory=dict)

    @property
    def moves(self) -> bool:
        """Whether it may differ from stamp to stamp."""
        return not self.is_static and len(self.matrices) > 1

    def sampled(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Return the matrices (N, 4, 4) at instants within."""
        known = np.array(sorted(self.matrices))
        poses = np.array([self.matrices[one] for one in known.tolist()])
        found = np.broadcast_to(np.eye(4), (len(stamps_ns), 4, 4)).copy()
        if not self.moves:
            pose: np.ndarray = found @ poses[-1]
            return pose
        # differences of nanoseconds are exact, sums of them in floating point are not
        time, wanted = known - known[0], stamps_ns - known[0]
        found[:, :3, :3] = Slerp(time, Rotation.from_matrix(poses[:, :3, :3]))(wanted).as_matrix()
        for axis in range(3):
            found[:, axis, 3] = np.interp(wanted, time, poses[:, axis, 3])
        return found


class TransformTree:
    """Transforms by child frame, gathered message by message."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, stamp_ns: int, matrix: np.ndarray, parent: str, child: str,
            is_static: bool = False) -> None:
        """
        Add a transform; of two at one instant the later counts.

        Parameters
        ----------
        stamp_ns : int
        matrix : ndarray, shape (4, 4)
            Parent from child.
        parent, child : str
        is_static : bool
            It holds at all times.

        Raises
        ------
        InputError
            If the child has another parent already.

        """
        edge = self._edges.get(child)
        if edge is None or edge.is_static and is_static:
            edge = self._edges[child] = _Edge(parent, is_static)
        if edge.parent != parent:
            raise InputError(f'The frame {child} has two parents in TF, {edge.parent} and '
                             f'{parent}; a tree allows one.')
        edge.matrices[int(stamp_ns)] = matrix

    @property
    def frames(self) -> list[str]:
        """Names of all frames, sorted."""
        return sorted({*self._edges, *(edge.parent for edge in self._edges.values())})

    def poses(self, world: str, body: str) -> BodyPoses:
        """
        Return the poses of one frame in another, where all transforms between them are known.

        They stand at the stamps of the transform that comes most often; the others are
        interpolated there. Transforms from a frame called odom are those of odometry.

        Parameters
        ----------
        world, body : str

        Raises
        ------
        InputError
            If a frame does not exist (those that do are listed), if nothing ties the two, or if
            nothing between them moves.

        """
        for name in (world, body):
            if name not in self.frames:
                there = ', '.join(self.frames[:30]) or 'none'
                raise InputError(f'TF has no frame {name}; it has {there}.')
        up, down = self._to_root(body), self._to_root(world)
        shared = next((name for name in up if name in down), None)
        if shared is None:
            raise InputError(f'No chain of transforms ties {body} to {world}: TF holds the tree '
                             f'of {up[-1]} and that of {down[-1]}; choose two frames of one.')
        below, above = up[:up.index(shared)], down[:down.index(shared)]
        moving = [self._edges[name] for name in (*below, *above)
                  if self._edges[name].moves]
        if not moving:
            raise InputError(f'Nothing between {world} and {body} moves in TF; name the frame '
                             'that the robot moves in, such as odom, and one on the robot.')
        begin = max(min(edge.matrices) for edge in moving)
        end = min(max(edge.matrices) for edge in moving)
        busiest = max(moving, key=lambda edge: len(edge.matrices))
        stamps = np.array(sorted(busiest.matrices), np.int64)
        stamps = stamps[(stamps >= begin) & (stamps <= end)]
        if len(stamps) < 2:
            raise InputError(f'The transforms between {world} and {body} do not overlap in time.')
        matrices = np.broadcast_to(np.eye(4), (len(stamps), 4, 4))
        for name in above:
            matrices = matrices @ np.linalg.inv(self._edges[name].sampled(stamps))
        for name in reversed(below):
            matrices = matrices @ self._edges[name].sampled(stamps)
        kind = ODOMETRY if world.split('/')[-1] in ODOMETRY_FRAMES else ABSOLUTE
        return BodyPoses(matrices[:, :3, :3], matrices[:, :3, 3], stamps, kind=kind,
                         body_frame=body, world_frame=world)

    def still(self, first: str, second: str) -> np.ndarray:
        """
        Return where a frame is in another, (4, 4), by static transforms.

        Raises
        ------
        InputError
            If a frame does not exist, or nothing static ties the two.

        """
        if first == second:
            return np.eye(4)
        for name in (first, second):
            if name not in self.frames:
                there = ', '.join(self.frames[:30]) or 'none'
                raise InputError(f'TF has no static frame {name}; it has {there}.')
        up, down = self._to_root(second), self._to_root(first)
        shared = next((name for name in up if name in down), None)
        if shared is None:
            raise InputError(f'No chain of static transforms ties {second} to {first}.')
        matrix = np.eye(4)
        now = np.zeros(1, np.int64)
        for name in down[:down.index(shared)]:
            matrix = matrix @ np.linalg.inv(self._edges[name].sampled(now)[0])
        for name in reversed(up[:up.index(shared)]):
            matrix = matrix @ self._edges[name].sampled(now)[0]
        return matrix

    def _to_root(self, name: str) -> list[str]:
        """Return the frame and what it hangs from, up to the root."""
        chain = [name]
        while chain[-1] in self._edges:
            parent = self._edges[chain[-1]].parent
            if parent in chain:
                raise InputError(f'TF goes round in a circle at the frame {parent}.')
            chain.append(parent)
        return chain
