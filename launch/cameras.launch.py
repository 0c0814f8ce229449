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
Calibrate several cameras at once, each in a namespace of its own.

ros2 launch selfcal_ros cameras.launch.py cameras:=left,right

Camera `left` publishes /left/image_raw, gets /left/camera_info, and its file is left.yaml. The
arguments of agv.launch.py hold for all of them; in `output`, ${NAME} is the name of the camera.
"""

from launch import LaunchDescription
from launch.actions import (DeclareLaunchArgument, GroupAction, IncludeLaunchDescription,
                            OpaqueFunction)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare
from selfcal_ros.nodes.launch_arguments import shared_file_problem, shared_topic_problem


def include_each(context):
    """Include agv.launch.py once for each name."""
    names = LaunchConfiguration('cameras').perform(context).replace(',', ' ').split()
    given = context.launch_configurations
    problem = (shared_file_problem(names, given.get('output', ''))
               or shared_topic_problem(names, given))
    if problem:
        raise RuntimeError(problem)
    path = PathJoinSubstitution([FindPackageShare('selfcal_ros'), 'launch', 'agv.launch.py'])
    # a source of its own for each: one that is shared would start the same nodes twice
    return [GroupAction([IncludeLaunchDescription(
        PythonLaunchDescriptionSource(path),
        launch_arguments={'namespace': name, 'camera_name': name,
                          'image': LaunchConfiguration('image')}.items())])
            for name in dict.fromkeys(names)]


def generate_launch_description():
    """Start the nodes of every camera."""
    return LaunchDescription([
        DeclareLaunchArgument('cameras', description='names, separated by commas'),
        DeclareLaunchArgument('image', default_value='image_raw',
                              description='image topic, relative to the name of the camera'),
        OpaqueFunction(function=include_each),
    ])
