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
"""rorapid_tracker: images and the camera's calibration in, poses of a known object out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, cast

from diagnostic_msgs.msg import DiagnosticArray
from msg_adapters.diagnostics import diagnostics_message, status_message, WARN
from msg_adapters.image import depth_metres
from msg_adapters.message_types import Message, rclpy_types
from msg_adapters.stamps import header_message, stamp_ns
import numpy as np
from rclpy.node import Node
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.camera_info_input import CameraInfoInput
from selfcal_ros.nodes.construction import whole_or_none
from selfcal_ros.nodes.diagnostic_name import diagnostic_name
from selfcal_ros.nodes.given_paths import given_path, model_paths
from selfcal_ros.nodes.image_topics import ImageInputs
from selfcal_ros.nodes.input_watchdog import InputWatchdog
from selfcal_ros.nodes.object_topics import begin, ObjectTopics, Start
from selfcal_ros.nodes.parameter_declaration import declare, follow
from selfcal_ros.nodes.parameter_words import in_parameters
from selfcal_ros.nodes.parameters import RorapidTrackerParameters
from selfcal_ros.nodes.quality_of_service import IMAGES_IN, IMAGES_OUT, STEADY
from selfcal_ros.nodes.rig_inputs import (
    camera_names, check_rig_parameters, rig_of_file, RigInputs)
from selfcal_ros.nodes.rig_worker import RigWorker
from selfcal_ros.nodes.rival_publishers import RivalPublishers
from selfcal_ros.nodes.tf_messages import transform_type
from selfcal_ros.nodes.tracking_status import tracking_status
from selfcal_ros.nodes.tracking_worker import InstantMessages, TrackingWorker
from selfcal_ros.pipeline.depth_pairing import DepthPairing
from selfcal_ros.pipeline.rig_session import RigSession
from selfcal_ros.pipeline.several_objects import object_names, parted_starts
from selfcal_ros.pipeline.tracking_run import read_start
from selfcal_ros.pipeline.tracking_session import AUTO, TrackingSession
from selfcal_ros.report.camera_files.known_camera import read_known
from selfcal_ros.rorapid.model import read_model
from selfcal_ros.rorapid.options import ReadLines, TrackerOptions
from selfcal_ros.rorapid.visibility.visible_model import check_size
from sensor_msgs.msg import Image


class ObjectTrackerNode(Node):
    """Follows objects through `image` or `image/compressed` and publishes each one's `pose`."""

    @whole_or_none
    def __init__(self) -> None:
        super().__init__('rorapid_tracker')
        p = self.parameters = declare(self, RorapidTrackerParameters)
        if not p.model:
            raise ArgumentError('rorapid_tracker needs the shape of the object: '
                                '--ros-args -p model:=/path/to/model.cao')
        check_rig_parameters(p)
        self.types = rclpy_types()
        paths = model_paths(p.model)
        self._models = [read_model(path, p.model_scale) for path in paths]
        for path, model in zip(paths, self._models):
            for remark in getattr(model, 'remarks', ()):
                self.get_logger().warning(f'{path}: {remark}')
        stored = read_known(given_path(p.camera_file)) if p.camera_file else None
        #: Seconds from line to line, and which lines, as the camera file says.
        self._file_lines = (0.0, 'rows') if stored is None else (
            stored.line_delay_s or 0.0, stored.lines)
        camera = None if stored is None else stored.camera
        rig, of_rig = rig_of_file(p), camera_names(p.cameras)
        starts = starts_of(p.start_pose, len(paths), camera)
        options = tracker_options(p, self._file_lines)
        sessions = [RigSession(model, rig, options) if of_rig else
                    TrackingSession(model, options) for model in self._models]
        for session, start in zip(sessions, starts):
            if camera is not None:
                session.set_camera(camera)
            begin(session, start)
        #: Frame of the images.
        self.image_frame = ''
        self._overlays = [self.create_publisher(Image, topic, IMAGES_OUT) for topic in (
            [f'~/{name}/overlay' for name in of_rig] or ['~/overlay'])]
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.transforms: Any = (self.create_publisher(self._transform_type(), '/tf', 100)
                                if p.publish_tf else None)
        self._ready = self.create_guard_condition(self._publish)
        names = object_names(paths) if len(paths) > 1 else ['']
        # with a rig all sessions are of one
        self._worker = (RigWorker(sessions,  # type: ignore[arg-type]
                                  self._ready.trigger, names, of_rig) if of_rig else
                        TrackingWorker(sessions, self._ready.trigger, names))
        self._objects = [
            ObjectTopics(self, model, name, start, partial(self._worker.command, which=k))
            for k, (model, name, start) in enumerate(zip(self._models, names, starts))]
        self._pairing = DepthPairing() if p.depth else None
        if p.depth:
            self.create_subscription(Image, 'depth', self._on_depth, IMAGES_IN)
        self._inputs: ImageInputs | RigInputs
        self._infos: CameraInfoInput | RigInputs
        if of_rig:
            self._inputs = self._infos = RigInputs(
                self, self._on_instant,
                lambda which, one: self._command(lambda rig: rig.set_camera(one, which)),
                lambda placed: self._command(lambda rig: rig.set_cameras(placed)))
        else:
            self._inputs = ImageInputs(self, self._on_image, transport=p.image_transport,
                                       reliability=p.reliability)
            self._infos = CameraInfoInput(
                self, 'camera_info', lambda one: self._command(lambda s: s.set_camera(one)))
        self._watchdog = InputWatchdog(self, 'images', lambda: self._inputs.topics,
                                       p.silence_s)
        self._rivals = RivalPublishers(self, lambda: self._inputs.topics,
                                       'end all but one, or remap the input')
        self.create_timer(1.0, self._diagnose, clock=STEADY)
        follow(self, self._check_change, self._change)

    def destroy_node(self) -> None:
        """End the thread, too."""
        if hasattr(self, '_worker'):
            self._worker.stop()
        super().destroy_node()  # type: ignore[no-untyped-call]

    @staticmethod
    def _transform_type() -> type:
        return transform_type('publish_tf')

    def _check_change(self, new: RorapidTrackerParameters) -> None:
        """Refuse parameters that contradict each other, or ask for what is not installed."""
        for model in self._models:
            check_size(model, *tracker_options(new).control_points)
        if new.publish_tf:
            self._transform_type()

    def _change(self, new: RorapidTrackerParameters, old: RorapidTrackerParameters) -> None:
        """Do what changed parameters say; the tracker goes on with all that it has learned."""
        self._watchdog.limit_s = new.silence_s
        options = tracker_options(new, self._file_lines)
        if options != tracker_options(old, self._file_lines):
            self._worker.command(lambda session: session.set_options(options))
        self._inputs.choose(new.image_transport, new.reliability)
        if new.publish_tf and self.transforms is None:
            self.transforms = self.create_publisher(self._transform_type(), '/tf', 100)

    # what comes in

    def _on_image(self, msg: Message) -> None:
        self._hear(msg.header.frame_id)
        if self._pairing is None:
            self._submit([(msg, None)])
            return
        self._submit(self._pairing.image(stamp_ns(msg.header.stamp), msg))

    def _hear(self, frame: str) -> None:
        self._watchdog.heard()
        self.image_frame = frame
        for one in self._objects:
            one.check_frame(frame)

    def _on_depth(self, msg: Image) -> None:
        try:
            # subscribed to where there is a pairing only
            self._submit(self._pairing.depth(  # type: ignore[union-attr]
                stamp_ns(msg.header.stamp), depth_metres(msg)))
        except InputError as error:
            self.get_logger().warning(f'depth image dropped: {error}', throttle_duration_sec=5.0)

    def _on_instant(self, header: Message, images: Sequence[Message]) -> None:
        self._hear(header.frame_id)
        self._worker.submit(InstantMessages(header, tuple(images), self._are_drawn()))

    def _are_drawn(self) -> list[bool]:
        """Of which cameras somebody looks at the overlay."""
        return [one.get_subscription_count() > 0 for one in self._overlays]

    def _command(self, action: Callable[[Any], object]) -> None:
        self._worker.command(action)

    def _submit(self, pairs: Iterable[tuple[Message, np.ndarray | None]]) -> None:
        """Hand over images, each with its depth or None."""
        for msg, depth in pairs:
            self._worker.submit(InstantMessages(msg.header, (msg,), self._are_drawn(), depth))

    # what goes out

    def _publish(self) -> None:
        """Publish what the thread has finished."""
        while (done := self._worker.poll()) is not None:
            if isinstance(done, str):
                self.get_logger().warning(in_parameters(done))
                continue
            for publisher, picture in zip(self._overlays, done.overlays):
                if picture is not None:
                    publisher.publish(picture)
            for topics, one in zip(self._objects, done.objects):
                if one is not None:
                    topics.publish(one, done.header)

    def _diagnose(self) -> None:
        self._inputs.look()
        news = self._inputs.complaint(news=True)
        if news:
            self.get_logger().warning(news)
        complaint = self._rivals.complaint or self._inputs.complaint()
        statuses = []
        for topics in self._objects:
            level, text, values = tracking_status(
                topics.newest, self._infos.problem, self._worker.dropped,
                self._watchdog.too_long_s)
            if complaint:
                level, text = max(level, WARN), f'{complaint}; {text}'
            values.update(self._inputs.values)
            what = f'tracking {topics.name}' if topics.name else 'tracking'
            statuses.append(status_message(f'{diagnostic_name(self)}: {what}', level,
                                           in_parameters(text), self.types, values,
                                           self.parameters.camera_name))
        header = header_message(self.get_clock().now().nanoseconds, '', self.types)
        self._diagnostics.publish(diagnostics_message(statuses, header, self.types))


