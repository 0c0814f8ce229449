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
The calibrators: tracks in, a CameraInfo for every image out, better as the motion goes on.

planar_calibrator and affine_calibrator are this node under two names; they differ in what they
take for the motion of the camera unless told.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray
from msg_adapters.diagnostics import diagnostics_message, status_message, WARN
from msg_adapters.message_types import Message, rclpy_types
from msg_adapters.stamps import header_message, stamp_ns
from msg_adapters.tracks import tracks_from_message
import numpy as np
from rclpy.node import Node
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import InputError, SelfcalError
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.nodes.calibration_file import CalibrationFile
from selfcal_ros.nodes.calibration_status import calibration_status, NOTHING_NEW, UNDER_WAY
from selfcal_ros.nodes.change_watch import ChangeWatch
from selfcal_ros.nodes.construction import whole_or_none
from selfcal_ros.nodes.diagnostic_name import diagnostic_name
from selfcal_ros.nodes.estimation_job import Job, JobKind, JobResult
from selfcal_ros.nodes.estimation_worker import EstimationWorker
from selfcal_ros.nodes.input_watchdog import InputWatchdog
from selfcal_ros.nodes.loss_count import LossCount
from selfcal_ros.nodes.mount_publisher import mount_line, mount_values, MountPublisher
from selfcal_ros.nodes.once_per_image import announcements_of, OncePerImage
from selfcal_ros.nodes.parameter_declaration import declare, follow
from selfcal_ros.nodes.parameter_words import in_parameters
from selfcal_ros.nodes.parameters import CalibratorParameters
from selfcal_ros.nodes.quality_of_service import LATCHED, PER_IMAGE, STEADY
from selfcal_ros.nodes.rival_publishers import RivalPublishers
from selfcal_ros.nodes.robot_topic import live_robot, RobotTopic
from selfcal_ros.nodes.scene_publisher import prepare_scene, ScenePublisher
from selfcal_ros.nodes.sensor_roi import SensorRoi
from selfcal_ros.nodes.session_settings import monitor_settings, session_settings
from selfcal_ros.nodes.stored_camera import StoredCamera
from selfcal_ros.nodes.tf_messages import transform_type
from selfcal_ros.nodes.upload import CameraInfoUpload, check_service
from selfcal_ros.pipeline.calibration_session import CalibrationSession, Interruption
from selfcal_ros.pipeline.estimate_request import EstimateRequest
from selfcal_ros.report.result_json import result_to_json
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from selfcal_ros.nodes.estimation_process import EstimationProcess


