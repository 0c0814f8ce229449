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
The live page: subscribes to what the nodes publish anyway, and shows it in a browser.

Without a browser it hears /diagnostics and a few tracks a second. Images are subscribed to while
somebody looks, and made smaller before they go out.
"""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial
from queue import Empty, SimpleQueue
import time
from typing import Any, TYPE_CHECKING

import cv2
from diagnostic_msgs.msg import DiagnosticArray
from msg_adapters.diagnostics import status_level
from msg_adapters.image import image_to_bgr
from msg_adapters.tracks import tracks_from_message
import numpy as np
from rclpy.client import Client
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.task import Future as RclpyFuture
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.nodes.construction import whole_or_none
from selfcal_ros.nodes.parameter_declaration import declare, follow
from selfcal_ros.nodes.parameters import CalibrationPageParameters
from selfcal_ros.nodes.quality_of_service import IMAGES_OUT, PER_IMAGE, STEADY
from selfcal_ros.nodes.ros_names import name_problem
from selfcal_ros.report.live_state import LiveState
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from selfcal_ros.nodes.page_server import PageServer

#: What the diagnostics of calibrators and trackers are called, after the name of the node.
CALIBRATION, IMAGES = ': calibration', ': images'
#: What a calibrator tells and no other node, whose diagnostics may end in the same word.
OUR_VALUES = {'keyframes', 'calibration file'}
#: Of so many tracks a second the page makes something.
TRACKS_HZ = 5.0
#: How often it looks after browsers, and tells them what is new.
LOOK_S, TELL_S = 0.2, 0.5
TRACKS, OVERLAY = 'tracks', 'feature_tracker/overlay'
JPEG_QUALITY = 80


class CalibrationPage(Node):
    """Serves the page of one calibrator: the one named, or the first that is heard."""

    @whole_or_none
    def __init__(self) -> None:
        super().__init__('calibration_page')
        self.parameters = declare(self, CalibrationPageParameters)
        named = self.parameters.calibrator.strip('/')
        why = self._cannot_watch(named) if self.parameters.calibrator else ''
        if why:
            raise ArgumentError(f'The parameter calibrator cannot be '
                                f'{self.parameters.calibrator!r:.80}: {why}; name a node, such as '
                                '/left/planar_calibrator.')
        self._state = LiveState()
        self._calibrator = ''
        self._tracks: Subscription | None = None
        self._overlay: Subscription | None = None
        self._buttons: dict[str, Any] = {}
        self._last_tracks_s = self._last_image_s = self._told_s = 0.0
        self._pressed: SimpleQueue[tuple[str, Future[tuple[bool, str]]]] = SimpleQueue()
        self._called = self.create_guard_condition(self._call)
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self.create_timer(LOOK_S, self._look, clock=STEADY)
        follow(self, lambda new: None, lambda new, old: None)
        self.server = _page_server()(self.parameters.host, self.parameters.port, self._press)
        self.get_logger().info(f'the live page is at {self.server.url}')
        if named:
            self._watch(named)

    def destroy_node(self) -> None:
        """End the server, too."""
        if hasattr(self, 'server'):
            self.server.close()
        super().destroy_node()  # type: ignore[no-untyped-call]

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in msg.status:
            if status.name.endswith(CALIBRATION):
                if OUR_VALUES <= {one.key for one in status.values}:
                    self._consider(status.name.removesuffix(CALIBRATION))
                if status.name == self._calibrator + CALIBRATION:
                    self._state.take_status(
                        self._calibrator, status.hardware_id, status_level(status),
                        status.message, {one.key: one.value for one in status.values}, now)
            elif status.name.endswith(IMAGES) and self._calibrator \
                    and _namespace(status.name) == _namespace(self._calibrator):
                self._state.take_images(status_level(status), status.message, now)

    def _consider(self, calibrator: str) -> None:
        """Watch the first calibrator that speaks, or rather the first of our namespace."""
        own = self.get_namespace().strip('/')
        if self.parameters.calibrator or self._calibrator \
                and _namespace(self._calibrator) == own:
            return
        if (not self._calibrator or _namespace(calibrator) == own) \
                and not self._cannot_watch(calibrator):
            self._watch(calibrator)

    def _cannot_watch(self, calibrator: str) -> str:
        """Say why there can be no calibrator of a name, or no tracker beside it."""
        return (name_problem(self, f'/{calibrator}/calibrate', is_service=True)
                or name_problem(self, self._beside(OVERLAY, calibrator)))

    def _watch(self, calibrator: str) -> None:
        """Take the tracks and the services of a calibrator."""
        self._calibrator = calibrator
        self.get_logger().info(f'watching /{calibrator}')
        for one in self._buttons.values():
            self.destroy_client(one)
        self._buttons = {}
        for old in filter(None, (self._tracks, self._overlay)):
            self.destroy_subscription(old)
        self._overlay = None
        # not decoded before it is known to be needed
        self._tracks = self.create_subscription(PointCloud2, self._beside(TRACKS, calibrator),
                                                self._on_tracks, PER_IMAGE, raw=True)

    def _beside(self, name: str, calibrator: str) -> str:
        """Name a topic of a calibrator's namespace, so that it can be remapped in ours."""
        space = _namespace(calibrator)
        if space == self.get_namespace().strip('/'):
            return name
        return f'/{space}/{name}' if space else f'/{name}'

    def _on_tracks(self, raw: bytes) -> None:
        now = time.monotonic()
        if now - self._last_tracks_s < 1 / TRACKS_HZ:
            return
        self._last_tracks_s = now
        try:
            frame = tracks_from_message(deserialize_message(raw, PointCloud2))
        except InputError as error:
            self.get_logger().warning(f'tracks dropped: {error}', throttle_duration_sec=5.0)
            return
        self._state.take_tracks(frame.track, frame.xy, frame.image_size, now)

    def _look(self) -> None:
        """Take images while somebody looks, and tell what is new."""
        is_wanted = self._calibrator and self.server.is_looked_at
        if is_wanted and self._overlay is None:
            self._overlay = self.create_subscription(
                Image, self._beside(OVERLAY, self._calibrator), self._on_overlay, IMAGES_OUT,
                raw=True)
        elif not is_wanted and self._overlay is not None:
            self.destroy_subscription(self._overlay)
            self._overlay = None
        now = time.monotonic()
        if self.server.is_open and now - self._told_s > TELL_S:
            self._told_s = now
            self.server.tell(self._state.as_dict(now))

    def _on_overlay(self, raw: bytes) -> None:
        now = time.monotonic()
        if now - self._last_image_s < 1 / self.parameters.image_rate \
                or not self.server.is_waited_for:
            return
        self._last_image_s = now
        try:
            jpeg = small_jpeg(image_to_bgr(deserialize_message(raw, Image)),
                              self.parameters.image_width)
        except InputError as error:
            self.get_logger().warning(f'image dropped: {error}', throttle_duration_sec=5.0)
            return
        self.server.show(jpeg)

    def _press(self, action: str) -> Future[tuple[bool, str]]:
        """Take a button, in the thread of the server; the executor does the rest."""
        answer: Future[tuple[bool, str]] = Future()
        self._pressed.put((action, answer))
        self._called.trigger()
        return answer

    def _call(self) -> None:
        """Call the services whose buttons were pressed."""
        while True:
            try:
                action, answer = self._pressed.get_nowait()
            except Empty:
                return
            if not self._calibrator:
                _settle(answer, False, 'no calibrator speaks on /diagnostics')
                continue
            client = self._buttons.get(action)
            if client is None:
                client = self._buttons[action] = self.create_client(
                    Trigger, f'/{self._calibrator}/{action}')
            self._ask(client, answer, time.monotonic() + 3.0)

    def _ask(self, client: Client, answer: Future[tuple[bool, str]], until_s: float) -> None:
        """Call a service once it is there."""
        if client.service_is_ready():
            client.call_async(Trigger.Request()).add_done_callback(partial(_answered, answer))
        elif time.monotonic() > until_s:
            _settle(answer, False, f'nobody offers {client.srv_name}')
        else:
            timer = self.create_timer(0.05, lambda: (
                self.destroy_timer(timer),
                self._ask(client, answer, until_s)  # type: ignore[func-returns-value]
            ), clock=STEADY)


