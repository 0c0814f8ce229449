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
"""The topic that tells poses of the robot: found, subscribed to, and what is wrong with it."""

from __future__ import annotations

from importlib import import_module

from msg_adapters.body_poses import POSE_TYPES
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.nodes.parameters import CalibratorParameters
from selfcal_ros.nodes.quality_of_service import STEADY
from selfcal_ros.nodes.ros_names import name_problem
from selfcal_ros.nodes.tf_messages import transform_type
from selfcal_ros.pipeline.calibration_session import CalibrationSession
from selfcal_ros.pipeline.estimate_request import EstimateRequest
from selfcal_ros.pipeline.robot.live_robot import LiveRobot, RobotSnapshot
from selfcal_ros.pipeline.robot.pose_checks import PoseReading
from selfcal_ros.pipeline.robot.robot_source import RobotSource
from selfcal_ros.pipeline.robot.stated import mount_facts, stated_sigmas

#: Poses: best effort matches every publisher; a second of the fastest may wait.
POSES_IN = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
POSES_IN_RELIABLE = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)
#: As tf2's listeners have it.
TF_IN = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
TF_STATIC_IN = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE,
                          durability=DurabilityPolicy.TRANSIENT_LOCAL)


def live_robot(node: Node, parameters: CalibratorParameters) -> LiveRobot | None:
    """
    Return what gathers the poses that parameters of a node ask for; None where they ask for none.

    Raises
    ------
    ArgumentError, InputError
        If a parameter is impossible, or something is not installed.

    """
    p = parameters
    if not p.robot:
        given = [name for name in ('robot_sigma', 'robot_unit', 'robot_frame', 'mount_facts',
                                   'camera_frame', 'publish_tf') if getattr(p, name)]
        given += ['robot_kind'] if p.robot_kind != 'auto' else []
        if given:
            raise ArgumentError(f'The parameter {given[0]} needs the poses of a robot: the '
                                'parameter robot, such as /odom or /tf:odom:base_link.')
        return None
    reading = PoseReading(None if p.robot_kind == 'auto' else p.robot_kind,
                          *stated_sigmas(p.robot_sigma), p.robot_unit or None,
                          p.robot_frame or None)
    source = RobotSource.parse(p.robot, reading)
    if source.table is not None:
        raise ArgumentError(f'The parameter robot takes a topic, such as /odom, not the table '
                            f'{p.robot}.')
    why = name_problem(node, source.topic)
    if why:
        raise ArgumentError(f'The parameter robot cannot be {p.robot!r:.80}: {why}; name a topic, '
                            'such as /odom.')
    if source.frames is not None:
        transform_type(f'robot:={p.robot}')
    return LiveRobot(source, mount_facts(p.mount_facts.replace(',', ' ').split()))


