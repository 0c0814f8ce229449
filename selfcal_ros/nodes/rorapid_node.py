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

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from msg_adapters.camera_info import camera_info_message, image_camera_from_info
from msg_adapters.diagnostics import diagnostics_message, status_message, WARN
from msg_adapters.markers import delete_markers, object_markers
from msg_adapters.message_types import rclpy_types
from msg_adapters.poses import pose_matrix, pose_with_covariance_message, transform_message
from msg_adapters.stamps import header_message
import numpy as np
from rclpy.node import Node
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.nodes.diagnostic_name import diagnostic_name
from selfcal_ros.nodes.image_topics import ImageInputs
from selfcal_ros.nodes.input_watchdog import InputWatchdog
from selfcal_ros.nodes.parameter_declaration import declare, follow
from selfcal_ros.nodes.parameter_words import in_parameters
from selfcal_ros.nodes.parameters import RorapidTrackerParameters
from selfcal_ros.nodes.quality_of_service import IMAGES_IN, IMAGES_OUT, LATCHED, PER_IMAGE, STEADY
from selfcal_ros.nodes.rival_publishers import RivalPublishers
from selfcal_ros.nodes.tf_messages import transform_type
from selfcal_ros.nodes.tracking_status import tracking_status
from selfcal_ros.nodes.tracking_worker import TrackedImage, TrackingWorker
from selfcal_ros.pipeline.tracking_run import read_start
from selfcal_ros.pipeline.tracking_session import TrackingSession
from selfcal_ros.report.camera_files.known_camera import check_unfolded, read_known_camera
from selfcal_ros.report.overlay import wireframe_segments, zoomed_camera
from selfcal_ros.rorapid.model import read_model
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.tracked_frame import TrackerState
from selfcal_ros.rorapid.visibility.visible_model import check_size
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

#: Red, green, blue of the wireframe's marker.
MARKER_COLOURS = {TrackerState.TRACKING: (0.0, 0.62, 0.45),
                  TrackerState.DEGRADED: (0.9, 0.62, 0.0),
                  TrackerState.INITIALISING: (0.6, 0.6, 0.6)}
#: A marker vanishes when no newer one comes for so long.
MARKER_LIFE_S = 1.0