def _answered(answer: Future[tuple[bool, str]], call: RclpyFuture) -> None:
    """Hand over what a service has answered."""
    if call.exception() is not None:
        _settle(answer, False, str(call.exception()))
    else:
        _settle(answer, bool(call.result().success), str(call.result().message))


def _settle(answer: Future[tuple[bool, str]], success: bool, message: str) -> None:
    # the browser may have gone away
    if answer.set_running_or_notify_cancel():
        answer.set_result((success, message))


def small_jpeg(bgr: np.ndarray, width: int) -> bytes:
    """
    Return an image as a JPEG for a browser.

    Parameters
    ----------
    bgr : ndarray of uint8, shape (H, W, 3)
    width : int
        Wider ones are made smaller.

    """
    if bgr.shape[1] > width:
        height = max(1, round(bgr.shape[0] * width / bgr.shape[1]))
        bgr = cv2.resize(bgr, (width, height), interpolation=cv2.INTER_AREA)
    return cv2.imencode('.jpg', bgr, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes()


def _namespace(name: str) -> str:
    """Return the namespace of a node as the diagnostics name it: '' for the root."""
    return name.partition(':')[0].rpartition('/')[0]


def _page_server() -> type[PageServer]:
    """Return the class of the server, whose library need not be there."""
    try:
        from selfcal_ros.nodes.page_server import PageServer
    except ImportError as error:
        if (error.name or '').partition('.')[0] != 'tornado':
            raise
        raise ArgumentError("The live page needs Tornado: sudo apt install python3-tornado (or "
                            "pip install '.[watch]' in the clone).") from None
    return PageServer
