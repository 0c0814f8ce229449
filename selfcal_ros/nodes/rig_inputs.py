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
"""What rorapid_tracker hears of several cameras: images by instants, calibrations, and places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
import re
from typing import TYPE_CHECKING

from msg_adapters.body_poses import transforms
from msg_adapters.message_types import Message
from msg_adapters.stamps import header_message, stamp_ns
import numpy as np
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.camera_info_input import CameraInfoInput
from selfcal_ros.nodes.given_paths import given_path
from selfcal_ros.nodes.image_topics import ImageInputs
from selfcal_ros.nodes.parameters import RorapidTrackerParameters
from selfcal_ros.nodes.robot_topic import TF_STATIC_IN
from selfcal_ros.nodes.tf_messages import transform_type
from selfcal_ros.pipeline.simultaneous import StampGroups
from selfcal_ros.report.camera_files.rig_reading import read_rig, rough_spread
from selfcal_ros.values.camera_rig import placed_beside, PlacedCamera
from selfcal_ros.values.transform_tree import TransformTree

if TYPE_CHECKING:
    from selfcal_ros.nodes.object_tracker_node import ObjectTrackerNode


def camera_names(text: str) -> list[str]:
    """
    Part the parameter cameras; empty for a single camera.

    Raises
    ------
    ArgumentError
        If it names fewer than two cameras, or as topics may not be called.

    """
    if not text.strip():
        return []
    names = [word.strip() for word in text.split(',')]
    if len(names) < 2 or len(set(names)) < len(names) or not all(
            re.fullmatch('[A-Za-z][A-Za-z0-9_]*', name) for name in names):
        raise ArgumentError('The parameter cameras takes the names of two or more cameras, '
                            f'separated by commas, such as left,right, not {text!r:.60}.')
    return names


def check_rig_parameters(p: RorapidTrackerParameters) -> None:
    """
    Refuse parameters that do not go together.

    Raises
    ------
    ArgumentError

    """
    if not p.cameras:
        given = [name for name in ('rig_file', 'rig_sigma') if getattr(p, name)]
        if given:
            raise ArgumentError(f'The parameter {given[0]} needs the parameter cameras, such as '
                                'left,right.')
        return
    for name in ('camera_file', 'depth'):
        if getattr(p, name):
            raise ArgumentError(f'The parameter {name} is for a single camera; leave it out '
                                'beside cameras.')


def rig_sigma(text: str) -> tuple[float, float] | None:
    """
    Read the parameter rig_sigma, degrees and metres; None where it is empty.

    Raises
    ------
    ArgumentError
        If it is not two such numbers.

    """
    if not text.strip():
        return None
    try:
        degrees, metres = map(float, text.replace(',', ' ').split())
    except ValueError:
        degrees = metres = -1.0
    if not (0 <= degrees < 180 and 0 <= metres < 1e6):
        raise ArgumentError('The parameter rig_sigma must be degrees and metres, such as '
                            f'"0.05 0.0005", not {text!r:.60}.')
    return degrees, metres


def rig_of_file(p: RorapidTrackerParameters) -> tuple[PlacedCamera, ...]:
    """Read the parameter rig_file; empty where the places come from TF."""
    names = camera_names(p.cameras)
    return read_rig(given_path(p.rig_file), names, sigma=rig_sigma(p.rig_sigma)
                    ) if p.rig_file else ()


class RigInputs:
    """
    Subscriptions to `NAME/image` and `NAME/camera_info` of each camera, and to /tf_static.

    Parameters
    ----------
    node : rclpy.node.Node
        Its `parameters`.
    submit : callable
        Called as submit(header, images) with what belongs to one instant: the header of the first
        camera, and an image message or None of each.
    calibrate : callable
        Called as calibrate(which, camera) for each calibration that is heard, where the places
        are from a file.
    place : callable
        Called as place(cameras) once TF tells the places.

    """

    def __init__(self, node: ObjectTrackerNode,
                 submit: Callable[[Message, Sequence[Message]], object],
                 calibrate: Callable[[int, Camera], object],
                 place: Callable[[Sequence[PlacedCamera]], object]) -> None:
        p = node.parameters
        self._node, self._submit, self._place = node, submit, place
        self.names = camera_names(p.cameras)
        self._groups = StampGroups(len(self.names))
        self._frames = [''] * len(self.names)
        self._unstamped: set[str] = set()
        self._images = [ImageInputs(node, partial(self._on_image, k), base=f'{name}/image',
                                    transport=p.image_transport, reliability=p.reliability)
                        for k, name in enumerate(self.names)]
        self._cameras: list[Camera | None] = [None] * len(self.names)
        self._by_tf, self._sigma = not p.rig_file, rig_sigma(p.rig_sigma)
        self._tree, self._problem = TransformTree(), ''

        def take(which: int, camera: Camera) -> None:
            self._cameras[which] = camera
            if self._by_tf:
                self._look()
            else:
                calibrate(which, camera)

        self._infos = [CameraInfoInput(node, f'{name}/camera_info', partial(take, k))
                       for k, name in enumerate(self.names)]
        if self._by_tf:
            node.create_subscription(transform_type('cameras'), '/tf_static', self._on_static,
                                     TF_STATIC_IN)

    # as ImageInputs has it

    @property
    def topics(self) -> list[str]:
        """Resolved names of the topics that are subscribed now."""
        return [topic for one in self._images for topic in one.topics]

    def choose(self, transport: str, reliability: str) -> None:
        """Follow another transport, or subscribe in another way, from now on."""
        for one in self._images:
            one.choose(transport, reliability)

    def complaint(self, news: bool = False) -> str:
        """Say what is being lost and why; see `ImageInputs.complaint`."""
        return '; '.join(filter(None, [one.complaint(news) for one in self._images]))

    def look(self) -> None:
        """Count what was lost so far."""
        for one in self._images:
            one.look()

    @property
    def values(self) -> dict[str, int]:
        """Counts for the diagnostics."""
        found = {f'{name}: {key}': value for name, one in zip(self.names, self._images)
                 for key, value in one.values.items()}
        return {**found, 'images too late': self._groups.late}

    @property
    def problem(self) -> str:
        """What is wrong with calibrations or places."""
        told = [f'{name}: {one.problem}' for name, one in zip(self.names, self._infos)
                if one.problem]
        if self._unstamped:
            told.append(f'The images of {" and ".join(sorted(self._unstamped))} have no stamp, '
                        'and stamps tell which belong together; let their driver fill the header.')
        if not self.frame:
            told.append(f'Poses are in the frame of {self.names[0]}, which was not heard yet.')
        return ' '.join([*told, *filter(None, [self._problem])])

    # what comes in

    @property
    def frame(self) -> str:
        """Optical frame of the first camera; empty until it is heard."""
        return self._frames[0] or self._infos[0].frame_id

    def _on_image(self, which: int, msg: Message) -> None:
        frame = msg.header.frame_id
        # a driver may come again with another
        if frame and frame != self._frames[which]:
            self._frames[which] = frame
            if self._by_tf:
                self._look()
        stamp, name = stamp_ns(msg.header.stamp), self.names[which]
        if stamp <= 0:
            self._unstamped.add(name)
            return
        self._unstamped.discard(name)
        for first, images in self._groups.add(which, stamp, msg):
            # a pose without a frame would be of no use
            if self.frame:
                self._submit(header_message(first, self.frame, self._node.types), images)

    def _on_static(self, msg: Message) -> None:
        def drop(why: str) -> None:
            self._node.get_logger().warning(f'/tf_static: {why}', throttle_duration_sec=5.0)

        for stamp, matrix, parent, child in transforms(msg, drop, is_static=True):
            self._tree.add(stamp, matrix, parent, child, is_static=True)
        self._look()

    def _look(self) -> None:
        """Put the cameras into place once TF tells where each is."""
        # TF has no slash before a frame
        frames = [(frame or info.frame_id).lstrip('/')
                  for frame, info in zip(self._frames, self._infos)]
        placed = []
        for k, (name, camera, frame) in enumerate(zip(self.names, self._cameras, frames)):
            if camera is None or not frame:
                self._problem = f'There is no camera_info of {name} yet.'
                return
            try:
                T = self._tree.still(frames[0], frame)
            except InputError as error:
                self._problem = str(error)
                return
            placed.append(PlacedCamera(name, camera, T, rough_spread(self._sigma) if k
                                       else np.zeros((6, 6))))
        self._problem = ''
        self._place(placed_beside(placed))
