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
Calibrate the camera of an arm while it moves; from a live camera, or from a bag.

ros2 launch selfcal_ros arm.launch.py image:=/camera/image_raw camera_name:=gripper
ros2 launch selfcal_ros arm.launch.py bag:=/path/to/bag

The arguments are those of agv.launch.py.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    """Start what agv.launch.py starts, with the calibrator for free motion."""
    share = FindPackageShare('selfcal_ros')
    return LaunchDescription([
        # declared here, so that these are the defaults and not what agv.launch.py has
        DeclareLaunchArgument('calibrator', default_value='affine_calibrator'),
        DeclareLaunchArgument('params_file', description='parameters of the nodes',
                              default_value=PathJoinSubstitution([share, 'config', 'arm.yaml'])),
        IncludeLaunchDescription(PythonLaunchDescriptionSource(
            PathJoinSubstitution([share, 'launch', 'agv.launch.py']))),
    ])
