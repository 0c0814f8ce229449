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
Poses of the robot while they come, and the mount that follows from those and a calibration.

Message by message they go to a `LiveRobot`; what an estimate needs of them is a `RobotSnapshot`,
which any thread or process may work on.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from msg_adapters.body_poses import body_pose, ODOMETRY_TYPE, transforms
from msg_adapters.message_types import Message

import numpy as np

from selfcal_ros.calibration.mount import MountFacts
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.errors import InputError, SelfcalError
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.pipeline.robot.pose_buffer import PoseBuffer
from selfcal_ros.pipeline.robot.robot_source import RobotSource
from selfcal_ros.values.body_poses import ABSOLUTE, BodyPoses, ODOMETRY
from selfcal_ros.values.tracks import Tracks
from selfcal_ros.values.transform_tree import TransformTree

#: Frames of TF that are remembered at most; a robot has a hundred.
MOST_FRAMES = 2000
#: Poses that long before and after a window of images count, for clocks that differ.
MARGIN_NS = 1_000_000_000


@dataclass(frozen=True)
class TransformsOf:
    """Transforms of one child frame: stamps (N,) and parent from child (N, 4, 4)."""

    parent: str
    child: str
    is_static: bool
    stamps_ns: np.ndarray
    matrices: np.ndarray


@dataclass(frozen=True)
class RobotSnapshot:
    """
    All that is known of the body at one moment.

    Attributes
    ----------
    source : RobotSource
    facts : MountFacts
    read : BodyPoses or tuple of TransformsOf
        What the topic told.

    """

    source: RobotSource
    facts: MountFacts
    read: BodyPoses | tuple[TransformsOf, ...]

    def poses(self) -> BodyPoses:
        """
        Return the poses of the body, as the user wants them taken.

        Raises
        ------
        InputError
            If they cannot be used; the sentence says what to do.

        """
        if isinstance(self.read, BodyPoses):
            found = self.read
        else:
            tree = TransformTree()
            for one in self.read:
                for stamp, matrix in zip(one.stamps_ns.tolist(), one.matrices):
                    tree.add(stamp, matrix, one.parent, one.child, one.is_static)
            world, body = self.source.frames or ('', '')
            found = tree.poses(world, body)
        return self.source.reading.applied(found, str(self.source))

    def between(self, first_ns: int, last_ns: int) -> RobotSnapshot:
        """Return what is known from just before one instant to just after another."""
        def near(stamps: np.ndarray) -> np.ndarray:
            return (stamps > first_ns - MARGIN_NS) & (stamps < last_ns + MARGIN_NS)
        if isinstance(self.read, BodyPoses):
            if self.read.stamps_ns is None:
                return self
            keep = near(self.read.stamps_ns)
            # of none there is nothing to hold images against, and that is told elsewhere
            keep[-2:] |= not keep.any()
            return replace(self, read=replace(
                self.read, rotation=self.read.rotation[keep], position=self.read.position[keep],
                stamps_ns=self.read.stamps_ns[keep]))
        return replace(self, read=tuple(
            one if one.is_static or near(one.stamps_ns).sum() < 2 else
            replace(one, stamps_ns=one.stamps_ns[near(one.stamps_ns)],
                    matrices=one.matrices[near(one.stamps_ns)]) for one in self.read))

    def mounted(self, result: Calibration, tracks: Tracks) -> Calibration:
        """Return the calibration with the mount, or with why there is none."""
        from selfcal_ros.calibration.mounting.mounting import mount_camera
        from selfcal_ros.calibration.structure.floor import with_floor
        try:
            return with_floor(mount_camera(result, self.poses(), tracks.stamps_ns, self.facts),
                              tracks)
        except (SelfcalError, np.linalg.LinAlgError) as error:
            # the calibration stands without the robot
            return replace(result, mount=NoEstimate('body_poses_unusable', why=str(error)))