class CalibratorNode(Node):
    """
    Turns `tracks` into `camera_info`, `~/result`, diagnostics and the scene.

    The `camera_info` of an image that is announced on `tracks/announced` does not wait for them.

    Parameters
    ----------
    name : str
    table : type
        Its parameters: `CalibratorParameters` or a class derived from it.
    worker : type
        Who estimates: `EstimationWorker`, a thread, or `EstimationProcess`.

    """

    @whole_or_none
    def __init__(self, name: str, table: type[CalibratorParameters],
                 worker: Callable[[], EstimationWorker | EstimationProcess] = EstimationWorker,
                 ) -> None:
        super().__init__(name)
        self.parameters = declare(self, table)
        self._file = CalibrationFile(self.parameters.camera_name, self.parameters.output)
        self._upload = CameraInfoUpload(self, self.parameters.set_camera_info_service)
        self._session = CalibrationSession(session_settings(self.parameters))
        self._stored = StoredCamera(self._file, self.get_logger()
                                    ) if self.parameters.begin_with_file else None
        self._robot = RobotTopic(self, self._session, live_robot(self, self.parameters))
        self._mount = MountPublisher(self, self.parameters.publish_tf)
        self._scene = ScenePublisher(self, self.parameters.world_frame)
        self._worker = worker()
        self._watch = ChangeWatch(self._session, self.get_logger(),
                                  monitor_settings(self.parameters), self._robot.told)
        self._takers: dict[JobKind, Callable[[JobResult[Any]], None]] = {
            JobKind.ESTIMATE: self._take_estimate,
            JobKind.WINDOW_SCORE: self._watch.take}
        self._types = rclpy_types()
        self._size = (0, 0)
        self._driver = SensorRoi(self, self._begin_anew)
        self._camera_info = self.create_publisher(CameraInfo, 'camera_info', PER_IMAGE)
        self._result = self.create_publisher(String, '~/result', LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # rclpy hands the number of a message to who takes two arguments, and its types know one
        self.tracks: Any = self.create_subscription(
            PointCloud2, 'tracks', self._on_tracks, PER_IMAGE)  # type: ignore[arg-type]
        self._announced = self.create_subscription(
            CameraInfo, announcements_of(self.tracks.topic_name), self._on_announced, PER_IMAGE)
        self._messages = OncePerImage()
        self._count = LossCount()
        self._watchdog = InputWatchdog(self, 'tracks', self._topics, self.parameters.silence_s)
        self._rivals = RivalPublishers(
            self, lambda: [self._camera_info.topic_name],
            'whoever listens gets both; remap camera_info of this node, or end the other')
        self._mixed = RivalPublishers(
            self, lambda: self._topics() + self._robot.topics,
            'what they say is mixed here; end all but one, or remap the input')
        self.create_service(Trigger, '~/calibrate', self._on_calibrate)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(Trigger, '~/save', self._on_save)
        self.create_timer(0.05, self._estimate, clock=STEADY)
        self.create_timer(1.0, self._diagnose, clock=STEADY)
        follow(self, self._check_change, self._change)

    def _topics(self) -> list[str]:
        """Return the topics that are subscribed now."""
        return [self.tracks.topic_name] if self.tracks else []

    def _check_change(self, new: CalibratorParameters) -> None:
        """Refuse parameters that contradict each other, or name what cannot be."""
        session_settings(new), monitor_settings(new)
        CalibrationFile(new.camera_name, new.output)
        check_service(self, new.set_camera_info_service)
        live_robot(self, new)
        if new.publish_tf:
            transform_type('publish_tf')

    def _change(self, new: CalibratorParameters, old: CalibratorParameters) -> None:
        """Do what changed parameters say, from the next estimate on."""
        self._watchdog.limit_s = new.silence_s
        if new.output != old.output:
            self._file = CalibrationFile(new.camera_name, new.output)
        if new.set_camera_info_service != old.set_camera_info_service:
            self._upload.close()
            self._upload = CameraInfoUpload(self, new.set_camera_info_service)
        self._session.change(session_settings(new))
        self._watch.change(monitor_settings(new))
        self._mount.change(new.publish_tf)

    def _on_tracks(self, msg: PointCloud2, about: dict[str, Any]) -> None:
        self._watchdog.heard()
        self._count.arrive(about.get('publication_sequence_number'), len(msg.data),
                           alone=self.count_publishers(self.tracks.topic_name) <= 1)
        try:
            frame = tracks_from_message(msg)
        except InputError as error:
            self.get_logger().warning(f'tracks dropped: {error}', throttle_duration_sec=5.0)
        else:
            # a message without points does not tell the size
            self._size = frame.image_size or self._size
            if frame.image_size:
                self._interrupted(self._session.add_tracks(
                    frame.stamp_ns, frame.track, frame.xy, frame.image_size))
                self._watch.offer(frame.image_size)
        if self._messages.is_first('tracks', stamp_ns(msg.header.stamp)):
            self._publish_camera_info(msg.header)

    def _on_announced(self, msg: CameraInfo) -> None:
        """Publish the CameraInfo of an image whose tracks will follow."""
        # one of another size waits for its tracks, which begin anew
        if (msg.width, msg.height) == self._size and self._messages.is_first(
                'announced', stamp_ns(msg.header.stamp)):
            self._publish_camera_info(msg.header)

    def listen_no_more(self) -> None:
        """End the subscriptions: tracks come by `take`."""
        for subscription in (self.tracks, self._announced):
            self.destroy_subscription(subscription)
        self.tracks = None

    def announce(self, header: Message, image_size: tuple[int, int]) -> None:
        """Publish the CameraInfo of an image whose tracks will follow (`TracksListener`)."""
        self._watchdog.heard()
        self._size = image_size
        self._interrupted(self._session.expect(stamp_ns(header.stamp), image_size))
        self._publish_camera_info(header)

    def take(self, header: Message, image_size: tuple[int, int], ids: np.ndarray,
             xy: np.ndarray) -> None:
        """Take the tracks of the image that was announced (`TracksListener`)."""
        self._session.add_tracks(stamp_ns(header.stamp), ids, xy, image_size)
        self._watch.offer(image_size)

    def _publish_camera_info(self, header: Message) -> None:
        self._mount.camera_frame = self.parameters.camera_frame or header.frame_id.lstrip('/')
        calibration = self._session.calibration
        camera = calibration.camera_of(self._session.newest) if calibration else None
        if camera is None and self._stored is not None:
            camera = self._stored.of_images(self._driver, self._size)
        self._camera_info.publish(self._driver.message(camera, header, self._size, self._types))

    def _estimate(self) -> None:
        """Fetch a result that is ready, and start another estimate where that is worthwhile."""
        done = self._worker.poll()
        if done is not None:
            self._takers[done.job.kind](done)
        window = self._watch.next_job()
        if window is not None:
            self._worker.submit(window)
        if self._session.is_due(idle=self._watchdog.silent_s > self.parameters.idle_s):
            self._start()

    def _start(self) -> int:
        """Start an estimate; returns the number of its views, 0 if there is none to start."""
        request = self._session.request()
        if request is None:
            return 0
        self._worker.submit(Job(JobKind.ESTIMATE, self._robot.with_poses(request),
                                partial(prepare_scene, self.parameters.world_frame)))
        return request.keyframes

    def _take_estimate(self, done: JobResult[EstimateRequest]) -> None:
        """Take a calibration, or the reason why there is none."""
        request, scene = done.job.request, done.prepared
        result = self._mount.named(done.value)
        if not self._session.accept(request, result):
            return
        kept = self._session.calibration
        if result and kept is not None and kept is not result:
            self.get_logger().info('the new calibration is less precise than the one in force, '
                                   'which stays')
            self._publish_result(kept)
            return
        if result and result.focal is None:
            self._watch.watch(result, request)
        elif result:
            # a lens that zooms would be blamed for that alone
            self._watch.forget()
        self._publish_result(result)
        if not result:
            self.get_logger().info(in_parameters(str(result)), throttle_duration_sec=5.0)
            return
        sigma = result.sigma
        self.get_logger().info(
            'fx {:.1f} ± {:.2g}, fy {:.1f} ± {:.2g}, cx {:.1f} ± {:.2g}, cy {:.1f} ± {:.2g} px '
            'from {} views'.format(*(v for name, value in zip(
                ('fx', 'fy', 'cx', 'cy'), result.camera.parameters) for v in (value, sigma[name])),
                len(result.frames)))
        if result.mount is not None:
            self.get_logger().info(in_parameters(mount_line(result.mount, result.findings)))
        self._mount.take(result.mount)
        if scene is not None:
            self._scene.publish(scene)
        if self.parameters.auto_save:
            try:
                self._save(result)
            except SelfcalError as error:
                self.get_logger().error(str(error), throttle_duration_sec=30.0)

    def _publish_result(self, result: Calibration | NotCalibrated) -> None:
        self._result.publish(String(data=in_parameters(result_to_json(result))))

    def _save(self, calibration: Calibration) -> str:
        """Write the file and give it to a driver; returns what was done."""
        camera = self._driver.full_camera(calibration.camera)
        written = f'written to {self._file.write(calibration, camera)}'
        return '; '.join(filter(None, (written, self._upload.send(camera))))

    def _interrupted(self, interruption: Interruption | None) -> None:
        """Tell why tracks begin anew; a calibration in force stays where it is still one."""
        if interruption is None:
            return
        if interruption.forgets or self._session.calibration is None:
            self._forgotten(interruption.reason)
            return
        self._watch.interrupt()
        self.get_logger().info(f'{interruption.reason}: tracks begin anew, the calibration stays '
                               'in force', throttle_duration_sec=5.0)

    def _begin_anew(self, reason: str) -> None:
        self._session.reset()
        self._forgotten(reason)

    def _forgotten(self, reason: str) -> None:
        """Tell everybody that what was known is void."""
        self.get_logger().info(f'starting anew: {reason}')
        self._watch.forget()
        self._publish_result(NotCalibrated.of(NoEstimate('session_reset', why=reason)))
        self._mount.forget()
        self._scene.clear()

    def _on_calibrate(self, _: Trigger.Request,
                      response: Trigger.Response) -> Trigger.Response:
        self._watch.release()
        state = self._session.snapshot()
        if (state.calibration and not state.new_keyframes and not state.estimating
                and not self._robot.lacks):
            self._publish_result(state.calibration)
            response.success = True
            response.message = NOTHING_NEW
            return response
        views = self._start()
        response.success = views > 0
        if views:
            response.message = f'estimating from {views} views; the result comes on ~/result'
        elif state.keyframes < 3:
            response.message = (f'{state.keyframes} views with parallax so far, three are needed: '
                                'keep moving')
        else:
            response.message = UNDER_WAY[state.abandoned]
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._stored = None
        self._begin_anew('~/reset was called')
        response.success, response.message = True, 'starting anew'
        return response

    @property
    def _serves_file(self) -> bool:
        """Whether the calibration of an earlier run is published."""
        return (self._stored is not None and self._stored.used
                and self._session.calibration is None)

    def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        calibration = self._session.calibration
        if calibration is None:
            failure = self._session.snapshot().failure
            hint = f': {failure.reason}' if failure is not None and failure.is_hint else ''
            response.success = False
            response.message = f'there is no calibration yet{hint}'
            if self._serves_file:
                response.message += '; the file of an earlier run stays as it is'
            return response
        try:
            response.message = self._save(calibration)
            response.success = True
        except SelfcalError as error:
            response.success, response.message = False, str(error)
        return response

    def _diagnose(self) -> None:
        level, text, values = self._watch.judge(
            *calibration_status(self._session.snapshot()))
        values |= self._file.values(self._session.calibration)
        if self._serves_file and self._stored is not None:
            text = f'the calibration of {self._stored.path} is in force; {text}'
            values |= self._stored.values()
        complaint = (self._mixed.complaint or self._rivals.complaint or self._loss()
                     or self._robot.complaint())
        values |= self._robot.values()
        calibration = self._session.calibration
        values |= mount_values(calibration.mount if calibration else None)
        if self._mount.why_not and calibration:
            text = f'{text}; {self._mount.why_not}'
        if self._watchdog.too_long_s:
            level, text = WARN, f'no tracks for {self._watchdog.silent_s:.0f} s; {text}'
        elif complaint:
            level, text = WARN, f'{complaint}; {text}'
        values['tracks lost'] = self._count.lost + self._count.overrun
        status = status_message(f'{diagnostic_name(self)}: calibration', level,
                                in_parameters(text), self._types, values,
                                self.parameters.camera_name)
        header = header_message(self.get_clock().now().nanoseconds, '', self._types)
        self._diagnostics.publish(diagnostics_message([status], header, self._types))

    def _loss(self) -> str:
        """Say which tracks are being lost; warn once where some are."""
        self._count.look()
        where = ('tracks', ', '.join(self._topics()), False)
        news = self._count.news(*where)
        if news:
            self.get_logger().warning(news)
        return self._count.complaint(*where)