class RorapidNode(Node):
    """Follows an object through `image` or `image/compressed` and publishes its `pose`."""

    def __init__(self):
        super().__init__('rorapid_tracker')
        p = self.parameters = declare(self, RorapidTrackerParameters)
        if not p.model:
            raise ArgumentError('rorapid_tracker needs the wireframe of the object: '
                                '--ros-args -p model:=/path/to/model.cao')
        self._types = rclpy_types()
        self._model = read_model(p.model, p.model_scale)
        for remark in getattr(self._model, 'remarks', ()):
            self.get_logger().warning(f'{p.model}: {remark}')
        self._segments = wireframe_segments(self._model)
        session = TrackingSession(self._model, tracker_options(p))
        camera = read_known_camera(p.camera_file) if p.camera_file else None
        if camera is not None:
            session.set_camera(camera)
        self._start = read_start(p.start_pose, None, camera) if p.start_pose else None
        if self._start is not None:
            session.start(*self._start)
        self._frame_id = ''
        self._info_key = self._newest = self._state = None
        self._info_problem = ''
        self._pose = self.create_publisher(PoseWithCovarianceStamped, 'pose', PER_IMAGE)
        self._overlay = self.create_publisher(Image, '~/overlay', IMAGES_OUT)
        self._markers = self.create_publisher(MarkerArray, '~/markers', PER_IMAGE)
        self._states = self.create_publisher(String, '~/state', LATCHED)
        self._camera_info = (self.create_publisher(CameraInfo, '~/camera_info', PER_IMAGE)
                             if p.camera_model == 'zoom' else None)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._transforms = (self.create_publisher(self._transform_type(), '/tf', 100)
                            if p.publish_tf else None)
        self._ready = self.create_guard_condition(self._publish)
        self._worker = TrackingWorker(session, self._ready.trigger)
        self._inputs = ImageInputs(self, self._on_image, transport=p.image_transport,
                                   reliability=p.reliability)
        # a publisher of CameraInfo may be of either reliability, too
        self.create_subscription(CameraInfo, 'camera_info', self._on_camera_info, IMAGES_IN)
        self.create_subscription(PoseWithCovarianceStamped, 'initialpose', self._on_initialpose,
                                 PER_IMAGE)
        self._watchdog = InputWatchdog(self, 'images', lambda: self._inputs.topics,
                                       p.silence_s)
        self._rivals = RivalPublishers(self, lambda: self._inputs.topics,
                                       'end all but one, or remap the input')
        self.create_service(Trigger, '~/start', self._on_start)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_timer(1.0, self._diagnose, clock=STEADY)
        follow(self, self._check_change, self._change)

    def destroy_node(self):
        """End the thread, too."""
        if hasattr(self, '_worker'):
            self._worker.stop()
        super().destroy_node()

    @staticmethod
    def _transform_type() -> type:
        return transform_type('publish_tf')

    def _check_change(self, new: RorapidTrackerParameters):
        """Refuse parameters that contradict each other, or ask for what is not installed."""
        check_size(self._model, *tracker_options(new).control_points)
        if new.publish_tf:
            self._transform_type()

    def _change(self, new: RorapidTrackerParameters, old: RorapidTrackerParameters):
        """Do what changed parameters say; the tracker goes on with all that it has learned."""
        self._watchdog.limit_s = new.silence_s
        options = tracker_options(new)
        if options != tracker_options(old):
            self._worker.command(lambda session: session.set_options(options))
        self._inputs.choose(new.image_transport, new.reliability)
        if new.publish_tf and self._transforms is None:
            self._transforms = self.create_publisher(self._transform_type(), '/tf', 100)

    # what comes in

    def _on_image(self, msg):
        self._watchdog.heard()
        self._frame_id = msg.header.frame_id
        self._worker.submit(msg, self._overlay.get_subscription_count() > 0)

    def _on_camera_info(self, msg: CameraInfo):
        # drivers send the same calibration with every image
        key = (msg.width, msg.height, msg.distortion_model, msg.k.tobytes(), bytes(msg.d),
               msg.binning_x, msg.binning_y, msg.roi.x_offset, msg.roi.y_offset, msg.roi.width,
               msg.roi.height)
        if key == self._info_key:
            return
        self._info_key = key
        try:
            camera = image_camera_from_info(msg)
            if camera is not None and min(camera.width, camera.height) > 0:
                check_unfolded(camera, 'The CameraInfo is wrong')
        except InputError as error:
            self._refuse_camera(str(error))
            return
        if camera is None:
            self._refuse_camera('The camera_info is of a camera that is not calibrated (its focal '
                                'length is zero).')
            return
        self._info_problem = ''
        self.get_logger().info(f'calibration for {camera.width}x{camera.height} pixels: '
                               f'fx {camera.K[0, 0]:.1f}, fy {camera.K[1, 1]:.1f} px')
        self._worker.command(lambda session: session.set_camera(camera))

    def _refuse_camera(self, problem: str):
        self._info_problem = problem
        self.get_logger().warning(f'camera_info dropped: {problem}', throttle_duration_sec=5.0)

    def _on_initialpose(self, msg: PoseWithCovarianceStamped):
        try:
            frame = msg.header.frame_id
            if frame and self._frame_id and frame != self._frame_id:
                raise InputError(f'It is in the frame {frame!r:.60}, the images are in '
                                 f'{self._frame_id!r:.60}; give it in the frame of the images.')
            pose = pose_matrix(msg)
            sigma_m = distance_sigma(pose[:3, 3], msg.pose.covariance)
        except InputError as error:
            self.get_logger().warning(f'initialpose dropped: {error}')
            return
        self._begin(pose[:3, :3], pose[:3, 3], sigma_m)

    def _begin(self, rotation, translation, distance_sigma_m=None):
        def begin(session):
            session.start(rotation, translation, distance_sigma_m)
            self._start = rotation, translation, distance_sigma_m

        self._worker.command(begin, anew=True)

    def _on_start(self, _, response):
        if self._start is None:
            response.success = False
            response.message = ('there is no start pose; publish one on initialpose, or set the '
                                'parameter start_pose')
            return response
        self._begin(*self._start)
        response.success, response.message = True, 'tracking from the start pose'
        return response

    def _on_reset(self, _, response):
        self._worker.command(lambda session: session.reset(forget_pose=True), anew=True)
        self._say('waiting for a start pose')
        self._clear_markers()
        self._newest = None
        response.success = True
        response.message = 'stopped; ~/start or an initialpose starts it again'
        return response

    # what goes out

    def _publish(self):
        """Publish what the thread has finished."""
        while (done := self._worker.poll()) is not None:
            if isinstance(done, str):
                self.get_logger().warning(in_parameters(done))
            else:
                self._publish_image(done)

    def _publish_image(self, done: TrackedImage):
        self._newest = done
        if done.overlay is not None:
            self._overlay.publish(done.overlay)
        if done.problem:
            self.get_logger().warning(f'image dropped: {done.problem}', throttle_duration_sec=5.0)
            return
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
            self._pose.publish(pose_with_covariance_message(pose, tracked.covariance, done.header,
                                                            self._types))
            if self.parameters.publish_tf:
                self._send_transform(pose, done.header)
        if self._camera_info is not None and tracked.focal_sigma_px > 0:
            self._camera_info.publish(camera_info_message(
                zoomed_camera(camera, tracked), done.header, self._types))
        if self._markers.get_subscription_count():
            self._markers.publish(object_markers(
                self._segments, pose, done.header, self._types, MARKER_COLOURS[tracked.state],
                0.01 * self._model.diameter_m, MARKER_LIFE_S))

    def _send_transform(self, pose, header):
        self._transforms.publish(self._transform_type()(transforms=[transform_message(
            pose, header, self.parameters.object_frame, self._types)]))

    def _say(self, text: str, state: TrackerState | None = None):
        """Tell the state where it has changed."""
        if state is not None and state == self._state:
            return
        if state is TrackerState.LOST:
            self.get_logger().warning(text)
            self._clear_markers()
        else:
            self.get_logger().info(text)
        self._state = state
        self._states.publish(String(data=text))

    def _clear_markers(self):
        header = header_message(self.get_clock().now().nanoseconds, self._frame_id, self._types)
        self._markers.publish(delete_markers(header, self._types))

    def _diagnose(self):
        level, text, values = tracking_status(
            self._newest, self._info_problem, self._worker.dropped, self._watchdog.too_long_s)
        self._inputs.count.look()
        news = self._inputs.complaint(news=True)
        if news:
            self.get_logger().warning(news)
        complaint = self._rivals.complaint or self._inputs.complaint()
        if complaint:
            level, text = max(level, WARN), f'{complaint}; {text}'
        values.update(self._inputs.count.values)
        status = status_message(f'{diagnostic_name(self)}: tracking', level,
                                in_parameters(text), self._types, values,
                                self.parameters.camera_name)
        header = header_message(self.get_clock().now().nanoseconds, '', self._types)
        self._diagnostics.publish(diagnostics_message([status], header, self._types))


def distance_sigma(translation: np.ndarray, covariance) -> float | None:
    """Standard deviation of a pose's distance (m) from its covariance (36,); None without any."""
    place = np.reshape(covariance, (6, 6))[:3, :3]
    away = translation / max(float(np.linalg.norm(translation)), 1e-12)
    variance = float(away @ place @ away)
    return variance**0.5 if np.isfinite(variance) and variance > 0 else None


def tracker_options(parameters: RorapidTrackerParameters) -> TrackerOptions:
    """
    Translate the parameters.

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
             'texture', 'recovery')
    values = {name: getattr(parameters, name) for name in names}
    # rapid and rorapid keep to the least numbers of the thesis, which fewer points cannot reach
    default = TrackerOptions()
    return TrackerOptions(
        plane_axis=axis,
        least_per_line=min(default.least_per_line, values['control_points_per_line']),
        least_per_conic=min(default.least_per_conic, values['control_points_per_conic']),
        **values)
