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
Track a known object; from a live camera, or from a bag.

ros2 launch selfcal_ros track.launch.py image:=/camera/image_raw camera_info:=/camera/camera_info
model:=/path/to/object.cao start_pose:="0 0 0.5 0 0 0"
ros2 launch selfcal_ros track.launch.py bag:=/path/to/bag camera_file:=/path/to/camera.yaml
model:=/path/to/object.cao start_pose:="0 0 0.5 0 0 0"
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import (LaunchConfiguration, NotEqualsSubstitution,
                                  PathJoinSubstitution)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare
from selfcal_ros.nodes.launch_hooks import dds_settings, end_on_refusal, look_at_arguments

ARGUMENTS = {
    'image': ('image', 'image topic of the camera; <image>/compressed is found, too'),
    'camera_info': ('camera_info', 'where the calibration of the camera comes from'),
    'model': ('', 'the object: a wireframe (.cao, .yaml) or a mesh (.stl, .obj, .ply)'),
    'model_scale': ('1.0', 'metres per unit of a mesh: 0.001 where it is in millimetres'),
    'start_pose': ('', '"tx ty tz rx ry rz", or a .pos file; empty: wait for initialpose'),
    'camera_file': ('', 'calibration file, where nobody publishes a camera_info'),
    'camera_model': ('perspective', 'perspective, zoom, weak or affine'),
    'motion': ('general', 'general, translation or planar'),
    'bag': ('', 'play this bag instead of listening to a camera'),
    'rate': ('1.0', 'playback speed'),
    'loop': ('false', 'play the bag again and again'),
    'namespace': ('', 'namespace of all nodes; one for each camera'),
    'respawn': ('false', 'start a node again that has crashed'),
    'use_sim_time': ('false', 'take the time from /clock, as of a bag or a simulation'),
    'params_file': (PathJoinSubstitution([FindPackageShare('selfcal_ros'), 'config',
                                          'track.yaml']), 'parameters of the nodes'),
}


def generate_launch_description():
    """Start the tracker, and the player where a bag is given."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    text = {name: ParameterValue(value[name], value_type=str)
            for name in ('bag', 'model', 'start_pose', 'camera_file', 'camera_model', 'motion')}
    topics = [('image', value['image']), ('image/compressed', [value['image'], '/compressed'])]
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=description)
          for name, (default, description) in ARGUMENTS.items()),
        look_at_arguments(ARGUMENTS),
        *dds_settings(),
        Node(package='selfcal_ros', executable='rorapid_tracker', output='screen',
             namespace=value['namespace'],
             remappings=[*topics, ('camera_info', value['camera_info'])],
             respawn=value['respawn'], respawn_delay=2.0, on_exit=end_on_refusal,
             parameters=[value['params_file'],
                         {name: text[name] for name in text if name != 'bag'},
                         {'model_scale': ParameterValue(value['model_scale'], value_type=float),
                          'use_sim_time': ParameterValue(value['use_sim_time'],
                                                         value_type=bool)}]),
        Node(package='selfcal_ros', executable='bag_player', output='screen',
             namespace=value['namespace'], remappings=topics, on_exit=end_on_refusal,
             condition=IfCondition(NotEqualsSubstitution(value['bag'], '')),
             parameters=[value['params_file'],
                         {'bag': text['bag'],
                          'rate': ParameterValue(value['rate'], value_type=float),
                          'loop': ParameterValue(value['loop'], value_type=bool)}]),
    ])
