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
"""What rorapid_tracker says of one object, and hears: its topics, services and state."""

from __future__ import annotations

from collections.abc import Callable
import re
import time
from typing import Any, TYPE_CHECKING, TypeAlias

from geometry_msgs.msg import PoseWithCovarianceStamped
from msg_adapters.camera_info import camera_info_message
from msg_adapters.markers import delete_markers, object_markers
from msg_adapters.message_types import Message, rclpy_types
from msg_adapters.poses import pose_matrix, pose_with_covariance_message, transform_message
from msg_adapters.stamps import header_message
import numpy as np
from numpy.typing import ArrayLike
from selfcal_ros.errors import InputError
from selfcal_ros.nodes.parameter_words import in_parameters
from selfcal_ros.nodes.quality_of_service import LATCHED, PER_IMAGE
from selfcal_ros.nodes.tf_messages import transform_type
from selfcal_ros.nodes.tracking_worker import ObjectInImage
from selfcal_ros.pipeline.tracking_session import AUTO, TrackingSession
from selfcal_ros.report.overlay import wireframe_segments, zoomed_camera
from selfcal_ros.rorapid.tracked_frame import TrackerState
from selfcal_ros.values.wireframe import WireframeModel
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

if TYPE_CHECKING:
    from selfcal_ros.nodes.object_tracker_node import ObjectTrackerNode

#: Rotation, translation and maybe a sigma of the distance (m), or AUTO, or None.
Start: TypeAlias = Any
#: Red, green, blue of the wireframe's marker.
MARKER_COLOURS = {TrackerState.TRACKING: (0.0, 0.62, 0.45),
                  TrackerState.DEGRADED: (0.9, 0.62, 0.0),
                  TrackerState.INITIALISING: (0.6, 0.6, 0.6)}
#: A marker vanishes when no newer one comes for so long.
MARKER_LIFE_S = 1.0
#: Another reason of the same state is told no sooner than this after the last one.
REASON_EVERY_S = 1.0
_NUMBER = re.compile(r'-?\d+(\.\d+)?')


def _check_frame(frame: str, images: str) -> None:
    """Raise InputError if a pose is in another frame than the images; empty ones may be any."""
    if frame and images and frame != images:
        raise InputError(f'It is in the frame {frame!r:.60}, the images are in {images!r:.60}; '
                         'give it in the frame of the images.')


