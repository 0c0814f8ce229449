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
"""Where the camera sits on the robot: as a message, in TF where asked for, in the diagnostics."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import TransformStamped
from msg_adapters.message_types import rclpy_types
from msg_adapters.poses import transform_message
from msg_adapters.stamps import header_message

import numpy as np

from rclpy.node import Node
from selfcal_ros.calibration.mount import Floor, Mount, PLACE, TURN
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.nodes.quality_of_service import LATCHED
from selfcal_ros.nodes.tf_messages import transform_type
from selfcal_ros.report.mounts.record import shown_sigma
from selfcal_ros.report.mounts.transform_files import CAMERA_FRAME, stored_mount
from selfcal_ros.report.mounts.words import mount_rows, mount_sentence, no_mount_sentence

#: Findings that say that a mount is hardly what a robot has.
ODD = ('mount_upside_down', 'mount_far_off')
#: A mount that differs from the published one by fewer of that one's sigmas is no news.
NEWS_SIGMAS = 1.0


class MountPublisher:
    """
    Publishes `~/mount`, and `/tf_static` with `publish_tf`, latched.

    A transform goes out once it has all six numbers. Another follows only where an estimate
    leaves the sigmas of the first, so that a robot does not shiver in TF.

    Parameters
    ----------
    node : rclpy.node.Node
    publish_tf : bool

    """

    def __init__(self, node: Node, publish_tf: bool) -> None:
        self._node, self._types = node, rclpy_types()
        self._mount = node.create_publisher(TransformStamped, '~/mount', LATCHED)
        self._static: Any = None
        self._told: Mount | None = None
        self._open = ''
        self.camera_frame = ''
        self.change(publish_tf)

    def change(self, publish_tf: bool) -> None:
        """Publish in TF, too, or no longer."""
        if publish_tf and self._static is None:
            kind = transform_type('publish_tf')
            self._static = (kind, self._node.create_publisher(kind, '/tf_static', LATCHED))
            if self._told is not None:
                self._send(self._told)
        elif not publish_tf and self._static is not None:
            self._node.destroy_publisher(self._static[1])
            self._static = None

    def take(self, mount: Mount | NoEstimate | None) -> None:
        """Take the mount of a calibration in force; None where no robot is listened to."""
        self._open = ''
        if not isinstance(mount, Mount):
            self._open = '' if mount is None else no_mount_sentence(mount)
            return
        try:
            stored_mount(mount, self.camera_frame)
        except ArgumentError as error:
            self._open = str(error)
            return
        if self._told is None or _differs(mount, self._told):
            self._told = mount
            self._send(mount)

    def named(self, result: Calibration | NotCalibrated) -> Calibration | NotCalibrated:
        """Return a result whose mount names the frame of the camera."""
        if not (isinstance(result, Calibration) and isinstance(result.mount, Mount)):
            return result
        return replace(result, mount=replace(result.mount, camera_frame=self.camera_frame))

    def _send(self, mount: Mount) -> None:
        header = header_message(self._node.get_clock().now().nanoseconds, mount.frame,
                                self._types)
        message = transform_message(mount.T_body_camera, header,
                                    self.camera_frame or CAMERA_FRAME, self._types)
        self._mount.publish(message)
        if self._static is not None:
            kind, publisher = self._static
            publisher.publish(kind(transforms=[message]))

    def forget(self) -> None:
        """Hold the next mount for news."""
        self._told, self._open = None, ''

    @property
    def why_not(self) -> str:
        """Why no transform is published; '' where one is, or nobody asks."""
        return self._open


def _differs(mount: Mount, other: Mount) -> bool:
    """Tell whether a mount leaves the sigmas of another."""
    sigma = other.covariance[:6, :6]
    turned = mount.T_body_camera[:3, :3] @ other.T_body_camera[:3, :3].T
    turn = rotation_vector(turned)
    moved = mount.T_body_camera[:3, 3] - other.T_body_camera[:3, 3]
    apart = np.abs(np.concatenate([moved, turn]))
    return bool((apart > NEWS_SIGMAS * np.sqrt(np.diag(sigma)) + 1e-9).any())


def mount_line(mount: Mount | NoEstimate, findings: Iterable[Finding] = ()) -> str:
    """Return a mount for the log, in a line: its numbers, what is open, and what is odd."""
    if not isinstance(mount, Mount):
        return no_mount_sentence(mount)
    known = [f'{row.name} {row.value} ± {row.sigma or 0} {row.unit}' for row in mount_rows(mount)
             if row.value and row.name in (*PLACE, *TURN)]
    odd = [one.sentence for one in findings if one.kind in ODD]
    return ' '.join(filter(None, (mount_sentence(mount), f'{", ".join(known)}.' if known else '',
                                  *odd)))


def mount_values(mount: Mount | NoEstimate | None) -> dict[str, Any]:
    """Return a mount for the diagnostics: metres, degrees, and what is open."""
    if not isinstance(mount, Mount):
        return {} if mount is None else {'mount': no_mount_sentence(mount)}
    values: dict[str, Any] = {}
    numbers = {**dict(zip(PLACE, mount.T_body_camera[:3, 3].tolist())),
               **{name: float(np.degrees(angle)) for name, angle in mount.angles.items()},
               'scale': mount.scale, 'time_offset': mount.time_offset_s}
    for name, sigma in shown_sigma(mount).items():
        if sigma is None:
            values[f'mount {name}'] = f'unobservable: {mount.missing.get(name, "")}'.rstrip(': ')
            continue
        values[f'mount {name}'] = numbers[name]
        values[f'mount {name} sigma'] = float(np.degrees(sigma)) if name in TURN else sigma
    if isinstance(mount.floor, Floor):
        values['height above the floor'] = mount.floor.height_m
        values['height above the floor sigma'] = mount.floor.sigma_m
    elif mount.floor is not None:
        values['height above the floor'] = f'unknown: {mount.floor.reason}'
    return values