def starts_of(text: str, count: int, camera: Camera | None) -> list[Start]:
    """Read the parameter start_pose, one an object: a pose, AUTO, or None where it waits."""
    if not text.strip():
        return [None] * count
    # without clicks no camera is needed
    return [word if word == AUTO else
            read_start(given_path(word), None, camera) if word else None  # type: ignore[arg-type]
            for word in parted_starts(text, count)]


def tracker_options(parameters: RorapidTrackerParameters,
                    file_lines: tuple[float, str] = (0.0, 'rows')) -> TrackerOptions:
    """
    Translate the parameters.

    Parameters
    ----------
    parameters : RorapidTrackerParameters
    file_lines : (float, {'rows', 'columns'})
        Seconds from line to line where the parameters say nothing, and which lines.

    Raises
    ------
    ArgumentError
        If values contradict each other.

    """
    axis: tuple[float, float, float] | None = None
    if parameters.plane_axis:
        try:
            x, y, z = map(float, parameters.plane_axis.replace(',', ' ').split())
        except ValueError:
            raise ArgumentError('The parameter plane_axis must be three numbers "x y z", not '
                                f'{parameters.plane_axis!r:.60}.') from None
        axis = x, y, z
    names = ('method', 'camera_model', 'motion', 'control_points_per_line',
             'control_points_per_conic', 'search_least_px', 'search_most_px', 'least_contrast',
             'texture', 'recovery', 'depth_scale_sigma')
    values = {name: getattr(parameters, name) for name in names}
    # rapid and rorapid keep to the least numbers of the thesis, which fewer points cannot reach
    default = TrackerOptions()
    delay, lines = (parameters.line_delay_s, parameters.lines) if parameters.line_delay_s else \
        file_lines
    return TrackerOptions(
        plane_axis=axis, line_delay_s=delay, lines=cast(ReadLines, lines),
        least_per_line=min(default.least_per_line, values['control_points_per_line']),
        least_per_conic=min(default.least_per_conic, values['control_points_per_conic']),
        **values)