class RobotTopic:
    """
    Listens to the robot, once there is somebody who speaks.

    Parameters
    ----------
    node : rclpy.node.Node
    session : CalibrationSession
        Poses near its views are kept longest.
    robot : LiveRobot or None
        None: there is nothing to listen to.

    """

    def __init__(self, node: Node, session: CalibrationSession, robot: LiveRobot | None) -> None:
        self._node, self._session, self.robot = node, session, robot
        self._topic = '' if robot is None else robot.source.topic
        self._kind = ''
        self._profile: QoSProfile | None = None
        self._subscription: Subscription | None = None
        if robot is None:
            return
        if robot.source.frames is not None:
            kind = transform_type('robot')
            node.create_subscription(kind, '/tf', lambda msg: robot.add_transforms(msg, False),
                                     TF_IN)
            node.create_subscription(kind, '/tf_static',
                                     lambda msg: robot.add_transforms(msg, True), TF_STATIC_IN)
            self._kind = 'tf2_msgs/msg/TFMessage'
        node.create_timer(0.25, self._look, clock=STEADY)

    @property
    def topics(self) -> list[str]:
        """Resolved name of the topic that one robot alone should speak on; TF has many."""
        if self.robot is None or self.robot.source.frames is not None:
            return []
        return [self._node.resolve_topic_name(self._topic)]

    def _look(self) -> None:
        """Listen to who publishes the topic, and keep within bounds."""
        robot = self.robot
        if robot is None:
            return
        if robot.source.frames is None:
            self._subscribe(robot)
        if robot.is_full:
            robot.thin(frame.stamp_ns for frame in self._session.keyframes)

    def _subscribe(self, robot: LiveRobot) -> None:
        """Listen as poses are sent now: who sends them may end, and begin again in another way."""
        publishers = [one for one in self._node.get_publishers_info_by_topic(
            self._node.resolve_topic_name(self._topic)) if one.topic_type in POSE_TYPES]
        kinds = [one.topic_type for one in publishers]
        if not kinds or self._kind and self._kind not in kinds:
            return
        # that of the poses so far
        kind = self._kind or kinds[0]
        reliable = all(one.qos_profile.reliability is ReliabilityPolicy.RELIABLE
                       for one in publishers if one.topic_type == kind)
        profile = POSES_IN_RELIABLE if reliable else POSES_IN
        if profile is self._profile:
            return
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self._kind, self._profile = kind, profile
        package, _, name = kind.split('/')
        self._subscription = self._node.create_subscription(
            getattr(import_module(f'{package}.msg'), name), self._topic,
            lambda msg: robot.add(msg, kind), profile)

    def _kinds(self) -> dict[str, list[str]]:
        return dict(self._node.get_topic_names_and_types())

    def with_poses(self, request: EstimateRequest) -> EstimateRequest:
        """Return a request with what the robot has told so far."""
        return request if self.robot is None else request.with_robot(self.told())

    def told(self) -> RobotSnapshot | None:
        """Return what the robot has told so far; None where that is nothing, or of no use."""
        if self.robot is None:
            return None
        try:
            return self.robot.snapshot()
        except InputError as error:
            self._node.get_logger().warning(f'poses of the robot: {error}',
                                            throttle_duration_sec=5.0)
            return None

    @property
    def lacks(self) -> bool:
        """Whether there are poses by now that a calibration in force has not seen."""
        calibration = self._session.calibration
        return (self.robot is not None and calibration is not None and len(self.robot) > 1
                and not calibration.mount)

    def complaint(self) -> str:
        """Say what is wrong with the poses; '' if nothing is."""
        if self.robot is None:
            return ''
        if not len(self.robot):
            if self.robot.dropped:
                return f'no pose of {self._topic} is of use: {self.robot.why_dropped}'
            return self._nobody()
        frames = self.robot.source.frames
        if frames is not None:
            there = self.robot.frames()
            missing = [name for name in frames if name not in there]
            if missing:
                return f'TF has no frame {missing[0]}; it has {", ".join(there[:30])}'
        return ''

    def _nobody(self) -> str:
        """Say that nobody speaks, and who does elsewhere."""
        kinds = self._kinds()
        own = kinds.get(self._node.resolve_topic_name(self._topic), [])
        if own and not self._kind:
            begin = f'{self._topic} carries {own[0]}, which holds no poses of a robot'
        else:
            begin = f'no poses on {self._topic} yet'
        others = sorted(name for name, types in kinds.items() if set(types) & set(POSE_TYPES)
                        and name != self._node.resolve_topic_name(self._topic))
        return f'{begin}; poses are on {", ".join(others[:12])}' if others else begin

    def values(self) -> dict[str, int | str]:
        """Return counts for the diagnostics."""
        if self.robot is None:
            return {}
        found: dict[str, int | str] = {'robot poses': len(self.robot),
                                       'robot poses dropped': self.robot.dropped}
        if self.robot.why_dropped:
            found['robot poses last dropped'] = self.robot.why_dropped
        back = sum(one.set_back for one in self.robot.buffers)
        if back:
            found['robot clock set back'] = back
        return found