class ObjectTopics:
    """
    One object of the node.

    Parameters
    ----------
    node : ObjectTrackerNode
        Its `parameters`, and `image_frame` of the images.
    model : WireframeModel
    name : str
        Before the names of its topics; empty for an only object.
    start : (ndarray (3, 3), ndarray (3,)), AUTO or None
        From the parameters; None: wait for initialpose.
    command : callable
        Queues command(action, anew) for the object's session.

    Attributes
    ----------
    newest : ObjectInImage or None
        What the last image gave.

    """

    def __init__(self, node: ObjectTrackerNode, model: WireframeModel, name: str, start: Start,
                 command: Callable[..., object]) -> None:
        self._node, self._model, self._start, self._command = node, model, start, command
        self._types, self.name = rclpy_types(), name
        self._segments = wireframe_segments(model)
        self._state: TrackerState | None = None
        # words that were told last, without their numbers, and when
        self._told, self._told_s = '', 0.0
        self._claimed = ''
        self.newest: ObjectInImage | None = None
        p, before = node.parameters, f'{name}/' if name else ''
        self._frame = f'{p.object_frame}_{name}' if name else p.object_frame
        self._pose = node.create_publisher(PoseWithCovarianceStamped, f'{before}pose', PER_IMAGE)
        self._markers = node.create_publisher(MarkerArray, f'~/{before}markers', PER_IMAGE)
        self._states = node.create_publisher(String, f'~/{before}state', LATCHED)
        self._camera_info = (node.create_publisher(CameraInfo, f'~/{before}camera_info', PER_IMAGE)
                             if p.camera_model == 'zoom' else None)
        node.create_subscription(PoseWithCovarianceStamped, f'{before}initialpose',
                                 self._on_initialpose, PER_IMAGE)
        node.create_service(Trigger, f'~/{before}start', self._on_start)
        node.create_service(Trigger, f'~/{before}reset', self._on_reset)

    # what comes in

    def _on_initialpose(self, msg: PoseWithCovarianceStamped) -> None:
        try:
            _check_frame(msg.header.frame_id, self._node.image_frame)
            pose = pose_matrix(msg)
            sigma_m = distance_sigma(pose[:3, 3], msg.pose.covariance)
        except InputError as error:
            self._node.get_logger().warning(f'{self._named("initialpose")} dropped: {error}')
            return
        # before any image nobody knows their frame
        self._claimed = '' if self._node.image_frame else msg.header.frame_id
        self._begin(pose[:3, :3], pose[:3, 3], sigma_m)

    def check_frame(self, images: str) -> None:
        """Drop a start that came before any image, if it is not in the frame of the images."""
        claimed, self._claimed = self._claimed, ''
        try:
            _check_frame(claimed, images)
        except InputError as error:
            self._node.get_logger().warning(f'{self._named("initialpose")} dropped: {error}')

            def drop(session: TrackingSession) -> None:
                session.reset(forget_pose=True)
                self._start = None

            self._command(drop, anew=True)

    def _named(self, topic: str) -> str:
        """Return a topic's name with that of the object."""
        return f'{self.name}/{topic}' if self.name else topic

    def _begin(self, rotation: ArrayLike, translation: ArrayLike,
               distance_sigma_m: float | None = None) -> None:
        def begin_there(session: TrackingSession) -> None:
            session.start(rotation, translation, distance_sigma_m)
            self._start = rotation, translation, distance_sigma_m

        self._command(begin_there, anew=True)

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._start is None:
            response.success = False
            response.message = ('there is no start pose; publish one on '
                                f'{self._named("initialpose")}, or set the parameter start_pose')
            return response
        self._command(lambda session: begin(session, self._start), anew=True)
        response.success, response.message = True, (
            'the object is sought' if self._start == AUTO else 'tracking from the start pose')
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._command(lambda session: session.reset(forget_pose=True), anew=True)
        self._say('waiting for a start pose')
        self._clear_markers()
        self.newest = None
        response.success = True
        response.message = 'stopped; ~/start or an initialpose starts it again'
        return response

    # what goes out

    def publish(self, done: ObjectInImage, header: Message) -> None:
        """Publish what an image gave; `transforms` of the node takes the transform."""
        self.newest = done
        if done.problem:
            self._node.get_logger().warning(f'image dropped: {done.problem}',
                                            throttle_duration_sec=5.0)
        tracked, camera = done.tracked, done.camera
        if tracked is None or camera is None:
            # there is a problem with every image that was not tracked
            return
        self._say(in_parameters(tracked.state.value + (f': {tracked.reason}' if tracked.reason
                                                       else '')), tracked.state)
        if tracked.state is TrackerState.LOST:
            return
        pose = np.column_stack([tracked.rotation, tracked.translation])
        if tracked:
            self._pose.publish(pose_with_covariance_message(pose, tracked.covariance, header,
                                                            self._types))
            if self._node.parameters.publish_tf:
                self._node.transforms.publish(transform_type('publish_tf')(transforms=[
                    transform_message(pose, header, self._frame, self._types)]))
        if self._camera_info is not None and tracked.focal_sigma_px > 0:
            self._camera_info.publish(camera_info_message(
                zoomed_camera(camera, tracked), header, self._types))
        if self._markers.get_subscription_count():
            self._markers.publish(object_markers(
                self._segments, pose, header, self._types, MARKER_COLOURS[tracked.state],
                0.01 * self._model.diameter_m, MARKER_LIFE_S))

    def _say(self, text: str, state: TrackerState | None = None) -> None:
        """Tell the state where it has changed, or its reason in more than numbers."""
        told = f'{self.name}: {text}' if self.name else text
        words, now = _NUMBER.sub('#', text), time.monotonic()
        if state is not None and state == self._state:
            if words == self._told or now - self._told_s < REASON_EVERY_S:
                return
        elif state is TrackerState.LOST:
            self._node.get_logger().warning(told)
            self._clear_markers()
        else:
            self._node.get_logger().info(told)
        self._state, self._told, self._told_s = state, words, now
        self._states.publish(String(data=text))

    def _clear_markers(self) -> None:
        header = header_message(self._node.get_clock().now().nanoseconds, self._node.image_frame,
                                self._types)
        self._markers.publish(delete_markers(header, self._types))


def begin(session: TrackingSession, start: Start) -> None:
    """Begin from a start, or seek the object; wait where there is none."""
    if start == AUTO:
        session.seek()
    elif start is not None:
        session.start(*start)


def distance_sigma(translation: np.ndarray, covariance: ArrayLike) -> float | None:
    """Standard deviation of a pose's distance (m) from its covariance (36,); None without any."""
    place = np.reshape(covariance, (6, 6))[:3, :3]
    away = translation / max(float(np.linalg.norm(translation)), 1e-12)
    variance = float(away @ place @ away)
    return variance**0.5 if np.isfinite(variance) and variance > 0 else None
