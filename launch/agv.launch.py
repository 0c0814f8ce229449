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
Calibrate the camera of a robot while it drives; from a live camera, or from a bag.

ros2 launch selfcal_ros agv.launch.py image:=/camera/image_raw camera_name:=front
ros2 launch selfcal_ros agv.launch.py image:=/camera/image_raw composed:=true rviz:=true
ros2 launch selfcal_ros agv.launch.py bag:=/path/to/bag watch:=true
ros2 launch selfcal_ros agv.launch.py image:=/camera/image_raw robot:=/odom publish_tf:=true
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import (LaunchConfiguration, NotEqualsSubstitution,
                                  PathJoinSubstitution)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare
from selfcal_ros.nodes.launch_hooks import dds_settings, end_on_refusal, look_at_arguments

ARGUMENTS = {
    'image': ('image', 'image topic of the camera; <image>/compressed is found, too'),
    'camera_info': ('camera_info', 'where the CameraInfo goes; consumers look beside the image'),
    'driver_camera_info': ('driver/camera_info', 'CameraInfo of a driver without a calibration, '
                           'for its binning and region of interest'),
    'set_camera_info_service': ('', 'service of a driver that gets what is saved, such as '
                                '/camera/set_camera_info; empty: none'),
    'bag': ('', 'play this bag instead of listening to a camera'),
    'rate': ('1.0', 'playback speed'),
    'loop': ('false', 'play the bag again and again'),
    'namespace': ('', 'namespace of all nodes; one for each camera'),
    'camera_name': ('camera', 'name in the calibration file'),
    'output': ('', 'calibration file; empty: where camera drivers look'),
    'auto_save': ('false', 'write the file after every estimate'),
    'calibrator': ('planar_calibrator', 'planar_calibrator or affine_calibrator'),
    'robot': ('', 'poses of the robot, such as /odom or /tf:odom:base_link: where the camera sits '
              'is estimated, too; empty: none'),
    'mount_facts': ('', 'known parts of the mount, such as "z=0.52:0.01 roll=0"'),
    'publish_tf': ('false', 'publish the mount on /tf_static, once it is known'),
    'composed': ('false', 'all nodes in one process: least latency from image to CameraInfo'),
    'respawn': ('false', 'start a node again that has crashed'),
    'use_sim_time': ('false', 'take the time from /clock, as of a bag or a simulation'),
    'rviz': ('false', 'show tracks, path and structure in RViz'),
    'watch': ('false', 'serve a live page of the calibration; its address is logged'),
    'watch_port': ('8765', 'of the live page; 0: any that is free'),
    'params_file': (PathJoinSubstitution([FindPackageShare('selfcal_ros'), 'config',
                                          'agv.yaml']), 'parameters of the nodes'),
}


def generate_launch_description():
    """Start tracker and calibrator, apart or in one process; the player where a bag is given."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    share = FindPackageShare('selfcal_ros')
    # launch writes each group to a file of its own: a node reads what it knows
    calibrator = {name: ParameterValue(value[name], value_type=str) for name in (
        'camera_name', 'output', 'set_camera_info_service', 'robot', 'mount_facts')}
    for name in ('auto_save', 'publish_tf'):
        calibrator[name] = ParameterValue(value[name], value_type=bool)
    player = {'bag': ParameterValue(value['bag'], value_type=str),
              'rate': ParameterValue(value['rate'], value_type=float),
              'loop': ParameterValue(value['loop'], value_type=bool)}
    images = [('image', value['image']), ('image/compressed', [value['image'], '/compressed'])]
    infos = [('camera_info', value['camera_info']),
             ('driver/camera_info', value['driver_camera_info'])]
    apart = UnlessCondition(value['composed'])
    played = NotEqualsSubstitution(value['bag'], '')

    sim_time = {'use_sim_time': ParameterValue(value['use_sim_time'], value_type=bool)}

    def node(executable, parameters=(), remappings=(), condition=None, arguments=(),
             respawn=value['respawn']):
        return Node(package='selfcal_ros', executable=executable, output='screen',
                    namespace=value['namespace'], arguments=list(arguments), condition=condition,
                    parameters=[value['params_file'], *parameters], remappings=remappings,
                    respawn=respawn, respawn_delay=2.0, on_exit=end_on_refusal)

    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=description)
          for name, (default, description) in ARGUMENTS.items()),
        look_at_arguments(ARGUMENTS),
        *dds_settings(),
        node(value['calibrator'], [calibrator, sim_time], infos, apart),
        node('feature_tracker', [sim_time], images, apart),
        node('all_nodes', [calibrator, sim_time], images + infos, IfCondition(value['composed']),
             ['feature_tracker', value['calibrator']]),
        node('calibration_page', [{'port': ParameterValue(value['watch_port'], value_type=int)}],
             condition=IfCondition(value['watch'])),
        # at the end of the bag it is done
        node('bag_player', [player], images, IfCondition(played), respawn=False),
        Node(package='rviz2', executable='rviz2', condition=IfCondition(value['rviz']),
             namespace=value['namespace'], parameters=[sim_time],
             arguments=['-d', PathJoinSubstitution([share, 'config', 'selfcal.rviz'])]),
    ])