class LiveRobot:
    """
    Gathers the poses of a body in bounded memory.

    Parameters
    ----------
    source : RobotSource
        A topic, or TF with two frames.
    facts : MountFacts, optional
        Known parts of the mount.

    Attributes
    ----------
    dropped : int
        Poses and transforms that were of no use.
    why_dropped : str
        Of the last of them.

    """

    def __init__(self, source: RobotSource, facts: MountFacts = MountFacts()) -> None:
        self.source, self.facts = source, facts
        self._buffer = PoseBuffer()
        self._names = ('', '')
        self._kind = ABSOLUTE
        # of each frame its parent, and whether for ever
        self._parents: dict[str, tuple[str, bool]] = {}
        self._last: dict[str, tuple[int, np.ndarray]] = {}
        self._links: dict[str, PoseBuffer] = {}
        self.dropped, self.why_dropped = 0, ''

    def __len__(self) -> int:
        """Count the poses, or the transforms on the way from frame to frame."""
        return len(self._buffer) + sum(len(one) for one in self._links.values())

    @property
    def buffers(self) -> tuple[PoseBuffer, ...]:
        """What holds the poses."""
        return (self._buffer, *self._links.values())

    def add(self, message: Message, kind: str) -> None:
        """
        Take a message of a pose.

        Parameters
        ----------
        message : Message
            nav_msgs/Odometry, geometry_msgs/PoseStamped or PoseWithCovarianceStamped.
        kind : str
            Its type, as package/msg/Name.

        """
        try:
            stamp, pose, world, body = body_pose(message)
            if stamp <= 0:
                raise InputError('a message has no stamp; what publishes it must fill the header')
        except InputError as error:
            self._drop(str(error))
            return
        self._names = (world or self._names[0], body or self._names[1])
        self._kind = ODOMETRY if kind == ODOMETRY_TYPE else ABSOLUTE
        self._buffer.add(stamp, pose)

    def add_transforms(self, message: Message, is_static: bool) -> None:
        """Take a TFMessage of /tf or /tf_static; only the way from frame to frame is kept."""
        for stamp, matrix, parent, child in transforms(message, self._drop, is_static):
            known = self._parents.get(child)
            if known is None and len(self._parents) >= MOST_FRAMES:
                self._drop(f'TF has more than {MOST_FRAMES} frames')
                continue
            self._last[child] = (0 if is_static else stamp, matrix)
            if known != (parent, is_static):
                self._parents[child] = (parent, is_static)
                self._links = {name: self._link(name) for name in self._way()}
            if child in self._links:
                self._links[child].add(*self._last[child])

    def _link(self, child: str) -> PoseBuffer:
        """Return what holds the transforms of a frame on the way."""
        if child in self._links:
            return self._links[child]
        link = PoseBuffer()
        # that of a static transform may have come long ago, and comes once
        link.add(*self._last[child])
        return link

    def _way(self) -> set[str]:
        """Return the frames whose transforms lie above the two that are asked for."""
        found: set[str] = set()
        for name in self.source.frames or ():
            while name in self._parents and name not in found:
                found.add(name)
                name = self._parents[name][0]
        return found

    def _drop(self, why: str) -> None:
        self.dropped += 1
        self.why_dropped = why

    def thin(self, images_ns: Iterable[int]) -> None:
        """Keep within bounds; poses near the instants of these images stay."""
        images = list(images_ns)
        for one in self.buffers:
            one.thin(images)

    @property
    def is_full(self) -> bool:
        """Whether `thin` is due."""
        return any(one.is_full for one in self.buffers)

    def frames(self) -> list[str]:
        """Return the names of the frames that TF has told of, sorted."""
        return sorted({*self._parents, *(parent for parent, _ in self._parents.values())})

    def snapshot(self) -> RobotSnapshot | None:
        """Return what is known; None with fewer than two poses, and before TF has spoken."""
        if self.source.frames is not None:
            if not self._parents:
                return None
            told = tuple(TransformsOf(parent, child, fixed, *self._known(child))
                         for child, (parent, fixed) in self._parents.items())
            return RobotSnapshot(self.source, self.facts, told)
        stamps, poses = self._buffer.arrays()
        if len(stamps) < 2:
            return None
        return RobotSnapshot(self.source, self.facts, BodyPoses(
            poses[:, :3, :3], poses[:, :3, 3], stamps, kind=self._kind,
            body_frame=self._names[1] or 'base_link', world_frame=self._names[0] or 'world'))

    def _known(self, child: str) -> tuple[np.ndarray, np.ndarray]:
        """Return stamps and matrices; a frame beside the way has a name only."""
        if child in self._links:
            return self._links[child].arrays()
        stamp, matrix = self._last[child]
        return np.array([stamp], np.int64), matrix[None]
