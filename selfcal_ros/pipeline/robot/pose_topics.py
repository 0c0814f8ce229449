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
"""Poses of a body from the bag that holds the images: odometry, poses, or transforms."""

from __future__ import annotations

from collections.abc import Iterator
import itertools
import logging
from pathlib import Path
from typing import Any

from msg_adapters.body_poses import (body_pose, ODOMETRY_TYPE, POSE_TYPES, TRANSFORM_TYPE,
                                     transforms)
from msg_adapters.stamps import stamp_ns

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.bag_source import open_bag, OpenBag
from selfcal_ros.values.body_poses import ABSOLUTE, BodyPoses, ODOMETRY
from selfcal_ros.values.transform_tree import TransformTree

_LOGGER = logging.getLogger(__name__)

#: Topics of transforms, the second of those that hold at all times.
TRANSFORM_TOPICS = ('/tf', '/tf_static')
#: Who names no frames of TF is told those of so many messages.
MOST_LOOKED_AT = 500
#: A clock that goes back by more is a second run of the recording.
OVERTAKEN_NS = 200_000_000


class _LeftOut:
    """Poses that are of no use: how many, and the first of them."""

    def __init__(self) -> None:
        self.count, self.first = 0, ''

    def add(self, why: str) -> None:
        """Count one."""
        self.first = self.first or why
        self.count += 1

    def __str__(self) -> str:
        """Say so; it ends as a sentence does."""
        return f'{self.count} left out, the first {self.first}'


def read_pose_topic(path: str | Path, topic: str) -> BodyPoses:
    """
    Read the poses that a topic of a bag tells.

    Parameters
    ----------
    path : str or Path
        The bag.
    topic : str
        Of nav_msgs/Odometry, geometry_msgs/PoseStamped or PoseWithCovarianceStamped.

    Returns
    -------
    BodyPoses

    Raises
    ------
    InputError
        If there is no such topic (those of a fitting type are listed), or fewer than two of its
        messages are of use. Others are left out, which is logged.

    """
    path = Path(path)
    with open_bag(path) as bag:
        there = [one for one in bag.connections if one.topic in (topic, f'/{topic}')]
        chosen = [one for one in there if one.msgtype in POSE_TYPES]
        if not chosen:
            carries = (f'carries {there[0].msgtype}, which holds no poses of a robot' if there
                       else 'is not in it')
            raise InputError(f'The topic {topic} of {path} {carries}; {_fitting(bag)}.')
        read, left_out = [], _LeftOut()
        for msg in _messages(bag, chosen):
            stamp = stamp_ns(msg.header.stamp)
            try:
                if stamp <= 0:
                    raise InputError('There is no stamp; what publishes it must fill the header.')
                read.append(body_pose(msg))
            except InputError as error:
                left_out.add(f'at {stamp / 1e9:.3f} s: {error}')
    if len(read) < 2:
        raise InputError(f'The topic {topic} of {path} holds {len(read)} poses of use, and two '
                         'are needed at least' + (f'; {left_out}' if left_out.count else '.'))
    if left_out.count:
        _LOGGER.warning('poses on %s of %s: %s', topic, path, left_out)
    stamps = np.array([one[0] for one in read], np.int64)
    order = _order(stamps, f'{topic} of {path}')
    poses = np.array([one[1] for one in read])[order]
    kind = ODOMETRY if chosen[0].msgtype == ODOMETRY_TYPE else ABSOLUTE
    return BodyPoses(poses[:, :3, :3], poses[:, :3, 3], stamps[order], kind=kind,
                     body_frame=read[0][3] or 'base_link', world_frame=read[0][2] or 'world')


def read_transforms(path: str | Path, world: str, body: str) -> BodyPoses:
    """
    Read the poses of one frame in another from /tf and /tf_static of a bag.

    Transforms that are of no use are left out, which is logged.

    Raises
    ------
    InputError
        If the bag holds no transforms, or not those; see `TransformTree.poses`.

    """
    path, tree, left_out = Path(path), TransformTree(), _LeftOut()
    parents: dict[str, str] = {}
    torn: dict[str, InputError] = {}
    with open_bag(path) as bag:
        chosen = [one for one in bag.connections if one.msgtype == TRANSFORM_TYPE
                  and one.topic in TRANSFORM_TOPICS]
        if not chosen:
            raise InputError(f'{path} holds no transforms on /tf; {_fitting(bag)}.')
        for connection, msg in bag.messages(chosen):
            is_static = connection.topic == TRANSFORM_TOPICS[1]
            for stamp, matrix, parent, child in transforms(msg, left_out.add, is_static):
                try:
                    tree.add(stamp, matrix, parent, child, is_static)
                except InputError as error:
                    torn.setdefault(child, error)
                else:
                    parents[child] = parent
    try:
        # what hangs elsewhere may do so from two frames
        for child in sorted(_to_root(body, parents) ^ _to_root(world, parents)):
            if child in torn:
                raise torn[child]
        found = tree.poses(world, body)
    except InputError as error:
        why = str(error).rstrip('.')
        raise InputError(f'{path}: {why}; of the transforms {left_out}' if left_out.count else
                         f'{path}: {error}') from None
    if left_out.count:
        _LOGGER.warning('transforms of %s: %s', path, left_out)
    return found


def _to_root(name: str, parents: dict[str, str]) -> set[str]:
    """Return a frame and those that it hangs from."""
    found: set[str] = set()
    while name and name not in found:
        found.add(name)
        name = parents.get(name, '')
    return found


def _messages(bag: OpenBag, connections: list[Any]) -> Iterator[Any]:
    return (msg for _, msg in bag.messages(connections))


def _order(stamps: np.ndarray, source: str) -> np.ndarray:
    """Return the order of time; messages that come twice or were overtaken are common."""
    back = np.flatnonzero(np.diff(stamps) < -OVERTAKEN_NS)
    if len(back):
        raise InputError(f'The clock of {source} jumps back by '
                         f'{(stamps[back[0]] - stamps[back[0] + 1]) / 1e9:.3g} s; cut the '
                         'recording there, or use --start and --duration.')
    return np.unique(stamps, return_index=True)[1]


def _fitting(bag: OpenBag) -> str:
    """List what a user could name instead."""
    counts: dict[str, int] = {}
    for one in bag.connections:
        if one.msgtype in POSE_TYPES:
            counts[one.topic] = counts.get(one.topic, 0) + one.msgcount
    named = [f'{name} ({number})' for name, number in sorted(counts.items())]
    if any(one.msgtype == TRANSFORM_TYPE for one in bag.connections):
        named.append(_transforms_of(bag))
    return f'poses are on {", ".join(named[:12])}' if named else (
        'it holds no poses (Odometry, PoseStamped, PoseWithCovarianceStamped, TF)')


def _transforms_of(bag: OpenBag) -> str:
    """Name the frames of transforms, as far as the first messages do."""
    chosen = [one for one in bag.connections if one.msgtype == TRANSFORM_TYPE
              and one.topic in TRANSFORM_TOPICS]
    frames: dict[str, None] = {}
    for _, msg in itertools.islice(bag.messages(chosen) if chosen else (), MOST_LOOKED_AT):
        for one in msg.transforms:
            frames |= dict.fromkeys(str(name).lstrip('/') for name in (one.header.frame_id,
                                                                       one.child_frame_id))
    return '/tf:FIXED:BODY' + (f' (frames {", ".join(sorted(frames)[:12])})' if frames else '')
