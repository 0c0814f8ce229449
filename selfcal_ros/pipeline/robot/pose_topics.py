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
from pathlib import Path
from typing import Any

from msg_adapters.body_poses import (body_pose, ODOMETRY_TYPE, POSE_TYPES, TRANSFORM_TYPE,
                                     transforms)

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.bag_source import open_bag, OpenBag
from selfcal_ros.values.body_poses import ABSOLUTE, BodyPoses, ODOMETRY
from selfcal_ros.values.transform_tree import TransformTree

#: Topics of transforms, the second of those that hold at all times.
TRANSFORM_TOPICS = ('/tf', '/tf_static')
#: Who names no frames of TF is told those of so many messages.
MOST_LOOKED_AT = 500
#: A clock that goes back by more is a second run of the recording.
OVERTAKEN_NS = 200_000_000


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
        If there is no such topic (those of a fitting type are listed), or a message is wrong.

    """
    path = Path(path)
    with open_bag(path) as bag:
        there = [one for one in bag.connections if one.topic in (topic, f'/{topic}')]
        chosen = [one for one in there if one.msgtype in POSE_TYPES]
        if not chosen:
            carries = (f'carries {there[0].msgtype}, which holds no poses of a robot' if there
                       else 'is not in it')
            raise InputError(f'The topic {topic} of {path} {carries}; {_fitting(bag)}.')
        read = [body_pose(msg) for msg in _messages(bag, chosen)]
    if len(read) < 2:
        raise InputError(f'The topic {topic} of {path} holds {len(read)} messages; poses at two '
                         'instants are needed at least.')
    stamps = np.array([one[0] for one in read], np.int64)
    if not stamps.any():
        raise InputError(f'The messages of {topic} in {path} have no stamps; what publishes them '
                         'must fill the header.')
    order = _order(stamps, f'{topic} of {path}')
    poses = np.array([one[1] for one in read])[order]
    kind = ODOMETRY if chosen[0].msgtype == ODOMETRY_TYPE else ABSOLUTE
    return BodyPoses(poses[:, :3, :3], poses[:, :3, 3], stamps[order], kind=kind,
                     body_frame=read[0][3] or 'base_link', world_frame=read[0][2] or 'world')


def read_transforms(path: str | Path, world: str, body: str) -> BodyPoses:
    """
    Read the poses of one frame in another from /tf and /tf_static of a bag.

    Raises
    ------
    InputError
        If the bag holds no transforms, or not those; see `TransformTree.poses`.

    """
    path, tree = Path(path), TransformTree()
    with open_bag(path) as bag:
        chosen = [one for one in bag.connections if one.msgtype == TRANSFORM_TYPE
                  and one.topic in TRANSFORM_TOPICS]
        if not chosen:
            raise InputError(f'{path} holds no transforms on /tf; {_fitting(bag)}.')
        for connection, msg in bag.messages(chosen):
            for stamp, matrix, parent, child in transforms(msg):
                tree.add(stamp, matrix, parent, child,
                         connection.topic == TRANSFORM_TOPICS[1])
    try:
        return tree.poses(world, body)
    except InputError as error:
        raise InputError(f'{path}: {error}') from None


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
        for _, _, parent, child in transforms(msg):
            frames |= dict.fromkeys((parent, child))
    return '/tf:FIXED:BODY' + (f' (frames {", ".join(sorted(frames)[:12])})' if frames else '')
